"""Which photographs share unknowns of navigation: strips with their shifts and drifts, mounts of cameras."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stereomate.block.network import Attitudes, Positions

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class NavigationGroups:
    """Groups of the photographs of a block and what is unknown of each.

    Attributes
    ----------
    strip : ndarray of int, shape (n,)
        -1 for photographs of none.
    strip_names : tuple of str
    time : ndarray, shape (n,)
        Seconds where all photographs state them, else the number in the strip.
    time_unit : {"s", "photograph"}
    shift_sigma, drift_sigma : (float, float, float) or None
        Priors, metres and metres in a unit of time; infinite for none; None where nothing is unknown.
    mount : ndarray of int, shape (n,)
    mount_names : tuple of str
    lever_arm : ndarray, shape (mounts, 3)
        From the projection centre to the place that positions tell, camera axes.
    lever_arm_sigma : float
        0: they are right.
    boresight_sigma : float
        Radians; infinite for no prior, 0: there is none.
    """

    strip: Integers
    strip_names: tuple[str, ...]
    time: Array
    time_unit: str
    shift_sigma: tuple[float, float, float] | None
    drift_sigma: tuple[float, float, float] | None
    mount: Integers
    mount_names: tuple[str, ...]
    lever_arm: Array
    lever_arm_sigma: float = 0.0
    boresight_sigma: float = math.inf

    def positions(self, photos: Integers, known: Integers, xyz: Array, sigma: Array) -> Positions:
        """Observed positions of some photographs of a network.

        Parameters
        ----------
        photos : ndarray of int
            Photograph of the block for each of the network.
        known : ndarray of int, shape (g,)
            Of these, which have positions.
        xyz, sigma : ndarray, shape (g, 3)
        """
        mine = photos[known]
        nothing = (math.inf,) * 3
        return Positions(
            known,
            xyz,
            sigma,
            self.lever_arm[self.mount[mine]],
            self.strip[mine],
            self.time[mine],
            self.shift_sigma is not None,
            self.drift_sigma is not None,
            np.array(self.shift_sigma or nothing),
            np.full(3, self.lever_arm_sigma),
            np.array(self.drift_sigma or nothing),
            self.strip_names,
            self.mount[mine],
            self.mount_names,
        )

    def attitudes(self, photos: Integers, known: Integers, rotations: Array, sigma: Array) -> Attitudes:
        """Observed attitudes of some photographs of a network."""
        return Attitudes(
            known,
            rotations,
            sigma,
            self.boresight_sigma > 0.0,
            self.boresight_sigma or math.inf,
            self.mount[photos[known]],
            self.mount_names,
        )


def one_group(count: int, lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> NavigationGroups:
    """All photographs in one strip and one mount, nothing unknown but the boresight."""
    zeros = np.zeros(count, np.int64)
    return NavigationGroups(
        zeros, ("1",), np.arange(count, dtype=np.float64), "photograph", None, None, zeros, ("1",),
        np.array([lever_arm], dtype=np.float64),
    )  # fmt: skip


__all__ = ["NavigationGroups", "one_group"]
