"""Covariances of adjusted orientations, as products made of them carry them on."""

from __future__ import annotations

from stereomate.coverage.covariance import OrientationCovariance
from stereomate.project.orient_adjust import Adjusted


def covariance_of(
    adjusted: Adjusted, names: tuple[str, ...], pairs: list[tuple[str, str]]
) -> OrientationCovariance | None:
    """Covariances of photographs and of pairs that see common points; None without a determined datum.

    Interior orientation and its correlation with the exterior one are not in it.
    """
    result = adjusted.result
    statistics = result.statistics
    if statistics is None or not adjusted.has_datum or result.solution.defect.size:
        return None
    cofactors, variance = statistics.cofactors, statistics.scale**2
    place = {name: k for k, name in enumerate(names) if not result.solution.lonely[k]}
    return OrientationCovariance(
        {name: variance * cofactors.photos[k] for name, k in place.items()},
        {
            (a, b): variance * cofactors.photo_pair(place[a], place[b])
            for a, b in pairs
            if a in place and b in place
        },
    )
