"""What comes out of a map grid taken as Cartesian, by full simulation, for every remedy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from stereomate.frames.adjusted import effective_scale_at
from stereomate.frames.attitude import rotation_tangent_from_axes
from stereomate.frames.curvature import CurvatureOptions, curvature_corrected
from stereomate.frames.factors import grid_factors
from stereomate.frames.prediction.bundle import BundleProblem, BundleState, adjust, undetermined
from stereomate.frames.prediction.intersection import intersect
from stereomate.frames.prediction.plan import FlightPlan, SimulatedBlock
from stereomate.frames.remedies import (
    GridBlock,
    cartesian_from_map,
    grid_principal_distance,
    map_from_cartesian,
    scaled_heights,
    unscaled_heights,
)
from stereomate.frames.transform import map_from_tangent, tangent_from_map

Array = NDArray[np.float64]
# M3i: principal distance scaled for each photograph by the scale at its own centre, not by that of the area.
Method = Literal["nothing", "P1", "M2", "M3", "M3i", "M4", "M1"]
METHODS: Final[tuple[Method, ...]] = ("nothing", "P1", "M2", "M3", "M3i", "M4", "M1")
Mode = Literal["direct", "indirect"]

_M4_PASSES: Final = 5
# A block that hangs together weakly takes more passes, until its points stand still.
_M4_MOST: Final = 40
_STILL_M: Final = 1e-7


@dataclass(frozen=True, eq=False)
class Outcome:
    """Errors of one way to work, computed minus true, metres, in grid axes.

    Attributes
    ----------
    mode, method : str
    free_principal_distance : bool
    errors : (n, 3)
        At the new points (all points of a directly oriented model).
    centre_error : (3,)
        At the point in the middle on the ground.
    centres_up_m : float
        Mean height error of the projection centres.
    principal_distance_mm : float
        The one used, or found.
    """

    mode: Mode
    method: Method
    free_principal_distance: bool
    errors: Array
    centre_error: Array
    centres_up_m: float
    principal_distance_mm: float

    @property
    def worst_height_m(self) -> float:
        """The height error of largest size, with its sign."""
        return float(self.errors[np.argmax(np.abs(self.errors[:, 2])), 2])

    @property
    def worst_plan_m(self) -> float:
        """Largest error in plan."""
        return float(np.hypot(self.errors[:, 0], self.errors[:, 1]).max())


class GridWork:
    """A simulated block as it looks in the grid: the same for all methods."""

    def __init__(
        self, plan: FlightPlan, block: SimulatedBlock, curvature: CurvatureOptions | None = None
    ) -> None:
        self.plan, self.block = plan, block
        self.curvature = curvature or CurvatureOptions(plan.radius_m, "classical", "ground")
        self.c = 1e-3 * plan.principal_distance_mm
        self.grid = GridBlock(
            plan.tangent,
            plan.frame,
            block.centres,
            block.rotations,
            np.full(len(block.centres), self.c),
        )
        self.truth = self.cartesian(block.points)

    @property
    def scale(self) -> float:
        """The scale that belongs to the curvature correction in use."""
        return self.plan.tau_e if self.curvature.level == "ground" else self.plan.tau

    @property
    def photo_scales(self) -> Array:
        """That scale at the centre of each photograph (p,)."""
        centres = map_from_cartesian(self.plan.frame, self.grid.grid_centres)
        if self.curvature.level == "ground":
            return effective_scale_at(self.plan.frame, centres[:, :2], self.plan.ground_m)
        return grid_factors(self.plan.crs, centres[:, 0], centres[:, 1])[0]

    def cartesian(self, tangent: Array) -> Array:
        """Tangent points in the Cartesian grid."""
        return cartesian_from_map(
            self.plan.frame, map_from_tangent(self.plan.tangent, self.plan.frame, tangent)
        )

    def curved(self, points: Array, centres: Array, rotations: Array) -> Array:
        """Image coordinates corrected for Earth curvature at current heights."""
        block = self.block
        return curvature_corrected(
            block.xy,
            self.c,
            rotations[block.photo_of],
            centres[block.photo_of, 2],
            points[block.point_of, 2],
            self.curvature,
        )

    def refined(self, state: BundleState) -> Array:
        """Image coordinates corrected by M4 at current points and orientations (in the grid)."""
        tangent, frame, block = self.plan.tangent, self.plan.frame, self.block
        centres = tangent_from_map(tangent, frame, map_from_cartesian(frame, state.centres))
        turn = rotation_tangent_from_axes("grid", tangent, centres, frame)
        c = np.full(len(centres), state.principal_distance)
        now = GridBlock(tangent, frame, centres, turn @ state.rotations, c)
        return block.xy + now.corrections(
            map_from_cartesian(frame, state.points), block.point_of, block.photo_of
        )


def direct_outcome(work: GridWork, method: Method) -> Outcome:
    """Direct georeferencing: true orientation, points by intersection."""
    block = work.block
    count = len(block.points)
    order = np.lexsort((block.photo_of, block.point_of))
    k = len(block.centres)

    def points_from(xy: Array, centres: Array, rotations: Array, c: float | Array) -> Array:
        each = np.broadcast_to(np.asarray(c, dtype=np.float64), (k,))
        return intersect(xy[order].reshape(count, k, 2), centres, rotations, each)

    centres, rotations = work.grid.grid_centres, work.grid.grid_rotations
    c = work.c
    if method == "M1":
        found = work.cartesian(points_from(block.xy, block.centres, block.rotations, c))
        return _outcome("direct", method, work, BundleState(centres, rotations, found, c), free=False)
    found = points_from(block.xy, centres, rotations, c)
    if method == "M4":
        for _ in range(_M4_PASSES):
            found = points_from(
                work.refined(BundleState(centres, rotations, found, c)), centres, rotations, c
            )
    elif method != "nothing":
        for _ in range(2):
            xy = work.curved(found, centres, rotations)
            if method == "M2":
                scaled = points_from(xy, scaled_heights(centres, work.scale), rotations, c)
                found = unscaled_heights(scaled, work.scale)
            else:
                c = float(grid_principal_distance(work.c, work.scale)) if method == "M3" else work.c
                each = c / work.photo_scales if method == "M3i" else c
                found = points_from(xy, centres, rotations, each)
    return _outcome("direct", method, work, BundleState(centres, rotations, found, c), free=False)


def indirect_outcome(work: GridWork, method: Method, *, free: bool = False) -> Outcome:
    """Indirect georeferencing: a bundle on control points; with c free, GNSS centres make it determinable."""
    block = work.block
    rigorous = method == "M1"
    c = float(grid_principal_distance(work.c, work.scale)) if method == "M3" else work.c
    scale = work.scale if method == "M2" else 1.0
    if rigorous:
        start = BundleState(block.centres, block.rotations, block.points, c)
    else:
        start = BundleState(
            scaled_heights(work.grid.grid_centres, scale),
            work.grid.grid_rotations,
            scaled_heights(work.truth, scale),
            c,
        )
    gnss = start.centres if free else None
    problem = BundleProblem(block.photo_of, block.point_of, block.xy, block.control, gnss, free)
    state = start
    passes = {"nothing": 1, "M1": 1, "M4": _M4_MOST}.get(method, 2)
    for number in range(passes):
        xy = block.xy
        if method == "M4":
            xy = work.refined(state)
        elif method in ("P1", "M2", "M3", "M3i"):
            heights = unscaled_heights(state.points, scale), unscaled_heights(state.centres, scale)
            xy = work.curved(*heights, state.rotations)
            if method == "M3i":
                # A principal distance c / tau_e of its own is the common one with coordinates times tau_e.
                xy = xy * work.photo_scales[block.photo_of, None]
        before, state = state, adjust(problem.with_images(xy), state)
        moved = float(np.abs(state.points - before.points).max())
        if method == "M4" and number + 1 >= _M4_PASSES and moved < _STILL_M:
            break
        if method == "M4" and number + 1 == passes and moved > 1e-4:
            raise undetermined()
    if rigorous:
        centres, points = work.cartesian(state.centres), work.cartesian(state.points)
    else:
        centres, points = unscaled_heights(state.centres, scale), unscaled_heights(state.points, scale)
    state = BundleState(centres, state.rotations, points, state.principal_distance)
    return _outcome("indirect", method, work, state, free=free)


def _outcome(mode: Mode, method: Method, work: GridWork, state: BundleState, *, free: bool) -> Outcome:
    errors = state.points - work.truth
    up = state.centres[:, 2] - work.grid.grid_centres[:, 2]
    return Outcome(
        mode,
        method,
        free,
        errors[~work.block.control],
        errors[work.block.centre_point],
        float(up.mean()),
        1e3 * state.principal_distance,
    )
