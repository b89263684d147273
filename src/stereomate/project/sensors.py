"""Cameras from what photographs say about them: calibration of the maker, sensor width, 35 mm equivalent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from stereomate.formats.exif import CameraTags
from stereomate.project.cameras import NOMINAL_SENSOR_WIDTH_MM

# Width of the sensor in mm by model, from the makers' data sheets (sensor class in brackets).
SENSOR_WIDTHS_MM: Final[dict[str, float]] = {
    "FC200": 6.17,  # Phantom 2 Vision (1/2.3 inch)
    "FC300C": 6.17,  # Phantom 3 Standard
    "FC300S": 6.17,  # Phantom 3 Advanced, Professional
    "FC300X": 6.17,  # Phantom 3 Professional
    "FC330": 6.17,  # Phantom 4
    "FC350": 6.17,  # Inspire 1, X3
    "FC220": 6.17,  # Mavic Pro
    "FC7203": 6.17,  # Mavic Mini
    "FC550": 17.3,  # X5 (four thirds)
    "FC6310": 13.2,  # Phantom 4 Pro (1 inch)
    "FC6310R": 13.2,  # Phantom 4 RTK
    "FC6310S": 13.2,  # Phantom 4 Pro 2.0
    "FC6520": 17.3,  # X5S
    "L1D-20c": 13.2,  # Mavic 2 Pro
    "M3E": 17.3,  # Mavic 3 Enterprise
    "ZenmuseP1": 35.9,  # full frame
}


@dataclass(frozen=True)
class DraftCamera:
    """A camera as it will be written into a project file, and where its figures come from.

    Attributes
    ----------
    lines : tuple of str
        TOML keys and values.
    source : str
    """

    name: str
    size_px: tuple[int, int]
    lines: tuple[str, ...]
    source: str


def draft_camera(tags: CameraTags, size_px: tuple[int, int]) -> DraftCamera:
    """The best description of a camera that its photograph allows.

    In this order: the maker's calibration (DJI's DewarpData), its calibrated focal length, focal length and
    sensor width of the model, the 35 mm equivalent with a sensor 36 mm wide; else keys to fill in.
    """
    name = tags.model or "camera"
    columns, rows = size_px
    taken = tags.size_px or size_px
    reduction = columns / taken[0]
    if tags.dewarp is not None and not tags.dewarped:
        return DraftCamera(name, size_px, tuple(_dewarp_lines(tags.dewarp, taken, reduction)), _DEWARP)
    if tags.calibrated_focal_px is not None:
        focal = tags.calibrated_focal_px * reduction
        lines = (f"principal_distance_px = {focal:.3f}", '# distortion = { model = "brown", k1 = 0.0, ... }')
        return DraftCamera(
            name, size_px, lines, "CalibratedFocalLength of the photograph: nominal, no distortion"
        )
    width = SENSOR_WIDTHS_MM.get(tags.model)
    if tags.focal_length_mm is not None and width is not None:
        lines = (
            f"principal_distance_mm = {tags.focal_length_mm:g}",
            f"sensor_mm = [{width:g}, {width * rows / columns:.4f}]",
        )
        source = (
            f"focal length of the photograph and the sensor width of {name}: nominal, good to some percent"
        )
        return DraftCamera(name, size_px, lines, source)
    if tags.focal_length_35mm is not None:
        focal = tags.focal_length_35mm / NOMINAL_SENSOR_WIDTH_MM * columns
        source = "35 mm equivalent of the photograph, a sensor 36 mm wide assumed: good to some percent"
        return DraftCamera(name, size_px, (f"principal_distance_px = {focal:.1f}",), source)
    lines = ("# principal_distance_mm = ", "# sensor_mm = [ , ]          # or pixel_pitch_mm")
    return DraftCamera(name, size_px, lines, "nothing found: fill in from the calibration report")


_DEWARP: Final = "the maker's calibration of this camera (DewarpData)"


def _dewarp_lines(dewarp: tuple[float, ...], taken: tuple[int, int], reduction: float) -> list[str]:
    """DJI counts the principal point from the middle of the image taken, rows down; fx / fy is affinity."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = dewarp
    x, y = (taken[0] / 2 + cx) * reduction, (taken[1] / 2 + cy) * reduction
    values = {"k1": k1, "k2": k2, "k3": k3, "p1": p1, "p2": p2, "b1": fx / fy - 1.0}
    terms = ", ".join(f"{name} = {value:.9g}" for name, value in values.items())
    return [
        f"principal_distance_px = {fy * reduction:.4f}",
        f"principal_point_px = [{x:.4f}, {y:.4f}]",
        f'distortion = {{ model = "brown", {terms} }}',
    ]
