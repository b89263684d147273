"""Control and check points of an orientation as plain numbers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereomate.block.reliability import Reliability
from stereomate.frames.transform import map_from_tangent
from stereomate.project.orient_adjust import Adjusted
from stereomate.project.orient_inputs import OrientInputs

Array = NDArray[np.float64]


def control_record(inputs: OrientInputs, adjusted: Adjusted) -> dict[str, Any] | None:
    """Residuals of control and check points, those that contradict the others beside the rest."""
    result = adjusted.result
    observed = result.network.control
    if observed is None or inputs.control is None:
        return None
    statistics = result.statistics
    part = statistics.control if statistics is not None else None
    sigma = statistics.point_sigma if statistics is not None else None
    record: dict[str, Any] = {}
    assert observed.check is not None  # filled in by the network
    residual = observed.xyz - result.points[observed.point]
    given = _given(inputs, observed.xyz)
    apart = _apart(adjusted)
    counted = np.where(apart, math.nan, residual)
    for kind, rows in (
        ("control", np.flatnonzero(~observed.check)),
        ("check", np.flatnonzero(observed.check)),
    ):
        with np.errstate(invalid="ignore"):
            rms = [
                number(math.sqrt(float(np.mean(v**2)))) if (v := c[np.isfinite(c)]).size else None
                for c in counted[rows].T
            ]
        record[kind] = {
            # Those that took part: what was left out has no residual.
            "count": int(np.isfinite(counted[rows]).any(axis=1).sum()),
            "rms_m": rms,
            # Gross errors of control, check points that contradict the block: listed, not counted.
            "apart": [result.network.points.names[int(observed.point[k])] for k in rows if apart[k].any()],
            "points": [
                {
                    **_control_point(result, observed, part, sigma, residual, k),
                    "given": given[k],
                    "apart": bool(apart[k].any()),
                }
                for k in rows.tolist()
            ],
        }
    return record


def _apart(adjusted: Adjusted) -> NDArray[np.bool_]:
    """Coordinates of control and check points that are not counted with the others, shape (k, 3)."""
    result = adjusted.result
    assert result.network.control is not None  # asked before
    apart = np.zeros(result.network.control.xyz.shape, np.bool_)
    for error in result.gross_errors:
        if error.kind == "control":
            apart[error.row] |= np.isfinite(error.size)
    for point in result.check_points:
        apart[point.row] |= point.stands_out
    return apart


def _given(inputs: OrientInputs, xyz: Array) -> list[list[float | None]]:
    """Given coordinates of points in the map; nothing for one that is not known in all three."""
    out = np.full(xyz.shape, math.nan)
    known = np.isfinite(xyz).all(axis=1)
    if inputs.tangent is not None and known.any():
        out[known] = map_from_tangent(inputs.tangent, inputs.frame, xyz[known])
    return [numbers(row) for row in out]


def _control_point(
    result: Any, observed: Any, part: Reliability | None, sigma: Array | None, residual: Array, k: int
) -> dict[str, Any]:
    point = int(observed.point[k])
    return {
        "name": result.network.points.names[point],
        "residual_m": numbers(residual[k]),
        "sigma_m": numbers(np.where(np.isfinite(observed.sigma[k]), observed.sigma[k], math.nan)),
        "standard_deviation_m": None if sigma is None else numbers(sigma[point]),
        "standardized": None if part is None else numbers(part.standardized[k]),
        "redundancy": None if part is None else numbers(part.redundancy[k]),
        "detectable_m": None if part is None else numbers(part.minimal_detectable[k]),
        "rays": int(np.count_nonzero(result.network.image.point[result.used] == point)),
    }


def number(value: float) -> float | None:
    """Rounded far below what matters, so that the last bits do not reach a file."""
    value = float(value)
    return float(f"{value:.10g}") if math.isfinite(value) else None


def numbers(values: Array) -> list[float | None]:
    """`number` of every entry, flat."""
    return [number(v) for v in np.asarray(values).ravel().tolist()]
