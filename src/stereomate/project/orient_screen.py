"""Control points and positions looked at before the adjustment: exchanged axes, wrong units, wrong depth.

The photographs make a model of the ground without either. Control points in the model and projection centres
of the model are each compared with what is given for them: a single control point that stands out is left out
and what explains it is named; a whole set in another unit, or a principal distance that makes the model too
deep, is an error; positions that disagree with all of the control otherwise are left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.block.start import KnownPoints, control_places
from stereomate.block.start_datum import Datum, Places, find_datum
from stereomate.errors import CrsError, NotDeterminedError, ProjectError
from stereomate.frames.checks import check_height_units
from stereomate.frames.transform import map_from_tangent
from stereomate.geometry.similarity import SpaceTransform
from stereomate.project.orient_inputs import OrientInputs, heights_are_verified
from stereomate.project.orient_known import known_points
from stereomate.project.orient_measure import Measured, PartStart
from stereomate.units import FOOT

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# What is called gross here, in parts of the flying height and in standard deviations: the model is not
# adjusted yet, and smaller errors are found by the tests of the adjustment.
_GROSS: Final = 0.02
_GROSS_SIGMAS: Final = 10.0
_SCATTERS: Final = 6.0
# Of a scale that is another unit.
_UNIT_TOLERANCE: Final = 0.02
# Principal distances are seldom known worse, even nominal ones; a larger factor is a mistake.
_DEPTH: Final = 0.1
# A wrong depth moves the centres in height; in plan by tilts of the model only.
_PLAN_SHARE: Final = 0.2
# Spread of the control, of that of the positions; across, of the flying height.
_LEAST_SPREAD: Final = 0.25
_LEAST_WIDTH: Final = 0.05
# How well the relief of the control must fix the depth of the model to tell it from a shift of the heights.
_DEPTH_KNOWN: Final = 0.05


@dataclass(frozen=True, eq=False)
class Screened:
    """A block without control points and positions that cannot be right.

    Attributes
    ----------
    inputs, measured
        As they are adjusted; start values moved to the datum of what is left.
    findings : tuple of str
        What was left out, and why.
    """

    inputs: OrientInputs
    measured: Measured
    findings: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class _Part:
    """Control and positions of one part, in its frame and in the tangent frame."""

    start: PartStart
    control: Places
    positions: Places
    height: float  # of flight, metres, by the better known datum


def screen(inputs: OrientInputs, measured: Measured) -> Screened:
    """Leave out gross errors of control and positions, and name them.

    Raises
    ------
    CrsError
        If coordinates of the control or of the positions are in another unit.
    HeightSystemError
        If their heights are.
    ProjectError
        If the model is too deep or too flat: a wrong principal distance.
    """
    known = None if inputs.control is None else known_points(inputs.control, measured.photos)
    if known is None or inputs.control is None or inputs.tangent is None:
        return Screened(inputs, measured)
    parts: list[PartStart] = []
    points = measured.points.copy()
    wrong: dict[str, str] = {}
    findings: list[str] = []
    positions = inputs.positions
    for start in measured.parts:
        if start.datum == "none":
            parts.append(start)
            continue
        part = _part(inputs, measured, start, known)
        bad = _outliers(part)
        good = _without(part.control, bad)
        by_positions, by_control = _datum(part.positions, start), _datum(good, start)
        datum = by_control or by_positions
        if by_positions is not None and by_control is not None:
            disagreement = _compare(inputs, replace(part, control=good), by_positions, by_control)
            if disagreement:
                findings.append(disagreement)
                lost = positions.tangent.copy()
                lost[list(start.photos)] = math.nan
                positions = replace(positions, tangent=lost)
        # Control is judged here, with the positions; the start knew it alone.
        start = replace(start, outliers=start.outliers if start.datum == "positions" else ())
        if datum is None or not bad:
            parts.append(start)
            continue
        wrong |= _explained(inputs, part, datum.transform, bad)
        parts.append(_moved(start, datum.transform))
        mine = np.unique(measured.ties.point[np.isin(measured.ties.photo, start.photos)])
        points[mine] = datum.transform.apply(points[mine])
    findings = [
        f"control: {name} contradicts the others and is left out: {why}" for name, why in wrong.items()
    ] + findings
    xyz = inputs.control.tangent_xyz.copy()
    xyz[[name in wrong for name in inputs.control.names]] = math.nan
    control = replace(inputs.control, tangent_xyz=xyz)
    return Screened(
        replace(inputs, control=control, positions=positions),
        replace(measured, parts=tuple(parts), points=points),
        tuple(findings),
    )


def _part(inputs: OrientInputs, measured: Measured, start: PartStart, known: KnownPoints) -> _Part:
    n = len(measured.photos)
    centres, rotations = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
    photos = list(start.photos)
    centres[photos], rotations[photos] = start.centres, start.rotations
    control = control_places(centres, rotations, [photo.camera for photo in measured.photos], known)
    given = inputs.positions.tangent
    placed = np.flatnonzero(np.isfinite(given).all(axis=1) & np.isfinite(centres).all(axis=1))
    sigma = np.broadcast_to(np.array(inputs.positions.sigma_m), (len(placed), 3))
    names = tuple(measured.photos[k].name for k in placed.tolist())
    positions = Places("positions", names, centres[placed], given[placed], sigma)
    scale = 1.0
    by_positions = _datum(positions, start)
    if by_positions is not None:
        scale = by_positions.transform.scale
    ground = control.model[:, 2] if len(control.names) else measured.points[:, 2]
    height = scale * float(np.median(start.centres[:, 2]) - np.nanmedian(ground))
    return _Part(start, control, positions, max(height, 1e-6))


def _datum(places: Places, start: PartStart) -> Datum | None:
    """What places determine of the datum of a part; None where they do not."""
    if not len(places.names):
        return None
    try:
        found = find_datum(start.rotations, (places,))
    except NotDeterminedError:
        return None
    return None if found.kind == "none" else found


def _without(places: Places, names: set[str]) -> Places:
    keep = np.array([name not in names for name in places.names], dtype=np.bool_)
    kept = tuple(name for name in places.names if name not in names)
    return Places(places.kind, kept, places.model[keep], places.target[keep], places.sigma[keep])


def _outliers(part: _Part) -> set[str]:
    """Control points that stand out: against the positions where these determine a datum, and each other."""
    control, bad = part.control, set[str]()
    if not len(control.names):
        return bad
    by_positions = _datum(part.positions, part.start)
    if by_positions is not None:
        misfit = control.target - by_positions.transform.apply(control.model)
        # What all have in common (heights of another kind, a wrong principal distance) is none of one point.
        common = np.nan_to_num(np.nanmedian(_some(misfit), axis=0)) if len(misfit) > 2 else np.zeros(3)
        if len(misfit) <= 2:
            misfit = np.where([True, True, False], misfit, np.nan)
        size = np.linalg.norm(np.nan_to_num(misfit - common), axis=1)
        sigma = np.linalg.norm(np.hypot(control.sigma, part.positions.sigma[0]), axis=1)
        limit = np.maximum(_GROSS_SIGMAS * sigma, max(_GROSS * part.height, _scatter(size)))
        over = size > limit
        if 2 * np.count_nonzero(over) < max(len(size), 2):
            bad = {name for name, is_bad in zip(control.names, over, strict=True) if is_bad}
    among = _datum(_without(control, bad), part.start)
    # Three points fit any triangle; with four, which of them is wrong is told by nothing but the positions.
    if among is not None and (by_positions is None or len(control.names) - len(bad) > 4):
        rest = [name for name in control.names if name not in bad]
        size = np.linalg.norm(np.nan_to_num(among.residuals), axis=1)
        gross = {name for name, off in zip(rest, size, strict=True) if off > _GROSS * part.height}
        bad |= gross & set(among.outliers)
    return bad


def _some(values: Array) -> Array:
    """With zero where an axis is known of no point, so that its median is defined."""
    return np.where(np.isfinite(values).any(axis=0), values, 0.0)


def _scatter(size: Array) -> float:
    return _SCATTERS * 1.4826 * float(np.median(size)) if len(size) > 2 else 0.0


def _compare(inputs: OrientInputs, part: _Part, by_positions: Datum, by_control: Datum) -> str:
    """What positions and control say of each other; in words where they disagree.

    Raises
    ------
    CrsError, HeightSystemError, ProjectError
        If a unit or the principal distance explains the disagreement.
    """
    positions, control = part.positions, part.control
    _check_scale(inputs, by_positions.transform.scale / by_control.transform.scale)
    centres = by_control.transform.apply(positions.model)
    ground = by_positions.transform.apply(control.model)
    _check_heights(inputs, part, centres, ground)
    difference = np.median(positions.target - centres, axis=0)
    sigma = np.hypot(positions.sigma[0], np.nanmedian(control.sigma, axis=0))
    limit = np.maximum(_GROSS_SIGMAS * sigma, _GROSS * part.height)
    apart = np.abs(difference) > limit
    if not np.isfinite(control.target[:, 2]).any():
        apart[2] = False
    if not apart.any() or not _spread_enough(part, by_control.transform.scale):
        return ""
    deep = float(np.median(centres[:, 2]) - np.nanmedian(by_control.transform.apply(control.model)[:, 2]))
    flown = float(np.median(positions.target[:, 2]) - np.nanmedian(control.target[:, 2]))
    factor = deep / flown if flown > 0.0 else math.inf
    east, north, up = difference
    if apart[2] and math.hypot(east, north) < _PLAN_SHARE * abs(up):
        _check_depth(inputs, part, by_control, factor)
    return (
        f"positions: they are off what the control points say by {east:+.1f}, {north:+.1f}, {up:+.1f} m "
        "(east, north, up) in the middle and are left out: another height system or CRS? Flying height by "
        f"the photographs is {factor:.3f} times that by positions and control"
    )


def _spread_enough(part: _Part, scale: float) -> bool:
    """Whether the control spreads enough in plan to say where the photographs are, far from it."""

    def spread(places: Places) -> Array:
        plan = places.model[:, :2] - places.model[:, :2].mean(axis=0)
        return np.asarray(np.linalg.svd(plan, compute_uv=False) / math.sqrt(len(plan)))

    full = part.control.full
    if np.count_nonzero(full) < 3:
        return False
    own = spread(_without(part.control, {n for n, f in zip(part.control.names, full, strict=True) if not f}))
    wide: bool = own[0] >= _LEAST_SPREAD * spread(part.positions)[0]
    return wide and bool(scale * own[1] >= _LEAST_WIDTH * part.height)


def _check_scale(inputs: OrientInputs, ratio: float) -> None:
    """Refuse coordinates of which one set is in feet and the other in metres."""
    assert inputs.control is not None
    assert inputs.file.control is not None
    for factor, what, file in (
        (1.0 / FOOT, "positions", inputs.file.photos.orientation or None),
        (FOOT, "control points", inputs.file.control.file),
    ):
        if abs(ratio / factor - 1.0) < _UNIT_TOLERANCE:
            raise CrsError(
                f"distances between the {what} are 3.28 times those of the others: they look like feet",
                file=None if file is None else inputs.path.parent / file,
                field="crs",
                value=inputs.control.frame.name,
            )


def _check_heights(inputs: OrientInputs, part: _Part, centres: Array, ground: Array) -> None:
    """Refuse heights of which one set is in feet and the other in metres."""
    assert inputs.control is not None
    assert inputs.file.control is not None
    assert inputs.tangent is not None
    folder, tangent = inputs.path.parent, inputs.tangent
    known = np.isfinite(part.control.target[:, 2])
    frame = inputs.control.frame
    place = {name: k for k, name in enumerate(inputs.control.names)}
    written = inputs.control.xyz[[place[name] for name in part.control.names], 2]
    if known.any():
        expected = map_from_tangent(tangent, frame, ground[known])[:, 2]
        source = folder / inputs.file.control.file
        check_height_units(written[known], expected, "the control points", source)
    stated = map_from_tangent(tangent, inputs.frame, part.positions.target)[:, 2]
    expected = map_from_tangent(tangent, inputs.frame, centres)[:, 2]
    table = inputs.file.photos.orientation
    check_height_units(stated, expected, "the positions", folder / table if table else None)


def _check_depth(inputs: OrientInputs, part: _Part, by_control: Datum, factor: float) -> None:
    """Refuse a principal distance that makes the model too deep.

    A shift of all heights makes the same flying height; the relief of the control tells which it is. Where it
    does not, positions that only help (of EXIF, or of undeclared heights) may be left out; others may not.
    """
    if abs(factor - 1.0) < _DEPTH:
        return
    depth, sigma = _relief(part.control, by_control)
    known = sigma < _DEPTH_KNOWN
    if known and abs(depth - factor) > max(3.0 * sigma, 0.5 * abs(factor - 1.0)):
        return
    if not known and not heights_are_verified(inputs):
        return
    camera = inputs.photos[part.start.photos[0]].camera
    relief = f", and the relief of the control points {depth:.2f} times too deep" if known else ""
    other = "" if known else "; or positions and control are of different height systems"
    raise ProjectError(
        f"makes the flying height {factor:.2f} times that of positions and control{relief}",
        file=inputs.path,
        field=f"camera {camera.name}: principal distance",
        value=f"{camera.principal_distance_mm:g} mm",
        hint=f"{camera.principal_distance_mm / factor:.4g} mm would explain it{other}",
    )


def _relief(control: Places, datum: Datum) -> tuple[float, float]:
    """Relief of the control in the model over its relief as given, with its standard deviation.

    Heights of the model by those given, and a plane for the tilt, which a similarity fits wrongly then.
    """
    full = control.full
    if np.count_nonzero(full) < 6:
        return math.nan, math.inf
    model, given = datum.transform.apply(control.model[full]), control.target[full]
    centred = given - given.mean(axis=0)
    design = np.column_stack([centred[:, 2], centred[:, :2], np.ones(len(centred))])
    solution, _, rank, _ = np.linalg.lstsq(design, model[:, 2], rcond=None)
    if rank < 4:
        return math.nan, math.inf
    residuals = model[:, 2] - design @ solution
    variance = float(residuals @ residuals) / (len(given) - 4)
    return float(solution[0]), math.sqrt(variance * float(np.linalg.inv(design.T @ design)[0, 0]))


def _explained(inputs: OrientInputs, part: _Part, transform: SpaceTransform, bad: set[str]) -> dict[str, str]:
    """What would make a control point right."""
    assert inputs.control is not None
    assert inputs.tangent is not None
    frame = inputs.control.frame
    place = {name: k for k, name in enumerate(inputs.control.names)}
    found = {}
    limit = _GROSS * part.height
    for name, model in zip(part.control.names, part.control.model, strict=True):
        if name not in bad:
            continue
        expected = map_from_tangent(inputs.tangent, frame, transform.apply(model))
        given = inputs.control.xyz[place[name]]
        unit = frame.unit_m
        # Degrees to metres, roughly: what is looked for here is far larger.
        unit = unit if not frame.is_geographic else 111_000.0
        plan = unit * (given[:2] - expected[:2])
        x, y = plan
        swapped = float(np.hypot(*(unit * (given[1::-1] - expected[:2]))))
        off = float(np.hypot(x, y))
        heights = {w: abs(given[2] * f - expected[2]) for w, f in (("feet", FOOT), ("metres", 1.0 / FOOT))}
        word = min(heights, key=lambda w: heights[w])
        if swapped < limit < off:
            found[name] = "its x and y are exchanged"
        elif off < limit and heights[word] < limit:
            found[name] = f"its height looks like {word}"
        else:
            z = f", {given[2] - expected[2]:+.1f} in height" if math.isfinite(given[2]) else ""
            found[name] = f"it is off by {x:+.1f}, {y:+.1f} m in x, y{z}; is it the right point?"
    return found


def _moved(start: PartStart, transform: SpaceTransform) -> PartStart:
    turn = np.array(transform.rotation)
    return replace(start, centres=transform.apply(start.centres), rotations=turn @ start.rotations)
