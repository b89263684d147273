"""Which model serves a pixel: decided for blocks at once, the same as pixel by pixel."""

from dataclasses import replace

import numpy as np
from rectify_scenes import BASE, FLYING_HEIGHT, make_job

from stereomate.frames.transform import tangent_from_map
from stereomate.raster import Window
from stereomate.rectify.ground import ground_of, heights_of
from stereomate.rectify.kernels.serve import BOTH_SEE
from stereomate.rectify.layout import StereoModel
from stereomate.rectify.serving import Pixels, camera_nodes, serve_pixels


def winners(job, xy, h):
    """Index of the model of least score whose photographs show the points, -1 for none; a pixel at a time."""
    points = tangent_from_map(job.tangent, job.frame, np.column_stack([xy, h]))
    level = tangent_from_map(job.tangent, job.frame, np.column_stack([xy, np.full(len(h), 600.0)]))
    up = tangent_from_map(job.tangent, job.frame, np.column_stack([xy, np.full(len(h), 601.0)])) - level
    inside, tangent = [], []
    for photograph in job.photographs:
        camera_points = photograph.orientation.camera_from_tangent(points)
        inside.append(photograph.camera.image_from_camera(camera_points)[1])
        to_ground = level - np.array(photograph.orientation.centre)
        rise = -np.sum(to_ground * up, axis=1)
        tangent.append(np.linalg.norm(to_ground + rise[:, None] * up, axis=1) / rise)
    scores = []
    for m in job.models:
        both = [m.left] if m.right < 0 else [m.left, m.right]
        score = np.max([tangent[p] for p in both], axis=0) + m.penalty
        scores.append(np.where(np.all([inside[p] for p in both], axis=0), score, np.inf))
    scores = np.array(scores)
    best = np.sort(scores, axis=0)
    # Scores between the nodes of the lattice are interpolated: ground where two are close may go either way.
    close = best[1] < best[0] + 0.05
    return np.where(np.isfinite(best[0]), np.argmin(scores, axis=0), -1), close


def test_blocks_are_served_as_single_pixels_are():
    job = make_job()
    models = (StereoModel(0, 1, BASE, 0.0, 6.0, FLYING_HEIGHT), StereoModel(0, -1), StereoModel(1, -1))
    big = replace(job.grid, u0=job.grid.u0 - 400.0, v0=job.grid.v0 + 300.0, size=(2200, 1900))
    job = replace(
        job,
        models=(*models[:1], *(replace(m, penalty=0.15) for m in models[1:])),
        grid=big,
        height_range=(550.0, 650.0),
        options=replace(job.options, hidden="keep"),
    )
    rng = np.random.default_rng(4)
    seen = set()
    for window in (Window(0, 0, 700, 640), Window(800, 500, 640, 500), Window(1500, 1300, 700, 600)):
        ground = ground_of(job, window)
        heights = heights_of(job, ground, "test").copy()
        columns = np.arange(window.cols, dtype=np.float32)[None] + np.float32(0.5)
        serving = serve_pixels(
            job, ground, Pixels(window, columns, heights), list(job.models), camera_nodes(job, ground)
        )
        r, c = rng.integers(0, window.rows, 6000), rng.integers(0, window.cols, 6000)
        known = np.isfinite(heights[r, c])
        r, c = r[known], c[known]
        xy = job.grid.map_from_pixel(np.column_stack([c + window.col0 + 0.5, r + window.row0 + 0.5]))
        expected, close = winners(job, xy, heights[r, c].astype(np.float64))
        model = np.broadcast_to(np.asarray(serving.model), heights.shape)[r, c]
        sees = np.broadcast_to(np.asarray(serving.sees), heights.shape)[r, c]
        assert close.mean() < 0.5
        assert np.mean(model[~close] == expected[~close]) > 0.999  # but for a pixel at a photograph's border
        assert (sees[model >= 0] == BOTH_SEE).all()
        assert (sees[model < 0] == 0).all()
        seen |= set(np.unique(model).tolist())
    assert seen == {-1, 0, 1, 2}
