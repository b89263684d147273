"""`adjusted_in` of a project: which of its two meanings holds, or a refusal that names both."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import InputError
from stereomate.frames.adjusted import GridAdjustment, grid_height_excess_m, space_from_grid_centres
from stereomate.project.control import read_control
from stereomate.project.ground import GroundUnderBlock
from stereomate.project.orientations import Reading, WrittenOrientations, height_system, map_frame, named
from stereomate.project.schema import ControlSection, ProjectFile

Array = NDArray[np.float64]

_MEANINGS = (
    '"grid" (from an adjustment in the map grid, centre heights carry its scale) or "space" (true positions: '
    "satellite navigation, an adjustment in a tangent or geocentric frame)"
)


# More than this share of the GSD in height must not depend on a key that nobody set.
_LARGEST_SHARE_OF_GSD = 0.3


def resolve_adjusted(
    file: ProjectFile,
    reading: Reading,
    written: WrittenOrientations,
    rows: NDArray[np.int64],
    ground: GroundUnderBlock | None,
    notes: list[str],
) -> GridAdjustment | None:
    """How centres become true positions; None where they are taken as they are written.

    Parameters
    ----------
    written : WrittenOrientations
    rows : ndarray of int
        Those of its orientations that have a photograph.
    ground : GroundUnderBlock or None
        From the positions as they are written.

    Raises
    ------
    ProjectError
        If the key is missing and its meanings differ by more than 0.3 GSD, or it cannot hold.
    """
    declared = file.photos.adjusted_in
    if declared == "space":
        notes.append("centres are true positions (declared)")
        return None
    if not written.in_grid:
        if declared == "grid":
            raise reading.error("adjusted_in", "cannot be: positions are not coordinates of a map grid")
        return None
    if declared is None and written.camera_values:
        notes.append(
            f"{written.source.name}: centres are taken as true positions, because OpenSfM adjusts in a "
            "topocentric frame"
        )
        return None
    reference, relief, source = _reference(file, reading, written, ground)
    if declared is None:
        _refuse_or_note(reading, written, reference, rows, ground, notes, file.products.gsd)
        return None
    try:
        adjustment = space_from_grid_centres(written.frame, written.positions, reference)
    except InputError as error:
        raise named(error, reading.project_file, "photos.grid_reference_height") from error
    ppm = (float(adjustment.effective_scale.mean()) - 1.0) * 1e6
    notes.append(
        f"centres come from an adjustment in the grid: their heights above {reference:.1f} m ({source}) were "
        f"divided by the scale 1 {ppm:+.0f} ppm, which changes them by {adjustment.shift_m.mean():+.3f} m on "
        f"average, known to ±{adjustment.uncertainty_m(relief):.3f} m"
    )
    return adjustment


def _refuse_or_note(
    reading: Reading,
    written: WrittenOrientations,
    reference: float,
    rows: NDArray[np.int64],
    ground: GroundUnderBlock | None,
    notes: list[str],
    product_gsd: float | None,
) -> None:
    size = float(np.abs(grid_height_excess_m(written.frame, written.positions[rows], reference)).max())
    limit = _LARGEST_SHARE_OF_GSD * _gsd(written, ground, product_gsd)
    if size > limit:
        rule = (
            f"must be given, because its two meanings, {_MEANINGS}, differ by {size:.3f} m in the heights of "
            f"the centres, more than {_LARGEST_SHARE_OF_GSD:g} GSD ({limit:.3f} m)"
        )
        raise reading.error("adjusted_in", rule)
    notes.append(
        f'adjusted_in is not given: centres are taken as true positions ("space"); had they been adjusted in '
        f"the grid, they would be {size:.3f} m wrong in height, less than {_LARGEST_SHARE_OF_GSD:g} GSD"
    )


def _gsd(written: WrittenOrientations, ground: GroundUnderBlock | None, product_gsd: float | None) -> float:
    """The finer of the products' and the photographs' GSD, in metres."""
    gsd = [] if product_gsd is None else [product_gsd * written.frame.unit_m]
    if ground is not None and np.isfinite(ground.gsd_m).any():
        gsd.append(float(np.nanmedian(ground.gsd_m)))
    return min(gsd, default=0.0)


def _reference(
    file: ProjectFile, reading: Reading, written: WrittenOrientations, ground: GroundUnderBlock | None
) -> tuple[float, float, str]:
    """Height the scale acts about, in the heights of the centres; relief about it; where it is from."""
    relief = 0.0 if ground is None else ground.relief_m
    stated = file.photos.grid_reference_height
    if stated is not None:
        return stated, relief, "grid_reference_height"
    middle = written.frame.geodetic_from_map(written.positions).mean(axis=0)
    if file.control is not None:
        mean, spread = _control_heights(file.control, reading)
        source = "mean control height"
        relief = max(relief, spread)
    elif ground is not None:
        mean, source = ground.mean_m, "mean terrain under the block"
    else:
        rule = "must be given: without a height model and control nothing says where the grid has its scale"
        raise reading.error("grid_reference_height", rule)
    return float(written.frame.map_from_geodetic([middle[0], middle[1], mean])[2]), relief, source


def _control_heights(section: ControlSection, reading: Reading) -> tuple[float, float]:
    """Mean and standard deviation of the ellipsoidal heights of the control points."""
    control = read_control(section, reading.folder)
    heights = height_system(section.heights, reading.heights, reading, "control.heights")
    frame = map_frame(section.crs or reading.crs, heights, reading.project_file, "control.crs")
    points = frame.geodetic_from_map(control.xyz)
    return float(points[:, 2].mean()), float(points[:, 2].std())
