"""Pairs of a block that is oriented: chosen, matched, and looked at for what is no pair.

Photographs that show the same picture (a copy saved anew) have no base between them; one of them is left out.
Photographs that found no partner where their positions say they are may lie elsewhere: they are compared with
all others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from stereomate.block.photos import BlockPhoto
from stereomate.block.start_pairs import Approximation, Pair, PairSelection, pairs_by_first_look
from stereomate.block.tie_points import PairResult, TiePointOptions, choose_pairs, match_pairs
from stereomate.errors import ImageError
from stereomate.measurement.database import MeasurementDatabase
from stereomate.project.inputs import PhotoProblem
from stereomate.project.orient_inputs import OrientInputs
from stereomate.tiles import Executor

# Of so many photographs one without partners is compared with each; of more by a first look.
_EACH: Final = 40


@dataclass(frozen=True, eq=False)
class MatchedPairs:
    """Pairs of photographs with their matches in the database.

    Attributes
    ----------
    selection : PairSelection
        Without photographs that are left out.
    results : tuple of PairResult
    problems : tuple of PhotoProblem
        Photographs that show the picture of another one.
    findings : tuple of str
    """

    selection: PairSelection
    results: tuple[PairResult, ...]
    problems: tuple[PhotoProblem, ...]
    findings: tuple[str, ...]


def matched_pairs(
    database: MeasurementDatabase,
    photos: Sequence[BlockPhoto],
    inputs: OrientInputs,
    options: TiePointOptions,
    failed: Mapping[int, str],
    executor: Executor | None,
    progress: Callable[[int, int], None],
) -> MatchedPairs:
    """Choose and match the pairs of a block.

    Parameters
    ----------
    failed : mapping
        Numbers of photographs that could not be read.
    """
    lost = {k - 1 for k in failed}
    chosen = _chosen(database, photos, inputs, options)
    selection = _without(chosen, lost)
    results = match_pairs(database, photos, selection, options, executor, progress)
    alone = _without_partner(results, photos, lost) if len(photos) > len(lost) + 1 else set()
    findings: tuple[str, ...] = ()
    if alone:
        more = _more_pairs(database, photos, options, alone, lost) - set(selection.pairs)
        if more:
            selection = replace(selection, pairs=tuple(sorted({*selection.pairs, *more})))
            results = match_pairs(database, photos, selection, options, executor, progress)
            found = sorted(alone - _without_partner(results, photos, lost))
            if found:
                names = ", ".join(photos[k].name for k in found)
                words = "photographs without a partner where their positions say they are, found elsewhere"
                findings = (f"{words}: {names}",)
    copies = _copies(results, inputs)
    problems = tuple(
        PhotoProblem(
            photos[k].name,
            ImageError(
                f"shows the same picture as {photos[of].name}: a copy of it, or taken from one place",
                file=photos[k].path,
            ),
        )
        for k, of in sorted(copies.items())
    )
    kept = _without(selection, set(copies))
    remaining = set(kept.pairs)
    return MatchedPairs(
        kept, tuple(r for r in results if (r.first, r.second) in remaining), problems, findings
    )


def _chosen(
    database: MeasurementDatabase,
    photos: Sequence[BlockPhoto],
    inputs: OrientInputs,
    options: TiePointOptions,
) -> PairSelection:
    known = inputs.approximation
    if inputs.file.orient.pairs == "all":
        n = len(photos)
        known = Approximation(np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan))
        options = replace(options, pairs=replace(options.pairs, exhaustive=n))
    return choose_pairs(database, photos, known, options)


def _without(selection: PairSelection, lost: set[int]) -> PairSelection:
    return replace(selection, pairs=tuple(pair for pair in selection.pairs if not lost & set(pair)))


def _without_partner(results: Sequence[PairResult], photos: Sequence[BlockPhoto], lost: set[int]) -> set[int]:
    """Photographs of which no pair has matches that agree."""
    tied = {k for r in results if not r.reasons for k in (r.first, r.second)}
    return set(range(len(photos))) - tied - lost


def _more_pairs(
    database: MeasurementDatabase,
    photos: Sequence[BlockPhoto],
    options: TiePointOptions,
    alone: set[int],
    lost: set[int],
) -> set[Pair]:
    others = [k for k in range(len(photos)) if k not in lost]
    if len(photos) <= _EACH:
        return {(min(k, other), max(k, other)) for k in alone for other in others if other != k}
    look = pairs_by_first_look([database.features(p.number) for p in photos], options.pairs, alone)
    return {pair for pair in look.pairs if not lost & set(pair)}


def _copies(results: Sequence[PairResult], inputs: OrientInputs) -> dict[int, int]:
    """Photograph -> the one it shows the picture of: one that has a position, else the first."""
    placed = inputs.approximation.has_centre.tolist()
    copies: dict[int, int] = {}
    for result in results:
        if not result.same_picture:
            continue
        first, second = copies.get(result.first, result.first), copies.get(result.second, result.second)
        if first == second:
            continue
        kept, left = (second, first) if placed[second] and not placed[first] else (first, second)
        copies = {k: kept if of == left else of for k, of in copies.items()} | {left: kept}
    return copies
