"""Which parallax is removed at which point with which motion, and the factor that the tilt is given."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import InputError
from stereomate.relative.empirical.projectors import MOTIONS, Motion
from stereomate.relative.overcorrection import (
    corrected_overcorrection_factor,
    flat_overcorrection_factor,
    overcorrection_factor,
)

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Step:
    """Elimination of the y-parallax at a point with a motion."""

    point: str
    motion: Motion

    def __post_init__(self) -> None:
        if self.motion not in MOTIONS:
            raise InputError(f"must be one of {', '.join(MOTIONS)}", field="motion", value=self.motion)


@dataclass(frozen=True)
class Procedure:
    """One way of operating the instrument.

    Attributes
    ----------
    clearing : tuple of Step
        Eliminations in the order in which they are made, four in von Gruber's method.
    tilt : Step
        Where the remaining parallax is removed with a tilt, over-corrected.
    section : tuple of str
        Points of one cross-section, the corrected one last: the factor is computed from them.
    profiles : tuple of (str, str, str)
        If given, the tilt is the mean of those that the parallaxes of these cross-sections give directly (4),
        and no over-correction is made.
    """

    clearing: tuple[Step, ...]
    tilt: Step
    section: tuple[str, str, str]
    profiles: tuple[tuple[str, str, str], ...] = ()

    def __post_init__(self) -> None:
        motions = [step.motion for step in (*self.clearing, self.tilt)]
        if len(set(motions)) != len(motions):
            raise InputError("must use each motion once", field="procedure", value=motions)
        if not self.tilt.motion.startswith("omega"):
            raise InputError("must be omega1 or omega2", field="tilt motion", value=self.tilt.motion)
        if self.section[2] != self.tilt.point:
            raise InputError(
                f"must end with the over-corrected point {self.tilt.point}",
                field="section",
                value=self.section,
            )
        for section in (self.section, *self.profiles):
            if len(set(section)) != 3:
                raise InputError("must be three different points", field="section", value=section)

    @property
    def points(self) -> tuple[str, ...]:
        """Points that the procedure looks at, in order, each once."""
        names = [step.point for step in (*self.clearing, self.tilt)] + list(self.section)
        names += [name for profile in self.profiles for name in profile]
        return tuple(dict.fromkeys(names))

    @property
    def motions(self) -> tuple[Motion, ...]:
        """Motions that the procedure uses, the tilt last."""
        return tuple(step.motion for step in (*self.clearing, self.tilt))


def dependent_pair(moved: int = 2, corrected: str = "5") -> Procedure:
    """One projector moves, the other stays (joining a photograph to a finished model).

    Standard points: 1, 3, 5 under the left, 2, 4, 6 under the right projector; by and bz at those under the
    moved one, which its κ and φ do not touch.

    Parameters
    ----------
    moved : {2, 1}
        Projector that moves.
    corrected : {"5", "6", "3", "4"}
        Point at which the tilt is over-corrected; the other edge is cleared.
    """
    if moved not in (1, 2):
        raise InputError("must be 1 or 2", field="moved", value=moved)
    near, far = _edges(corrected)
    under, beside = (1, 0) if moved == 2 else (0, 1)
    centre = ("1", "2")
    clearing = (
        _step(centre[under], "by", moved),
        _step(centre[beside], "kappa", moved),
        _step(far[under], "bz", moved),
        _step(far[beside], "phi", moved),
    )
    return Procedure(clearing, _step(corrected, "omega", moved), _section(corrected, near, far))


def independent_pair(tilted: int = 2, corrected: str = "5") -> Procedure:
    """Both projectors turn, the base stays: κ and φ of each at the points under the other one.

    Parameters
    ----------
    tilted : {2, 1}
        Projector whose ω is used.
    corrected : {"5", "6", "3", "4"}
        Point at which the tilt is over-corrected.
    """
    if tilted not in (1, 2):
        raise InputError("must be 1 or 2", field="tilted", value=tilted)
    near, far = _edges(corrected)
    clearing = (
        _step("1", "kappa", 2),
        _step("2", "kappa", 1),
        _step(far[0], "phi", 2),
        _step(far[1], "phi", 1),
    )
    return Procedure(clearing, _step(corrected, "omega", tilted), _section(corrected, near, far))


@dataclass(frozen=True)
class Situation:
    """What is known when the over-correction factor has to be chosen.

    Attributes
    ----------
    cycle : int
        From 1.
    section : ndarray (3, 2)
        The cross-section by y, z, corrected point last.
    image_tangent : float
        Image ordinate over principal distance of the corrected point.
    history : tuple of (float, float)
        Factor and parallax p* of each cycle before.
    parallax : float
        p* now, in metres in the model.
    whole_factor : float
        n from the exact derivatives at all points of the procedure, wherever they lie.
    """

    cycle: int
    section: FloatArray
    image_tangent: float
    history: tuple[tuple[float, float], ...]
    parallax: float
    whole_factor: float


Rule = Callable[[Situation], float]


def flat_rule(situation: Situation) -> float:
    """n of flat terrain from the image ordinate of the corrected point (1)."""
    return float(flat_overcorrection_factor(1.0, situation.image_tangent))


def modified_rule(situation: Situation) -> float:
    """n of flat terrain first, then corrected by what each pass has left (2)."""
    if not situation.history:
        return flat_rule(situation)
    factor, first = situation.history[-1]
    if first == 0.0:
        return factor
    return corrected_overcorrection_factor(factor, first, situation.parallax)


def general_rule(situation: Situation) -> float:
    """n of the cross-section, any terrain (8)."""
    return float(overcorrection_factor(situation.section))


def whole_model_rule(situation: Situation) -> float:
    """n from the derivatives at all points: for points that form no cross-section, as round a lake."""
    return situation.whole_factor


def own_rule(factor: float) -> Rule:
    """A factor of one's own, the same in every cycle.

    Raises
    ------
    InputError
        If it is not finite.
    """
    if not math.isfinite(factor):
        raise InputError("must be finite", field="over-correction factor", value=factor)
    return lambda _: factor


RULES: Final[dict[str, Rule]] = {
    "flat": flat_rule,
    "modified": modified_rule,
    "general": general_rule,
    "whole": whole_model_rule,
}


def rule_of(text: str) -> Rule:
    """A rule by its name (flat, modified, general, whole), or a number as one's own factor.

    Raises
    ------
    InputError
        If it is neither.
    """
    if text in RULES:
        return RULES[text]
    try:
        factor = float(text)
    except ValueError:
        raise InputError(f"must be one of {', '.join(RULES)} or a number", field="rule", value=text) from None
    return own_rule(factor)


def _step(point: str, element: str, projector: int) -> Step:
    motion = next(name for name in MOTIONS if name == f"{element}{projector}")
    return Step(point, motion)


def _edges(corrected: str) -> tuple[tuple[str, str], tuple[str, str]]:
    if corrected in ("5", "6"):
        return ("5", "6"), ("3", "4")
    if corrected in ("3", "4"):
        return ("3", "4"), ("5", "6")
    raise InputError("must be 3, 4, 5 or 6", field="corrected", value=corrected)


def _section(corrected: str, near: tuple[str, str], far: tuple[str, str]) -> tuple[str, str, str]:
    side = near.index(corrected)
    return ("1", "2")[side], far[side], corrected
