"""`adjusted_in` of a project: which of its two meanings holds, or a refusal that names both."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stereomate.formats.orientation_table import MAP_COLUMNS, read_orientation_table
from stereomate.project.adjusted import LARGEST_SHARE_OF_GSD, GridScale, grid_scale, true_positions
from stereomate.project.ground import GroundUnderBlock
from stereomate.project.orientations import Reading, WrittenOrientations, height_system, map_frame
from stereomate.project.schema import ControlSection, ProjectFile
from stereomate.rectify.options import RectifyOptions

Array = NDArray[np.float64]

_MEANINGS = (
    '"grid" (from an adjustment in the map grid, centre heights carry its scale) or "space" (true positions: '
    "satellite navigation, an adjustment in a tangent or geocentric frame)"
)


def resolve_adjusted(
    file: ProjectFile,
    reading: Reading,
    written: WrittenOrientations,
    rows: NDArray[np.int64],
    ground: GroundUnderBlock | None,
    options: RectifyOptions,
    notes: list[str],
) -> tuple[GridScale | None, Array]:
    """True positions (n, 3) of all orientations, in the frame they are written in.

    Returns
    -------
    scale : GridScale or None
        How they were changed; None where they are as written.
    positions : ndarray (n, 3)

    Raises
    ------
    ProjectError
        If the key is missing and its meanings differ by more than 0.3 GSD, or it cannot hold.
    """
    declared = file.photos.adjusted_in
    positions = written.positions
    if declared == "space":
        notes.append("centres are true positions (declared)")
        return None, positions
    if not written.in_grid:
        if declared == "grid":
            raise reading.error("adjusted_in", "cannot be: positions are not coordinates of a map grid")
        return None, positions
    if declared is None and written.camera_values:
        notes.append(
            f"{written.source.name}: centres are taken as true positions, because OpenSfM adjusts in a "
            "topocentric frame"
        )
        return None, positions
    reference, relief, source = _reference(file, reading, written, ground)
    scale = grid_scale(written.frame, positions, reference, relief)
    if declared == "grid":
        notes.append(f"{scale.sentence}; reference: {source}")
        return scale, true_positions(written.frame, positions, scale)
    _refuse_or_note(reading, written, scale, rows, ground, options, notes)
    return None, positions


def _refuse_or_note(
    reading: Reading,
    written: WrittenOrientations,
    scale: GridScale,
    rows: NDArray[np.int64],
    ground: GroundUnderBlock | None,
    options: RectifyOptions,
    notes: list[str],
) -> None:
    size = float(np.abs(scale.change_m[rows]).max())
    gsd = _gsd(written, ground, options)
    limit = LARGEST_SHARE_OF_GSD * gsd
    if size > limit:
        rule = (
            f"must be given, because its two meanings, {_MEANINGS}, differ by {size:.3f} m in the heights of "
            f"the centres, more than {LARGEST_SHARE_OF_GSD:g} GSD ({limit:.3f} m)"
        )
        raise reading.error("adjusted_in", rule)
    notes.append(
        f'adjusted_in is not given: centres are taken as true positions ("space"); had they been adjusted in '
        f"the grid, they would be {size:.3f} m wrong in height, less than {LARGEST_SHARE_OF_GSD:g} GSD"
    )


def _gsd(written: WrittenOrientations, ground: GroundUnderBlock | None, options: RectifyOptions) -> float:
    """The finer of the products' and the photographs' GSD, in metres."""
    gsd = [] if options.gsd is None else [options.gsd * written.frame.unit_m]
    if ground is not None and np.isfinite(ground.gsd_m).any():
        gsd.append(float(np.nanmedian(ground.gsd_m)))
    return min(gsd, default=0.0)


def _reference(
    file: ProjectFile, reading: Reading, written: WrittenOrientations, ground: GroundUnderBlock | None
) -> tuple[float, float, str]:
    """Ellipsoidal height the scale acts about, relief about it, and where it is from."""
    relief = 0.0 if ground is None else ground.relief_m
    stated = file.photos.grid_reference_height
    if stated is not None:
        middle = written.positions.mean(axis=0)
        point = np.array([middle[0], middle[1], stated])
        return float(written.frame.geodetic_from_map(point)[2]), relief, "grid_reference_height"
    if file.control is not None:
        mean, spread = _control_heights(file.control, reading)
        return mean, max(relief, spread), "mean control height"
    if ground is None:
        rule = "must be given: without a height model and control nothing says where the grid has its scale"
        raise reading.error("grid_reference_height", rule)
    return ground.mean_m, relief, "mean terrain under the block"


def _control_heights(section: ControlSection, reading: Reading) -> tuple[float, float]:
    """Mean and standard deviation of the ellipsoidal heights of the control points."""
    table = read_orientation_table(reading.folder / Path(section.file), section.columns, section.separator)
    heights = height_system(section.heights, reading.heights, reading, "control.heights")
    frame = map_frame(section.crs or reading.crs, heights, reading.project_file, "control.crs")
    points = frame.geodetic_from_map(np.array([row.values(MAP_COLUMNS) for row in table.rows]))
    return float(points[:, 2].mean()), float(points[:, 2].std())
