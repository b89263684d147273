"""Layers of an orientation for a GIS: photographs, points, and the residuals of what was given as vectors."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray

from stereomate.formats.geopackage import Layer, write_layers
from stereomate.frames.transform import map_from_tangent
from stereomate.project.orient_adjust import Adjusted
from stereomate.project.orient_inputs import OrientInputs
from stereomate.project.orient_record import OrientedPhotos

Array = NDArray[np.float64]

LAYERS: Final = "block.gpkg"
# Part of the extent of the block that the longest vector takes.
_LONGEST: Final = 0.1


def write_orient_layers(
    path: Path, inputs: OrientInputs, adjusted: Adjusted, photos: OrientedPhotos, record: dict[str, Any]
) -> Path:
    """Write the layers ``photographs``, ``points`` and ``residual_vectors``; only with a datum."""
    layers = [
        _photographs(photos, record),
        _points(inputs, adjusted),
        _vectors(inputs, adjusted, record),
    ]
    write_layers(path, layers, inputs.frame.crs)
    return path


def _photographs(photos: OrientedPhotos, record: dict[str, Any]) -> Layer:
    listed = {entry["name"]: entry for entry in record["photographs"]}
    residuals = {
        entry["name"]: entry["residual_m"] for entry in (record["positions"] or {}).get("residuals", [])
    }
    nothing = [None, None, None]
    missing = [residuals.get(Path(name).stem, nothing) for name in photos.names]
    deviations = [listed[name]["standard_deviation_m"] for name in photos.names]
    columns: dict[str, Any] = {"name": list(photos.names), "camera": list(photos.cameras)}
    columns |= dict(zip(("omega", "phi", "kappa"), photos.opk_deg.T, strict=True))
    columns |= {f"s{a}": _axis(deviations, k) for k, a in enumerate("xyz")}
    columns |= {f"position_residual_{a}": _axis(missing, k) for k, a in enumerate("xyz")}
    columns["image_rms_px"] = [_plain(listed[name].get("image_rms_px")) for name in photos.names]
    columns["image_points"] = [listed[name]["image_points"] for name in photos.names]
    return Layer("photographs", "Point Z", shapely.points(photos.positions), columns)


def _points(inputs: OrientInputs, adjusted: Adjusted) -> Layer:
    result = adjusted.result
    known = np.flatnonzero(np.isfinite(result.points).all(axis=1))
    assert inputs.tangent is not None  # with a datum there is one
    xyz = map_from_tangent(inputs.tangent, inputs.frame, result.points[known])
    statistics = result.statistics
    sigma = np.full((len(known), 3), math.nan) if statistics is None else statistics.point_sigma[known]
    rays = np.bincount(result.network.image.point[result.used], minlength=len(result.points))
    kinds = np.full(len(result.points), "tie", dtype=object)
    control = result.network.control
    if control is not None:
        assert control.check is not None  # filled in by the network
        kinds[control.point] = np.where(control.check, "check", "control")
    names = result.network.points.names
    columns = {
        "name": [names[k] for k in known.tolist()],
        "kind": kinds[known].tolist(),
        "sx": sigma[:, 0],
        "sy": sigma[:, 1],
        "sz": sigma[:, 2],
        "rays": rays[known],
    }
    return Layer("points", "Point Z", shapely.points(xyz), columns)


def _vectors(inputs: OrientInputs, adjusted: Adjusted, record: dict[str, Any]) -> Layer:
    """Lines from the adjusted place to where, exaggerated, the observed one lies."""
    result = adjusted.result
    rows: list[tuple[str, str, Array, list[float | None]]] = []
    names = {name: k for k, name in enumerate(result.network.photographs.names)}
    for entry in (record["positions"] or {}).get("residuals", []):
        rows.append(("position", entry["name"], result.centres[names[entry["name"]]], entry["residual_m"]))
    points = {name: k for k, name in enumerate(result.network.points.names)}
    for kind, values in (record["control"] or {}).items():
        for entry in values["points"]:
            rows.append((kind, entry["name"], result.points[points[entry["name"]]], entry["residual_m"]))
    rows = [row for row in rows if np.isfinite(row[2]).all()]
    if not rows:
        return Layer("residual_vectors", "LineString Z", [], {})
    place = np.array([row[2] for row in rows])
    residual = np.array([[_plain(v) for v in row[3]] for row in rows])
    moved = np.nan_to_num(residual)
    scale = exaggeration(place, moved)
    assert inputs.tangent is not None  # with a datum there is one
    start = map_from_tangent(inputs.tangent, inputs.frame, place)
    end = map_from_tangent(inputs.tangent, inputs.frame, place + scale * moved)
    columns: dict[str, Any] = {"kind": [row[0] for row in rows], "name": [row[1] for row in rows]}
    columns |= {f"d{axis}": residual[:, k] for k, axis in enumerate("xyz")}
    columns["exaggeration"] = np.full(len(rows), scale)
    lines = shapely.linestrings(np.stack([start, end], axis=1))
    return Layer("residual_vectors", "LineString Z", lines, columns)


def exaggeration(place: Array, residual: Array) -> float:
    """A round factor that makes the longest residual a tenth of the block."""
    extent = float(np.ptp(place[:, :2], axis=0).max())
    longest = float(np.linalg.norm(residual, axis=1).max())
    if not (extent > 0.0 and longest > 0.0):
        return 1.0
    wanted = _LONGEST * extent / longest
    step: float = 10.0 ** math.floor(math.log10(wanted))
    return float(max(k * step for k in (1.0, 2.0, 5.0) if k * step <= wanted * (1.0 + 1e-12)))


def _axis(values: list[Any], k: int) -> list[float]:
    return [_plain(v[k]) for v in values]


def _plain(value: float | None) -> float:
    return math.nan if value is None else float(value)
