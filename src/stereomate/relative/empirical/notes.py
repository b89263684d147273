"""The notes of a run as an operator would write them, and its summary as a table."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from stereomate.relative.empirical.projectors import ANGLES, Motion
from stereomate.relative.empirical.record import EmpiricalRun, StepNote
from stereomate.units import DEGREE

_SYMBOLS: Final = {"by": "by", "bz": "bz", "omega": "ω", "phi": "φ", "kappa": "κ"}
_PRIMES: Final = {"1": "'", "2": "''"}


def motion_symbol(motion: Motion) -> str:
    """The motion as instruments label it: one prime for the left projector, two for the right."""
    return _SYMBOLS[motion[:-1]] + _PRIMES[motion[-1]]


def operator_notes(run: EmpiricalRun, every_round: bool = False) -> str:
    """Each step of a run as text: point, motion, parallax before and after, scale readings, factor.

    Parameters
    ----------
    run : EmpiricalRun
    every_round : bool
        Write repeated rounds of clearing out; else one line says how many there were.
    """
    lines = [
        f"start: {_settings_text(run, 0)}",
        f"       largest y-parallax {_metres(run.largest[0]).lstrip('+')} m",
    ]
    for cycle in sorted({note.cycle for note in run.notes}):
        lines += ["", f"cycle {cycle}"]
        lines.append(f"  {'point':<7}{'motion':<8}{'p before':>13}{'p after':>13}{'from':>14}{'to':>14}")
        notes = [note for note in run.notes if note.cycle == cycle]
        for place, note in enumerate(notes):
            if note.round == 1 or every_round:
                lines.append(_line(note))
            elif place + 1 == len(notes) or notes[place + 1].round < note.round:
                lines.append(f"  points cleared again, {note.round} rounds in all")
        if cycle < len(run.settings):
            lines.append(f"  largest y-parallax now {_metres(run.largest[cycle]).lstrip('+')} m")
            lines.append(f"  {_settings_text(run, cycle)}")
    lines += ["", f"{run.outcome}: {run.reason}"]
    return "\n".join(lines)


def comparison_table(runs: Mapping[str, EmpiricalRun]) -> str:
    """Largest y-parallax at the start and after each cycle for several rules, side by side."""
    cycles = max(len(run.largest) for run in runs.values())
    name_width = max(len("rule"), *(len(name) for name in runs)) + 2
    head = "rule".ljust(name_width) + f"{'n':>10}" + f"{'start':>11}"
    head += "".join(f"{f'cycle {c}':>11}" for c in range(1, cycles)) + "  outcome"
    lines = ["largest |y-parallax| at the points, metres in the model", head, "-" * len(head)]
    for name, run in runs.items():
        factors = [note.factor for note in run.notes if note.factor is not None]
        first = f"{factors[0]:.3f}" if factors else ("mean ω" if run.procedure.profiles else "±∞")
        cells = "".join(f"{value:>11.2g}" for value in run.largest)
        cells += " " * 11 * (cycles - len(run.largest))
        lines.append(name.ljust(name_width) + f"{first:>10}" + cells + "  " + run.outcome)
    return "\n".join(lines)


def _line(note: StepNote) -> str:
    text = f"  {note.point:<7}{motion_symbol(note.motion):<8}"
    text += f"{_metres(note.parallax_before):>13}{_metres(note.parallax_after):>13}"
    text += f"{_reading(note.motion, note.value_before):>14}{_reading(note.motion, note.value_after):>14}"
    if note.kind == "over-correct" and note.factor is not None:
        removing = _reading(note.motion, note.removing_value)
        text += f"   over-corrected {note.factor:.3f} times (p removed at {removing})"
    if note.kind == "profiles":
        text += "   mean ω of the profiles"
    return text


def _settings_text(run: EmpiricalRun, cycle: int) -> str:
    setting = run.settings[cycle]
    return "  ".join(
        f"{motion_symbol(motion)} {_reading(motion, setting.value(motion))}"
        for motion in run.procedure.motions
    )


def _reading(motion: Motion, value: float) -> str:
    if motion[:-1] in ANGLES:
        return f"{_signed(value / DEGREE, 5)}°"
    return f"{_signed(value, 3)} m"


def _metres(value: float) -> str:
    if math.isfinite(value) and 0.0 < abs(value) < 5e-5:
        return "0.0000" if abs(value) < 5e-10 else f"{value:+.1e}"
    return _signed(value, 4)


def _signed(value: float, decimals: int) -> str:
    return f"{value:+.{decimals}f}" if round(value, decimals) != 0.0 else f"{0.0:.{decimals}f}"
