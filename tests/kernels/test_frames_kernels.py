"""Kernels of the frames: their edges, to be run with numba's bounds checks too."""

import numpy as np

from stereomate.frames import kernels

A, E2 = 6378137.0, 0.00669438002290


def test_geodetic_at_poles_equator_and_date_line():
    lon = np.array([0.0, 180.0, -180.0, 90.0, 12.0])
    lat = np.array([90.0, -90.0, 0.0, 0.0, 89.9999999])
    points = np.stack([lon, lat, np.array([0.0, -100.0, 9000.0, 5.0, 1.0])])
    ecef, back = np.empty((3, 5)), np.empty((3, 5))
    kernels.geocentric_from_geodetic(points, A, E2, ecef)
    kernels.geodetic_from_geocentric(ecef, A, E2, back)
    np.testing.assert_allclose(back[1:], points[1:], rtol=0, atol=5e-9)
    np.testing.assert_allclose(np.cos(np.deg2rad(back[0, 2:] - lon[2:])), 1.0, atol=1e-12)


def test_grid_values_at_the_last_node_and_outside():
    values = np.arange(12.0).reshape(3, 4)
    lon = np.array([10.0, 13.0, 13.0, 10.0, 11.5, 9.9, 13.1, np.nan])
    lat = np.array([50.0, 50.0, 48.0, 48.0, 49.0, 50.0, 50.0, 49.0])
    out = np.empty(8)
    kernels.grid_values(values, 10.0, 50.0, 1.0, 1.0, lon, lat, out)
    np.testing.assert_allclose(out[:5], (0.0, 3.0, 11.0, 8.0, 5.5))
    assert np.isnan(out[5:]).all()


def test_collinearity_difference_behind_the_camera_is_nan():
    centres, rotations = np.zeros((1, 3)), np.eye(3)[None].copy()
    points = np.array([[1.0, 2.0, -10.0], [1.0, 2.0, 10.0], [1.0, 2.0, 0.0]])
    index, photo = np.arange(3), np.zeros(3, dtype=np.int64)
    out = np.empty((3, 2))
    shifted = points + np.array([0.5, 0.0, 0.0])
    kernels.collinearity_difference(
        shifted, points, index, photo, centres, rotations, centres, rotations, np.array([100.0]), out
    )
    np.testing.assert_allclose(out[0], (5.0, 0.0), atol=1e-12)
    assert np.isnan(out[1:]).all()
