"""Operating the instrument: cycles of eliminations and one over-corrected tilt, noted step by step."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import InputError, NotDeterminedError
from stereomate.relative.empirical.procedure import Procedure, Rule, Situation, Step, general_rule
from stereomate.relative.empirical.projectors import (
    ANGLES,
    PlotterModel,
    Setting,
    model_points,
    parallax_jacobian,
    y_parallaxes,
)
from stereomate.relative.empirical.record import EmpiricalRun, Kind, Outcome, StepNote
from stereomate.relative.overcorrection import tilt_from_parallaxes

FloatArray = NDArray[np.float64]

_LARGEST_TURN = math.radians(60.0)
_NEWTON_STEPS = 40
# A parallax below this part of the flying height is none.
_ROUNDING = 1e-11
# A thousandth of what a motion plainly does is second-order influence, which no operator would use.
_LEAST_EFFECT = 1e-3


@dataclass(frozen=True)
class EmpiricalOptions:
    """How the instrument is operated.

    Attributes
    ----------
    cycles : int
        Cycles to make.
    rounds : int
        Largest number of rounds of the clearing steps, before the tilt and after it. A round leaves what its
        motions do to each other's points: second-order effects of the tilts, first-order ones where points 1
        and 2 are off the nadirs. It is repeated until all its points are free of parallax.
    parallax_std : float
        Standard deviation in metres in the model of every elimination and reading; 0: an exact operator.
    seed : int
        Of its random errors.
    given_section : array_like, shape (3, 2), optional
        The cross-section known from a map or the previous model; else it is read from the model as it stands.
    cleared_ratio : float
        Largest parallax over flying height that counts as cleared: 1e-5 is 1.5 µm in a 15 cm photograph.
    critical_factor : float
        Size of n above which the tilt counts as not determined.
    """

    cycles: int = 4
    rounds: int = 10
    parallax_std: float = 0.0
    seed: int = 0
    given_section: ArrayLike | None = None
    cleared_ratio: float = 1e-5
    critical_factor: float = 200.0

    def __post_init__(self) -> None:
        for name in ("cycles", "rounds"):
            if getattr(self, name) < 1:
                raise InputError("must be 1 or more", field=name, value=getattr(self, name))
        if not (math.isfinite(self.parallax_std) and self.parallax_std >= 0.0):
            raise InputError("must be finite and not negative", field="parallax_std", value=self.parallax_std)


def eliminate(model: PlotterModel, setting: Setting, step: Step, target: float = 0.0) -> Setting:
    """The setting with the y-parallax at the step's point brought to `target` with its motion alone.

    Raises
    ------
    NotDeterminedError
        If the motion does not move the parallax there, or the rays no longer meet.
    """
    point = model if model.names == (step.point,) else model.only([step.point])
    depth = _depth(point, setting, step)
    turns = step.motion[:-1] in ANGLES
    current = setting
    for _ in range(_NEWTON_STEPS):
        excess = float(y_parallaxes(point, current)[0]) - target
        slope = float(parallax_jacobian(point, current, [step.motion])[0, 0])
        if not math.isfinite(excess):
            raise NotDeterminedError(f"{step.motion} at point {step.point}: the rays no longer meet")
        if abs(slope) < _LEAST_EFFECT * (depth if turns else 1.0):
            raise NotDeterminedError(f"{step.motion} does not move the y-parallax at point {step.point}")
        if abs(excess) <= 0.01 * _ROUNDING * depth:
            return current
        value = current.value(step.motion) - excess / slope
        if turns and abs(value) > _LARGEST_TURN:
            raise NotDeterminedError(f"{step.motion} at point {step.point} runs out of its range")
        current = current.moved(step.motion, value)
    return current


def run_empirical(
    model: PlotterModel,
    start: Setting,
    procedure: Procedure,
    rule: Rule = general_rule,
    options: EmpiricalOptions | None = None,
) -> EmpiricalRun:
    """Operate the instrument for some cycles.

    Each cycle: the clearing steps, the tilt over-corrected n times (or from profiles), the clearing steps
    again. Kasper's summary repeats points 1 and 2 only; without 3 and 4 the parallaxes that their motions
    took over from the wrong tilt stay in the model.

    Parameters
    ----------
    model : PlotterModel
        Points seen in both photographs; those beyond the procedure's are looked at, not used.
    start : Setting
        Setting to begin with; bx stays.
    procedure : Procedure
    rule : callable
        Gives n for a `Situation`.
    options : EmpiricalOptions, optional

    Raises
    ------
    InputError
        If the procedure names a point the model does not have, or rays do not meet at the start.
    """
    chosen = options if options is not None else EmpiricalOptions()
    operator = _Operator(model, procedure, rule, chosen)
    initial = y_parallaxes(model, start)
    if not np.isfinite(initial).all():
        name = model.names[int(np.argmin(np.isfinite(initial)))]
        raise InputError("must have rays that meet below both projectors at the start", field=f"point {name}")
    settings, parallaxes = [start], [initial]
    stopped: tuple[Outcome, str] | None = None
    for cycle in range(1, chosen.cycles + 1):
        try:
            setting, stopped = operator.cycle(cycle, settings[-1])
        except NotDeterminedError as error:
            stopped = ("lost", str(error))
            break
        if stopped is not None:
            break
        settings.append(setting)
        parallaxes.append(y_parallaxes(model, setting))
    table = np.array(parallaxes)
    amplification = whole_factor(model, settings[-1], procedure)
    rows = [model.index(name) for name in procedure.points]
    outcome, reason = stopped or _judge(table[:, rows], settings[-1], model, amplification, chosen)
    return EmpiricalRun(
        model, procedure, tuple(operator.notes), tuple(settings), table, outcome, reason, amplification
    )


def whole_factor(model: PlotterModel, setting: Setting, procedure: Procedure) -> float:
    """n from the exact derivatives at the points where the procedure clears and over-corrects.

    What ω does to the parallax at the corrected point alone, over what it does when the clearing steps
    follow; for standard points this is the factor of the cross-section, for others its generalisation.

    Returns
    -------
    float
        ±inf where the points do not determine the tilt; nan where the clearing steps do not determine their
        own motions.
    """
    names = [*(step.point for step in procedure.clearing), procedure.tilt.point]
    jacobian = parallax_jacobian(model.only(names), setting, procedure.motions)
    if not np.isfinite(jacobian).all():
        return math.nan
    others, by_tilt = jacobian[:-1, :-1], jacobian[:-1, -1]
    if np.linalg.matrix_rank(others / np.abs(others).max(axis=0), tol=1e-9) < len(others):
        return math.nan
    alone = float(jacobian[-1, -1])
    left = alone - float(jacobian[-1, :-1] @ np.linalg.solve(others, by_tilt))
    return math.copysign(math.inf, left) if abs(left) < 1e-12 * abs(alone) else alone / left


class _Operator:
    """The hand at the wheels: keeps the notes, the history of p* and the random errors of reading."""

    def __init__(
        self, model: PlotterModel, procedure: Procedure, rule: Rule, options: EmpiricalOptions
    ) -> None:
        for name in procedure.points:
            model.index(name)
        self.model, self.procedure, self.rule, self.options = model, procedure, rule, options
        self.single = {name: model.only([name]) for name in procedure.points}
        self.notes: list[StepNote] = []
        self.history: list[tuple[float, float]] = []
        self.random = np.random.default_rng(options.seed)

    def cycle(self, cycle: int, setting: Setting) -> tuple[Setting, tuple[Outcome, str] | None]:
        """One cycle; a stop instead of a setting's worth of work when no factor exists."""
        setting = self.clear(cycle, setting)
        if self.procedure.profiles:
            setting = self.tilt_by_profiles(cycle, setting)
        else:
            setting, stopped = self.tilt_over_corrected(cycle, setting)
            if stopped is not None:
                return setting, stopped
        return self.clear(cycle, setting), None

    def clear(self, cycle: int, setting: Setting) -> Setting:
        """Rounds of the clearing steps until their points are free of parallax, or a round brings nothing."""
        names = [step.point for step in self.procedure.clearing]
        model = self.model.only(names)
        visible = np.maximum(
            _ROUNDING * np.abs(model_points(model, setting)[:, 2]), 3.0 * self.options.parallax_std
        )
        least = math.inf
        for number in range(1, self.options.rounds + 1):
            before, written = setting, len(self.notes)
            for step in self.procedure.clearing:
                moved = eliminate(self.single[step.point], setting, step, self.error())
                self.note("clear", step, (setting, moved), moved.value(step.motion), (cycle, number))
                setting = moved
            left = float(np.max(np.abs(y_parallaxes(model, setting)) / visible))
            if left <= 1.0:
                break
            if not left < least:
                # The motions drive each other apart while the tilt is still wrong: the round is taken back.
                del self.notes[written:]
                return before
            least = left
        return setting

    def tilt_over_corrected(self, cycle: int, setting: Setting) -> tuple[Setting, tuple[Outcome, str] | None]:
        step = self.procedure.tilt
        error = self.error()
        parallax = self.parallax(step.point, setting) - error
        removing = eliminate(self.single[step.point], setting, step, error).value(step.motion)
        factor = self.rule(self.situation(cycle, setting, parallax))
        if not math.isfinite(factor):
            return setting, (
                "critical",
                f"no over-correction factor exists for point {step.point}: n = {factor}",
            )
        self.history.append((factor, parallax))
        before = setting.value(step.motion)
        moved = setting.moved(step.motion, before + factor * (removing - before))
        if not math.isfinite(self.parallax(step.point, moved)):
            raise NotDeterminedError(f"over-correcting {factor:.3g} times, the rays no longer meet")
        self.note("over-correct", step, (setting, moved), removing, (cycle, 1), factor)
        return moved, None

    def tilt_by_profiles(self, cycle: int, setting: Setting) -> Setting:
        step = self.procedure.tilt
        tilt = float(np.mean(self.profile_tilts(setting)))
        if not math.isfinite(tilt):
            raise NotDeterminedError("a profile lies on its critical circle: no tilt from it")
        before = setting.value(step.motion)
        # A rise of ω turns the ray of the left projector, hence p, one way and that of the right the other.
        value = before - tilt if step.motion == "omega1" else before + tilt
        moved = setting.moved(step.motion, value)
        self.note("profiles", step, (setting, moved), value, (cycle, 1))
        return moved

    def profile_tilts(self, setting: Setting) -> FloatArray:
        """dω by (4) from the parallaxes of each profile."""
        sections = np.array([self.section_read(names, setting) for names in self.procedure.profiles])
        parallaxes = np.array(
            [[self.parallax(n, setting) - self.error() for n in names] for names in self.procedure.profiles]
        )
        return np.asarray(tilt_from_parallaxes(sections, parallaxes))

    def situation(self, cycle: int, setting: Setting, parallax: float) -> Situation:
        given = self.options.given_section
        section = (
            self.section_read(self.procedure.section, setting) if given is None else np.asarray(given, float)
        )
        row = self.model.index(self.procedure.tilt.point)
        vectors = self.model.left if self.procedure.tilt.motion == "omega1" else self.model.right
        return Situation(
            cycle=cycle,
            section=section,
            image_tangent=float(-vectors[row, 1] / vectors[row, 2]),
            history=tuple(self.history),
            parallax=parallax,
            whole_factor=whole_factor(self.model, setting, self.procedure),
        )

    def section_read(self, names: tuple[str, str, str], setting: Setting) -> FloatArray:
        """Cross-section (3, 2) from the projection centre of the tilted projector, as the model stands."""
        centre = setting.centre(1 if self.procedure.tilt.motion == "omega1" else 2)
        points = model_points(self.model.only(names), setting)
        return np.stack((points[:, 1] - centre[1], centre[2] - points[:, 2]), axis=-1)

    def parallax(self, point: str, setting: Setting) -> float:
        return float(y_parallaxes(self.single[point], setting)[0])

    def error(self) -> float:
        std = self.options.parallax_std
        return float(self.random.normal(0.0, std)) if std > 0.0 else 0.0

    def note(
        self,
        kind: Kind,
        step: Step,
        settings: tuple[Setting, Setting],
        removing: float,
        count: tuple[int, int],
        factor: float | None = None,
    ) -> None:
        before, after = settings
        self.notes.append(
            StepNote(
                cycle=count[0],
                round=count[1],
                kind=kind,
                point=step.point,
                motion=step.motion,
                parallax_before=self.parallax(step.point, before),
                parallax_after=self.parallax(step.point, after),
                value_before=before.value(step.motion),
                value_after=after.value(step.motion),
                removing_value=removing,
                factor=factor,
            )
        )


