"""Control and check points that a page shows, with where the photographs have them."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path
from typing import Any

import numpy as np

from stereomate.errors import FormatError
from stereomate.rectify.job import RectifyJob

_NEEDED = ("name", "x", "y", "z")
# Residual vectors, where an adjustment has written them beside its points.
_RESIDUALS = ("vx", "vy", "vz")


def residuals_of_run(folder: Path) -> dict[str, list[float]]:
    """Intersection minus given, metres, of the check points in the report of a run; empty without one."""
    path = folder / "report.json"
    if not path.is_file():
        return {}
    # loading the project layer takes longer than all the rest of a first picture
    from stereomate.project.run_record import read_run_record

    checked = read_run_record(path).get("accuracy", {}).get("check_points")
    points = checked["points"] if checked else []
    return {p["name"]: p["difference_m"] for p in points if None not in p["difference_m"]}


def read_points(path: Path | None, job: RectifyJob, folder: Path) -> list[dict[str, Any]]:
    """Points of a CSV with the columns name, x, y, z, perhaps type, and perhaps residuals vx, vy, vz, metres.

    Without columns of residuals, those of the run's own check points of these names are taken.

    Raises
    ------
    FormatError
        If it is no such table.
    """
    if path is None:
        return []
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (FileNotFoundError, UnicodeDecodeError) as error:
        raise FormatError("must be a CSV in UTF-8", file=path) from error
    delimiter = ";" if text.split("\n", 1)[0].count(";") >= len(_NEEDED) - 1 else ","
    rows = list(csv.DictReader(io.StringIO(text), delimiter=delimiter))
    if rows and not set(_NEEDED) <= set(rows[0]):
        raise FormatError(
            f"must have the columns {', '.join(_NEEDED)}", file=path, field="columns", value=list(rows[0])
        )
    found = []
    known = residuals_of_run(folder)
    for k, row in enumerate(rows):
        values = [_number(path, k, key, row) for key in ("x", "y", "z")]
        pixel = job.grid.pixel_from_map(np.array(values[:2]))
        point = {
            "name": row["name"],
            "type": row.get("type") or "control",
            "map": values,
            "pixel": pixel.tolist(),
        }
        if set(_RESIDUALS) <= set(row):
            point["residual"] = [_number(path, k, key, row) for key in _RESIDUALS]
        elif row["name"] in known:
            point["residual"] = known[row["name"]]
        found.append(point)
    return found


def _number(path: Path, index: int, name: str, row: dict[str, Any]) -> float:
    try:
        value = float(row[name])
    except (TypeError, ValueError):
        value = math.nan
    if not math.isfinite(value):
        raise FormatError("must be a number", file=path, field=f"row {index + 1}: {name}", value=row[name])
    return value
