"""A block of film photographs known by measurements alone, with deformed film and scans that lie anyhow."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from stereomate.camera.distortion import BrownDistortion, EbnerDeformation
from stereomate.camera.model import Camera
from stereomate.frames.attitude import AttitudeConvention, object_from_camera
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import tangent_from_map

SIZE, PITCH, FORMAT = 11800, 0.02, 228.0
LENS = BrownDistortion.from_certificate((0.0, 2e-8, -1e-12), symmetry_mm=(0.01, -0.02))
FILM = Camera.from_pixel_pitch("RC30", (SIZE, SIZE), 153.358, PITCH, (-0.006, 0.006), LENS)
# Millimetres at the points of the grid.
PLANTED = (0.012, -0.008, 0.009, -0.007, 0.015, -0.011, 0.010, 0.012, -0.009, 0.008, -0.012, 0.010)
MARKS = {
    "1": (-106.0, -106.004), "2": (106.003, 105.998), "3": (-105.997, 106.002), "4": (106.001, -106.0),
    "5": (-110.004, 0.003), "6": (110.002, -0.001), "7": (0.004, 110.0), "8": (-0.002, -110.003),
}  # fmt: skip
FRAME = MapFrame("EPSG:25832", HeightSystem.undeclared())
MIDDLE, GROUND, FLYING = np.array([512000.0, 5400000.0]), 300.0, 1230.0

PROJECT = """
[project]
name = "film"
crs = "EPSG:25832"
heights = "undeclared"

[[camera]]
name = "RC30"
size_px = [{size}, {size}]
principal_distance_mm = 153.358
pixel_pitch_mm = 0.02
principal_point_mm = [-0.006, 0.006]
{camera}

[camera.distortion]
model = "brown"
convention = "usgs"
units = "mm"
direction = "measured_to_ideal"
point_of_symmetry_mm = [0.01, -0.02]
k1 = 2e-8
k2 = -1e-12

[camera.fiducials]
marks = {{ {marks} }}
transform = "{transform}"
format_mm = [228.0, 228.0]
measured = "marks.csv"

[photos]
orientation = "positions.csv"
angles = "local"