def _depth(point: PlotterModel, setting: Setting, step: Step) -> float:
    depth = -float(model_points(point, setting)[0, 2])
    if not math.isfinite(depth):
        raise NotDeterminedError(f"{step.motion} at point {step.point}: the rays do not meet")
    return abs(depth)


def _judge(
    table: FloatArray, setting: Setting, model: PlotterModel, amplification: float, options: EmpiricalOptions
) -> tuple[Outcome, str]:
    """Outcome when all cycles could be made, from the parallaxes (cycles + 1, points)."""
    largest = np.abs(table).max(axis=1)
    if not np.isfinite(largest).all():
        return "lost", "rays of a point no longer meet"
    if not abs(amplification) <= options.critical_factor:
        return "critical", f"the points do not determine the tilt: its factor is {amplification:.3g}"
    depth = float(np.abs(model_points(model, setting)[:, 2]).mean())
    # An operator cannot tell a parallax from his own errors of setting and reading.
    if largest[-1] <= max(options.cleared_ratio * depth, 5.0 * options.parallax_std):
        return "cleared", f"largest y-parallax {largest[-1]:.3g} m after {len(largest) - 1} cycles"
    if len(largest) > 2 and largest[-1] > largest[-2]:
        return "diverging", f"largest y-parallax grows from {largest[-2]:.3g} to {largest[-1]:.3g} m"
    return "converging", f"largest y-parallax is still {largest[-1]:.3g} m"
