"""A small made survey with an analytic surface, for tests of rectification: two tilted photographs in UTM."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import tifffile

from stereomate.camera.distortion import BrownDistortion
from stereomate.camera.model import Camera
from stereomate.coverage.survey import Photograph
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.orientation import ExteriorOrientation
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import tangent_from_map
from stereomate.geometry.rotations import rotation_from_opk
from stereomate.parallax.laws import ParallaxLaw
from stereomate.rectify.grid import ProductGrid
from stereomate.rectify.job import RectifyJob
from stereomate.rectify.layout import StereoModel
from stereomate.rectify.options import RectifyOptions
from stereomate.terrain.model import HeightModel

CRS = "EPSG:25832"
CENTRE = np.array([690_000.0, 5_320_000.0])
GROUND = 600.0
FLYING_HEIGHT = 1000.0
BASE = 500.0
CAMERA = Camera.from_pixel_pitch(
    "test", (1500, 1200), 60.0, 0.036, (0.02, -0.03), BrownDistortion(k1=-0.05, k2=0.01, p1=1e-4, p2=-2e-4)
)


def hills(x, y):
    """Height of the ground at map positions relative to CENTRE."""
    return GROUND + 60.0 * np.sin(x / 170.0) * np.cos(y / 210.0) + 0.08 * x


def height_model(cell: float = 10.0, function=hills, size: int = 260) -> HeightModel:
    first = -0.5 * size * cell
    at = first + (np.arange(size) + 0.5) * cell
    x, y = np.meshgrid(at, -at)
    affine = (cell, 0.0, CENTRE[0] + first, 0.0, -cell, CENTRE[1] - first)
    return HeightModel.from_array(function(x, y), affine, MapFrame(CRS, HeightSystem.ellipsoidal()))


def photographs(tangent: TangentFrame, frame: MapFrame, folder: Path | None, direction: float = 0.0):
    """Two photographs with tilts of a few degrees; their image is noise when a folder is given."""
    along = np.array([np.cos(direction), np.sin(direction)])
    photos = []
    tilts = np.radians([[1.6, -1.9, 0.8], [-2.1, 1.7, -0.9]])
    for k, sign in enumerate((-0.5, 0.5)):
        xy = CENTRE + sign * BASE * along
        centre = tangent_from_map(tangent, frame, [*xy, GROUND + FLYING_HEIGHT + 6.0 * sign])
        rotation = rotation_from_opk(tilts[k] + [0.0, 0.0, direction])
        path = None
        if folder is not None:
            path = folder / f"photo{k}.tif"
            write_noise(path, k)
        photos.append(Photograph(f"photo{k}", path, CAMERA, ExteriorOrientation(tuple(centre), rotation)))
    return tuple(photos)


def write_noise(path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    cols, rows = CAMERA.size_px
    pixels = rng.integers(1, 255, (rows, cols, 3), dtype=np.uint8)
    tifffile.imwrite(path, pixels, tile=(256, 256), photometric="rgb")


def make_job(
    folder: Path | None = None, *, rotation: float = 0.0, law: str = "logarithmic", **changes
) -> RectifyJob:
    """A job over the common ground of the two photographs."""
    frame = MapFrame(CRS, HeightSystem.ellipsoidal())
    tangent = TangentFrame.at_map(frame, [*CENTRE, GROUND])
    heights = changes.pop("heights", None) or height_model()
    photos = photographs(tangent, frame, folder, rotation)
    centres = np.array(
        [
            [*(CENTRE + s * BASE * np.array([np.cos(rotation), np.sin(rotation)])), GROUND + FLYING_HEIGHT]
            for s in (-0.5, 0.5)
        ]
    )
    corners = CENTRE + np.array([(-250, -280), (250, -280), (250, 280), (-250, 280)])
    job = RectifyJob(
        name="",
        frame=frame,
        tangent=tangent,
        photographs=photos,
        reductions=(1, 1),
        heights=heights,
        centres_in_height_model=np.column_stack([heights.pixel_from_map(centres[:, :2]), centres[:, 2]]),
        grid=ProductGrid.covering(corners, 0.6, rotation),
        models=(StereoModel(0, 1, BASE, 0.0, 6.0, FLYING_HEIGHT),),
        law=ParallaxLaw(law, BASE, FLYING_HEIGHT + 100.0, GROUND - 100.0),
        height_range=(GROUND - 150.0, GROUND + 150.0),
        bands=(0, 1, 2),
        dtype=np.dtype(np.uint8),
        options=RectifyOptions(gsd=0.6),
    )
    return replace(job, **changes)
