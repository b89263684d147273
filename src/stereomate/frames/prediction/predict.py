"""The prediction for a planned flight: every way to work, simulated, with the paper's equations beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stereomate.frames.crs import geodetic_of, horizontal_part, parse
from stereomate.frames.curvature import CurvatureOptions
from stereomate.frames.factors import effective_scale, gauss_radius, grid_factors_geodetic
from stereomate.frames.prediction.equations import (
    centre_height_shift,
    direct_point_error,
    ground_level_relief_error,
    indirect_point_error,
)
from stereomate.frames.prediction.plan import FlightPlan, simulated_block, simulated_pair
from stereomate.frames.prediction.simulate import (
    METHODS,
    GridWork,
    Method,
    Mode,
    Outcome,
    direct_outcome,
    indirect_outcome,
)

Array = NDArray[np.float64]

# Height accuracy expected of a flight, as a share of the flying height (Ressl's 0.06 per mille).
EXPECTED_SHARE = 0.06e-3

_METHOD = {"classical": "classical", "sphere": "spherical"}


@dataclass(frozen=True, eq=False)
class Prediction:
    """Errors to expect of a planned flight.

    Attributes
    ----------
    plan : FlightPlan
    curvature : CurvatureOptions
        The correction of P1, M2 and M3.
    outcomes : tuple of Outcome
        Direct; indirect with c fixed; indirect with c free; each for all methods.
    equation_2_m, equation_3_m, equation_4_m : float
        The paper's equations with the scale of the curvature correction: shift of the centres, error of the
        highest new point (indirect), error of a point on the ground (direct).
    expected_m : float
        Height accuracy to compare with.
    """

    plan: FlightPlan
    curvature: CurvatureOptions
    outcomes: tuple[Outcome, ...]
    equation_2_m: float
    equation_3_m: float
    equation_4_m: float
    expected_m: float

    def outcome(self, mode: Mode, method: Method, *, free: bool = False) -> Outcome:
        """One of the outcomes."""
        return next(
            o for o in self.outcomes if (o.mode, o.method, o.free_principal_distance) == (mode, method, free)
        )

    def harmless(self, outcome: Outcome) -> bool:
        """Whether an outcome's worst height error stays below a third of the expected accuracy."""
        return abs(outcome.worst_height_m) <= self.expected_m / 3.0

    def words(self) -> list[str]:
        """What it means, in sentences."""
        plan = self.plan
        direct, fixed = self.outcome("direct", "P1"), self.outcome("indirect", "P1")
        centre, worst = direct.centre_error[2], direct.worst_height_m
        good = [method for method in METHODS if self.harmless(self.outcome("direct", method))]
        return [
            (
                f"Map scale here: {1e6 * (plan.tau - 1):+.1f} ppm at the ellipsoid, "
                f"{1e6 * (plan.tau_e - 1):+.1f} ppm at the ground; "
                f"convergence {np.rad2deg(plan.convergence):+.4f} degrees."
            ),
            (
                f"Direct georeferencing in the grid with {_METHOD[self.curvature.method]} Earth curvature "
                f"correction: points {abs(centre):.3f} m too {'high' if centre > 0 else 'low'} in the "
                f"middle of a model, at worst {worst:+.3f} m: {abs(worst) / self.expected_m:.1f} times the "
                f"{self.expected_m:.3f} m expected of the flight."
            ),
            (
                f"Aerial triangulation in the grid with c fixed: centres {fixed.centres_up_m:+.3f} m, "
                f"new points at worst {fixed.worst_height_m:+.3f} m."
            ),
            (
                "Harmless for direct georeferencing (below a third of the expected accuracy): "
                f"{', '.join(good)}."
            ),
        ]


def predict(
    plan: FlightPlan, expected_m: float | None = None, curvature: CurvatureOptions | None = None
) -> Prediction:
    """Simulate a planned flight in its map.

    Parameters
    ----------
    plan : FlightPlan
    expected_m : float, optional
        Height accuracy expected of the flight; 0.06 per mille of the flying height if absent.
    curvature : CurvatureOptions, optional
        The Earth curvature correction of P1, M2 and M3; if absent the classical one, which keeps distances at
        ground level. The scale of equations and remedies follows from it: tau_e for ground level, tau for the
        ellipsoid.
    """
    pair = GridWork(plan, simulated_pair(plan), curvature)
    block = GridWork(plan, simulated_block(plan), curvature)
    outcomes = [direct_outcome(pair, method) for method in METHODS]
    for free in (False, True):
        outcomes += [indirect_outcome(block, method, free=free) for method in METHODS]
    ground, scale = plan.ground_m, pair.scale
    centre, hill = ground + plan.flying_height_m, ground + plan.relief_m
    equation_3 = indirect_point_error(scale, hill, ground)
    if pair.curvature.level == "ground":
        equation_3 = equation_3 + ground_level_relief_error(hill, ground, centre, plan.radius_m)
    return Prediction(
        plan,
        pair.curvature,
        tuple(outcomes),
        float(centre_height_shift(scale, centre, ground)),
        float(equation_3),
        float(direct_point_error(scale, ground, centre)),
        EXPECTED_SHARE * plan.flying_height_m if expected_m is None else expected_m,
    )


@dataclass(frozen=True, eq=False)
class ErrorMap:
    """Height error of direct georeferencing in the grid over the area of the projection, by equation (4).

    Attributes
    ----------
    longitude_deg, latitude_deg : (rows, cols)
    scale_ppm : (rows, cols)
        tau_e - 1 at the ground.
    height_error_m : (rows, cols)
        Of points on the ground; NaN where the projection is not defined.
    """

    longitude_deg: Array
    latitude_deg: Array
    scale_ppm: Array
    height_error_m: Array


def error_map(plan: FlightPlan, size: int = 60) -> ErrorMap:
    """Height errors over the area of use of the map (or 6 by 8 degrees around the block if none is known)."""
    area = horizontal_part(parse(plan.crs)).area_of_use
    lon0, lat0 = plan.tangent.longitude_deg, plan.tangent.latitude_deg
    west, south, east, north = (
        (area.west, area.south, area.east, area.north)
        if area is not None and area.east > area.west
        else (lon0 - 3.0, max(lat0 - 4.0, -85.0), lon0 + 3.0, min(lat0 + 4.0, 85.0))
    )
    lon, lat = np.meshgrid(
        np.linspace(west, east, size), np.linspace(max(south, -88.0), min(north, 88.0), size)
    )
    tau, _ = grid_factors_geodetic(plan.crs, lon, lat)
    datum = geodetic_of(plan.crs)
    radius = gauss_radius(datum.semi_major_m, datum.flattening, lat)
    tau_e = effective_scale(tau, plan.ground_m, radius)
    error = direct_point_error(tau_e, plan.ground_m, plan.ground_m + plan.flying_height_m)
    return ErrorMap(lon, lat, 1e6 * (tau_e - 1.0), error)
