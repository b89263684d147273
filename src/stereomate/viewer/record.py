"""product.json and measure.json of a page: what it needs to show a product, and to measure in it exactly."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from stereomate import __version__
from stereomate.coverage.covariance import OrientationCovariance
from stereomate.forms import PAGE
from stereomate.frames.codes import epsg_code
from stereomate.frames.transform import map_from_tangent
from stereomate.rectify.job import RectifyJob
from stereomate.stereo.product import StereoProduct, orientation_record
from stereomate.viewer.lattice import VALUES, MeasuringLattice
from stereomate.viewer.layers import layer_size, layer_step

# Edge of a tile of the height model.
HEIGHT_TILE: Final = 256
# Nodes around what the product can ask for: bicubic interpolation needs two, places beside it some more.
_HEIGHT_APRON: Final = 4


@dataclass(frozen=True)
class HeightWindow:
    """The part of the height model that a product stands on."""

    col0: int
    row0: int
    cols: int
    rows: int


def height_window(job: RectifyJob, lattice: MeasuringLattice) -> HeightWindow:
    """The part of the height model under the lattice."""
    places = lattice.values[..., 6:8].reshape(-1, 2)
    places = places[np.isfinite(places).all(axis=1)]
    rows, cols = job.heights.shape
    low = np.clip(np.floor(places.min(axis=0)) - _HEIGHT_APRON, 0, (cols, rows)).astype(int)
    high = np.clip(np.ceil(places.max(axis=0)) + _HEIGHT_APRON, 0, (cols, rows)).astype(int)
    return HeightWindow(int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1]))


def viewer_record(product: StereoProduct, object_heights_m: tuple[float, ...]) -> dict[str, Any]:
    """What a product is, as plain values; what is measured with stands in `measuring_record`."""
    job = product.job
    grid, law = job.grid, job.law
    code, parameters = law.kernel_parameters()
    cols, rows = layer_size(grid.size)
    return {
        "format": PAGE.version,
        "software": f"stereomate {__version__}",
        "name": job.name,
        "key": product_key(product),
        "grid": {
            "u0": grid.u0,
            "v0": grid.v0,
            "gsd": grid.gsd,
            "size": list(grid.size),
            "rotation_rad": grid.rotation,
            "unit_m": job.frame.unit_m,
        },
        "crs": {
            "name": job.frame.name,
            "epsg": epsg_code(job.frame.crs),
            "heights": job.frame.heights.description,
            "height_unit_m": job.frame.heights.metres_per_unit,
        },
        "stereo": job.is_stereo,
        "law": {"kind": law.kind, "code": code, "parameters": parameters.tolist()},
        "height_range": list(job.height_range),
        "interpolation": job.options.heights_interpolation,
        "layers": {"cols": cols, "rows": rows, "step": layer_step(grid.size)},
        "homogeneity": list(object_heights_m) if job.is_stereo else [],
        "lineage": {"tile": 512, "maps": bool(product.files.lineage)},
        "photographs": [
            {"name": photograph.name, "centre": list(photograph.orientation.centre)}
            for photograph in job.photographs
        ],
        "models": [[m.left, m.right] for m in job.models],
        "agreement": _agreement(product),
    }


def measuring_record(
    product: StereoProduct, lattice: MeasuringLattice, window: HeightWindow
) -> dict[str, Any]:
    """How the lattice and the tiles of heights are to be read: nothing of it is needed to see the product."""
    job = product.job
    node_rows, node_cols = lattice.values.shape[:2]
    return {
        "datum": lattice.datum,
        "orientation": _covariances(product),
        "centre_pixels": _centre_pixels(job),
        "heights": {
            "tile": HEIGHT_TILE,
            "col0": window.col0,
            "row0": window.row0,
            "cols": window.cols,
            "rows": window.rows,
            "model_size": [job.heights.shape[1], job.heights.shape[0]],
            "cell_m": list(job.heights.cell_size_m),
            "scale": lattice.dem_scale,
            "highest": _highest(job, window),
        },
        "lattice": {
            "col0": lattice.col0,
            "row0": lattice.row0,
            "step": lattice.step,
            "cols": node_cols,
            "rows": node_rows,
            "values": VALUES,
            "error_m": lattice.error_m,
        },
    }


def _covariances(product: StereoProduct) -> dict[str, Any] | None:
    """How well the photographs are oriented: (6, 6) matrices by their numbers, of pairs first by second."""
    record = orientation_record(product)
    if record is None:
        return None
    number = {photograph.name: k for k, photograph in enumerate(product.job.photographs)}
    known = OrientationCovariance.from_record(record)
    return {
        "photographs": [[number[name], matrix.tolist()] for name, matrix in known.photographs.items()],
        "pairs": [[number[a], number[b], matrix.tolist()] for (a, b), matrix in known.pairs.items()],
    }


def _highest(job: RectifyJob, window: HeightWindow) -> float:
    """Highest node of the part of the height model that is published, its own units."""
    highest = job.heights.range_around(window.col0, window.row0, window.cols, window.rows)[1]
    return highest if math.isfinite(highest) else 0.0


def _centre_pixels(job: RectifyJob) -> list[list[float]]:
    """Where the projection centres lie in the product, in the order of its photographs."""
    centres = map_from_tangent(job.tangent, job.frame, job.centres_tangent)
    return [[float(v) for v in pixel] for pixel in job.grid.pixel_from_map(centres[:, :2])]


def _agreement(product: StereoProduct) -> dict[str, Any] | None:
    """Measured residual parallaxes of the product, in pixels, where there are any."""
    found = product.agreement
    if not found:
        return None
    return {
        key: value
        for key, value in found.items()
        if isinstance(value, dict) and all(_plain(v) for v in value.values())
    }


def _plain(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return all(_plain(v) for v in value)
    return (
        value is None or isinstance(value, int | str) or (isinstance(value, float) and math.isfinite(value))
    )


def product_key(product: StereoProduct) -> str:
    """Says whether measurements that a browser kept are those of this product."""
    text = json.dumps({"rasters": sorted(product.files.hashes.items()), "heights": product.height_model_hash})
    return hashlib.sha256(text.encode()).hexdigest()[:16]
