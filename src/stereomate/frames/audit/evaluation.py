"""How well a reading of an orientation fits: forward intersection of all points, and what is left."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.frames.adjusted import effective_scale_at, space_from_grid_centres
from stereomate.frames.audit.observations import AuditObservations, WrittenBlock
from stereomate.frames.audit.readings import AttitudeReading, HeightCandidate, Work
from stereomate.frames.curvature import CurvatureOptions, curvature_corrected
from stereomate.frames.factors import gauss_radius
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.remedies import GridBlock, map_from_cartesian
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_map, map_from_tangent, tangent_from_map
from stereomate.geometry.intersection import Rays, intersect_rays
from stereomate.geometry.rotations import rotation_from_vector

Array = NDArray[np.float64]

# Rays that meet at all have done so by then.
ITERATIONS: Final = 8


@dataclass(frozen=True, eq=False)
class Intersected:
    """Points of one reading, before they are compared.

    Attributes
    ----------
    points : ndarray (n, 3)
        In the map with ellipsoidal heights; NaN where rays do not meet before the cameras.
    residuals_px : ndarray (m, 2)
        Of the image coordinates, along columns and against rows.
    lost : float
        Share of the points without an intersection.
    rms_px : (float, float)
    """

    points: Array
    residuals_px: Array
    lost: float

    @property
    def rms_px(self) -> tuple[float, float]:
        """Root mean square of the image residuals; infinite if more than a twentieth of points is lost."""
        good = np.isfinite(self.residuals_px).all(axis=1)
        if self.lost > 0.05 or not good.any():
            return np.inf, np.inf
        x, y = np.sqrt(np.mean(self.residuals_px[good] ** 2, axis=0))
        return float(x), float(y)

    @property
    def total_px(self) -> float:
        """The two together."""
        return float(np.hypot(*self.rms_px))


class Evaluator:
    """Intersections of one block under any reading.

    Parameters
    ----------
    block : WrittenBlock
    observations : AuditObservations
    """

    def __init__(self, block: WrittenBlock, observations: AuditObservations) -> None:
        self.block, self.observations = block, observations
        self.ellipsoidal = MapFrame(block.crs, HeightSystem.ellipsoidal())
        middle = np.append(block.positions[:, :2].mean(axis=0), 0.0)
        self.tangent = TangentFrame.at_map(self.ellipsoidal, middle)

    def frame(self, heights: HeightCandidate) -> MapFrame:
        """The map with a height system."""
        return MapFrame(self.block.crs, heights.system)

    def centres_map(self, heights: HeightCandidate) -> Array:
        """Written centres with ellipsoidal heights."""
        return map_from_map(self.ellipsoidal, self.frame(heights), self.block.positions)

    def reference_map(self, heights: HeightCandidate) -> Array:
        """Known points with ellipsoidal heights, NaN where there are none (n, 3)."""
        known = self.observations.known
        out = np.full(self.observations.reference.shape, np.nan)
        if known.any():
            points = self.observations.reference[known]
            out[known] = map_from_map(self.ellipsoidal, self.frame(heights), points)
        return out

    def intersect(
        self,
        work: Work,
        attitude: AttitudeReading,
        heights: HeightCandidate,
        grid_height: float | None = None,
        turn: Array | None = None,
        iterations: int = ITERATIONS,
    ) -> Intersected:
        """All points under a reading.

        Parameters
        ----------
        grid_height : float, optional
            Ellipsoidal height of the control, about which ``adjusted`` centres are scaled.
        turn : ndarray (3,), optional
            A common turn of all photographs in tangent axes, radians.
        iterations : int
            Of the intersection; 0 leaves the points nearest to their rays, which is enough to tell readings
            that cannot be.
        """
        centres_map = self.centres_map(heights)
        if work == "adjusted":
            if grid_height is None:
                grid_height = float(np.nanmin(centres_map[:, 2])) - 1.0
            centres_map = space_from_grid_centres(self.ellipsoidal, centres_map, grid_height).centres
        centres = tangent_from_map(self.tangent, self.ellipsoidal, centres_map)
        rotations = attitude.rotations(self.block, self.tangent, centres, self.ellipsoidal)
        if turn is not None:
            rotations = rotation_from_vector(turn) @ rotations
        if work in ("space", "adjusted"):
            found = self._meet(centres, rotations, self.observations.image, iterations)
            points = np.full(found.points.shape, np.nan)
            good = np.isfinite(found.points).all(axis=1)
            points[good] = map_from_tangent(self.tangent, self.ellipsoidal, found.points[good])
            return Intersected(points, found.residuals_px, found.lost)
        block = GridBlock(self.tangent, self.ellipsoidal, centres, rotations, np.ones(len(centres)))
        found = self._meet(block.grid_centres, block.grid_rotations, self.observations.image)
        if work == "curvature":
            for _ in range(2):
                image = self._curved(found.points, block)
                found = self._meet(block.grid_centres, block.grid_rotations, image)
        return Intersected(map_from_cartesian(self.ellipsoidal, found.points), found.residuals_px, found.lost)

    def _meet(
        self, centres: Array, rotations: Array, image: Array, iterations: int = ITERATIONS
    ) -> Intersected:
        obs = self.observations
        photo = obs.photo_of
        rays = Rays(obs.point_of, centres[photo], rotations[photo], image, 1.0 / obs.c_px)
        met = intersect_rays(rays, len(obs.names), max_iterations=iterations)
        residuals = met.residuals * obs.c_px[:, None]
        below = np.isfinite(met.points).all(axis=1)
        # Rays that meet behind a camera are no points: collinearity does not see the sign of the depth.
        local = np.einsum("mji,mj->mi", rotations[photo], met.points[obs.point_of] - centres[photo])
        behind = np.zeros(len(obs.names), dtype=bool)
        np.logical_or.at(behind, obs.point_of, ~(local[:, 2] < 0.0))
        bad = behind | ~below
        points = np.where(bad[:, None], np.nan, met.points)
        residuals = np.where(bad[obs.point_of][:, None], np.nan, residuals)
        return Intersected(points, residuals, float(bad.mean()))

    def _curved(self, points: Array, block: GridBlock) -> Array:
        """Image coordinates with the classical curvature correction at the points' heights."""
        obs = self.observations
        datum = self.ellipsoidal.geodetic
        radius = gauss_radius(datum.semi_major_m, datum.flattening, self.tangent.latitude_deg)
        heights = points[obs.point_of, 2]
        good = np.isfinite(heights)
        image = obs.image.copy()
        image[good] = curvature_corrected(
            obs.image[good],
            1.0,
            block.grid_rotations[obs.photo_of[good]],
            block.grid_centres[obs.photo_of[good], 2],
            heights[good],
            CurvatureOptions(float(radius), "classical"),
        )
        return image

    def plane_scale_excess(self, heights: HeightCandidate, ground: float) -> Array:
        """(tau_e - 1) H at each point with known ground, H the mean height of the centres above `ground`."""
        above = float(self.centres_map(heights)[:, 2].mean()) - ground
        tau_e = effective_scale_at(self.ellipsoidal, self.observations.reference[:, :2], ground)
        return np.asarray((tau_e - 1.0) * above, dtype=np.float64)


