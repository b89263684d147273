"""What a run of the instrument leaves behind: the operator's notes and the parallaxes after each cycle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from stereomate.relative.empirical.procedure import Procedure
from stereomate.relative.empirical.projectors import Motion, PlotterModel, Setting

FloatArray = NDArray[np.float64]
Kind = Literal["clear", "over-correct", "profiles"]
Outcome = Literal["cleared", "converging", "diverging", "critical", "lost"]


@dataclass(frozen=True)
class StepNote:
    """One line of the operator's notes; metres and radians.

    Attributes
    ----------
    cycle, round : int
        From 1; the round counts the repetitions of the clearing steps before or after one tilt.
    kind : {"clear", "over-correct", "profiles"}
    point : str
        Where the parallax was looked at; for profiles their points.
    motion : str
    parallax_before, parallax_after : float
        At the point; after an over-correction it is not zero.
    value_before, value_after : float
        Scale readings of the motion.
    removing_value : float
        Reading that would have removed the parallax: where an over-correction starts counting.
    factor : float or None
        n, for an over-correction.
    """

    cycle: int
    round: int
    kind: Kind
    point: str
    motion: Motion
    parallax_before: float
    parallax_after: float
    value_before: float
    value_after: float
    removing_value: float
    factor: float | None = None


@dataclass(frozen=True)
class EmpiricalRun:
    """What came of it.

    Attributes
    ----------
    model : PlotterModel
    procedure : Procedure
    notes : tuple of StepNote
    settings : tuple of Setting
        At the start and after each cycle.
    parallaxes : ndarray (cycles + 1, n)
        y-parallaxes of all points of the model at the start and after each cycle.
    outcome : str
        ``cleared``; ``converging`` or ``diverging`` when the cycles are used up; ``critical`` when the points
        do not determine the tilt; ``lost`` when a step could not be made.
    reason : str
        One sentence to the outcome.
    tilt_amplification : float
        n at the end from the exact derivatives: how much of a remaining parallax the tilt error is.
    """

    model: PlotterModel
    procedure: Procedure
    notes: tuple[StepNote, ...]
    settings: tuple[Setting, ...]
    parallaxes: FloatArray
    outcome: Outcome
    reason: str
    tilt_amplification: float

    @property
    def setting(self) -> Setting:
        """The setting at the end."""
        return self.settings[-1]

    @property
    def largest(self) -> tuple[float, ...]:
        """Largest size of the procedure's y-parallaxes at the start and after each cycle, metres."""
        rows = [self.model.index(name) for name in self.procedure.points]
        return tuple(float(value) for value in np.abs(self.parallaxes[:, rows]).max(axis=1))
