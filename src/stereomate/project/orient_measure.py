"""Stages of an orientation up to its start values: features, pairs, tie points, start, refined tie points."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereomate.block.models import JoiningOptions, PairPose
from stereomate.block.photos import BlockPhoto
from stereomate.block.refine import OrientedPoints, measure_again
from stereomate.block.start import KnownPositions, find_start
from stereomate.block.tie_points import (
    PairResult,
    TiePointOptions,
    find_features,
    pair_poses,
    tie_points,
)
from stereomate.camera.model import Camera
from stereomate.errors import FormatError, ImageError
from stereomate.formats.image_points import ImageMeasurements
from stereomate.formats.lens import Lens, lens_of
from stereomate.measurement.database import CameraRow, ImageRow, MeasurementDatabase
from stereomate.measurement.features import FeatureOptions
from stereomate.measurement.tracks import ThinningOptions, TiePoints
from stereomate.project.inputs import PhotoProblem
from stereomate.project.orient_inputs import OrientInputs
from stereomate.project.orient_known import known_points, once_findings, outside_findings
from stereomate.project.orient_pairs import matched_pairs
from stereomate.project.orient_stated import (
    LEAST_POINTS,
    block_photos,
    pairs_of_tie_points,
    stated_findings,
    stated_tie_points,
)
from stereomate.relative.feature_pairs import AutomaticOptions
from stereomate.tiles import Executor
from stereomate.tiles.ledger import run_key

Array = NDArray[np.float64]
ProgressSink = Callable[[str, int, int], None]

# COLMAP's numbers of PINHOLE, OPENCV and OPENCV_FISHEYE.
_PINHOLE, _OPENCV, _FISHEYE = 1, 4, 5


@dataclass(frozen=True, eq=False)
class PartStart:
    """A connected part of the block: its photographs, their start orientations, its datum.

    Attributes
    ----------
    photos : tuple of int
    centres, rotations : ndarray, shape (len(photos), 3) and (len(photos), 3, 3)
    datum : {"positions", "control", "none"}
    outliers, notes : tuple of str
    """

    photos: tuple[int, ...]
    centres: Array
    rotations: Array
    datum: str
    outliers: tuple[str, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Measured:
    """A block with measurements and start values.

    Attributes
    ----------
    photos : tuple of BlockPhoto
    pairs : tuple of PairResult
    selection : str
        How pairs were chosen.
    ties : TiePoints
        As they will be adjusted.
    points : ndarray, shape (k, 3)
        Start of the tie points; NaN where not determined.
    parts : tuple of PartStart
        The largest first.
    not_joined : dict of int to str
    counts : dict
        Of tracks, contradictions, tie points, refined observations and failures.
    problems : tuple of PhotoProblem
        Photographs that turned out unreadable.
    findings : tuple of str
        What a reader must know of the measurements.
    tie_names : tuple of str or None
        Of stated tie points, as their file has them.
    """

    photos: tuple[BlockPhoto, ...]
    pairs: tuple[PairResult, ...]
    selection: str
    ties: TiePoints
    points: Array
    parts: tuple[PartStart, ...]
    not_joined: dict[int, str]
    counts: dict[str, Any]
    problems: tuple[PhotoProblem, ...]
    findings: tuple[str, ...] = ()
    tie_names: tuple[str, ...] | None = None


def measure_block(
    inputs: OrientInputs, database_path: Path, executor: Executor | None, progress: ProgressSink
) -> Measured:
    """Measure a block and find its start values; what is finished is kept in the database.

    Raises
    ------
    NotDeterminedError
        If no two photographs can be oriented to each other.
    """
    photos = block_photos(inputs.photos)
    with MeasurementDatabase.open(database_path) as database:
        _describe(database, photos, inputs)
        if inputs.tie_points is None:
            tied = _found(database, photos, inputs, executor, progress)
        else:
            tied = _stated(inputs.tie_points, photos, progress)
        start = _start(database, photos, tied, inputs, progress)
        parts, points, ties, counts = start.parts, start.points, tied.ties, tied.counts
        if inputs.tie_points is not None:
            # Gross errors are for the adjustment to find: nothing that somebody measured goes silently.
            ties = ties.select(np.isfinite(points[ties.point, 0]))
        elif inputs.file.orient.refine:
            oriented = _united(parts, len(photos), points)
            ties, measured = measure_again(
                database,
                photos,
                ties.select(start.used),
                oriented,
                None,
                executor,
                _named(progress, "refinement"),
            )
            counts = {**counts, "refined": measured}
        else:
            ties = ties.select(start.used).with_rays(2)
    findings = tied.findings
    if inputs.control is not None:
        findings += tuple(outside_findings(inputs.control, photos))
        findings += tuple(once_findings(inputs.control, photos))
    return Measured(
        photos,
        tied.pairs,
        tied.how,
        ties,
        points,
        parts,
        start.not_joined,
        counts,
        tied.problems,
        findings,
        tied.names,
    )


@dataclass(frozen=True, eq=False)
class _Tied:
    """Tie points of the block, and what its pairs gave."""

    ties: TiePoints
    counts: dict[str, Any]
    pairs: tuple[PairResult, ...]
    poses: tuple[PairPose, ...]
    how: str
    problems: tuple[PhotoProblem, ...] = ()
    findings: tuple[str, ...] = ()
    names: tuple[str, ...] | None = None


def _found(
    database: MeasurementDatabase,
    photos: Sequence[BlockPhoto],
    inputs: OrientInputs,
    executor: Executor | None,
    progress: ProgressSink,
) -> _Tied:
    """From the pixels of the photographs."""
    options = tie_point_options(inputs)
    failed = find_features(database, photos, options, executor, _named(progress, "features"))
    problems = tuple(PhotoProblem(photos[k - 1].name, ImageError(e)) for k, e in sorted(failed.items()))
    matched = matched_pairs(database, photos, inputs, options, failed, executor, _named(progress, "pairs"))
    selection, problems = matched.selection, (*problems, *matched.problems)
    progress("tie points", 0, 1)
    ties, counts = tie_points(database, photos, selection, options)
    progress("tie points", 1, 1)
    poses = pair_poses(database, photos, selection)
    return _Tied(ties, counts, matched.results, poses, selection.how, problems, matched.findings)


def _stated(given: ImageMeasurements, photos: Sequence[BlockPhoto], progress: ProgressSink) -> _Tied:
    """From a file: no pixel is looked at."""
    ties, names, counts = stated_tie_points(given, photos)
    poses, pairs = pairs_of_tie_points(ties, photos, _named(progress, "pairs"))
    how = f"photographs that share tie points of {given.path.name}"
    return _Tied(ties, counts, pairs, poses, how, (), tuple(stated_findings(counts)), names)


def tie_point_options(inputs: OrientInputs) -> TiePointOptions:
    """Options of features, pairs and thinning from the project file."""
    section = inputs.file.orient
    automatic = AutomaticOptions(
        largest_side_px=section.largest_side_px,
        features=FeatureOptions(max_features=section.features),
        least_points=20,
    )
    thinning = ThinningOptions(
        per_photo=section.points_per_photo, per_place=max(1, section.points_per_photo // 60)
    )
    return TiePointOptions(automatic, thinning=thinning)


def _named(progress: ProgressSink, stage: str) -> Callable[[int, int], None]:
    return lambda done, total: progress(stage, done, total)


def _describe(database: MeasurementDatabase, photos: Sequence[BlockPhoto], inputs: OrientInputs) -> None:
    """State cameras, photographs and positions, for this program and for COLMAP."""
    numbers: dict[str, int] = {}
    cameras: dict[int, CameraRow] = {}
    for photo in photos:
        if photo.camera.name not in numbers:
            numbers[photo.camera.name] = len(numbers) + 1
            cameras[numbers[photo.camera.name]] = _colmap_camera(photo.camera)
    database.set_photographs(cameras, [ImageRow(p.number, p.name, numbers[p.camera.name]) for p in photos])
    known = inputs.positions.geographic
    database.set_positions(
        {
            photo.number: (float(known[k, 1]), float(known[k, 0]), float(known[k, 2]))
            for k, photo in enumerate(photos)
            if np.isfinite(known[k]).all()
        }
    )


def _colmap_camera(camera: Camera) -> CameraRow:
    """As COLMAP's model that is nearest; a distortion it does not know is left out."""
    try:
        lens = lens_of(camera)
    except FormatError:
        (a, b, u), (d, e, v) = camera.pixel_from_photo
        f = camera.principal_distance_mm
        x, y = camera.principal_point_mm
        lens = Lens(
            "pinhole",
            camera.size_px,
            float(np.hypot(a, d)) * f,
            float(np.hypot(b, e)) * f,
            a * x + b * y + u,
            d * x + e * y + v,
        )
    plain = (lens.fx, lens.fy, lens.cx, lens.cy)
    if lens.kind == "fisheye":
        return CameraRow(_FISHEYE, camera.size_px, (*plain, *lens.radial))
    if lens.kind == "brown" and not any(lens.radial[2:]):
        return CameraRow(_OPENCV, camera.size_px, (*plain, *lens.radial[:2], lens.p1, lens.p2))
    return CameraRow(_PINHOLE, camera.size_px, plain)


