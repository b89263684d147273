"""A tiny synthetic survey on disk that can be run in a second, and what tests look at in its products."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rasterio
import scipy.ndimage

from stereomate.project import load
from stereomate.project.documents import write_documents
from stereomate.project.run import RunOptions, RunResult, run
from stereomate.synthetic.files import write_survey
from stereomate.synthetic.options import SurveyOptions
from stereomate.synthetic.survey import make_survey

TINY = {
    "seed": 3,
    "strips": 1,
    "photos_per_strip": 3,
    "size_px": (320, 240),
    "gsd_m": 0.5,
    "flying_height_m": 260.0,
    "pixel_pitch_mm": 0.1,
    "relief_m": 40.0,
    "terrain_step_m": 3.0,
    "buildings": 4,
    "trees": 20,
    "control_points": 0,
    "check_points": 0,
}


def write_tiny(folder: Path, **changes: object) -> Path:
    """Write the survey; returns its project file."""
    return write_survey(make_survey(SurveyOptions(**{**TINY, **changes})), folder).project


def variant(base: Path, folder: Path, **keys: str) -> Path:
    """A project file in `folder` of the survey in `base`, with more keys (as TOML) in [products]."""
    text = base.read_text()
    for name in ("orientation.csv", "heights.tif"):
        text = text.replace(f'"{name}"', f'"{base.parent / name}"')
    if "photos" in keys:
        text = text.replace('"strip*.tif"', keys.pop("photos"))
    text = text.replace('"strip*.tif"', f'"{base.parent}/strip*.tif"')
    text = text.replace("gsd = 0.5", f"gsd = {keys.pop('gsd', '0.5')}\nblocksize = 128")
    text += "".join(f"{key} = {value}\n" for key, value in keys.items())
    path = folder / "project.toml"
    path.write_text(text)
    return path


def make(project: Path, out: Path, *, report: bool = False, **options: object) -> RunResult:
    """`stereomate run` without its command line; the report, which takes longest, on request."""
    beside = (lambda r: write_documents(r, 0.0)) if report else None
    return run(load(project), out, RunOptions(**options), None, beside)


def raster(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (bands, rows, cols) and whether they are valid."""
    with rasterio.open(path) as file:
        return file.read(), file.dataset_mask() != 0


def terrain_heights(heights: Path, xy: np.ndarray) -> np.ndarray:
    """Bilinear heights of a north-up height model at map positions (..., 2), by scipy."""
    with rasterio.open(heights) as file:
        col, row = ~file.transform @ (xy[..., 0], xy[..., 1])
        return scipy.ndimage.map_coordinates(file.read(1).astype(float), [row - 0.5, col - 0.5], order=1)
