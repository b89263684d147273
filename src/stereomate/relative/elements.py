"""The five elements of a relative orientation, dependent or independent pair, with their covariance.

Both describe one and the same estimate: the adjustment moves the base on the sphere and turns the right
camera by small steps, so that it works for any tilt; the elements and their covariance follow by exact
Jacobians.

- dependent pair: the left photograph is fixed, base (bx, by, bz), right camera Rx(omega) Ry(phi) Rz(kappa);
- independent pair: the base is the x axis, left camera Ry(phi1) Rz(kappa1), right camera
  Rx(omega2) Ry(phi2) Rz(kappa2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import NotDeterminedError
from stereomate.geometry.rotations import (
    opk_from_rotation,
    rotation_from_opk,
    rotation_x,
    rotation_y,
)
from stereomate.relative.kernels.pose import tangents
from stereomate.relative.pair import RelativePose

Array = NDArray[np.float64]

DEPENDENT = ("by", "bz", "omega", "phi", "kappa")
INDEPENDENT = ("phi1", "kappa1", "omega2", "phi2", "kappa2")


@dataclass(frozen=True)
class Elements:
    """Five elements with their covariance; angles in radians, base components in the unit of bx.

    Parameters
    ----------
    kind : {"dependent", "independent"}
        Which five.
    names : tuple of str
        ``by bz omega phi kappa`` or ``phi1 kappa1 omega2 phi2 kappa2``.
    values, covariance : ndarray, shape (5,) and (5, 5)
        Estimates and their covariance.
    """

    kind: Literal["dependent", "independent"]
    names: tuple[str, ...]
    values: Array
    covariance: Array

    @property
    def standard_deviations(self) -> Array:
        """Standard deviations, shape (5,)."""
        deviations: Array = np.sqrt(np.diag(self.covariance))
        return deviations

    @property
    def correlations(self) -> Array:
        """Correlation matrix, shape (5, 5)."""
        s = self.standard_deviations
        correlations: Array = self.covariance / np.outer(s, s)
        return correlations

    def __getitem__(self, name: str) -> float:
        return float(self.values[self.names.index(name)])


def pose_from_dependent(
    by: float, bz: float, omega: float, phi: float, kappa: float, bx: float = 1.0
) -> RelativePose:
    """Pose of a dependent pair; angles in radians, base components in one unit."""
    base = np.array([bx, by, bz], dtype=np.float64)
    return RelativePose(base / np.linalg.norm(base), rotation_from_opk([omega, phi, kappa]))


def pose_from_independent(
    phi1: float, kappa1: float, omega2: float, phi2: float, kappa2: float
) -> RelativePose:
    """Pose of an independent pair; angles in radians."""
    left = rotation_from_opk([0.0, phi1, kappa1])
    return RelativePose(left[0].copy(), left.T @ rotation_from_opk([omega2, phi2, kappa2]))


def dependent_elements(pose: RelativePose, covariance: Array, bx: float = 1.0) -> Elements:
    """By, bz, omega, phi, kappa for a base component bx of the given length.

    Parameters
    ----------
    pose : RelativePose
        The estimate.
    covariance : ndarray, shape (5, 5)
        Of the steps of `stereomate.relative.kernels.pose.move`.
    bx : float
        Any length; negative where the right photograph lies to the left.

    Raises
    ------
    NotDeterminedError
        If the base is perpendicular to the x axis, so that no by and bz belong to a bx.
    """
    b = pose.base
    if abs(b[0]) < 1e-6 or bx == 0.0:
        raise NotDeterminedError("bx is zero: the base is perpendicular to the x axis of the left photograph")
    factor = abs(bx) * math.copysign(1.0, b[0]) / b[0]
    angles = opk_from_rotation(pose.left_from_right)
    by_base = np.array([[-b[1] / b[0], 1.0, 0.0], [-b[2] / b[0], 0.0, 1.0]]) * factor
    jacobian = np.zeros((5, 5))
    jacobian[:2, :2] = by_base @ _tangents(b).T
    jacobian[2:, 2:] = np.linalg.inv(_axes(angles))
    values = np.concatenate([b[1:] * factor, angles])
    return Elements("dependent", DEPENDENT, values, jacobian @ covariance @ jacobian.T)


def independent_elements(pose: RelativePose, covariance: Array) -> Elements:
    """Phi1, kappa1, omega2, phi2, kappa2: the base is the x axis of the model.

    Raises
    ------
    NotDeterminedError
        If the base lies in the optical axis of the left camera, where kappa1 and omega2 are one.
    """
    b = pose.base
    across = math.hypot(b[0], b[1])
    if across < 1e-6:
        raise NotDeterminedError("kappa1: the base lies in the optical axis of the left photograph")
    # The first row of Ry(phi1) Rz(kappa1) is the base in the left camera.
    phi1, kappa1 = math.atan2(b[2], across), math.atan2(-b[1], b[0])
    model_from_left = rotation_from_opk([0.0, phi1, kappa1])
    angles = opk_from_rotation(model_from_left @ pose.left_from_right)
    left_axes = np.stack([[0.0, 1.0, 0.0], rotation_y(phi1)[:, 2]], axis=1)
    # Turning the left camera moves the base and turns the right camera the other way, in the left frame.
    forward = np.zeros((5, 5))
    moved = -np.cross(left_axes, np.array([1.0, 0.0, 0.0]), axis=0)
    forward[:2, :2] = _tangents(b) @ model_from_left.T @ moved
    forward[2:, :2] = -model_from_left.T @ left_axes
    forward[2:, 2:] = model_from_left.T @ _axes(angles)
    jacobian = np.linalg.inv(forward)
    values = np.concatenate([[phi1, kappa1], angles])
    return Elements("independent", INDEPENDENT, values, jacobian @ covariance @ jacobian.T)


def _tangents(base: Array) -> Array:
    out = np.empty((2, 3))
    tangents(np.array(base), out)
    return out


def _axes(opk: Array) -> Array:
    """Rotation vector of small changes of omega, phi, kappa, in the outer axes; shape (3, 3)."""
    outer = rotation_x(opk[0])
    return np.stack([[1.0, 0.0, 0.0], outer[:, 1], (outer @ rotation_y(opk[1]))[:, 2]], axis=1)
