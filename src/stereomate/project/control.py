"""Control points of a project: a table, or an IGN ``.app`` or ``.mes`` file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stereomate.formats.ign import GroundPoints, read_ground_points
from stereomate.formats.orientation_table import MAP_COLUMNS, read_orientation_table
from stereomate.project.schema import ControlSection

_IGN = (".app", ".mes")


def read_control(section: ControlSection, folder: Path) -> GroundPoints:
    """Names and coordinates of the control points, as written.

    Raises
    ------
    FormatError
        If the file is no table of points.
    """
    path = folder / section.file
    if section.columns is None and path.suffix.lower() in _IGN:
        return read_ground_points(path)
    table = read_orientation_table(path, section.columns, section.separator)
    return GroundPoints(
        tuple(row.name for row in table.rows), np.array([row.values(MAP_COLUMNS) for row in table.rows])
    )