@dataclass(frozen=True, eq=False)
class _Started:
    parts: tuple[PartStart, ...]
    points: Array
    used: NDArray[np.bool_]
    not_joined: dict[int, str]


def _start(
    database: MeasurementDatabase,
    photos: Sequence[BlockPhoto],
    tied: _Tied,
    inputs: OrientInputs,
    progress: ProgressSink,
) -> _Started:
    cameras = [photo.camera for photo in photos]
    ties, poses = tied.ties, tied.poses
    options = None if inputs.tie_points is None else JoiningOptions(least_points=LEAST_POINTS)
    stated = inputs.positions
    positions = KnownPositions(stated.tangent, stated.sigma_m, stated.attitudes)
    has_positions = bool(np.isfinite(inputs.positions.tangent).any())
    control = known_points(inputs.control, photos) if inputs.control is not None else None
    key = run_key(
        ties=[ties.point.tolist(), ties.photo.tolist(), ties.pixels.tolist()],
        cameras=[repr(camera) for camera in cameras],
        poses=[[p.first, p.second, p.base.tolist(), p.first_from_second.tolist()] for p in poses],
        positions=np.nan_to_num(inputs.positions.tangent, nan=-1e9).tolist(),
        angles=np.nan_to_num(inputs.positions.attitudes, nan=-1e9).tolist(),
        control=None if control is None else [control.pixels.tolist(), repr(control.xyz.tolist())],
    )
    done = database.done("start").get("")
    if done is not None and done[0] == key:
        progress("start", len(photos), len(photos))
        return _started(done[1], len(ties))
    start = find_start(
        ties,
        cameras,
        poses,
        positions if has_positions else None,
        control,
        options=options,
        progress=_named(progress, "start"),
    )
    points = np.full((int(ties.point.max()) + 1, 3), np.nan)
    used = np.zeros(len(ties), dtype=np.bool_)
    for part in reversed(start.parts):
        known = np.isfinite(part.points[:, 0])
        points[known] = part.points[known]
        used |= part.used
    record = {
        "parts": [
            {
                "photos": part.photos.tolist(),
                "centres": part.centres[part.photos].tolist(),
                "rotations": part.rotations[part.photos].tolist(),
                "datum": part.datum.kind,
                "outliers": list(part.datum.outliers),
                "notes": list(part.datum.notes),
            }
            for part in start.parts
        ],
        "points": np.where(np.isfinite(points), points, 1e300).tolist(),
        "used": np.flatnonzero(used).tolist(),
        "not_joined": {str(k): reason for k, reason in start.reasons.items()},
    }
    database.set_done("start", "", key, record)
    progress("start", len(photos), len(photos))
    return _started(record, len(ties))


def _started(record: dict[str, Any], count: int) -> _Started:
    """From the record, whether it is new or an old one: both ways give the same numbers."""
    parts = tuple(
        PartStart(
            tuple(part["photos"]),
            np.array(part["centres"]).reshape(-1, 3),
            np.array(part["rotations"]).reshape(-1, 3, 3),
            part["datum"],
            tuple(part["outliers"]),
            tuple(part["notes"]),
        )
        for part in record["parts"]
    )
    points = np.array(record["points"], dtype=np.float64).reshape(-1, 3)
    points[points > 1e299] = np.nan
    used = np.zeros(count, dtype=np.bool_)
    used[record["used"]] = True
    return _Started(parts, points, used, {int(k): v for k, v in record["not_joined"].items()})


def _united(parts: Sequence[PartStart], count: int, points: Array) -> OrientedPoints:
    centres, rotations = np.full((count, 3), np.nan), np.full((count, 3, 3), np.nan)
    for part in parts:
        centres[list(part.photos)] = part.centres
        rotations[list(part.photos)] = part.rotations
    return OrientedPoints(centres, rotations, points)
