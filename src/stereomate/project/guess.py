"""What a file of orientations leaves open, decided by the tie and control points of a project.

A file that does not say about which axes its angles turn, or in which unit, is read in every way that it
allows; each reading is judged by the forward intersection of the project's points, and the audit then tells
the kind of heights and whether the centres were adjusted in the grid.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import FormatError, InputError, ProjectError
from stereomate.formats.declared import Declared, MatrixDirection
from stereomate.formats.exchange import format_named
from stereomate.formats.orientation_set import OrientationSet, converted
from stereomate.frames.attitude import AttitudeAxes, AttitudeConvention, Mount
from stereomate.frames.audit.evaluation import Evaluator
from stereomate.frames.audit.findings import Audit, attitude_fits
from stereomate.frames.audit.observations import AuditObservations, WrittenBlock
from stereomate.frames.audit.ranking import AttitudeFit, attitude_score, certainty, ground_height
from stereomate.frames.audit.readings import AttitudeReading, HeightCandidate, attitude_readings
from stereomate.frames.checks import check_coordinates
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.project.audit import audit_block, height_candidates
from stereomate.project.loader import project_frame
from stereomate.project.observations import observations_for, photo_cameras
from stereomate.project.reading import read_project_file
from stereomate.project.schema import ProjectFile

Array = NDArray[np.float64]

# What a reader may ask for, and what to try then; degrees with minutes look like any decimal number.
_CHOICES: Final[dict[str, tuple[str, ...]]] = {
    "axes": get_args(AttitudeAxes),
    "unit": ("deg", "gon", "rad"),
    "mount": get_args(Mount),
    "matrix": get_args(MatrixDirection),
    "order": ("opk", "rph"),
    "opensfm_frame": ("projected", "topocentric"),
}
_SAMPLE: Final = 250
_UNDECIDED: Final = 4.0
_BETTER: Final = 9.0
_GRID: Final = AttitudeConvention("matrix", "grid")
_ELLIPSOIDAL: Final = HeightCandidate("ellipsoidal", "ellipsoidal heights", HeightSystem.ellipsoidal())


@dataclass(frozen=True)
class Guess:
    """Declarations completed by an audit.

    Attributes
    ----------
    declared : Declared
    grid_reference_height : float or None
        Where the centres were adjusted in the grid: the height of the control, in the orientation's heights.
    notes : tuple of str
        What was guessed, the evidence, how sure it is, and what stays open.
    """

    declared: Declared
    grid_reference_height: float | None
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Candidate:
    """One way to read the file."""

    declared: Declared
    guessed: tuple[tuple[str, str], ...]
    orientations: OrientationSet
    block: WrittenBlock
    # Supposes another order of the angles than the one every format means by its columns.
    unusual: bool = False
    rms_px: tuple[float, float] = field(default=(np.inf, np.inf))

    @property
    def words(self) -> str:
        """What it takes the file to mean."""
        return ", ".join(f"{key} {value}" for key, value in self.guessed) or "as declared"

    @property
    def fit(self) -> AttitudeFit:
        """Its image residuals as those of a reading."""
        return AttitudeFit(attitude_readings(_GRID)[0], self.rms_px)


def guess_declared(source: Path, source_format: str, declared: Declared, project: Path) -> Guess:
    """What is not declared about a file of orientations, from the observations of a project.

    Parameters
    ----------
    source : path
        The file.
    source_format : str
        Its format, a name in `FORMATS`.
    declared : Declared
        What is known; the rest is tried.
    project : path
        Project file with ``[observations]``, cameras, and control where heights are to be told. Its own
        orientation is not looked at.

    Raises
    ------
    FormatError
        If the points do not decide: the readings that fit alike are named, or the one that the format cannot
        express.
    ProjectError
        If the project has no observations.
    """
    source, project = Path(source), Path(project)
    file = read_project_file(project)
    if file.observations is None:
        raise ProjectError(
            "must be given: an orientation is guessed from tie or control points",
            file=project,
            field="observations",
            hint='[observations] with files = ["ties.mes"]',
        )
    notes: list[str] = []
    candidates = _candidates(source, source_format, declared, file, project, notes)
    cameras = photo_cameras(file, project, candidates[0].orientations, notes)
    found = observations_for(file, project, candidates[0].orientations.names, cameras, notes)
    sample = found.usable().sample(_SAMPLE)
    ranked = _ranked(candidates, sample)
    best = ranked[0]
    _require_meeting(source, ranked, sample)
    _require_decided(source, ranked)
    frame = project_frame(file, project)
    systems = height_candidates(file, project, frame, best.block.positions)
    result, _, _ = audit_block(file, frame, best.block, found, systems, _own_heights(best))
    _require_as_read(source, best, result)
    if best.guessed:
        notes.append(_sentence(source, ranked))
    return _completed(best, result, notes)


def _candidates(
    source: Path, name: str, declared: Declared, file: ProjectFile, project: Path, notes: list[str]
) -> list[_Candidate]:
    """Every way the file can be read, those that come to the same only once."""
    frame = project_frame(file, project)
    try:
        format_named(name, "--from").read(source, declared)
    except FormatError as error:
        if error.field not in (*_CHOICES, "crs"):
            raise
        if error.field == "crs":
            declared = replace(declared, crs=file.project.crs)
            notes.append(f"{source.name}: coordinates are taken to be in the CRS of the project")
        refused: FormatError | None = error
    else:
        refused = None
    read = list(_readings(source, name, declared, ()))
    if not read:
        raise refused or FormatError("cannot be read in any way", file=source)
    found: list[_Candidate] = []
    for values, guessed, orientations in read:
        candidate = _Candidate(values, guessed, orientations, _block(orientations, frame))
        if not any(_same(candidate.block, other.block) for other in found):
            found.append(candidate)
    for candidate in list(found):
        if candidate.declared.order is None:
            found += _phi_first(source, name, candidate, frame)
    check_coordinates(frame, found[0].block.positions, "projection centres", source, tolerated=0.5)
    return found


def _readings(
    source: Path, name: str, declared: Declared, guessed: tuple[tuple[str, str], ...]
) -> Iterator[tuple[Declared, tuple[tuple[str, str], ...], OrientationSet]]:
    """Readings of a file: whatever the reader asks for is tried with every choice."""
    try:
        yield declared, guessed, format_named(name, "--from").read(source, declared)
    except FormatError as error:
        key = error.field or ""
        if key in _CHOICES and getattr(declared, key) is None:
            for choice in _CHOICES[key]:
                more: dict[str, Any] = {key: choice}
                yield from _readings(source, name, replace(declared, **more), (*guessed, (key, choice)))
    except InputError:  # a choice that makes no sense in this frame
        return


def _phi_first(source: Path, name: str, candidate: _Candidate, frame: MapFrame) -> Iterator[_Candidate]:
    """The same with phi as the first rotation, where the format lets that be declared."""
    declared = replace(candidate.declared, order="pok")
    try:
        orientations = format_named(name, "--from").read(source, declared)
    except InputError:
        return
    block = _block(orientations, frame)
    if not _same(block, candidate.block):
        guessed = (*candidate.guessed, ("order", "pok"))
        yield _Candidate(declared, guessed, orientations, block, unusual=True)


def _block(orientations: OrientationSet, frame: MapFrame) -> WrittenBlock:
    """Orientations in the map of the project, heights as they are written if nobody declared them."""
    place = orientations.place
    heights = place.heights if isinstance(place, MapFrame) else HeightSystem.ellipsoidal()
    result = converted(orientations, MapFrame(frame.crs, heights), "grid")
    return WrittenBlock(frame.crs, result.positions, result.rotations, _GRID)


def _same(one: WrittenBlock, other: WrittenBlock) -> bool:
    apart = np.abs(one.attitudes - other.attitudes).max()
    return bool(apart < 1e-9 and np.abs(one.positions - other.positions).max() < 1e-4)


def _ranked(candidates: Sequence[_Candidate], observations: AuditObservations) -> list[_Candidate]:
    """By their image residuals; an unusual order of angles only wins where it fits better."""
    reading: AttitudeReading = attitude_readings(_GRID)[0]
    fitted = []
    for candidate in candidates:
        try:
            rms = Evaluator(candidate.block, observations).intersect("space", reading, _ELLIPSOIDAL).rms_px
        except InputError:  # coordinates that cannot be
            rms = (np.inf, np.inf)
        fitted.append(replace(candidate, rms_px=rms))
    best = min(fitted, key=lambda candidate: candidate.fit.total_px)

    def order(candidate: _Candidate) -> float:
        score = attitude_score(candidate.fit, best.fit) if np.isfinite(best.fit.total_px) else 0.0
        return score + _UNDECIDED * candidate.unusual

    return sorted(fitted, key=order)


def _require_meeting(source: Path, ranked: Sequence[_Candidate], observations: AuditObservations) -> None:
    """Some reading must make rays meet; one that no declaration can say is named."""
    if np.isfinite(ranked[0].fit.total_px):
        return
    usual = [candidate for candidate in ranked if not candidate.unusual]
    tried = []
    for candidate in usual:
        fits = attitude_fits(Evaluator(candidate.block, observations), candidate.block, [_ELLIPSOIDAL])
        tried.append((fits[0].total_px, candidate, fits[0]))
    px, candidate, fit = min(tried, key=lambda entry: entry[0])
    rule = f"is no orientation of these points in any of {len(ranked)} readings: their rays do not meet"
    hint = None
    if np.isfinite(px):
        hint = f"they would meet to {px:.3g} px with {candidate.words}, and {fit.reading.name}"
    raise FormatError(rule, file=source, hint=hint)


def _require_decided(source: Path, ranked: Sequence[_Candidate]) -> None:
    best = ranked[0]
    alike = [
        other
        for other in ranked[1:]
        if attitude_score(other.fit, best.fit) < _UNDECIDED and not (other.unusual and not best.unusual)
    ]
    if alike:
        listed = "; ".join(f"{c.words} ({c.fit.total_px:.3f} px)" for c in (best, *alike))
        apart = np.rad2deg(np.abs(best.block.attitudes - alike[0].block.attitudes).max())
        raise FormatError(
            "cannot be guessed: the points are met alike with " + listed,
            file=source,
            field=alike[0].guessed[-1][0] if alike[0].guessed else None,
            hint=f"declare it; the first two differ by {apart:.2g} degrees at most",
        )


def _require_as_read(source: Path, best: _Candidate, result: Audit) -> None:
    """The audit must not know a much better reading, which no declaration can express."""
    top = result.attitudes[0]
    own = next(fit for fit in result.attitudes if fit.reading.mistakes == 0)
    if attitude_score(own, top) > _BETTER:
        raise FormatError(
            f"is not what its format says: read with {best.words}, rays miss each other by "
            f"{own.total_px:.3g} px; they would meet to {top.total_px:.3g} px with {top.reading.name}",
            file=source,
        )


def _sentence(source: Path, ranked: Sequence[_Candidate]) -> str:
    best = ranked[0]
    text = f"{source.name}: guessed {best.words}: image residuals {best.fit.total_px:.3g} px"
    other = next((c for c in ranked[1:] if c.unusual == best.unusual), None)
    if other is None:
        return f"{text}; nothing else is possible"
    if not np.isfinite(other.fit.total_px):
        return f"{text}; with every other reading the rays do not meet (practically certain)"
    sure = certainty(attitude_score(other.fit, best.fit))
    return f"{text}; {other.fit.total_px:.3g} px for the next, {other.words} ({sure})"


def _own_heights(best: _Candidate) -> list[HeightCandidate]:
    """The system of the written heights, if it is declared or follows from the frame."""
    place = best.orientations.place
    heights = place.heights if isinstance(place, MapFrame) else HeightSystem.ellipsoidal()
    if heights.kind == "undeclared":
        return []
    return [HeightCandidate(heights.reference or heights.kind, heights.description, heights)]


def _completed(best: _Candidate, result: Audit, notes: list[str]) -> Guess:
    """The declarations with what the audit decided about heights and centres."""
    says = {finding.key: finding for finding in result.findings}
    declared, height = best.declared, None
    place = best.orientations.place
    if isinstance(place, MapFrame) and place.heights.kind == "undeclared":
        finding = says.get("photos.heights")
        if finding is not None and finding.sure != "undecided":
            declared = replace(declared, heights=result.best.heights.system)
            notes.append(f"guessed heights: {finding.sentence} ({finding.sure})")
        else:
            notes.append("heights stay undeclared: no known points decide their kind")
    finding = says.get("photos.adjusted_in")
    if finding is not None and finding.sure != "undecided" and finding.value == '"grid"':
        height = _reference_height(result, best, declared)
        notes.append(f"guessed centres: {finding.sentence} ({finding.sure})")
    elif finding is not None:
        notes.append(f"centres are read as true positions: {finding.sentence} ({finding.sure})")
    notes += [f"not decided: {line}" for line in result.undecided]
    return Guess(declared, height, tuple(notes))


def _reference_height(result: Audit, best: _Candidate, declared: Declared) -> float | None:
    """Height of the control in the system of the orientation, rounded to what it is worth."""
    place = best.orientations.place
    if not isinstance(place, MapFrame) or place.is_geographic:
        return None
    plain = MapFrame(best.block.crs, HeightSystem.ellipsoidal())
    known = result.observations.reference[result.observations.known]
    geodetic = MapFrame(best.block.crs, result.best.reference_heights.system).geodetic_from_map(known)
    ground = ground_height(
        result.observations,
        _with_heights(result.observations, plain.map_from_geodetic(geodetic)),
    )
    if ground is None:
        return None
    own = MapFrame(place.crs, declared.heights or place.heights)
    middle = geodetic.mean(axis=0)
    return round(float(own.map_from_geodetic([middle[0], middle[1], ground])[2]), 2)


def _with_heights(observations: AuditObservations, points: Array) -> Array:
    out = np.full(observations.reference.shape, np.nan)
    out[observations.known] = points
    return out
