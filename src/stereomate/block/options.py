"""Options of the bundle adjustment."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from stereomate.errors import InputError


@dataclass(frozen=True)
class TestOptions:
    """Statistical tests.

    Parameters
    ----------
    alpha : float
        Probability to reject one good observation (two-sided).
    power : float
        Probability to find an error of the size of the minimal detectable one.
    alpha_global : float
        Probability to reject a good adjustment by its sigma0.
    """

    __test__ = False

    alpha: float = 0.001
    power: float = 0.80
    alpha_global: float = 0.01

    def __post_init__(self) -> None:
        for name in ("alpha", "power", "alpha_global"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise InputError("must be between 0 and 1", field=f"tests.{name}", value=getattr(self, name))


@dataclass(frozen=True)
class BlockOptions:
    """How a block is adjusted.

    Parameters
    ----------
    max_iterations : int
    relative_tolerance : float
        The loop ends when a step promises to lower the weighted sum of squares by less than this part of it.
    robust : {"none", "huber", "snooping", "l1"}
        ``huber``: image points weighted down beyond `huber_width` standard deviations, all stay in.
        ``snooping``: the same to start with, then gross errors are taken out one after the other by the test
        of their standardized residuals, in all kinds of observations.
        ``l1``: the sum of the absolute standardized residuals of all kinds is made small, what stands out
        of that goes at once, and snooping ends it. For many gross errors, also in control and positions.
    huber_width : float
    free_network : {"none", "auto", "always"}
        Inner constraints over photographs and points in place of a datum: ``auto`` if there is none.
    statistics : bool
        Covariances, redundancy numbers and what follows from them.
    scale_by : {"estimated", "prior"}
        Standard deviations from the estimated sigma0 or from 1.
    tests : TestOptions
    """

    max_iterations: int = 50
    relative_tolerance: float = 1e-12
    robust: Literal["none", "huber", "snooping", "l1"] = "none"
    huber_width: float = 2.0
    free_network: Literal["none", "auto", "always"] = "auto"
    statistics: bool = True
    scale_by: Literal["estimated", "prior"] = "estimated"
    tests: TestOptions = field(default_factory=TestOptions)

    def __post_init__(self) -> None:
        if self.max_iterations < 1:
            raise InputError("must be positive", field="max_iterations", value=self.max_iterations)
        if not self.relative_tolerance > 0.0:
            raise InputError("must be positive", field="relative_tolerance", value=self.relative_tolerance)
        if not self.huber_width > 0.0:
            raise InputError("must be positive", field="huber_width", value=self.huber_width)
        for name, choices in (
            ("robust", ("none", "huber", "snooping", "l1")),
            ("free_network", ("none", "auto", "always")),
            ("scale_by", ("estimated", "prior")),
        ):
            if getattr(self, name) not in choices:
                raise InputError(
                    f"must be one of {', '.join(choices)}", field=name, value=getattr(self, name)
                )
