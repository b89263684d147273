"""What `stereomate georef audit` prints: findings, evidence, hypotheses, as tables and as JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from stereomate.frames.audit.findings import Audit
    from stereomate.frames.audit.ranking import Differences, Hypothesis
    from stereomate.project.audit import ProjectAudit


def print_audit(found: ProjectAudit) -> None:
    """Print an audit as tables and sentences."""
    from stereomate.cli.output import console

    out = console()
    out.print(f"[bold]Audit of {found.path}[/bold]", highlight=False)
    if found.turns is not None:
        _print_lines(out, "Photographs turned against their attitude", found.turns.sentences())
    if found.audit is not None:
        _print_points_audit(out, found, found.audit)


def _print_points_audit(out: Console, found: ProjectAudit, result: Audit) -> None:
    from stereomate.cli.output import table

    rows = [(finding.key, finding.value, finding.sure) for finding in result.findings]
    out.print(table("What the project file should say", ("key", "value", "how sure"), rows, left=(0, 1, 2)))
    _print_lines(out, "Why", [finding.sentence for finding in result.findings])
    _print_lines(out, "Evidence", result.evidence)
    _print_lines(out, "What the data do not decide", result.undecided)
    _print_lines(out, "Height systems registered here whose geoid was not tried", found.registered)
    _print_lines(out, "Notes", found.notes)
    out.print(_ranking_table(result))
    heads = ("angles", "image residuals px")
    readings = [(fit.reading.name, f"{fit.total_px:.3f}") for fit in result.attitudes[:8]]
    out.print(table("Readings of the attitudes", heads, readings, rest=len(result.attitudes) - 8))


def _print_lines(out: Console, title: str, lines: Sequence[str]) -> None:
    if lines:
        out.print(f"[bold]{title}[/bold]")
        for line in lines:
            out.print(f"  • {line}", highlight=False, markup=False)


def _ranking_table(result: Audit) -> Any:
    from stereomate.cli.output import table
    from stereomate.frames.audit.readings import WORK_WORDS

    rows = []
    for h in result.ranked[:10]:
        rows.append(
            (
                WORK_WORDS[h.work] + ("" if h.attitude == result.best.attitude else f"; {h.attitude.name}"),
                h.heights.label,
                h.reference_heights.label,
                f"{h.image_rms_px[0]:.3f}/{h.image_rms_px[1]:.3f}",
                _mean(h.points),
                _mean(h.control),
                f"{h.score - result.best.score:.1f}",
            )
        )
    heads = ("reading", "heights", "of control", "image px", "known points m", "control m", "behind")
    title = "Hypotheses, the best first (mean differences east, north, height)"
    return table(title, heads, rows, left=(0, 1, 2), rest=len(result.ranked) - 10)


def _mean(part: Differences | None) -> str:
    return "" if part is None else " ".join(f"{value:+.3f}" for value in part.mean)


def audit_dict(found: ProjectAudit) -> dict[str, Any]:
    """An audit for JSON."""
    value: dict[str, Any] = {"project": found.path, "notes": found.notes}
    if found.turns is not None:
        names = found.turns.names
        value["turned"] = {names[turn.photo]: turn.turn_deg for turn in found.turns.turned}
        value["turns"] = [{"photograph": names[turn.photo], "turn": turn} for turn in found.turns.turns]
        value["turn_words"] = found.turns.sentences()
    result = found.audit
    if result is None:
        return value
    return value | {
        "findings": result.findings,
        "evidence": result.evidence,
        "undecided": result.undecided,
        "accuracy_m": result.accuracy_m,
        "flying_height_m": result.flying_height_m,
        "scale_excess_m": result.scale_excess_m,
        "scale_pattern": result.slope,
        "common_turn": result.turn,
        "explained": result.explained,
        "registered_height_systems": found.registered,
        "hypotheses": [_hypothesis_dict(h) for h in result.ranked],
        "attitudes": [{"name": fit.reading.name, "rms_px": fit.rms_px} for fit in result.attitudes],
    }


def _hypothesis_dict(h: Hypothesis) -> dict[str, Any]:
    return {
        "work": h.work,
        "attitude": h.attitude.name,
        "heights": h.heights.text,
        "heights_unit": h.heights.unit or None,
        "control_heights": h.reference_heights.text,
        "control_heights_unit": h.reference_heights.unit or None,
        "image_rms_px": h.image_rms_px,
        "points": h.points,
        "control": h.control,
        "score": h.score,
    }
