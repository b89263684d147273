"""What an audit says: findings with their certainty, the evidence, and what stays open, in sentences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from stereomate.frames.audit.evaluation import CommonTurn, Evaluator
from stereomate.frames.audit.ranking import (
    AttitudeFit,
    Hypothesis,
    PatternSlope,
    accuracy_m,
    adjusted_in,
    attitude_score,
    certainty,
    decide,
    flying_height_m,
    ground_height,
)
from stereomate.frames.factors import grid_factors

_UNDECIDED: Final = 4.0


@dataclass(frozen=True)
class Finding:
    """What to put in the project file, and how sure that is.

    Attributes
    ----------
    key, value : str
        ``photos.heights`` and the like, and its value as TOML.
    sure : str
        ``practically certain``, ``very likely``, ``likely``, ``undecided``.
    sentence : str
        Why.
    """

    key: str
    value: str
    sure: str
    sentence: str


def explains(hypothesis: Hypothesis, sigma: float) -> bool:
    """Whether a hypothesis meets known points to within three standard deviations of a block."""
    parts = [part for part in (hypothesis.points, hypothesis.control) if part is not None]
    return all(abs(value) < 3.0 * sigma for part in parts for value in part.mean)


def unexplained(
    findings: Sequence[Finding], best: Hypothesis, sigma: float, undecided: list[str]
) -> list[Finding]:
    """Findings on heights and adjustment that no hypothesis bears out: the best of them is not right."""
    part = best.points or best.control
    words = " ".join(f"{value:+.3f}" for value in part.mean) if part else "nothing"
    undecided.append(
        f"no pair of height systems that was tried explains the known points: they are missed by {words} m "
        f"(east, north, height) at best, with an accuracy of {sigma:.3f} m"
    )
    kinds = ("photos.heights", "control.heights", "photos.adjusted_in")
    return [replace(f, sure="undecided") if f.key in kinds else f for f in findings]


def compared_only(findings: Sequence[Finding], best: AttitudeFit, undecided: list[str]) -> list[Finding]:
    """Findings where the rays of the best reading do not meet well: they only compare what was tried."""
    undecided.append(
        f"the rays of the best reading ({best.reading.name}) miss each other by {best.total_px:.0f} px: "
        "either the attitudes are measured ones, good to a degree or so, or no reading tried is right"
    )
    sure = ("practically certain", "very likely")
    return [replace(f, sure="likely") if f.sure in sure else f for f in findings]


def attitude_findings(fits: Sequence[AttitudeFit], undecided: list[str]) -> list[Finding]:
    """One finding for each key that the best reading sets; readings that fit as well stay open."""
    best, second = fits[0], fits[1]
    for fit in fits[1:]:
        if attitude_score(fit, best) < _UNDECIDED:
            undecided.append(
                f"angles {fit.reading.name}: {fit.total_px:.3f} px against {best.total_px:.3f} px of the "
                f"best ({best.reading.name}); the photographs are too nearly level, or flown too straight"
            )
    sentence = f"{best.reading.name}: image residuals {best.total_px:.3g} px"
    found = []
    if best.reading.unsaid:
        words = ", ".join(best.reading.unsaid)
        other = next((fit for fit in fits if fit.reading.unsaid != best.reading.unsaid), None)
        margin = np.inf if other is None else attitude_score(other, best)
        found.append(
            Finding("photos (no key says it)", f"# {words}", certainty(margin), f"{sentence}; {_next(other)}")
        )
    elif not best.reading.keys:
        sure = certainty(attitude_score(second, best))
        found.append(
            Finding("photos (no key says it)", f"# {best.reading.name}", sure, f"{sentence}; {_next(second)}")
        )
    for key, value in best.reading.keys:
        other = next((fit for fit in fits if dict(fit.reading.keys).get(key) != value), None)
        margin = np.inf if other is None else attitude_score(other, best)
        found.append(Finding(key, value, certainty(margin), f"{sentence}; {_next(other)}"))
    return found


def _next(fit: AttitudeFit | None) -> str:
    if fit is None or not np.isfinite(fit.total_px):
        return "no other reading makes the rays meet"
    return f"{fit.total_px:.3g} px for the next, {fit.reading.name}"


def height_findings(
    ranked: Sequence[Hypothesis], tried: tuple[int, int], undecided: list[str]
) -> list[Finding]:
    """What the heights are; `tried` says how many kinds of the orientation and of known points were tried."""
    best = ranked[0]
    found = []
    for key, word, part, kinds in (
        ("photos.heights", "the orientation's heights", lambda h: h.heights.value, tried[0]),
        ("control.heights", "the control's heights", lambda h: h.reference_heights.value, tried[1]),
    ):
        decision = decide(ranked, part)
        sure = decision.sure
        candidate = best.heights if key.startswith("photos") else best.reference_heights
        sentence = f"{word} are {candidate.name}"
        if decision.other is not None:
            sentence += (
                f"; otherwise known points would differ by {_height_of(decision.other):+.3f} m in height"
            )
        elif kinds > 1:
            sentence += "; every other kind that was tried is far off"
        else:
            sentence += "; no other kind was tried, and the points tell only that both are in one system"
            sure = "likely"
        found.append(Finding(key, candidate.value, sure, sentence))
    same = [h for h in ranked if h.heights.name == h.reference_heights.name]
    if len({h.heights.name for h in same if h.score < best.score + 4.0}) > 1:
        undecided.append(
            "orientation and known points are in one height system; the data do not tell which (the geoid is "
            "too even over the block)"
        )
    return found


def adjusted_finding(
    ranked: Sequence[Hypothesis], evaluator: Evaluator, excess: float, sigma: float, undecided: list[str]
) -> Finding:
    best = ranked[0]
    decision = decide(ranked, adjusted_in)
    value = adjusted_in(best)
    words = {
        "grid": "the centres come from an adjustment in the grid and carry its scale in their heights",
        "space": "the centres are true positions",
    }
    sentence = words[value]
    if decision.other is not None:
        sentence += (
            f"; read the other way, known points would lie {_height_of(decision.other):+.3f} m in height "
            f"(here {_height_of(best):+.3f} m); (tau_e - 1) H is {excess:+.3f} m"
        )
    if value == "grid":
        known = evaluator.reference_map(best.reference_heights)
        ground = ground_height(evaluator.observations, known)
        if ground is not None:
            sentence += f"; the scale acts about the mean height of the control, {ground:.1f} m ellipsoidal"
    undecided += _ways_of_the_grid(ranked, decision.decided)
    if abs(excess) < 2.0 * sigma:
        undecided.append(
            f"adjusted in the grid or in space: the two lie only {abs(excess):.3f} m apart here, less than "
            f"twice the accuracy of {sigma:.3f} m"
        )
    elif decision.decided:
        undecided.append(
            f"an error of another origin of the same size and sign ({excess:+.3f} m in all heights) would "
            "look the same as the scale of the grid"
        )
    return Finding("photos.adjusted_in", f'"{value}"', decision.sure, sentence)


def _ways_of_the_grid(ranked: Sequence[Hypothesis], decided: bool) -> list[str]:
    """Which of the ways to adjust in the grid cannot be told apart."""
    best = ranked[0]
    alike = {
        h.work: h
        for h in ranked
        if (h.heights, h.reference_heights, h.attitude)
        == (best.heights, best.reference_heights, best.attitude)
    }
    if "curvature" not in alike or "cartesian" not in alike or (adjusted_in(best) == "space" and decided):
        return []
    curved, plain = alike["curvature"], alike["cartesian"]
    apart = abs(_height_of(curved) - _height_of(plain))
    margin = abs(curved.score - plain.score)
    if margin >= 9.0:
        return []
    return [
        (
            "whether that adjustment corrected the image coordinates for Earth curvature: with and without "
            f"it heights differ by {apart:.3f} m (image residuals {np.hypot(*curved.image_rms_px):.3f} and "
            f"{np.hypot(*plain.image_rms_px):.3f} px)"
        )
    ]


def _height_of(h: Hypothesis) -> float:
    """Mean height difference to known points: all, else control."""
    part = h.points or h.control
    return np.nan if part is None else part.mean[2]


def evidence_sentences(
    evaluator: Evaluator,
    ranked: Sequence[Hypothesis],
    fits: Sequence[AttitudeFit],
    turn: CommonTurn | None,
    excess: float,
    slope: PatternSlope | None,
) -> list[str]:
    block, best = evaluator.block, ranked[0]
    middle = block.positions[:, :2].mean(axis=0)
    _, gamma = grid_factors(block.crs, middle[0], middle[1])
    lines = [
        (
            f"{len(evaluator.observations.names)} points, {len(evaluator.observations.point_of)} rays, "
            f"{len(block.positions)} photographs; flying height {flying_height_m(evaluator):.0f} m; "
            f"differences are judged by {accuracy_m(evaluator):.3f} m"
        )
    ]
    x, y = best.image_rms_px
    lines.append(f"image residuals {x:.3f} / {y:.3f} px (x, y) after forward intersection")
    for name, part in (("known points", best.points), ("control", best.control)):
        if part is not None:
            mean = " ".join(f"{value:+.3f}" for value in part.mean)
            std = " ".join(f"{value:.3f}" for value in part.std)
            lines.append(f"{name} ({part.count}): mean {mean} m, standard deviation {std} m")
    if turn is not None:
        about = ", ".join(
            f"{value:+.4f} ± {sigma:.4f}" for value, sigma in zip(turn.about_deg, turn.sigma_deg, strict=True)
        )
        lines.append(
            f"y-parallaxes ask for a common turn of all photographs as declared by {about} degrees about "
            f"east, north and up; the convergence of the grid is {np.rad2deg(float(gamma)):+.4f} degrees"
        )
    if slope is not None and adjusted_in(best) == "grid":
        told = "" if slope.told else "; the scale varies too little over the block for that to prove anything"
        lines.append(
            f"read as true positions, heights follow the pattern of the scale over the block with a slope of "
            f"{slope.slope:.2f} ± {slope.sigma:.2f} (1: the scale, 0: a constant){told}"
        )
    space = next((h for h in ranked if h.work == "space" and h.heights == best.heights), None)
    if space is not None and np.isfinite(_height_of(space)):
        lines.append(
            f"read as true positions, points lie {_height_of(space):+.3f} m in height; (tau_e - 1) H is "
            f"{excess:+.3f} m"
        )
    return lines
