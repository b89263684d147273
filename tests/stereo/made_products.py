"""Products of a synthetic survey without any image: the job, and exact positions of points on both."""

from __future__ import annotations

import numpy as np

from stereomate.coverage.summary import survey_coverage
from stereomate.frames.transform import map_from_tangent
from stereomate.rectify.options import RectifyOptions
from stereomate.rectify.planning import Request, plan_products
from stereomate.stereo.lineage import LineageRule
from stereomate.synthetic.options import SurveyOptions
from stereomate.terrain.intersection import ground_distances
from stereomate.terrain.model import HeightModel

OPTIONS = SurveyOptions(
    seed=5,
    strips=1,
    photos_per_strip=3,
    size_px=(800, 600),
    gsd_m=0.6,
    flying_height_m=500.0,
    pixel_pitch_mm=0.12,
    relief_m=120.0,
    terrain_step_m=2.0,
    buildings=30,
    trees=200,
    control_points=3,
    check_points=5,
)


def height_model(survey, shift_m: float = 0.0, tilt_deg: float = 0.0) -> HeightModel:
    """The terrain of the world; shifted and tilted towards azimuth 50 degrees when asked."""
    world = survey.world
    rows, cols = world.heights.shape
    row, col = np.mgrid[0:rows, 0:cols]
    along = (col - 0.5 * cols) * np.cos(np.radians(40.0)) - (row - 0.5 * rows) * np.sin(np.radians(40.0))
    tilt = np.tan(np.radians(tilt_deg)) * along * world.options.terrain_step_m
    return HeightModel.from_array(world.heights + shift_m + tilt, world.affine, world.frame)


def make_job(survey, heights: HeightModel, **options):
    coverage = survey_coverage(survey.survey, heights)
    options = RectifyOptions(gsd=survey.options.gsd_m, **options)
    return plan_products(survey.survey, heights, coverage, options, Request())[0]


def product_positions(job, points):
    """Exact positions of map points (n, 3) on orthophoto and stereomate.

    Rays of every photograph are traced to the height model; of those the one counts that the product shows
    at the place where it puts the point. Returns indices of the points that appear in both, their map
    positions on orthophoto and stereomate, and the photographs.
    """
    from stereomate.frames.transform import tangent_from_map

    rule = LineageRule(job)
    at = tangent_from_map(job.tangent, job.frame, points)
    found = [np.full((len(points), 3), np.nan) for _ in range(2)]
    for p, photograph in enumerate(job.photographs):
        _, inside = photograph.camera.image_from_camera(photograph.orientation.camera_from_tangent(at))
        centre = np.array(photograph.orientation.centre)
        ray = at - centre
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        distance = ground_distances(job.heights, job.tangent, centre, ray)
        ground = np.full((len(points), 3), np.nan)
        met = np.isfinite(distance) & inside
        ground[met] = map_from_tangent(job.tangent, job.frame, centre + distance[met, None] * ray[met])
        uv = job.grid.uv_from_map(ground[:, :2])
        for side in range(2):
            shown = uv.copy()
            if side == 1:
                shown[:, 0] -= job.law.q(ground[:, 2])
            xy = job.grid.map_from_uv(shown)
            for k in np.flatnonzero(met & np.isnan(found[side][:, 0])):
                if rule.photographs(side, job.grid.pixel_from_map(xy[k : k + 1]))[0] == p + 1:
                    found[side][k] = [*xy[k], p]
    both = np.flatnonzero(np.isfinite(found[0][:, 0]) & np.isfinite(found[1][:, 0]))
    left, right = found[0][both], found[1][both]
    return both, left[:, :2], right[:, :2], np.stack([left[:, 2], right[:, 2]], axis=-1).astype(int)
