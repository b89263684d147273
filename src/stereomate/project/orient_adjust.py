"""From a measured block to its adjustment: which parts go together, what is calibrated, what cannot be."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.block.adjustment import BlockAdjustment, adjust_block
from stereomate.block.options import BlockOptions, TestOptions
from stereomate.block.orient_network import Assembled, BlockData, assemble
from stereomate.block.start import KnownPoints
from stereomate.block.variance import estimate_variance_components
from stereomate.camera.model import Camera
from stereomate.errors import NotDeterminedError
from stereomate.project.orient_calibration import calibrated_camera, is_automatic, prior_sigmas
from stereomate.project.orient_camera_doubts import HELD_FIRST, undetermined
from stereomate.project.orient_heights import height_findings
from stereomate.project.orient_inputs import OrientInputs
from stereomate.project.orient_known import control_measurements
from stereomate.project.orient_measure import Measured
from stereomate.project.orient_navigation import navigation_groups
from stereomate.project.orient_photos import shared_pixels
from stereomate.project.orient_placed import placed_by_table
from stereomate.project.orient_screen import screen
from stereomate.project.orient_strips import StripShifts, with_shifted_strips

Array = NDArray[np.float64]

_RADIAL: Final = ("k1", "k2", "k3", "k4")
_TRIAL_ITERATIONS: Final = 25
UNDETERMINED: Final = "too few good observations determine their orientation"


@dataclass(frozen=True, eq=False)
class Adjusted:
    """The adjusted block.

    Attributes
    ----------
    data : BlockData
        As it was adjusted at last.
    assembled : Assembled
    result : BlockAdjustment
    oriented : tuple of int
        Photographs that have an orientation.
    has_datum : bool
        Whether the result is in the tangent frame of the map; else in a frame of its own.
    left_out : dict of int to str
        Photographs without an orientation and why.
    findings : tuple of str
        What a reader must know.
    strips : StripShifts
        Tests of the strips' positions.
    """

    data: BlockData
    assembled: Assembled
    result: BlockAdjustment
    oriented: tuple[int, ...]
    has_datum: bool
    left_out: dict[int, str]
    findings: tuple[str, ...]
    strips: StripShifts


def adjust_measured(
    inputs: OrientInputs, measured: Measured, progress: Callable[[int, int], None] | None = None
) -> Adjusted:
    """Adjust a measured block with everything that is known of it.

    First with what any block determines (orientation, radial distortion); then with the standard deviations
    of the tie points scaled to what the block shows them to be; then, where the camera's calibration is left
    to this program, with principal distance and point too, which stay only if the block determines them.

    Raises
    ------
    NotDeterminedError
        If the observations do not determine the orientation.
    CrsError, HeightSystemError, ProjectError
        If a unit or the principal distance is wrong: `screen`.
    """
    screened = screen(inputs, measured)
    inputs, measured = screened.inputs, screened.measured
    findings = [*inputs.findings, *measured.findings, *screened.findings, *height_findings(inputs, measured)]
    at, left_out = _taking_part(inputs, measured, findings)
    options = BlockOptions(
        robust=inputs.file.orient.robust,
        tests=TestOptions(inputs.file.orient.significance, inputs.file.orient.power),
    )
    data = _block_data(inputs, measured)
    wanted = {n: keys for n, keys in data.calibrate.items() if is_automatic(inputs, n)}
    data = data.with_calibration(
        {n: tuple(k for k in keys if n not in wanted or k in _RADIAL) for n, keys in data.calibrate.items()}
    )
    tell = progress or (lambda done, total: None)
    tell(0, 3)
    assembled, result = adjust_assembled(data, at, options)
    tell(1, 3)
    factor = _image_factor(assembled, result)
    if math.isfinite(factor) and abs(factor - 1.0) > 0.05:
        findings.append(
            f"tie points: their standard deviations are {factor:.2f} times what they were stated with "
            "(variance component of the image points)"
        )
        data = replace(data, ties=replace(data.ties, sigma_px=data.ties.sigma_px * factor))
        at = _moved(at, assembled, result)
        assembled, result = adjust_assembled(data, at, options)
    tell(2, 3)
    if at.has_datum and any(wanted.values()):
        data, assembled, result = _more_parameters(data, wanted, at, options, (assembled, result), findings)
    assembled, result = without_undetermined(data, at, options, (assembled, result), left_out)
    assembled, result, strips = with_shifted_strips(data, assembled, result)
    if inputs.file.orient.variance_components:
        assembled, result = _with_components(assembled, result, findings)
    undetermined = [data.names[k] for k in sorted(left_out) if left_out[k] == UNDETERMINED]
    if undetermined:
        findings.append(f"photographs left out, {UNDETERMINED}: {', '.join(undetermined)}")
    tell(3, 3)
    findings += result.notes
    return Adjusted(
        data,
        assembled,
        result,
        tuple(assembled.photos[result.determined_photos].tolist()),
        at.has_datum,
        left_out,
        tuple(dict.fromkeys(findings)),
        strips,
    )


@dataclass(frozen=True, eq=False)
class Approximate:
    """Approximate values of photographs and tie points; NaN for those that take no part."""

    centres: Array
    rotations: Array
    points: Array
    has_datum: bool


def adjust_assembled(
    data: BlockData, at: Approximate, options: BlockOptions
) -> tuple[Assembled, BlockAdjustment]:
    """The network of what takes part, and its adjustment."""
    assembled = assemble(data, at.centres, at.rotations, at.points, at.has_datum)
    return assembled, adjust_block(assembled.network, options)


def without_undetermined(
    data: BlockData,
    at: Approximate,
    options: BlockOptions,
    before: tuple[Assembled, BlockAdjustment],
    left_out: dict[int, str],
) -> tuple[Assembled, BlockAdjustment]:
    """Without photographs that kept their start: no orientation is better than one that nothing tells.

    They come to `left_out`. The others are adjusted again, as tie points that were seen by one of these and
    by one other photograph go too.
    """
    assembled, result = before
    while not result.determined_photos.all() and result.determined_photos.any():
        lost = assembled.photos[~result.determined_photos]
        left_out |= dict.fromkeys(lost.tolist(), UNDETERMINED)
        at = _moved(at, assembled, result)
        at.centres[lost], at.rotations[lost] = math.nan, math.nan
        assembled, result = adjust_assembled(data, at, options)
    return assembled, result


def _moved(at: Approximate, assembled: Assembled, result: BlockAdjustment) -> Approximate:
    """The adjusted values as approximate ones; points that were not determined keep theirs."""
    centres, rotations, points = at.centres.copy(), at.rotations.copy(), at.points.copy()
    centres[assembled.photos] = result.centres
    rotations[assembled.photos] = result.rotations
    adjusted = result.points[: len(assembled.ties)]
    known = np.isfinite(adjusted[:, 0])
    points[assembled.ties[known]] = adjusted[known]
    return Approximate(centres, rotations, points, at.has_datum)


def _with_components(
    assembled: Assembled, result: BlockAdjustment, findings: list[str]
) -> tuple[Assembled, BlockAdjustment]:
    """Adjusted with standard deviations fitted to each kind of observations; what they became is named."""
    start = replace(result.adjusted_network(), cameras=result.network.cameras)
    found = estimate_variance_components(start, result.options)
    parts = [
        f"{c.group} {c.factor:.2f} (redundancy {c.redundancy:.0f})"
        for c in found.components
        if c.factor != 1.0
    ]
    words = "standard deviations fitted to the residuals (variance components), factors: " + ", ".join(parts)
    if not found.converged:
        words += "; the fit did not settle"
    small = [c.group for c in found.components if c.factor == 1.0]
    if small:
        words += f"; too few observations to tell: {', '.join(small)}"
    findings.append(words)
    return replace(assembled, network=found.adjustment.network), found.adjustment


def _image_factor(assembled: Assembled, result: BlockAdjustment) -> float:
    """Square root of the variance component of the tie points; NaN where they have little redundancy."""
    if result.statistics is None:
        return math.nan
    image = result.statistics.image
    ties = np.arange(len(result.used)) < len(assembled.rows)
    rows = result.used & ties & np.isfinite(image.redundancy).all(axis=1)
    redundancy = float(image.redundancy[rows].sum())
    if redundancy < 50.0:
        return math.nan
    return math.sqrt(float(np.sum((result.residuals[rows] / image.sigma[rows]) ** 2)) / redundancy)


def _more_parameters(
    data: BlockData,
    wanted: dict[str, tuple[str, ...]],
    at: Approximate,
    options: BlockOptions,
    before: tuple[Assembled, BlockAdjustment],
    findings: list[str],
) -> tuple[BlockData, Assembled, BlockAdjustment]:
    """Release principal distance and principal point as far as the block determines them.

    Tried on the observations that are good without them; what is not determined is held and named.
    """
    assembled, result = before
    good = assembled.rows[result.used[: len(assembled.rows)]]
    clean = replace(data, ties=data.ties.select(np.sort(good)))
    start = _moved(at, assembled, result)
    plain = replace(options, robust="none", max_iterations=_TRIAL_ITERATIONS)
    held: set[str] = set()
    for _ in range(3):
        keys = {n: tuple(k for k in chosen if k not in held) for n, chosen in wanted.items()}
        if all(set(keys[n]) <= set(data.calibrate[n]) for n in keys):
            return data, assembled, result
        try:
            trial = adjust_assembled(clean.with_calibration({**data.calibrate, **keys}), start, plain)
            doubts = undetermined(data, keys, trial[1])
        except NotDeterminedError as error:
            doubts = {"principal_distance": str(error)}
        if not doubts:
            released = data.with_calibration({**data.calibrate, **keys})
            final = adjust_assembled(released, start, options)
            return released, *final
        first = next(key for key in (*HELD_FIRST, *doubts) if key in doubts and key not in held)
        held.add(first)
        if first == "principal_point":
            held |= {"p1", "p2"}
        findings.append(doubts[first])
    return data, assembled, result


def _taking_part(
    inputs: OrientInputs, measured: Measured, findings: list[str]
) -> tuple[Approximate, dict[int, str]]:
    """Start orientations of the photographs that are adjusted together, and why the others are not."""
    n = len(measured.photos)
    left_out = dict(measured.not_joined)
    with_datum = [part for part in measured.parts if part.datum != "none"]
    chosen = with_datum or list(measured.parts[:1])
    for part in measured.parts:
        if part not in chosen:
            names = ", ".join(measured.photos[k].name for k in part.photos)
            reason = f"belongs to a part of {len(part.photos)} photographs without connection to the others"
            findings.append(f"unconnected part without a datum, left out: {names}")
            left_out |= dict.fromkeys(part.photos, reason)
    if len(measured.parts) > 1:
        sizes = " + ".join(str(len(part.photos)) for part in measured.parts)
        how = "they are connected by positions and control points only" if with_datum else ""
        findings.append(
            f"the block falls apart into {len(measured.parts)} parts of {sizes} photographs; {how}".rstrip(
                "; "
            )
        )
    centres, rotations = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
    for part in chosen:
        centres[list(part.photos)] = part.centres
        rotations[list(part.photos)] = part.rotations
        findings += part.notes
        findings += [
            f"{part.datum}: {_outlier(measured, part.datum, name)} contradicts the others"
            for name in part.outliers
        ]
    if with_datum:
        placed = placed_by_table(inputs, measured, centres, rotations)
        if placed:
            names = ", ".join(measured.photos[k].name for k in placed)
            findings.append(
                "photographs that share too few points with the others to be joined, placed by their stated "
                f"orientation and adjusted with it as start: {names}"
            )
        left_out = {k: reason for k, reason in left_out.items() if k not in placed}
    return Approximate(centres, rotations, measured.points, bool(with_datum)), left_out


def _outlier(measured: Measured, kind: str, name: str) -> str:
    return measured.photos[int(name)].name if kind == "positions" else name


def _block_data(inputs: OrientInputs, measured: Measured) -> BlockData:
    cameras: dict[str, Camera] = {}
    calibrate: dict[str, tuple[str, ...]] = {}
    for photo in inputs.photos:
        if photo.camera.name not in cameras:
            camera, keys = calibrated_camera(inputs, photo)
            cameras[camera.name], calibrate[camera.name] = camera, keys
    numbers = {name: k for k, name in enumerate(cameras)}
    control, check, sigma = None, None, None
    if inputs.control is not None:
        rows = control_measurements(inputs.control, measured.photos)
        if rows is not None and inputs.control.is_placed:
            point, photo_of, pixels, sigma = rows
            c = inputs.control
            pixels = shared_pixels(inputs.photos, photo_of, pixels)
            control = KnownPoints(c.names, c.tangent_xyz, c.sigma_m, point, photo_of, pixels)
            check = c.check
    ties = measured.ties
    ties = replace(ties, pixels=shared_pixels(inputs.photos, ties.photo, ties.pixels))
    return BlockData(
        tuple(photo.name for photo in inputs.photos),
        np.array([numbers[photo.camera.name] for photo in inputs.photos], dtype=np.int64),
        tuple(cameras.values()),
        calibrate,
        ties,
        control,
        check,
        sigma,
        inputs.positions.tangent,
        inputs.positions.sigma_m,
        inputs.positions.attitudes,
        inputs.positions.attitude_sigma,
        measured.tie_names,
        {name: prior_sigmas(inputs, name) for name in cameras},
        navigation_groups(inputs),
    )
