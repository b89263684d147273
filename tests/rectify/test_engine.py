"""Positions of the engine against an independent exact computation, and what the products promise."""

from dataclasses import replace

import numpy as np
import pyproj
import pytest
from rectify_scenes import CAMERA, CENTRE, GROUND, height_model, hills, make_job

from stereomate.raster import Window
from stereomate.rectify.engine import orthophoto_part, rectify_window, stereomate_part
from stereomate.rectify.grid import ProductGrid
from stereomate.rectify.ground import ground_of, heights_of, mate_positions, shown_ground
from stereomate.rectify.kernels.warp import warp
from stereomate.rectify.serving import camera_nodes

NONE = np.empty((0, 0), np.uint16)


def exact_pixels(job, p, xy, h):
    """Photograph position of map points: PROJ to ECEF, collinearity and Brown written out here."""
    to_geo = pyproj.Transformer.from_crs("EPSG:25832", "EPSG:4258", always_xy=True)
    lon, lat = to_geo.transform(xy[:, 0], xy[:, 1])
    geo_ecef = pyproj.Transformer.from_crs("EPSG:4937", "EPSG:4936", always_xy=True)
    points = np.column_stack(geo_ecef.transform(lon, lat, h))
    t = job.tangent
    lon0, lat0 = np.radians([t.longitude_deg, t.latitude_deg])
    enu = np.array(
        [
            [-np.sin(lon0), np.cos(lon0), 0],
            [-np.sin(lat0) * np.cos(lon0), -np.sin(lat0) * np.sin(lon0), np.cos(lat0)],
            [np.cos(lat0) * np.cos(lon0), np.cos(lat0) * np.sin(lon0), np.sin(lat0)],
        ]
    )
    origin = np.array(geo_ecef.transform(t.longitude_deg, t.latitude_deg, t.height_m))
    tangent = (points - origin) @ enu.T
    o = job.photographs[p].orientation
    camera = (tangent - np.array(o.centre)) @ o.object_from_camera
    # OpenCV's Brown in axes x right, y down
    x, y = camera[:, 0] / -camera[:, 2], -camera[:, 1] / -camera[:, 2]
    d = CAMERA.distortion
    s = x * x + y * y
    radial = 1 + d.k1 * s + d.k2 * s * s
    xd = x * radial + 2 * d.p1 * x * y + d.p2 * (s + 2 * x * x)
    yd = y * radial + d.p1 * (s + 2 * y * y) + 2 * d.p2 * x * y
    col = 750.0 + (xd * 60.0 + 0.02) / 0.036
    row = 600.0 + (yd * 60.0 + 0.03) / 0.036
    return np.column_stack([col, row])


def bilinear_height(x, y, cell=10.0, size=260):
    """Bilinear interpolation of `hills` sampled as `height_model` does, written out here."""
    first = -0.5 * size * cell
    c, r = (x - first) / cell - 0.5, (-y - first) / cell - 0.5
    j, i = np.floor(c).astype(int), np.floor(r).astype(int)
    node = lambda jj, ii: hills(first + (jj + 0.5) * cell, -(first + (ii + 0.5) * cell))  # noqa: E731
    fx, fy = c - j, r - i
    top = node(j, i) * (1 - fx) + node(j + 1, i) * fx
    bottom = node(j, i + 1) * (1 - fx) + node(j + 1, i + 1) * fx
    return top * (1 - fy) + bottom * fy


def warped(job, ground, window, columns, heights, p):
    nodes = camera_nodes(job, ground)[p]
    code, parameters = job.photographs[p].camera.kernel_parameters()
    x, y = np.empty(heights.shape, np.float32), np.empty(heights.shape, np.float32)
    valid = np.empty(heights.shape, np.uint8)
    lat = ground.lattice
    warp(
        columns, heights, NONE, 0, nodes, lat.col0 - window.col0, lat.row0, lat.step, float(window.row0),
        code, parameters, 1.0, 750.0, 600.0, x, y, valid,
    )  # fmt: skip
    return np.stack([x + 750.5, y + 600.5], axis=-1), valid != 0


@pytest.mark.parametrize("rotation", [0.0, 0.35])
def test_orthophoto_positions_are_exact_to_a_hundredth_of_a_pixel(rotation):
    job = make_job(rotation=rotation)
    window = Window(37, 51, 700, 600)
    ground = ground_of(job, window)
    heights = heights_of(job, ground, "test").copy()
    columns = np.arange(window.cols, dtype=np.float32)[None] + np.float32(0.5)
    found, valid = warped(job, ground, window, columns, heights, 0)
    rng = np.random.default_rng(1)
    r, c = rng.integers(0, window.rows, 500), rng.integers(0, window.cols, 500)
    xy = job.grid.map_from_pixel(np.column_stack([c + window.col0 + 0.5, r + window.row0 + 0.5]))
    h = bilinear_height(*(xy - CENTRE).T)
    np.testing.assert_allclose(heights[r, c], h, atol=2e-3)
    expected = exact_pixels(job, 0, xy, h)
    inside = (expected > 0).all(axis=1) & (expected < [1500, 1200]).all(axis=1)
    assert inside.sum() > 300
    np.testing.assert_array_equal(valid[r, c], inside)
    assert np.abs(found[r, c] - expected)[inside].max() < 0.01


