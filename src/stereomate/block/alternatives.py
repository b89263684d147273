"""Gross errors that a test cannot place: which sets of observations of a point explain what was found.

The largest standardized residual of a point need not be the one that is wrong: along the base three rays of
one strip contradict each other in one number only, and a wrong height of a control point can look like a
wrong ray. So every small set of observations is tried with the photographs as they are: the smallest that
explains the contradiction replaces what was taken out, and where several sets are about as likely all
of them stay out. A good observation lost costs little, a bad one kept costs a point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from stereomate.block.equations import camera_arrays
from stereomate.block.kernels import alternatives as kernels
from stereomate.block.kernels.structure import order_by
from stereomate.block.loop import Solution, outside_photographs
from stereomate.block.network import Network

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

_LARGEST_SET: Final = 3
# Another set is told from the best one if it is less than a twentieth as likely.
_DOUBT: Final = 2.0 * math.log(20.0)
_DEGREES: Final = 200


@dataclass(frozen=True, eq=False)
class Explained:
    """What to leave out of some points.

    Attributes
    ----------
    points : ndarray of int, shape (t,)
        Those whose contradictions are explained.
    in_doubt : ndarray of bool, shape (t,)
        Whether there is more than one explanation.
    rays : ndarray of bool, shape (m,)
        Image observations to leave out, of these points; with those that never take part.
    axes : ndarray of bool, shape (k, 3)
        Coordinates of control points to leave out.
    """

    points: Integers
    in_doubt: Mask
    rays: Mask
    axes: Mask


def explain(
    network: Network, solution: Solution, out: tuple[Mask, Mask], scales: Array, alpha: float
) -> Explained:
    """Explanations of the contradictions in points that have observations `out`.

    Parameters
    ----------
    network : Network
        With all observations.
    solution : Solution
        Where the photographs are.
    out : ndarrays of bool, shape (m,) and (k, 3)
        Image observations and coordinates of control that were taken out of the points in question.
    scales : ndarray, shape (m,)
        Standard deviations of image points over those stated.
    alpha : float
        Of the test of one observation.
    """
    image, control = network.image, network.control
    p, m = len(network.points.names), len(image.photo)
    order = np.arange(m)
    start = order_by(image.point, p, order)
    weight = 1.0 / (image.sigma * scales[:, None]) ** 2
    weight[outside_photographs(network) | solution.lonely[image.photo]] = 0.0
    rows, known, known_weight, removable = _control(network)
    eligible = weight[:, 0] > 0.0
    count = np.bincount(image.point[out[0] & eligible], minlength=p)
    if control is not None:
        np.add.at(count, control.point, out[1].sum(axis=1))
    points = np.flatnonzero(count)
    # An explanation has to be possible, not good: what is left to find the next pass finds.
    limits = np.append(math.inf, chi2.isf(alpha**2, np.arange(1, _DEGREES)))
    cameras = camera_arrays(solution.prepared, solution.state)
    rays, axes = np.zeros(m, np.bool_), np.zeros(known.shape, np.bool_)
    found = np.zeros(len(points), np.int64)
    kernels.explain(
        points, np.minimum(count[points], _LARGEST_SET), start, order, image.photo, image.xy, weight,
        network.photographs.camera, cameras.model, cameras.packed, solution.state.centres,
        solution.state.rotations, solution.state.points, rows, known, known_weight, removable, limits, _DOUBT,
        rays, axes, found,
    )  # fmt: skip
    size = np.bincount(image.point[rays], minlength=p)
    if control is not None:
        np.add.at(size, control.point, axes.sum(axis=1))
    explained = found > 0
    rays |= ~eligible
    return Explained(points[explained], (size[points] > found)[explained], rays, axes)


def _control(network: Network) -> tuple[Integers, Array, Array, Mask]:
    """Row of each point, coordinates, weights, and which of them may be wrong; held ones may not."""
    rows = np.full(len(network.points.names), -1, np.int64)
    control = network.control
    if control is None or not len(control.point):
        return rows, np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3), np.bool_)
    assert control.check is not None
    rows[control.point[~control.check]] = np.flatnonzero(~control.check)
    sigma: Array = control.sigma
    if control.covariance is not None:
        own = np.sqrt(np.diagonal(control.covariance, axis1=1, axis2=2))
        sigma = np.where(np.isfinite(own), own, sigma)
    known = np.isfinite(sigma)
    held = np.where(sigma == 0.0, 1e-6, sigma)
    return rows, np.where(known, control.xyz, 0.0), 1.0 / held**2, known & (sigma > 0.0)
