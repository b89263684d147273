"""The same adjustment seen in other ways: variance components, a shift of the positions, in the map grid."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Final

import numpy as np

from stereomate.block.adjustment import BlockAdjustment
from stereomate.block.in_grid import GridComparison, Method, compare_in_grid
from stereomate.block.network import BlockCamera, Control, Network
from stereomate.block.systematic import find_systematic_shift
from stereomate.block.variance import components_of
from stereomate.errors import NotDeterminedError, StereomateError
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.project.orient_adjust import Adjusted
from stereomate.project.orient_inputs import OrientInputs

_METHODS: Final[tuple[Method, ...]] = ("P1", "M2", "M3")
_C: Final = "principal_distance_mm"
_DIGITS: Final = 4
_NO_HEIGHTS: Final = "not determined: no control point with a height took part"


def comparisons(inputs: OrientInputs, adjusted: Adjusted) -> dict[str, Any]:
    """What `adjustment.json` holds under ``comparison``.

    ``variance_components``: factors of the standard deviations of each kind of observations.
    ``positions_shift``: a shift common to all positions against control, with its likely cause.
    ``in_grid``: the same block adjusted in the map grid as other programs do it (Ressl 2002), with
    curvature correction alone (P1), scaled heights (M2) or scaled principal distance (M3), the latter held
    and free: grid adjustment minus rigorous one, metres.
    """
    result = without_gross_errors(adjusted.result)
    tangent, frame = inputs.tangent, inputs.frame
    found: dict[str, Any] = {
        "variance_components": [
            {"group": c.group, "factor": _rounded(c.factor), "redundancy": _rounded(c.redundancy)}
            for c in components_of(adjusted.result)
        ]
    }
    if not adjusted.has_datum or tangent is None or frame.is_geographic:
        return found
    level = MapFrame(frame.crs, HeightSystem.ellipsoidal())
    # Most of the control taken out is put back: a shift of all positions is what makes it wrong.
    # A principal distance that is found too takes a shift of the heights into itself: it is held meanwhile.
    shift = _shift(_with_given(result, adjusted.result.network), tangent, level)
    if shift is not None:
        found["positions_shift"] = shift
    found["in_grid"] = _in_grid(result, tangent, level)
    return found


def findings_of(comparison: dict[str, Any]) -> list[str]:
    """What a reader must know of it."""
    lines = []
    shift = comparison.get("positions_shift")
    if shift is not None and shift["cause"]:
        size = ", ".join(f"{v:+.3f}" for v in shift["east_north_up_m"])
        line = f"positions against control: all are off by {size} m (east, north, up); {shift['cause']}"
        remedy = '. photos.adjusted_in = "grid" takes it out'
        lines.append(line + (remedy if "Ressl" in shift["cause"] else ""))
    return lines


def without_gross_errors(result: BlockAdjustment) -> BlockAdjustment:
    """The adjustment over the network of what was used: another one need not search again."""
    image = result.network.image
    used = result.used
    if used.all() and not result.gross_errors:
        return result
    thinned = replace(
        image, photo=image.photo[used], point=image.point[used], xy=image.xy[used], sigma=image.sigma[used]
    )
    network = replace(result.solution.prepared.network, image=thinned)
    fixed = result.network.photographs.fixed
    network = replace(network, photographs=replace(network.photographs, fixed=fixed))
    return replace(
        result,
        network=network,
        options=replace(result.options, robust="none"),
        residuals=result.residuals[used],
        used=np.ones(int(used.sum()), np.bool_),
    )


def _with_given(result: BlockAdjustment, given: Network) -> BlockAdjustment:
    """With principal distances held as they were found, and control as given if most of it was taken out."""
    cameras = tuple(
        BlockCamera(camera, {name: sigma for name, sigma in entry.free.items() if name != _C})
        for camera, entry in zip(result.cameras, result.network.cameras, strict=True)
    )
    network = replace(result.network, cameras=cameras)
    if _mostly_out(result.network.control, given.control):
        network = replace(network, control=given.control, positions=given.positions)
    return replace(result, network=network)


def _mostly_out(control: Control | None, given: Control | None) -> bool:
    """Whether the tests took more control than they left: then it may be the positions that are wrong."""
    if control is None or given is None:
        return False
    assert given.check is not None  # filled in by the network
    known = np.isfinite(given.sigma) & ~given.check[:, None]
    out = (known & ~np.isfinite(control.sigma)).any(axis=1)
    return 2 * int(out.sum()) > int(known.any(axis=1).sum())


def _shift(result: BlockAdjustment, tangent: TangentFrame, frame: MapFrame) -> dict[str, Any] | None:
    network = result.network
    if network.positions is None or network.control is None or network.positions.shift:
        return None
    assert network.control.check is not None
    if (network.control.check | ~np.isfinite(network.control.sigma).any(axis=1)).all():
        return None
    try:
        found = find_systematic_shift(result, tangent, frame)
    except NotDeterminedError:
        return None
    return {
        "east_north_up_m": [_rounded(v) for v in found.shift],
        "sigma_m": [_rounded(v) for v in found.sigma],
        "significant": found.significant.tolist(),
        "grid_excess_m": _rounded(found.grid_excess_m),
        "cause": found.cause,
    }


def _in_grid(result: BlockAdjustment, tangent: TangentFrame, frame: MapFrame) -> list[dict[str, Any]]:
    rows = []
    own = {n: s for entry in result.network.cameras for n, s in entry.free.items() if n != _C}
    for free in ({}, {_C: math.inf}):
        undetermined = bool(free) and not _holds_heights(result)
        for method in _METHODS:
            if undetermined:
                rows.append({"method": method, "principal_distance": _word(free), "failed": _NO_HEIGHTS})
                continue
            try:
                found = compare_in_grid(result, tangent, frame, method, {**own, **free})
            except StereomateError as error:
                rows.append({"method": method, "principal_distance": _word(free), "failed": str(error)})
                continue
            rows.append(_row(found, _word(free)))
    return rows


def _holds_heights(result: BlockAdjustment) -> bool:
    """Whether control that took part has heights: without, a free principal distance is any."""
    control = result.solution.prepared.network.control
    if control is None:
        return False
    assert control.check is not None  # filled in by the network
    return bool((~control.check & np.isfinite(control.sigma[:, 2])).any())


def _word(free: dict[str, float]) -> str:
    return "free" if free else "held"


def _row(found: GridComparison, word: str) -> dict[str, Any]:
    return {
        "method": found.method,
        "principal_distance": word,
        "principal_distance_mm": _rounded(found.principal_distance_mm),
        "points_mean_m": [_rounded(v) for v in found.points],
        "points_rms_m": [_rounded(v) for v in found.points_rms],
        "centres_mean_m": [_rounded(v) for v in found.centres],
        "centres_rms_m": [_rounded(v) for v in found.centres_rms],
        "image_rms_px": _rounded(found.rms_px),
        "converged": found.adjustment.converged,
    }


def _rounded(value: float) -> float | None:
    return round(float(value), _DIGITS) if math.isfinite(value) else None