[orient]
tie_points = "ties.txt"
position_sigma_m = [0.05, 0.05, 0.05]
{orient}
"""


def scan(number: int) -> Camera:
    """How the film of a photograph lay in the scanner: turned, mirrored, skew, and not quite parallel."""
    camera = Camera.from_pixel_pitch(
        "RC30", (SIZE, SIZE), 153.358, PITCH, rotation=90 * (number % 4), mirrored=number % 5 == 0
    )
    rng = np.random.default_rng(number)
    turn, skew, shift = (
        rng.normal(0.0, 2e-3),
        rng.normal(0.0, 3e-4, 4).reshape(2, 2),
        rng.normal(0.0, 30.0, 2),
    )
    matrix = np.array(camera.pixel_from_photo)
    linear = (np.eye(2) + skew) @ np.array([[1.0, -turn], [turn, 1.0]]) @ matrix[:, :2]
    rows = np.column_stack([linear, matrix[:, 2] + shift])
    return replace(
        camera,
        pixel_from_photo=tuple(map(tuple, rows.tolist())),
        projective_per_mm=tuple(rng.normal(0.0, 2e-6, 2).tolist()),
    )


@dataclass(frozen=True)
class FilmBlock:
    """Truth: names, centres and angles, points of the ground, photo coordinates of what is seen."""

    names: tuple[str, ...]
    centres: np.ndarray
    opk_deg: np.ndarray
    ground: np.ndarray
    point: np.ndarray
    photo: np.ndarray
    photo_mm: np.ndarray

    def write(
        self,
        folder: Path,
        *,
        orient: str,
        camera: str = "",
        transform: str = "projective",
        seed: int = 5,
        sigma_mm: float = 0.003,
    ) -> Path:
        """Measurements with errors as a project."""
        folder.mkdir(parents=True, exist_ok=True)
        rng = np.random.default_rng(seed)
        ties, marks = [], ["mark,photograph,col,row"]
        for k, name in enumerate(self.names):
            lying = scan(k)
            mine = self.photo == k
            seen = self.photo_mm[mine] + rng.normal(0.0, sigma_mm, (int(mine.sum()), 2))
            for point, (col, row) in zip(self.point[mine], lying.image_from_photo(seen), strict=True):
                ties.append(f"p{point:04d} {name} {col:.5f} {row:.5f} {sigma_mm / PITCH}")
            for mark, xy in MARKS.items():
                col, row = lying.image_from_photo(xy)
                marks.append(f"{mark},{name},{col:.6f},{row:.6f}")
        lines = ["name,x,y,z,omega,phi,kappa"]
        positions = self.centres + rng.normal(0.0, 0.05, self.centres.shape)
        for name, xyz, opk in zip(self.names, positions, self.opk_deg, strict=True):
            lines.append(",".join([name, *(f"{v:.4f}" for v in (*xyz, *opk))]))
        for file, text in (("ties.txt", ties), ("marks.csv", marks), ("positions.csv", lines)):
            (folder / file).write_text("\n".join(text) + "\n", encoding="utf-8")
        listed = ", ".join(f'"{name}" = [{x}, {y}]' for name, (x, y) in MARKS.items())
        path = folder / "project.toml"
        path.write_text(
            PROJECT.format(size=SIZE, marks=listed, transform=transform, orient=orient, camera=camera),
            encoding="utf-8",
        )
        return path


def film_block(strips: int = 3, per_strip: int = 4, points: int = 260, seed: int = 3) -> FilmBlock:
    """Strips of 60 % forward and 40 % side overlap over hills, every second flown back."""
    rng = np.random.default_rng(seed)
    n = strips * per_strip
    strip, place = np.divmod(np.arange(n), per_strip)
    wide = FORMAT / 153.358 * FLYING
    along, across = 0.4 * wide, 0.6 * wide
    centres = np.column_stack(
        [
            MIDDLE[0] + along * (place - (per_strip - 1) / 2),
            MIDDLE[1] + across * (strip - (strips - 1) / 2),
            np.full(n, GROUND + FLYING),
        ]
    ) + rng.normal(0.0, 1.0, (n, 3)) * (25.0, 25.0, 15.0)
    angles = np.column_stack([rng.normal(0.0, 1.0, (n, 2)), rng.normal(0.0, 3.0, n) + 180.0 * (strip % 2)])
    half = np.array([along * (per_strip - 1) + 0.9 * wide, across * (strips - 1) + 0.9 * wide]) / 2.0
    xy = MIDDLE + rng.uniform(-half, half, (points, 2))
    ground = np.column_stack([xy, GROUND + 80.0 * np.sin((xy - MIDDLE) / 400.0).sum(axis=1)])
    tangent = TangentFrame.at_map(FRAME, np.array([*MIDDLE, 0.0]))
    local = tangent_from_map(tangent, FRAME, centres)
    turns = object_from_camera(angles, AttitudeConvention("opk", "local", "deg"), tangent, local, None)
    seen = tangent_from_map(tangent, FRAME, ground)
    spacing = EbnerDeformation.of_format((FORMAT, FORMAT)).spacing_mm
    camera = replace(FILM, format_mm=(FORMAT, FORMAT), deformation=EbnerDeformation(spacing, *PLANTED))
    point, photo, photo_mm = [], [], []
    for k in range(n):
        pixels, inside = camera.image_from_camera((seen - local[k]) @ turns[k])
        point.append(np.flatnonzero(inside))
        photo.append(np.full(int(inside.sum()), k))
        photo_mm.append(camera.photo_from_image(pixels[inside]))
    names = tuple(f"s{s}_{p}" for s, p in zip(strip.tolist(), place.tolist(), strict=True))
    joined = (np.concatenate(parts) for parts in (point, photo, photo_mm))
    return FilmBlock(names, centres, angles, ground, *joined)


__all__ = ["FRAME", "PLANTED", "FilmBlock", "film_block", "scan"]
