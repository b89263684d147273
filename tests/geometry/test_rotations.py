import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stereomate.geometry import rotations as rot

angles = st.tuples(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))


@settings(deadline=None)
@given(angles)
def test_angles_and_quaternions_are_inverses(opk):
    r = rot.rotation_from_opk(opk)
    np.testing.assert_allclose(r @ r.T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(rot.rotation_from_opk(rot.opk_from_rotation(r)), r, atol=1e-12)
    np.testing.assert_allclose(rot.rotation_from_pok(rot.pok_from_rotation(r)), r, atol=1e-12)
    np.testing.assert_allclose(rot.rotation_from_quaternion(rot.quaternion_from_rotation(r)), r, atol=1e-12)


def test_omega_turns_y_into_z():
    np.testing.assert_allclose(rot.rotation_from_opk([np.pi / 2, 0, 0]) @ [0, 1, 0], [0, 0, 1], atol=1e-15)


def test_kappa_is_applied_first():
    r = rot.rotation_from_opk([0.3, 0.2, 0.1])
    expected = rot.rotation_x(0.3) @ rot.rotation_y(0.2) @ rot.rotation_z(0.1)
    np.testing.assert_array_equal(r, expected)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_at_and_near_gimbal_lock_the_matrix_comes_back(sign):
    # An arcsine would lose half the digits here: an angle of 1.5e-8 out of a rounding of 1e-16.
    rng = np.random.default_rng(1)
    outer, inner = rng.uniform(-3.0, 3.0, (2, 2000))
    middle = sign * np.pi / 2 * (1.0 - 10.0 ** rng.uniform(-17.0, -3.0, 2000))
    angles = np.stack([outer, middle, inner], axis=-1)
    for matrix, inverse in (
        (rot.rotation_from_opk, rot.opk_from_rotation),
        (rot.rotation_from_pok, rot.pok_from_rotation),
    ):
        r = matrix(angles)
        np.testing.assert_allclose(matrix(inverse(r)), r, rtol=0, atol=1e-11)


@pytest.mark.parametrize("length", [0.0, 1e-12, 1e-5, 1.0, 3.0])
def test_rotation_vector_and_angle(length):
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    assert rot.rotation_angle(rot.rotation_from_vector(length * axis)) == pytest.approx(
        length, abs=1e-15, rel=1e-12
    )


def test_vectorised_shapes():
    opk = np.zeros((4, 5, 3))
    assert rot.rotation_from_opk(opk).shape == (4, 5, 3, 3)
    assert rot.quaternion_from_rotation(rot.rotation_from_opk(opk)).shape == (4, 5, 4)
