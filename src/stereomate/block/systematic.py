"""Systematic effects: a common shift of the observed positions, and what it looks like.

Centres that come from an adjustment in the map grid carry the plane scale in their heights: equation (2) of
Ressl (2002), ``(τ_e - 1)(H_centre - H_control)`` (georeferencing theory, section 9). Taken as true positions
together with control they show up as a shift in height of just this size.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from stereomate.block.adjustment import BlockAdjustment, adjust_block
from stereomate.errors import InputError, NotDeterminedError
from stereomate.frames.adjusted import grid_height_excess_m
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_tangent

Array = NDArray[np.float64]

# What a prediction leaves of a shift, at most, to be named as its likely cause: image errors that go together
# move heights by a few standard deviations too.
_LEFT: Final = 1.0 / 3.0


@dataclass(frozen=True, eq=False)
class SystematicShift:
    """A shift common to all observed positions.

    Attributes
    ----------
    shift, sigma : ndarray, shape (3,)
        Observed minus adjusted positions and its standard deviation: east, north, up, metres.
    significant : ndarray of bool, shape (3,)
        At the level of the tests of the adjustment.
    grid_excess_m : float
        What equation (2) predicts for the height.
    cause : str
        The likely cause in words; empty if nothing is significant.
    adjustment : BlockAdjustment
        With the shift as an unknown.
    """

    shift: Array
    sigma: Array
    significant: NDArray[np.bool_]
    grid_excess_m: float
    cause: str
    adjustment: BlockAdjustment


def find_systematic_shift(
    adjustment: BlockAdjustment, tangent: TangentFrame, frame: MapFrame
) -> SystematicShift:
    """Adjust again with a common shift of the positions, and judge it.

    Parameters
    ----------
    adjustment : BlockAdjustment
        With positions and with control that has heights.
    tangent : TangentFrame
        That of the network.
    frame : MapFrame
        Map and heights the positions were delivered in.

    Raises
    ------
    InputError
        If there are no positions or no control: nothing to see a shift by.
    NotDeterminedError
        If the adjustment with the shift does not converge.
    """
    network, options = adjustment.network, adjustment.options
    positions, control = network.positions, network.control
    if positions is None or control is None or control.check is None or control.check.all():
        raise InputError("must hold positions and control points", field="network")
    strips = np.zeros(len(positions.photo), np.int64)
    no_prior = np.full(3, math.inf)
    shifted = replace(positions, strip=strips, strip_names=(), shift=True, shift_sigma=no_prior, drift=False)
    again = adjust_block(replace(network, positions=shifted), replace(options, statistics=True))
    statistics = again.statistics
    if statistics is None:
        raise NotDeterminedError("shift of the positions: the adjustment with it does not converge")
    at = again.shared_names.index("strip 0: shift x")
    shift, sigma = again.shared[at : at + 3], statistics.shared_sigma[at : at + 3]
    significant = np.abs(shift) > norm.isf(options.tests.alpha / 2.0) * sigma
    use = ~control.check & np.isfinite(control.sigma[:, 2])
    centres = map_from_tangent(tangent, frame, again.centres)
    ground = map_from_tangent(tangent, frame, again.points[control.point[use]])
    excess = 0.0
    if use.any() and not frame.is_geographic:
        excess = float(np.mean(grid_height_excess_m(frame, centres, float(ground[:, 2].mean()))))
    cause = ""
    left = float(shift[2] - excess)
    if significant[2] and abs(left) <= max(_LEFT * abs(shift[2]), 3.0 * float(sigma[2])) < abs(shift[2]):
        cause = (
            f"the heights of the positions differ by {shift[2]:+.3f} m, and "
            f"(tau_e - 1)(H_centre - H_control), equation (2) of Ressl (2002), is {excess:+.3f} m: "
            "the positions probably come from an adjustment in the map grid; it leaves "
            f"{left:+.3f} m, {abs(left) / sigma[2]:.1f} standard deviations"
        )
    elif significant.any():
        cause = "not known: a vertical datum, a lever arm, or a principal distance not held in flight"
    return SystematicShift(shift, sigma, significant, excess, cause, again)
