"""A synthetic survey: the world, the flight over it, and the exact image of any point."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.camera.model import Camera
from stereomate.coverage.survey import Photograph, Survey
from stereomate.frames.orientation import ExteriorOrientation
from stereomate.geometry.rotations import rotation_from_opk
from stereomate.synthetic.extent import LIMIT_OF_TILT
from stereomate.synthetic.making import make_world
from stereomate.synthetic.options import SurveyOptions
from stereomate.synthetic.render import render_photograph
from stereomate.synthetic.world import SyntheticWorld
from stereomate.tiles.executor import Executor

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GroundPoint:
    """A signalised point: a white disc on a black one, its centre on the terrain; map coordinates."""

    name: str
    position: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class SyntheticSurvey:
    """A world and the photographs flown over it.

    Attributes
    ----------
    world : SyntheticWorld
    survey : Survey
        The photographs with their true orientations; no image files yet.
    strips : ndarray of int (n,)
        Strip of each photograph, from 1.
    centres : ndarray (n, 3)
        True projection centres: map coordinates, ellipsoidal heights.
    angles_deg : ndarray (n, 3)
        Omega, phi, kappa about the grid axes at each centre.
    control_points, check_points : tuple of GroundPoint
    """

    world: SyntheticWorld
    survey: Survey
    strips: NDArray[np.int64]
    centres: Array
    angles_deg: Array
    control_points: tuple[GroundPoint, ...]
    check_points: tuple[GroundPoint, ...]

    @property
    def options(self) -> SurveyOptions:
        """What the survey was made with."""
        return self.world.options

    def project(self, number: int, points: ArrayLike) -> tuple[Array, NDArray[np.bool_]]:
        """Exact pixels (..., 2) of map points (..., 3) in photograph `number`, and whether they fall on it.

        Nothing is said about what may hide them: see `visible`.
        """
        photograph = self.survey.photographs[number]
        tangent = self.world.tangent_from_map(points)
        return photograph.camera.image_from_camera(photograph.orientation.camera_from_tangent(tangent))

    def visible(self, number: int, points: ArrayLike) -> NDArray[np.bool_]:
        """Whether map points (..., 3) appear in photograph `number`: on it and hidden by nothing."""
        _, inside = self.project(number, points)
        centre = self.survey.photographs[number].orientation.centre
        seen: NDArray[np.bool_] = inside & self.world.is_visible(centre, points)
        return seen

    def render(self, number: int, executor: Executor | None = None) -> NDArray[np.uint8]:
        """The image (rows, cols, 3) of photograph `number`."""
        return render_photograph(self.world, self.survey.photographs[number], number, executor)

    def roof_corners(self) -> Array:
        """All roof corners (n, 3), map coordinates."""
        return np.concatenate([np.empty((0, 3)), *(house.corners() for house in self.world.buildings)])

    def tree_tops(self) -> Array:
        """All tree tops (n, 3), map coordinates."""
        return np.array([(*tree.centre, tree.top) for tree in self.world.trees]).reshape(-1, 3)


def make_survey(options: SurveyOptions | None = None) -> SyntheticSurvey:
    """Make a world and fly over it.

    Raises
    ------
    InputError
        If an option breaks a rule.
    CrsError
        If the CRS is not conformal, or the block too large for one synthetic world.
    """
    options = options or SurveyOptions()
    world = make_world(options)
    camera = Camera.from_pixel_pitch(
        "synthetic",
        options.size_px,
        options.principal_distance_mm,
        options.pixel_pitch_mm,
        options.principal_point_mm,
        options.distortion,
    )
    strips, centres, angles, times = _flight(options)
    rotations = _rotation_tangent_from_grid(world, centres) @ rotation_from_opk(np.radians(angles))
    positions = world.tangent_from_map(centres)
    counts = [int(np.sum(strips[: i + 1] == strip)) for i, strip in enumerate(strips)]
    photographs = tuple(
        Photograph(
            f"strip{strip}_{count:02d}",
            None,
            camera,
            ExteriorOrientation((float(x), float(y), float(z)), rotation),
            float(time),
        )
        for strip, count, (x, y, z), rotation, time in zip(
            strips, counts, positions, rotations, times, strict=True
        )
    )
    points = [tuple(float(v) for v in row) for row in world.targets]
    split = options.control_points
    return SyntheticSurvey(
        world,
        Survey(world.frame, world.tangent, photographs),
        strips,
        centres,
        angles,
        tuple(GroundPoint(f"C{i + 1:02d}", (p[0], p[1], p[2])) for i, p in enumerate(points[:split])),
        tuple(GroundPoint(f"K{i + 1:02d}", (p[0], p[1], p[2])) for i, p in enumerate(points[split:])),
    )


def _flight(options: SurveyOptions) -> tuple[NDArray[np.int64], Array, Array, Array]:
    """Strip numbers, centres in the map, angles in degrees about the grid axes, and times in seconds."""
    rng = np.random.default_rng([options.seed, 10])
    turn = math.radians(90.0 - options.heading_deg)
    along, across = np.array([math.cos(turn), math.sin(turn)]), np.array([-math.sin(turn), math.cos(turn)])
    strips, centres, angles, times = [], [], [], []
    clock = 0.0
    for strip in range(options.strips):
        forth = 1.0 if strip % 2 == 0 else -1.0
        offset = (0.5 * (options.strips - 1) - strip) * options.strip_spacing_m
        for photo in range(options.photos_per_strip):
            way = forth * (photo - 0.5 * (options.photos_per_strip - 1)) * options.base_m
            plan = np.array(options.centre) + way * along + offset * across
            position = [*plan, options.terrain_height_m + options.flying_height_m]
            centres.append(position + options.position_sigma_m * rng.standard_normal(3))
            tilt = np.clip(rng.standard_normal(3), -LIMIT_OF_TILT, LIMIT_OF_TILT) * options.tilt_sigma_deg
            kappa = math.degrees(turn) + (0.0 if forth > 0.0 else 180.0) + tilt[2]
            angles.append([tilt[0], tilt[1], (kappa + 180.0) % 360.0 - 180.0])
            strips.append(strip + 1)
            times.append(clock)
            clock += 4.0
        clock += 120.0
    return np.array(strips), np.array(centres), np.array(angles), np.array(times)


def _rotation_tangent_from_grid(world: SyntheticWorld, centres: Array, step: float = 50.0) -> Array:
    """Grid east, grid north and up at map points (n, 3) as columns in tangent axes (n, 3, 3).

    From differences of the rigorous point transformation alone, not from a formula for the convergence: what
    the angles of a table mean is checked against this. Grid north is taken on the ellipsoid, where the map is
    conformal; at a flying height of 1 km its direction differs by some 1e-8, as (N + h) / (M + h) does
    from N / M.
    """
    feet = centres * [1.0, 1.0, 0.0]

    def shifted(dx: float, dy: float, dz: float) -> Array:
        return world.tangent_from_map(feet + np.array([dx, dy, dz]))

    up = shifted(0.0, 0.0, step) - shifted(0.0, 0.0, -step)
    up /= np.linalg.norm(up, axis=-1, keepdims=True)
    north = shifted(0.0, step, 0.0) - shifted(0.0, -step, 0.0)
    north -= np.sum(north * up, axis=-1, keepdims=True) * up
    north /= np.linalg.norm(north, axis=-1, keepdims=True)
    return np.stack([np.cross(north, up), north, up], axis=-1)