@dataclass(frozen=True)
class CommonTurn:
    """The turn of all photographs together that would fit best.

    Attributes
    ----------
    about_deg, sigma_deg : (3,) tuple
        About east, north and up, and standard deviations.
    rms_px : float
        Image residuals left with it.
    """

    about_deg: tuple[float, float, float]
    sigma_deg: tuple[float, float, float]
    rms_px: float


def common_turn(
    evaluator: Evaluator, attitude: AttitudeReading, heights: HeightCandidate
) -> CommonTurn | None:
    """By how much all photographs would have to turn together: the y-parallaxes' own word on the axes.

    A common turn about the vertical of the size of the convergence says that angles are about other axes.
    Gauss-Newton over re-intersected points, with numerical derivatives.

    Returns
    -------
    CommonTurn or None
        None where rays do not meet at all.
    """
    turn, normal = np.zeros(3), np.eye(3)
    step = 1e-5
    for _ in range(6):
        base = evaluator.intersect("space", attitude, heights, turn=turn)
        if not np.isfinite(base.total_px):
            return None
        columns = [
            (
                evaluator.intersect("space", attitude, heights, turn=turn + step * e).residuals_px
                - base.residuals_px
            )
            / step
            for e in np.eye(3)
        ]
        design = np.stack([column.ravel() for column in columns], axis=1)
        good = np.isfinite(design).all(axis=1) & np.isfinite(base.residuals_px.ravel())
        normal = design[good].T @ design[good]
        change = -np.linalg.solve(normal, design[good].T @ base.residuals_px.ravel()[good])
        turn = turn + change
        if np.abs(change).max() < 1e-8:
            break
    last = evaluator.intersect("space", attitude, heights, turn=turn)
    rms = last.total_px
    variance = float(np.nanmean(last.residuals_px**2))
    sigma = np.sqrt(variance * np.diag(np.linalg.inv(normal)))
    x, y, z = np.rad2deg(turn)
    a, b, c = np.rad2deg(sigma)
    return CommonTurn((float(x), float(y), float(z)), (float(a), float(b), float(c)), rms)
