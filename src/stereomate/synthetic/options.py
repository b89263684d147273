"""What a synthetic survey shall be like."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stereomate.camera.distortion import BrownDistortion, Distortion
from stereomate.errors import InputError

# About 20 px of barrel distortion in the corners of the default camera, a little decentring and affinity.
DEFAULT_DISTORTION = BrownDistortion(k1=-0.075, k2=0.030, k3=-0.004, p1=4e-4, p2=-2.5e-4)


@dataclass(frozen=True)
class SurveyOptions:
    """Options of `make_survey`; lengths in metres, the same seed gives the same world to the byte.

    Parameters
    ----------
    seed : int
        Seed of everything random.
    crs : str
        Projected, conformal map CRS. The default is Lambert-93 in Corsica: convergence 4.5°, scale 1.0018.
    centre : (float, float)
        Centre of the block in the map.
    strips, photos_per_strip : int
        Strips are flown to and fro.
    size_px : (int, int)
        Columns (along the flight) and rows of a photograph.
    gsd_m : float
        Ground sampling distance at the mean terrain height.
    flying_height_m : float
        Above the mean terrain.
    heading_deg : float
        Direction of flight of the first strip, clockwise from grid north.
    pixel_pitch_mm : float
        Size of a pixel; with the two above it gives the principal distance.
    principal_point_mm : (float, float)
        Principal point in the photo system.
    distortion : Distortion
        Of the lens.
    forward_overlap, side_overlap : float
        At the mean terrain height.
    tilt_sigma_deg, position_sigma_m : float
        Scatter of omega, phi and kappa (limited to 2.5 sigma) and of the centres.
    relief_m : float
        Highest less lowest terrain.
    terrain_height_m : float
        Mean ellipsoidal height of the terrain.
    terrain_step_m : float
        Mesh of the terrain grid; the terrain is its bilinear surface.
    buildings, trees : int
        At most so many; a small block has room for fewer.
    control_points, check_points : int
        Signalised points on open ground.
    noise_dn : float
        Standard deviation of the sensor noise.
    exposure_sigma : float
        Relative scatter of the brightness of photographs.
    vignetting : float
        Light lost in the corners of the photograph.
    colour_sigma : float
        Relative scatter of the brightness of each band of each photograph, beside `exposure_sigma`.
    gradient_sigma : float
        Relative scatter of the brightness of each band from the middle of a photograph to its sides.
    samples : int
        Rays along each side of a pixel in which surfaces meet.
    """

    seed: int = 1
    crs: str = "EPSG:2154"
    centre: tuple[float, float] = (1_207_000.0, 6_145_000.0)
    strips: int = 2
    photos_per_strip: int = 5
    size_px: tuple[int, int] = (1600, 1200)
    gsd_m: float = 0.3
    flying_height_m: float = 500.0
    heading_deg: float = 90.0
    pixel_pitch_mm: float = 0.06
    principal_point_mm: tuple[float, float] = (0.213, -0.147)
    distortion: Distortion = DEFAULT_DISTORTION
    forward_overlap: float = 0.60
    side_overlap: float = 0.28
    tilt_sigma_deg: float = 1.5
    position_sigma_m: float = 2.0
    relief_m: float = 90.0
    terrain_height_m: float = 300.0
    terrain_step_m: float = 2.0
    buildings: int = 44
    trees: int = 900
    control_points: int = 8
    check_points: int = 12
    noise_dn: float = 1.5
    exposure_sigma: float = 0.02
    vignetting: float = 0.12
    colour_sigma: float = 0.0
    gradient_sigma: float = 0.0
    samples: int = 2

    def __post_init__(self) -> None:
        for name in ("strips", "photos_per_strip", "samples"):
            _require(getattr(self, name) >= 1, "must be at least 1", name, getattr(self, name))
        for name in ("gsd_m", "flying_height_m", "pixel_pitch_mm", "terrain_step_m"):
            value = getattr(self, name)
            _require(math.isfinite(value) and value > 0.0, "must be positive", name, value)
        for name in (
            "tilt_sigma_deg",
            "position_sigma_m",
            "relief_m",
            "noise_dn",
            "exposure_sigma",
            "vignetting",
            "colour_sigma",
            "gradient_sigma",
            "buildings",
            "trees",
            "control_points",
            "check_points",
        ):
            value = getattr(self, name)
            _require(math.isfinite(value) and value >= 0, "must not be negative", name, value)
        for name in ("forward_overlap", "side_overlap"):
            value = getattr(self, name)
            _require(0.0 <= value < 1.0, "must be at least 0 and below 1", name, value)
        _require(min(self.size_px) >= 16, "must be at least 16 by 16", "size_px", self.size_px)
        _require(
            self.relief_m < self.flying_height_m,
            "must be below flying_height_m: the camera stays above the terrain",
            "relief_m",
            self.relief_m,
        )

    @property
    def principal_distance_mm(self) -> float:
        """Principal distance that gives the ground sampling distance at the mean terrain."""
        return self.flying_height_m / self.gsd_m * self.pixel_pitch_mm

    @property
    def footprint_m(self) -> tuple[float, float]:
        """Length along and across the flight that a photograph covers at the mean terrain."""
        return self.size_px[0] * self.gsd_m, self.size_px[1] * self.gsd_m

    @property
    def base_m(self) -> float:
        """Distance between neighbouring centres of a strip."""
        return self.footprint_m[0] * (1.0 - self.forward_overlap)

    @property
    def strip_spacing_m(self) -> float:
        """Distance between neighbouring strips."""
        return self.footprint_m[1] * (1.0 - self.side_overlap)


def _require(holds: bool, rule: str, field: str, value: object) -> None:
    if not holds:
        raise InputError(rule, field=field, value=value)
