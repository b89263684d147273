"""A block of measurements without photographs, made from known truth: text files that `orient` reads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereomate.camera.model import Camera
from stereomate.frames.attitude import AttitudeConvention, object_from_camera
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import tangent_from_map

CAMERA = Camera.from_pixel_pitch("cam", (3000, 2000), 18.0, 0.006)
FRAME = MapFrame("EPSG:25832", HeightSystem.undeclared())
MIDDLE = np.array([512000.0, 5400000.0])
GROUND = 300.0
FLYING_HEIGHT = 600.0

PROJECT = """
[project]
name = "measured"
crs = "EPSG:25832"
heights = "undeclared"

[[camera]]
name = "cam"
size_px = [3000, 2000]
principal_distance_mm = 18.0
pixel_pitch_mm = 0.006

[photos]
{photos}
[orient]
tie_points = "ties.txt"
calibrate = "none"
{orient}
{more}
"""


@dataclass(frozen=True)
class MeasuredBlock:
    """Truth: names, centres in the map, points of the ground in the map, what every photograph shows."""

    names: tuple[str, ...]
    centres: np.ndarray
    opk_deg: np.ndarray
    ground: np.ndarray
    image: tuple[tuple[int, int, float, float], ...]  # point, photograph, column, row: without errors

    def write(self, folder, *, positions=None, photos="", orient="", more="", sigma_px=0.2, keep=None):
        """Write the files and return the project file; `positions` (n, 3) makes a table of positions."""
        rng = np.random.default_rng(5)
        rows = []
        for point, photo, col, row in self.image:
            if keep is None or keep(point, photo):
                dx, dy = rng.normal(0.0, sigma_px, 2)
                rows.append(f"p{point:03d} {self.names[photo]} {col + dx:.3f} {row + dy:.3f} {sigma_px}")
        (folder / "ties.txt").write_text("\n".join(rows) + "\n", encoding="utf-8")
        if positions is not None:
            lines = ["name,x,y,z,omega,phi,kappa"]
            for name, xyz, opk in zip(self.names, positions, self.opk_deg, strict=True):
                lines.append(",".join([name, *(f"{v:.4f}" for v in (*xyz, *opk))]))
            (folder / "positions.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
            photos += 'orientation = "positions.csv"\nangles = "local"\n'
        path = folder / "project.toml"
        path.write_text(PROJECT.format(photos=photos, orient=orient, more=more), encoding="utf-8")
        return path


def measured_block(
    strips: int = 2, per_strip: int = 4, points: int = 160, tilt_deg: float = 0.0, seed: int = 2
) -> MeasuredBlock:
    """Two strips over hills; heights of the flight differ by some metres from photograph to photograph.

    With a tilt all photographs look northwards by so much.
    """
    rng = np.random.default_rng(seed)
    n = strips * per_strip
    strip, place = np.divmod(np.arange(n), per_strip)
    centres = np.column_stack(
        [
            MIDDLE[0] + 240.0 * (place - (per_strip - 1) / 2),
            MIDDLE[1] + 280.0 * (strip - (strips - 1) / 2),
            np.full(n, GROUND + FLYING_HEIGHT),
        ]
    ) + rng.normal(0.0, 1.0, (n, 3)) * (15.0, 15.0, 12.0)
    angles = np.column_stack([rng.normal(0.0, 1.5, (n, 2)), rng.normal(0.0, 3.0, n) + 180.0 * (strip % 2)])
    half = np.array([240.0 * per_strip, 280.0 * strips + 250.0]) / 2.0
    xy = MIDDLE + rng.uniform(-half, half, (points, 2))
    xy[:, 1] += FLYING_HEIGHT * np.tan(np.radians(tilt_deg))
    angles[:, 0] += tilt_deg
    z = GROUND + 30.0 * np.sin((xy - MIDDLE) / 150.0).sum(axis=1)
    ground = np.column_stack([xy, z])
    tangent = TangentFrame.at_map(FRAME, np.array([*MIDDLE, 0.0]))
    local = tangent_from_map(tangent, FRAME, centres)
    turns = object_from_camera(angles, AttitudeConvention("opk", "local", "deg"), tangent, local, None)
    seen = tangent_from_map(tangent, FRAME, ground)
    image = []
    for k in range(n):
        pixels, inside = CAMERA.image_from_camera((seen - local[k]) @ turns[k])
        image += [(int(j), k, *map(float, pixels[j])) for j in np.flatnonzero(inside)]
    names = tuple(f"s{s}_{p}" for s, p in zip(strip.tolist(), place.tolist(), strict=True))
    return MeasuredBlock(names, centres, angles, ground, tuple(image))


__all__ = ["CAMERA", "FRAME", "MeasuredBlock", "measured_block"]
