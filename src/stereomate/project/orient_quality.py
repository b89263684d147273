"""Reliability of each kind of observations, and whether what was asked of the result is met."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereomate.block.adjustment import BlockAdjustment
from stereomate.block.reliability import Reliability
from stereomate.project.schema import AccuracySection

Array = NDArray[np.float64]

# Edges of the histogram of standardized residuals.
_BINS = np.linspace(-5.0, 5.0, 41)


def observation_groups(result: BlockAdjustment) -> list[dict[str, Any]]:
    """Of each kind of observations: how many, how well controlled, what errors would have been found.

    Image points in pixels, control and positions in metres, attitudes in radians.
    """
    statistics = result.statistics
    if statistics is None:
        return []
    parts: tuple[tuple[str, Reliability | None], ...] = (
        ("image", statistics.image),
        ("control", statistics.control),
        ("positions", statistics.positions),
        ("attitudes", statistics.attitudes),
    )
    groups = []
    for kind, part in parts:
        if part is None or not part.residuals.size:
            continue
        took_part = np.isfinite(part.redundancy)
        if kind == "image":
            took_part &= result.used[:, None]
        if not took_part.any():
            continue
        groups.append(_group(kind, part, took_part) | {"gross_errors": _count(result, kind)})
    return groups


def _count(result: BlockAdjustment, kind: str) -> int:
    return sum(error.kind == kind for error in result.gross_errors)


def _group(kind: str, part: Reliability, rows: NDArray[np.bool_]) -> dict[str, Any]:
    redundancy, detectable = part.redundancy[rows], part.minimal_detectable[rows]
    detectable = detectable[np.isfinite(detectable)]
    standardized = part.standardized[rows]
    standardized = standardized[np.isfinite(standardized)]
    return {
        "kind": kind,
        "unit": {"image": "px", "attitudes": "rad"}.get(kind, "m"),
        "observations": int(rows.sum()),
        "residual_rms": _number(math.sqrt(float(np.mean(part.residuals[rows] ** 2)))),
        "redundancy_mean": _number(float(redundancy.mean())),
        "redundancy_least": _number(float(redundancy.min())),
        "largest_standardized": _number(float(np.abs(standardized).max())) if standardized.size else None,
        "detectable_median": _number(float(np.median(detectable))) if detectable.size else None,
        "standardized_histogram": np.histogram(standardized, _BINS)[0].tolist(),
    }


def judged_accuracy(asked: AccuracySection | None, control: dict[str, Any] | None) -> list[dict[str, Any]]:
    """What `[accuracy]` asks in plan and height against the rms of the check points."""
    if asked is None:
        return []
    check = (control or {}).get("check")
    rms = check["rms_m"] if check and check["count"] else [None, None, None]
    plan = None if rms[0] is None or rms[1] is None else math.hypot(rms[0], rms[1])
    found = []
    for what, limit, value in (
        ("horizontal", asked.horizontal_m, plan),
        ("vertical", asked.vertical_m, rms[2]),
    ):
        if limit is not None:
            met = None if value is None else bool(value <= limit)
            found.append({"what": what, "asked_m": limit, "found_m": _number(value), "met": met})
    return found


def _number(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(f"{value:.8g}")
