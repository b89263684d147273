"""How large each effect of the map projection is in a block, had it not been handled (Ressl 2002).

The rays of a run are rigorous, so none of these errors is in its products: the figures tell a client what
software would do that takes the grid as Cartesian, and an authority what was taken care of.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

from stereomate.coverage.summary import Coverage
from stereomate.frames.factors import effective_scale, gauss_radius, grid_factors
from stereomate.frames.refraction import refraction_corrected
from stereomate.project.model import Project
from stereomate.report.page import Section, Table


@dataclass(frozen=True)
class GridEffect:
    """An effect: its size in its own terms, and the error in metres it would have made."""

    name: str
    size: str
    error_m: float
    consequence: str
    handled: bool = True

    def as_record(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "effect": self.name,
            "size": self.size,
            "error_m": self.error_m,
            "consequence": self.consequence,
            "handled": self.handled,
        }


def grid_effects(project: Project, coverage: Coverage) -> tuple[GridEffect, ...]:
    """The effects at the middle of a block; empty where nothing is known of its ground.

    Scale: ``(τ_e - 1) H`` with H the flying height above ground, theory of Ressl's equations (2)-(4); Earth
    curvature: ``d²/2R`` at the farthest corner d of a footprint; convergence: ``γ d``.
    """
    known = coverage.known
    if not known:
        return ()
    frame = project.frame
    _, lat, _ = project.tangent.geodetic_from_tangent(np.zeros(3))
    centres = {p.name: c for p, c in zip(project.survey.photographs, project.survey.centres_map, strict=True)}
    flown = float(np.mean([f.height_above_ground_m for f in known]))
    ground = frame.geodetic_from_map(
        np.array([[*centres[f.name][:2], f.ground_m] for f in known], np.float64)
    )[:, 2]
    xy = np.array([centres[f.name][:2] for f in known])
    tau, gamma = grid_factors(frame.crs, xy[:, 0], xy[:, 1])
    radius = float(gauss_radius(project.tangent.semi_major_m, project.tangent.flattening, lat))
    scale = effective_scale(tau, ground, radius) - 1.0
    reach = frame.unit_m * max(
        float(np.hypot(*(shapely.get_coordinates(f.polygon) - centres[f.name][:2]).T).max()) for f in known
    )
    spread = float(scale.max() - scale.min())
    return (
        GridEffect(
            "scale of the map against the scale of heights",
            f"τ_e - 1 = {1e6 * scale.mean():+.0f} ppm",
            float(abs(scale.mean()) * flown),
            "heights of all points",
        ),
        GridEffect(
            "change of that scale over the block",
            f"{1e6 * spread:.1f} ppm",
            spread * flown,
            "tilt and warp of heights with one mean scale",
        ),
        GridEffect(
            "Earth curvature",
            f"d = {reach:.0f} m from the nadir to the farthest corner",
            reach**2 / (2.0 * radius),
            "heights at the edge of a photograph",
        ),
        GridEffect(
            "convergence of meridians",
            f"γ = {np.degrees(gamma.mean()):+.4f}°",
            float(abs(gamma.mean()) * reach),
            "plan, where angles about true north are taken as about grid north",
        ),
        _refraction(flown, float(ground.mean()), reach),
    )


def _refraction(flown_m: float, ground_m: float, reach_m: float) -> GridEffect:
    """Displacement of the farthest corner by the standard atmosphere, on the ground."""
    image = np.array([[reach_m / flown_m, 0.0]])
    corrected = refraction_corrected(image, 1.0, np.eye(3), ground_m + flown_m, ground_m)
    displaced = float(np.hypot(*(np.asarray(corrected) - image)[0]) * flown_m)
    return GridEffect(
        "atmospheric refraction (standard atmosphere)",
        f"{1e6 * displaced / flown_m:.1f} ppm of the principal distance at the farthest corner",
        displaced,
        "plan at the edge of a photograph, unless camera or orientation hold it already",
        handled=False,
    )


def effects_section(effects: tuple[GridEffect, ...]) -> Section:
    """The section of the report."""
    rows = tuple(
        (e.name, e.size, f"{e.error_m:.3f}", e.consequence, "handled" if e.handled else "not modelled")
        for e in effects
    )
    headings = ("effect", "size in this block", "error if ignored, m", "in", "here")
    said = (
        "Rays are computed in a tangent frame on the ellipsoid; the map grid and its heights are used at the "
        "edges only. These are the errors of software that takes the grid as Cartesian."
    )
    return Section("Map projection", (said,), (Table(headings, rows),))
