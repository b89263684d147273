"""Relative orientation of measured points: all should be good, so many bad ones mean another error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from stereomate.errors import NotDeterminedError
from stereomate.relative.orientation import RelativeOptions, RelativeOrientation, relative_orientation
from stereomate.relative.pair import Correspondences
from stereomate.relative.remarks import remarks
from stereomate.relative.snooping import SnoopingOptions

# Mistakes are single: where fewer measured points than this share agree, what they have in common is wrong.
_LEAST_SHARE: Final = 0.6


@dataclass(frozen=True)
class MeasuredOrientation:
    """Relative orientation of a table of points.

    Parameters
    ----------
    names : tuple of str
    orientation : RelativeOrientation or None
        None where none has the points before both cameras.
    reasons : tuple of str
        Why it is not determined; empty if it is.
    notes : tuple of str
        What is to be known besides: points left out, a plane, exchanged photographs, large residuals.
    """

    names: tuple[str, ...]
    orientation: RelativeOrientation | None
    reasons: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def determined(self) -> bool:
        """There is an orientation."""
        return not self.reasons


def orient_measured(
    correspondences: Correspondences, names: Sequence[str], options: RelativeOptions | None = None
) -> MeasuredOrientation:
    """Orient two photographs from measured points, gross errors tested for by data snooping.

    Parameters
    ----------
    correspondences : Correspondences
    names : sequence of str
        One per correspondence.
    options : RelativeOptions, optional
        Data snooping is added where they have none.

    Raises
    ------
    InputError
        If there are fewer than five points.
    """
    options = options or RelativeOptions()
    if options.snooping is None:
        options = replace(options, snooping=SnoopingOptions())
    try:
        found = relative_orientation(correspondences, options)
    except NotDeterminedError as error:
        return MeasuredOrientation(tuple(names), None, (str(error).partition(": ")[2],), ())
    reasons = found.reasons
    agree = int(np.count_nonzero(found.used))
    if not reasons and agree < _LEAST_SHARE * len(names):
        causes = "another principal distance, other units, or other points than meant"
        reasons = (f"only {agree} of {len(names)} measured points agree on an orientation: {causes}",)
    return MeasuredOrientation(tuple(names), found, reasons, () if reasons else remarks(found, names))
