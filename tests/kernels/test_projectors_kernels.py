"""The kernel of the two projectors, also run with bounds checks."""

from __future__ import annotations

import numpy as np

from stereomate.geometry.rotations import rotation_from_opk
from stereomate.relative.kernels import projectors as kernels


def test_rotation_is_the_conventional_one():
    v = np.array([0.3, -0.7, -1.2])
    np.testing.assert_allclose(
        kernels.rotate(0.1, -0.2, 0.3, v), rotation_from_opk([0.1, -0.2, 0.3]) @ v, rtol=1e-14
    )


def test_vertical_pair():
    left = np.array([[0.0, 0.5, -1.0], [0.2, 0.0, -1.0], [-0.5, 0.0, -1.0]])
    right = np.array([[-0.5, 0.5, -1.0], [-0.3, 0.01, -1.0], [0.5, 0.0, -1.0]])
    setting = np.zeros(11)
    setting[10] = 600.0
    points, jacobian = np.empty((3, 4)), np.empty((3, 10))
    kernels.measure(left, right, setting, points, jacobian)
    np.testing.assert_allclose(points[0], [0.0, 0.0, 600.0, -1200.0], atol=1e-9)
    np.testing.assert_allclose(points[1], [-12.0, 240.0, 6.0, -1200.0], atol=1e-9)
    # by, bz, ω, φ, κ of the left, of the right projector at a point 600 m aside and 1200 m below it.
    np.testing.assert_allclose(jacobian[0, :5], [1.0, 0.5, 1500.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(jacobian[0, 5:], [-1.0, -0.5, -1500.0, -300.0, 600.0], atol=1e-9)
    assert np.isnan(points[2]).all()
    assert np.isnan(jacobian[2]).all()
