"""A planned flight, and the photographs and points of its simulation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import InputError
from stereomate.frames.checks import check_coordinates
from stereomate.frames.factors import effective_scale, gauss_radius, grid_factors
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.geometry.rotations import rotation_from_opk, rotation_z

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FlightPlan:
    """What is to be flown, where, and in which map.

    Attributes
    ----------
    crs : str
        Projected, conformal CRS.
    x, y : float
        Middle of the block in its coordinates.
    flying_height_m : float
        Above the ground.
    ground_m : float
        Ellipsoidal height of the ground and of the control.
    relief_m : float
        Height of the highest points above the ground; may be negative (a gorge).
    principal_distance_mm, format_mm : float
        Camera with a square format.
    overlap, sidelap : float
        Shares of the format, 0 to 1 exclusive.
    heading_deg : float
        Direction of flight from true north, clockwise.
    tilt_deg : float
        Size of the photographs' tilts in both axes, with alternating signs.

    Raises
    ------
    CrsError
        If the CRS is geographic or not conformal.
    InputError
        If a number is outside its range.
    """

    crs: str
    x: float
    y: float
    flying_height_m: float
    ground_m: float = 0.0
    relief_m: float = 0.0
    principal_distance_mm: float = 150.0
    format_mm: float = 230.0
    overlap: float = 0.6
    sidelap: float = 0.6
    heading_deg: float = 90.0
    tilt_deg: float = 0.0

    def __post_init__(self) -> None:
        for field in ("flying_height_m", "principal_distance_mm", "format_mm"):
            if not 0.0 < getattr(self, field) < 1e5:
                raise InputError("must be positive", field=field, value=getattr(self, field))
        for field in ("overlap", "sidelap"):
            if not 0.0 < getattr(self, field) < 1.0:
                raise InputError("must be a share between 0 and 1", field=field, value=getattr(self, field))
        if abs(self.tilt_deg) > 45.0:
            raise InputError("must be at most 45", field="tilt_deg", value=self.tilt_deg)
        if self.relief_m >= 0.9 * self.flying_height_m:
            raise InputError("the relief must stay below the aircraft", field="relief_m", value=self.relief_m)
        self.frame.require_conformal()
        check_coordinates(self.frame, (self.x, self.y), "positions of the block")

    @cached_property
    def frame(self) -> MapFrame:
        """The map with ellipsoidal heights."""
        return MapFrame(self.crs, HeightSystem.ellipsoidal())

    @cached_property
    def tangent(self) -> TangentFrame:
        """Tangent frame at the middle of the block, on the ellipsoid."""
        return TangentFrame.at_map(self.frame, (self.x, self.y, 0.0))

    @property
    def radius_m(self) -> float:
        """Gaussian mean radius at the block."""
        datum = self.frame.geodetic
        return float(gauss_radius(datum.semi_major_m, datum.flattening, self.tangent.latitude_deg))

    @property
    def tau(self) -> float:
        """Point scale at the middle of the block."""
        return float(grid_factors(self.crs, self.x, self.y)[0])

    @property
    def convergence(self) -> float:
        """Grid convergence at the middle of the block, radians."""
        return float(grid_factors(self.crs, self.x, self.y)[1])

    @property
    def tau_e(self) -> float:
        """Effective scale at the height of the ground."""
        return float(effective_scale(self.tau, self.ground_m, self.radius_m))

    @property
    def base_m(self) -> float:
        """Distance of exposures along the strip."""
        return (1.0 - self.overlap) * self.footprint_m

    @property
    def strip_distance_m(self) -> float:
        """Distance of strips."""
        return (1.0 - self.sidelap) * self.footprint_m

    @property
    def footprint_m(self) -> float:
        """Edge of the format on the ground."""
        return self.format_mm / self.principal_distance_mm * self.flying_height_m


@dataclass(frozen=True, eq=False)
class SimulatedBlock:
    """Photographs and points with exact image coordinates, computed in space.

    Attributes
    ----------
    centres, rotations : (p, 3), (p, 3, 3)
        True orientation in the tangent frame.
    points : (n, 3)
        True points in the tangent frame.
    control : (n,) bool
        Which of them are control points.
    centre_point : int
        The point in the middle, on the ground.
    photo_of, point_of : (m,) int
    xy : (m, 2)
        Image coordinates in metres.
    """

    centres: Array
    rotations: Array
    points: Array
    control: NDArray[np.bool_]
    centre_point: int
    photo_of: NDArray[np.int64]
    point_of: NDArray[np.int64]
    xy: Array


def simulated_pair(plan: FlightPlan) -> SimulatedBlock:
    """One model: two photographs, five by five points of its overlap on the ground and as many at the
    relief."""
    along = np.array([-0.5, 0.5]) * plan.base_m
    # Across: a little inside the format; along: from nadir to nadir, or as far as the overlap reaches.
    inside = 0.92
    reach = min(0.5 * plan.base_m, 0.5 * inside * plan.overlap * plan.footprint_m)
    u = np.linspace(-1.0, 1.0, 5) * reach
    v = np.linspace(-1.0, 1.0, 5) * 0.5 * inside * plan.footprint_m
    layers = []
    for h in [0.0] if plan.relief_m == 0.0 else [0.0, plan.relief_m]:
        nearer = min(1.0, 1.0 - h / plan.flying_height_m)  # a hill fills the format sooner
        layers.append([(a, b * nearer, h) for b in v for a in u])
    points = np.concatenate(layers)
    nadirs = np.column_stack([along, np.zeros(2)])
    return _photographed(plan, nadirs, points, np.zeros(len(points), bool), 12, everywhere=True)


def simulated_block(plan: FlightPlan, strips: int = 3, photographs: int = 5) -> SimulatedBlock:
    """A block of parallel strips with three by five control points on the ground.

    New points lie between them, every other one on the ground and at the relief.
    """
    s = (np.arange(photographs) - 0.5 * (photographs - 1)) * plan.base_m
    t = (np.arange(strips) - 0.5 * (strips - 1)) * plan.strip_distance_m
    nadirs = np.array([(a, b) for b in t for a in s])
    u = np.linspace(s[0], s[-1], 2 * photographs - 1)
    reach = 0.4 * plan.footprint_m
    v = np.linspace(t[0] - reach, t[-1] + reach, 4 * strips + 1)
    control_rows = v[:: 2 * strips]
    if plan.sidelap < 0.5:
        # Strips hang together by points of their narrow sidelap, which the even rows may miss.
        middles = 0.5 * (t[1:] + t[:-1])
        tenth = 0.3 * plan.sidelap * plan.footprint_m
        v = np.unique(np.concatenate([v, middles, middles - tenth, middles + tenth]))
    grid = np.array([(a, b) for b in v for a in u])
    rows, cols = np.divmod(np.arange(len(grid)), len(u))
    control = np.isin(v, control_rows)[rows] & (cols % 2 == 0)
    heights = np.where(control | ((rows + cols) % 2 == 0), 0.0, plan.relief_m)
    middle = int(np.argmin(np.abs(grid).sum(axis=1) + np.where(control | (heights != 0.0), 1e9, 0.0)))
    return _photographed(plan, nadirs, np.column_stack([grid, heights]), control, middle)


def _photographed(
    plan: FlightPlan,
    nadirs: Array,
    points: Array,
    control: NDArray[np.bool_],
    centre_point: int,
    *,
    everywhere: bool = False,
) -> SimulatedBlock:
    """Put a block given along and across the flight over the ellipsoid, and photograph it."""
    centres = _on_ellipsoid(plan, nadirs, plan.ground_m + plan.flying_height_m)
    ground = _on_ellipsoid(plan, points[:, :2], plan.ground_m + points[:, 2])
    lon, lat, _ = plan.tangent.geodetic_from_tangent(centres).T
    tilt = np.deg2rad(plan.tilt_deg)
    signs = np.array([(1, 1), (-1, -1), (1, -1), (-1, 1)])[np.arange(len(centres)) % 4]
    tilts = np.column_stack([signs * tilt, np.zeros(len(centres))])
    # x of the image along the flight: heading from north clockwise is 90° minus the angle from east
    level = rotation_z(np.pi / 2 - np.deg2rad(plan.heading_deg))
    rotations = plan.tangent.rotation_tangent_from_enu(lon, lat) @ level @ rotation_from_opk(tilts)
    c, half = plan.principal_distance_mm * 1e-3, 0.5e-3 * plan.format_mm
    local = np.einsum("pji,pnj->pni", rotations, ground[None] - centres[:, None])
    xy = -c * local[..., :2] / local[..., 2:]
    seen = (local[..., 2] < 0.0) & (np.abs(xy).max(axis=-1) <= half * (1.0 + 2.0 * abs(tilt)) * 1.001)
    if everywhere:
        seen = local[..., 2] < 0.0
        if not seen.all():
            rule = "lets a photograph look above the horizon: too much for this format and principal distance"
            raise InputError(rule, field="tilt_deg", value=plan.tilt_deg)
    photo_of, point_of = np.nonzero(seen)
    block = SimulatedBlock(centres, rotations, ground, control, centre_point, photo_of, point_of, xy[seen])
    return block if everywhere else _determined(block, points)


def _determined(block: SimulatedBlock, nominal: Array) -> SimulatedBlock:
    """The block without new points that fewer than two photographs see."""
    keep = block.control | (np.bincount(block.point_of, minlength=len(block.points)) >= 2)
    if not (keep & ~block.control).any():
        raise InputError("leaves no point that two photographs see", field="overlap, sidelap")
    number = np.cumsum(keep) - 1
    off = np.hypot(nominal[:, 0], nominal[:, 1]) + np.where(keep & ~block.control, 0.0, np.inf)
    middle = block.centre_point if keep[block.centre_point] else int(np.argmin(off + np.abs(nominal[:, 2])))
    rows = keep[block.point_of]
    return replace(
        block,
        points=block.points[keep],
        control=block.control[keep],
        centre_point=int(number[middle]),
        photo_of=block.photo_of[rows],
        point_of=number[block.point_of[rows]],
        xy=block.xy[rows],
    )


def _on_ellipsoid(plan: FlightPlan, along_across: Array, height: Array | float) -> Array:
    """Tangent coordinates of positions along and across the flight at ellipsoidal heights.

    Distances are kept at the ground: positions on the tangent plane, carried to the ellipsoid along the arc.
    """
    angle = np.pi / 2 - np.deg2rad(plan.heading_deg)
    east = along_across[:, 0] * np.cos(angle) - along_across[:, 1] * np.sin(angle)
    north = along_across[:, 0] * np.sin(angle) + along_across[:, 1] * np.cos(angle)
    distance = np.hypot(east, north)
    theta = distance / (plan.radius_m + plan.ground_m)
    shrink = np.where(
        distance > 0.0, plan.radius_m * np.sin(theta) / np.where(distance > 0.0, distance, 1.0), 0.0
    )
    down = -plan.radius_m * (1.0 - np.cos(theta))
    lon_lat_h = plan.tangent.geodetic_from_tangent(np.column_stack([east * shrink, north * shrink, down]))
    lon_lat_h[:, 2] = height
    return plan.tangent.tangent_from_geodetic(lon_lat_h)