@pytest.mark.parametrize("law", ["logarithmic", "linear", "natural"])
@pytest.mark.parametrize("rotation", [0.0, -0.4])
def test_stereomate_inverts_the_rows_of_the_true_surface(law, rotation):
    job = make_job(rotation=rotation, law=law)
    window = Window(20, 30, 500, 300)
    ground = shown_ground(job, window)
    columns, heights, folds = mate_positions(job, window, ground)
    assert folds == 0
    known = np.isfinite(columns)
    assert known.mean() > 0.95
    r, c = np.nonzero(known)
    pixels = np.column_stack([columns[r, c] + window.col0, r + window.row0 + 0.5])
    xy = job.grid.map_from_pixel(pixels)
    h = bilinear_height(*(xy - CENTRE).T)
    u = columns[r, c] - job.law.q(h) / job.grid.gsd
    # 0.004 px of bend that is not followed, float32 columns
    assert np.abs(u - (c + 0.5)).max() < 0.005
    np.testing.assert_allclose(heights[r, c], h, atol=0.01)


def test_parallax_is_positive_for_high_ground_and_left_is_the_smaller_u(tmp_path):
    job = make_job(tmp_path)
    ortho, mate = rectify_window(job, Window(0, 0, 300, 200))
    assert set(np.unique(ortho.photograph)) <= {0, 1}
    assert set(np.unique(mate.photograph)) <= {0, 2}
    assert (job.law.q(GROUND + 50.0) - job.law.q(GROUND)) > 0


def test_windows_of_any_cut_give_the_same_pixels(tmp_path):
    job = make_job(tmp_path)
    whole = Window(100, 100, 400, 300)
    parts = [Window(100, 100, 150, 300), Window(250, 100, 250, 120), Window(250, 220, 250, 180)]
    for make in (lambda j, w: orthophoto_part(j, w, "left"), stereomate_part):
        expected = make(job, whole).pixels.astype(int)
        for w in parts:
            got = make(job, w).pixels.astype(int)
            part = expected[w.row0 - 100 : w.row1 - 100, w.col0 - 100 : w.col1 - 100]
            # White noise: a position that differs in the last bits of float32 may move a value a little.
            assert np.mean(got == part) > 0.98


def test_voids_stay_voids(tmp_path):
    model = height_model()
    holes = model.patch(0, 0, 260, 260).heights.copy()
    holes[100:140, 120:150] = np.nan
    job = make_job(tmp_path, heights=type(model).from_array(holes, model.affine, model.frame))
    ortho, mate = rectify_window(job, Window(0, 0, *job.grid.size))
    ground = ground_of(job, Window(0, 0, *job.grid.size))
    void = np.isnan(heights_of(job, ground, "void"))
    assert void.sum() > 1000
    assert not ortho.valid[void].any()
    assert (ortho.pixels[void] == 0).all()
    assert (mate.valid == 0).sum() >= void.sum() * 0.8


def test_hidden_ground_is_masked_filled_or_kept(tmp_path):
    def wall(x, y):
        return GROUND + np.where(np.abs(x) < 15.0, 120.0, 0.0) + 0.0 * y

    heights = height_model(5.0, wall, 400)
    parts = {}
    for hidden in ("keep", "nodata", "fill"):
        job = make_job(tmp_path, heights=heights)
        job = replace(job, options=replace(job.options, hidden=hidden))
        part = orthophoto_part(job, Window(0, 0, *job.grid.size), "left")
        parts[hidden] = (part.valid != 0).copy(), part.photograph.copy(), job.grid
    keep, nodata = parts["keep"][0], parts["nodata"][0]
    grid: ProductGrid = parts["keep"][2]
    row = grid.size[1] // 2
    cols = np.arange(grid.size[0])
    x = grid.map_from_pixel(np.column_stack([cols + 0.5, np.full(cols.size, row + 0.5)]))[:, 0] - CENTRE[0]
    # The left centre stands 250 m west of the wall, 1000 m above: behind its top edge at x = 15
    # (top 120 m) the shadow reaches x = 15 + (250 + 15) * 120 / (1000 - 120).
    end = 15.0 + 265.0 * 120.0 / 880.0
    shadow = (x > 22.0) & (x < end - 3.0)
    clear = ((x > end + 3.0) & (x < 200.0)) | ((x < -22.0) & (x > -200.0))
    assert keep[row][shadow].all()
    assert not nodata[row][shadow].any()
    assert nodata[row][clear].all()


def test_grids_of_the_four_windows_share_the_lattice_of_their_product():
    job = make_job()
    a = ground_of(job, Window(0, 0, 512, 512)).lattice
    b = ground_of(job, Window(512, 0, 512, 512)).lattice
    assert a.step == b.step
    assert (b.col0 - a.col0) % a.step == 0
