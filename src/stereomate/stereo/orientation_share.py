"""The part of a point's covariance that comes from the orientations of its two photographs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.coverage.covariance import OrientationCovariance
from stereomate.rectify.job import RectifyJob

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def covariances_of(
    job: RectifyJob, photographs: Ints, stated: tuple[float, float], known: OrientationCovariance | None
) -> Floats | None:
    """Covariances of the left and the right orientation of each point.

    Parameters
    ----------
    photographs : ndarray of int (n, 2)
        Indices into those of the job, -1 for none.
    stated : (float, float)
        Standard deviations of all centres (m) and all rotations (rad), independent of each other; both 0
        where none are stated.
    known : OrientationCovariance, optional
        Taken where none are stated.

    Returns
    -------
    ndarray (n, 12, 12) or None
        None where nothing is stated or known; NaN for points whose photographs are not known together.
    """
    variances = np.tile(np.repeat(np.square(stated), 3), 2)
    if variances.any():
        return np.broadcast_to(np.diag(variances), (len(photographs), 12, 12))
    if known is None:
        return None
    pairs, index = np.unique(photographs, axis=0, return_inverse=True)
    names = [photograph.name for photograph in job.photographs]
    matrices = [
        known.of_pair(names[a], names[b]) if min(a, b) >= 0 else np.full((12, 12), np.nan)
        for a, b in pairs.tolist()
    ]
    return np.array(matrices).reshape(-1, 12, 12)[index.ravel()]


def orientation_share(jacobians: tuple[Floats, Floats], covariances: Floats | None) -> Floats:
    """Share (n, 3, 3) of orientations in points that change with them by `jacobians`, (n, 3, 6) each."""
    by = np.concatenate(jacobians, axis=2)
    if covariances is None:
        return np.zeros((len(by), 3, 3))
    return np.asarray(by @ covariances @ np.swapaxes(by, 1, 2))
