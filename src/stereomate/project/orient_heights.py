"""Heights of positions looked at without control: against the height model, and against the photographs.

Bases between positions give the model its scale, and with it the flying height: tie points then lie where
the ground must be. A height model says where it is. Without one the ups and downs of the flight remain:
heights in feet go up and down 3.28 times as much as the photographs do.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import CrsError
from stereomate.frames.checks import check_height_units
from stereomate.frames.transform import map_from_map, map_from_tangent
from stereomate.project.orient_inputs import OrientInputs
from stereomate.project.orient_measure import Measured, PartStart
from stereomate.project.orientations import Reading
from stereomate.project.surface import open_terrain
from stereomate.terrain.model import HeightModel
from stereomate.units import FOOT

Array = NDArray[np.float64]

_LEAST_POINTS: Final = 20
_LEAST_PHOTOS: Final = 6
# An offset from the height model is named from so many standard deviations of the positions' heights, and
# from this part of the flying height: trees, and a principal distance that is not known better, make less.
_SIGMAS: Final = 4.0
_PART: Final = 0.03
# How well a separation of ellipsoid and geoid must explain an offset.
_SEPARATION: Final = 0.1
_SLOPE_SIGMAS: Final = 5.0


def height_findings(inputs: OrientInputs, measured: Measured) -> list[str]:
    """What heights of positions contradict.

    Raises
    ------
    HeightSystemError
        If they are in feet and a height model in metres shows it, or the reverse.
    """
    parts = [part for part in measured.parts if part.datum == "positions"]
    if inputs.tangent is None or not parts:
        return []
    model = _terrain(inputs)
    if model is not None:
        found = _against_terrain(inputs, measured, parts, model)
        if found is not None:
            return [found] if found else []
    return [line for part in parts if (line := _against_model(inputs, part))]


def _terrain(inputs: OrientInputs) -> HeightModel | None:
    # A level that stands in was made of the positions themselves.
    if not inputs.file.has_ground or inputs.tangent is None:
        return None
    known = inputs.positions.tangent[np.isfinite(inputs.positions.tangent).all(axis=1)]
    path = inputs.path
    reading = Reading(path, "photos", path.parent, inputs.file.project.crs, inputs.frame.heights)
    return open_terrain(
        inputs.file, reading, map_from_tangent(inputs.tangent, inputs.frame, known), inputs.frame, []
    )


def _against_terrain(
    inputs: OrientInputs, measured: Measured, parts: list[PartStart], model: HeightModel
) -> str | None:
    """In words how far tie points lie off the height model, empty if they do not; None if nothing tells."""
    assert inputs.tangent is not None  # asked before
    photos = [k for part in parts for k in part.photos]
    seen = np.unique(measured.ties.point[np.isin(measured.ties.photo, photos)])
    points = measured.points[seen]
    ground = map_from_tangent(inputs.tangent, inputs.frame, points[np.isfinite(points[:, 0])])
    try:
        there = map_from_map(model.frame, inputs.frame, ground)
    except CrsError:
        return None
    terrain = model.heights_at(there[:, :2])
    off = (there[:, 2] - terrain) * inputs.frame.heights.metres_per_unit
    known = np.isfinite(off)
    if np.count_nonzero(known) < _LEAST_POINTS:
        return None
    shift = float(np.median(off[known]))
    spread = 1.4826 * float(np.median(np.abs(off[known] - shift)))
    centres = np.concatenate([part.centres for part in parts])
    height = float(np.median(centres[:, 2]) - np.nanmedian(points[:, 2]))
    stated = inputs.positions.tangent[photos]
    stated = stated[np.isfinite(stated).all(axis=1)]
    written = map_from_tangent(inputs.tangent, inputs.frame, stated)[:, 2]
    if abs(shift) > max(_SIGMAS * inputs.positions.sigma_m[2], _PART * height, spread):
        table = inputs.file.photos.orientation
        source = inputs.path.parent / table if table else None
        check_height_units(
            written, written - shift / inputs.frame.heights.metres_per_unit, "the positions", source
        )
        return _offset(inputs, ground, shift, spread)
    return ""


def _offset(inputs: OrientInputs, ground: Array, shift: float, spread: float) -> str:
    separation = _separation(inputs, ground)
    text = (
        f"heights of the positions do not fit the height model: the ground of the photographs lies "
        f"{shift:+.1f} m (scatter {spread:.1f} m) off it"
    )
    if separation is not None and abs(abs(shift) - abs(separation)) < _SEPARATION * abs(separation):
        kind = "ellipsoidal" if shift * separation > 0.0 else "above sea level"
        return (
            f"{text}; ellipsoid and geoid are {separation:+.1f} m apart here: the heights of the positions "
            f"are probably {kind} (photos.heights says otherwise)"
        )
    return f"{text}: another height system, or heights of another kind?"


def _separation(inputs: OrientInputs, ground: Array) -> float | None:
    """Ellipsoidal height minus height of the project's system; None where that is not known."""
    if inputs.frame.heights.kind == "undeclared":
        return None
    middle = np.median(ground, axis=0)
    value = float(
        inputs.frame.geodetic_from_map(middle)[2] - middle[2] * inputs.frame.heights.metres_per_unit
    )
    return value if abs(value) > 1.0 else None


def _against_model(inputs: OrientInputs, part: PartStart) -> str:
    """Whether the positions go up and down in feet; a plane is taken off both, which a tilt may be."""
    stated = inputs.positions.tangent[list(part.photos)]
    known = np.isfinite(stated).all(axis=1)
    if np.count_nonzero(known) < _LEAST_PHOTOS:
        return ""
    plan = stated[known, :2] - stated[known, :2].mean(axis=0)
    design = np.column_stack([plan, np.ones(len(plan))])
    basis, _ = np.linalg.qr(design)

    def without_plane(values: Array) -> Array:
        return np.asarray(values - basis @ (basis.T @ values))

    flown = without_plane(part.centres[known, 2])
    written = without_plane(stated[known, 2])
    square = float(flown @ flown)
    if not square > 0.0:
        return ""
    slope = float(flown @ written) / square
    rest = written - slope * flown
    freedom = max(len(plan) - 4, 1)
    sigma = max(math.sqrt(float(rest @ rest) / freedom), inputs.positions.sigma_m[2]) / math.sqrt(square)
    for factor, word in ((1.0 / FOOT, "feet"), (FOOT, "metres where the CRS has feet")):
        if abs(slope - factor) < 3.0 * sigma and abs(slope - 1.0) > _SLOPE_SIGMAS * sigma:
            return (
                f"heights of the positions go up and down {slope:.2f} times as much as the photographs say: "
                f"they look like {word}, and heights of the ground are wrong then"
            )
    return ""
