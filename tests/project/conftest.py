"""A small project on disk: two vertical photographs of rising ground, in UTM 32N."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
import tifffile

EAST, NORTH = 512_000.0, 5_400_000.0
GROUND, FLYING = 200.0, 300.0

PROJECT = """
[project]
crs = "EPSG:25832"
heights = "ellipsoidal"

[[camera]]
name = "small"
size_px = [60, 40]
principal_distance_mm = 30.0
pixel_pitch_mm = 0.1

[photos]
files = "photo_*.tif"
orientation = "orientation.csv"
angles = "grid"
adjusted_in = "space"

[terrain]
file = "heights.tif"

[products]
gsd = 1.0
"""

ORIENTATION = (
    "filename,x,y,z,omega,phi,kappa\n"
    f"photo_1.tif,{EAST - 12},{NORTH},{GROUND + FLYING},0.5,-0.3,1.0\n"
    f"photo_2.tif,{EAST + 12},{NORTH},{GROUND + FLYING},-0.2,0.4,-1.5\n"
)


class SmallProject:
    """A folder with a project; every part of it can be spoiled."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.path = folder / "project.toml"
        self.write("project.toml", PROJECT)
        self.write("orientation.csv", ORIENTATION)
        random = np.random.default_rng(1)
        for number in (1, 2):
            pixels = random.integers(0, 255, (40, 60, 3), dtype=np.uint8)
            tifffile.imwrite(folder / f"photo_{number}.tif", pixels, photometric="rgb")
        col, row = np.meshgrid(np.arange(40), np.arange(40))
        self.write_heights(GROUND + 0.2 * col - 0.1 * row)

    def write(self, name: str, text: str) -> None:
        (self.folder / name).write_text(text, encoding="utf-8")

    def replace(self, name: str, old: str, new: str) -> None:
        text = (self.folder / name).read_text(encoding="utf-8")
        assert old in text
        self.write(name, text.replace(old, new))

    def write_heights(self, heights: np.ndarray, *, crs: str = "EPSG:25832", shift: float = 0.0) -> None:
        rows, cols = heights.shape
        step = 5.0
        west, north = EAST - cols * step / 2 + shift, NORTH + rows * step / 2
        with rasterio.open(
            self.folder / "heights.tif",
            "w",
            driver="GTiff",
            width=cols,
            height=rows,
            count=1,
            dtype="float32",
            crs=crs,
            nodata=-9999.0,
            transform=rasterio.Affine(step, 0.0, west, 0.0, -step, north),
        ) as file:
            file.write(heights.astype(np.float32), 1)


@pytest.fixture
def small(tmp_path: Path) -> SmallProject:
    return SmallProject(tmp_path)
