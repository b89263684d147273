"""What the photographs of a survey reach: the block, its flattest ray, and the ground that must exist."""

from __future__ import annotations

import math
from typing import Final

from stereomate.synthetic.options import SurveyOptions

LIMIT_OF_TILT: Final = 2.5  # standard deviations


def block_size(options: SurveyOptions) -> tuple[float, float]:
    """Length along and across the flight that the photographs cover at the mean terrain."""
    length, width = options.footprint_m
    return (
        length + (options.photos_per_strip - 1) * options.base_m,
        width + (options.strips - 1) * options.strip_spacing_m,
    )


def steepest_ray(options: SurveyOptions) -> float:
    """Tangent of the largest nadir angle of a photograph's ray, with tilts and room for the distortion."""
    half_diagonal = 0.5 * math.hypot(*options.size_px) * options.pixel_pitch_mm
    offset = math.hypot(*options.principal_point_mm)
    angle = math.atan(1.08 * (half_diagonal + offset) / options.principal_distance_mm)
    tilt = math.sqrt(2.0) * LIMIT_OF_TILT * math.radians(options.tilt_sigma_deg)
    return math.tan(min(angle + tilt, math.radians(80.0)))


def terrain_nodes(options: SurveyOptions) -> tuple[int, int]:
    """Rows and columns of terrain nodes that hold every footprint."""
    length, width = block_size(options)
    lowest = options.flying_height_m + 0.8 * options.relief_m + 3.0 * options.position_sigma_m
    half = 0.5 * math.hypot(*options.footprint_m)
    margin = (
        steepest_ray(options) * lowest - half + 3.0 * options.position_sigma_m + 4.0 * options.terrain_step_m
    )
    c, s = abs(math.sin(math.radians(options.heading_deg))), abs(math.cos(math.radians(options.heading_deg)))
    size = (length * c + width * s + 2.0 * margin, length * s + width * c + 2.0 * margin)
    return math.ceil(size[1] / options.terrain_step_m) + 1, math.ceil(size[0] / options.terrain_step_m) + 1
