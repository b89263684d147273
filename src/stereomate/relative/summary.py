"""A relative orientation as plain numbers: the JSON record of a pair, and its lines to print."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import NotDeterminedError
from stereomate.forms import PAIR
from stereomate.relative.automatic import AutomaticOrientation
from stereomate.relative.diagnosis import GeometryDiagnosis
from stereomate.relative.elements import Elements
from stereomate.relative.orientation import RelativeOrientation
from stereomate.relative.sixpoints import six_points


def pair_record(result: AutomaticOrientation, names: tuple[str, str], points: bool = True) -> dict[str, Any]:
    """Everything known of an oriented pair as dicts, lists and numbers.

    Parameters
    ----------
    result : AutomaticOrientation
    names : (str, str)
        Left and right photograph.
    points : bool
        Every correspondence with its residuals and tests too.

    Returns
    -------
    dict
        ``format`` is 1. Angles in degrees and radians are told by their names; base components for a bx of
        one. Elements are there only where the orientation is determined.
    """
    record: dict[str, Any] = {
        "format": PAIR.version,
        "kind": "relative orientation",
        "left": names[0],
        "right": names[1],
        "determined": result.determined,
        "reasons": list(result.reasons),
        "notes": list(result.notes),
        "counts": dict(result.counts),
    }
    orientation = result.orientation
    if orientation is None:
        return record
    record["sampson_rms_px"] = result.rms_px
    record.update(orientation_record(orientation, result.determined))
    if points:
        places = {
            "left_px": np.round(result.left_px, 4).tolist(),
            "right_px": np.round(result.right_px, 4).tolist(),
        }
        record["points"] = {**places, **_points(orientation)}
    return record


def table_record(
    names: Sequence[str],
    orientation: RelativeOrientation | None,
    reasons: Sequence[str],
    notes: Sequence[str],
    points: bool = True,
) -> dict[str, Any]:
    """As `pair_record`, of measured points: their `names` are among the points, lengths are in their unit."""
    record: dict[str, Any] = {
        "format": PAIR.version,
        "kind": "relative orientation of measured points",
        "determined": not reasons,
        "reasons": list(reasons),
        "notes": list(notes),
        "counts": {"points": len(names)},
    }
    if orientation is None:
        return record
    unit = orientation.adjustment.correspondences.unit
    record["counts"]["points used"] = int(np.count_nonzero(orientation.used))
    record["unit"] = unit
    record[f"sampson_rms_{unit}"] = orientation.sampson_rms
    record.update(orientation_record(orientation, not reasons))
    if points:
        record["points"] = {"names": list(names), **_points(orientation)}
    return record


def orientation_record(orientation: RelativeOrientation, determined: bool) -> dict[str, Any]:
    """Sigma0, redundancy, geometry and, where it is determined, the elements and the six-point picture."""
    unit = orientation.adjustment.correspondences.unit
    record: dict[str, Any] = {
        f"sampson_robust_{unit}": orientation.sampson_robust,
        "sigma0": orientation.sigma0,
        "redundancy": orientation.adjustment.redundancy,
    }
    if orientation.diagnosis is not None:
        record["geometry"] = _geometry(orientation.diagnosis)
    if not determined:
        return record
    record["base"] = orientation.pose.base.tolist()
    record["left_from_right"] = orientation.pose.left_from_right.tolist()
    for kind, elements in available_elements(orientation).items():
        record[kind] = _elements(elements)
    record["six_points"] = [
        {
            "number": p.number,
            "points": p.points,
            f"y_parallax_{unit}": p.y_parallax,
            f"standard_deviation_{unit}": p.standard_deviation,
        }
        for p in six_points(orientation.pose, orientation.adjustment.correspondences, orientation.points())
    ]
    return record


def available_elements(orientation: RelativeOrientation) -> dict[str, Elements]:
    """The dependent and the independent pair, as far as they exist for this base."""
    found = {}
    for kind in ("dependent", "independent"):
        try:
            found[kind] = orientation.dependent() if kind == "dependent" else orientation.independent()
        except NotDeterminedError:
            # A base along the optical axis or across the x axis has no such elements.
            continue
    return found


def element_rows(elements: Elements) -> list[tuple[str, str, str]]:
    """(name, value, standard deviation) as text: base components per bx, angles in degrees."""
    rows = []
    for name, value, deviation in zip(
        elements.names, elements.values, elements.standard_deviations, strict=True
    ):
        if name in ("by", "bz"):
            rows.append((f"{name}/bx", f"{value:+.6f}", f"{deviation:.6f}"))
        else:
            rows.append((name, f"{math.degrees(value):+.5f}°", f"{math.degrees(deviation):.5f}°"))
    return rows


def _elements(elements: Elements) -> dict[str, Any]:
    values = {}
    for name, value, deviation in zip(
        elements.names, elements.values, elements.standard_deviations, strict=True
    ):
        length = name in ("by", "bz")
        values[name if length else f"{name}_deg"] = float(value if length else math.degrees(value))
        values[f"{name}_standard_deviation" if length else f"{name}_standard_deviation_deg"] = float(
            deviation if length else math.degrees(deviation)
        )
    return {
        **values,
        "names": list(elements.names),
        "covariance_rad": elements.covariance.tolist(),
        "correlations": elements.correlations.tolist(),
    }


def _geometry(diagnosis: GeometryDiagnosis) -> dict[str, Any]:
    cylinder = diagnosis.critical_cylinder
    return {
        "largest_standard_deviation_deg": diagnosis.largest_standard_deviation_deg,
        "cofactor_omega": diagnosis.cofactor_omega,
        "inflation_omega": diagnosis.inflation_omega,
        "critical_cylinder": {
            "centre_bases": list(cylinder.centre),
            "radius_bases": cylinder.radius,
            "distance": cylinder.distance,
        },
        "flatness": diagnosis.flatness,
        "planar": diagnosis.planar,
        "parallax_ratio": diagnosis.parallax_ratio,
        "other_orientations": [
            {"base": p.base.tolist(), "left_from_right": p.left_from_right.tolist()}
            for p in diagnosis.alternatives
        ],
    }


def _points(orientation: RelativeOrientation) -> dict[str, Any]:
    statistics = orientation.points()
    unit = orientation.adjustment.correspondences.unit

    def column(values: NDArray[np.float64]) -> list[float | None]:
        return [round(float(v), 6) if math.isfinite(v) else None for v in values]

    return {
        "used": statistics.used.tolist(),
        f"y_parallax_{unit}": column(statistics.y_parallax),
        f"sampson_{unit}": column(statistics.sampson),
        "redundancy": column(statistics.redundancy),
        "standardized": column(statistics.standardized),
        f"minimal_detectable_{unit}": column(statistics.minimal_detectable),
    }
