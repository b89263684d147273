"""Photographs of a project that are turned against their attitude, found by matching neighbours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.coverage.survey import Photograph
from stereomate.errors import ProjectError
from stereomate.measurement.features import FeatureOptions, Features, detect_features, grey_image
from stereomate.measurement.matching import match_features
from stereomate.project.model import Project
from stereomate.raster.thumbnail import read_thumbnail
from stereomate.relative.turns import PairTurns, PhotoTurn, ground_offsets, pair_turns, photo_turns

Array = NDArray[np.float64]

# Photographs are matched at this size: turns need no detail.
_LONGEST_PX: Final = 800
_FEATURES: Final = 1500
_NEIGHBOURS: Final = 4


@dataclass(frozen=True)
class TurnAudit:
    """Which photographs are turned.

    Attributes
    ----------
    names : tuple of str
        Of the photographs, in the order of the survey.
    turns : tuple of PhotoTurn
    pairs : tuple of PairTurns
    """

    names: tuple[str, ...]
    turns: tuple[PhotoTurn, ...]
    pairs: tuple[PairTurns, ...]

    @property
    def turned(self) -> tuple[PhotoTurn, ...]:
        """Photographs more than 45° off."""
        return tuple(turn for turn in self.turns if turn.is_turned)

    @property
    def unmatched(self) -> tuple[str, ...]:
        """Photographs no neighbour could be matched with."""
        seen = {turn.photo for turn in self.turns}
        return tuple(name for k, name in enumerate(self.names) if k not in seen)

    def sentences(self) -> list[str]:
        """What was found, in words."""
        lines = []
        kinds: dict[int, list[PhotoTurn]] = {}
        for turn in self.turned:
            kinds.setdefault(round(turn.turn_deg / 90.0) * 90 % 360, []).append(turn)
        for angle, members in sorted(kinds.items()):
            listed = ", ".join(self.names[turn.photo] for turn in members)
            agree, pairs = sum(t.agreeing for t in members), sum(t.pairs for t in members)
            worst = max(abs((t.turn_deg - angle + 180.0) % 360.0 - 180.0) for t in members)
            lines.append(
                f"{listed}: turned by {angle}° against their attitude ({agree} of {pairs} matches with "
                f"neighbours agree; the mean of each lies within {worst:.1f}° of {angle}°): their yaw or "
                f"kappa is {angle}° wrong, or their pixels are stored turned (camera.rotation = {angle})"
            )
        if not lines:
            lines.append(f"no photograph is turned against its attitude ({len(self.turns)} were matched)")
        if self.unmatched:
            lines.append("not decided, no neighbour matched: " + ", ".join(self.unmatched))
        return lines


def audit_turns(project: Project) -> TurnAudit:
    """Match every photograph with its nearest neighbours at reduced size, and see how it is turned.

    Raises
    ------
    ProjectError
        If the project has fewer than two photographs with a file.
    """
    photographs = [photo for photo in project.survey.photographs if photo.path is not None]
    if len(photographs) < 2:
        raise ProjectError("must be at least two to be matched", file=project.path, field="photos.files")
    centres = np.array([photo.orientation.centre for photo in photographs])
    described = [_described(photo) for photo in photographs]
    found = []
    for left, right in _neighbours(centres):
        (features_l, z_l), (features_r, z_r) = described[left], described[right]
        matches = match_features(features_l, features_r)
        base = complex(*(centres[right] - centres[left])[:2])
        turns = pair_turns(left, right, z_l[matches.left], z_r[matches.right], base)
        if turns is not None:
            found.append(turns)
    names = tuple(photo.name for photo in photographs)
    return TurnAudit(names, photo_turns(found, len(photographs)), tuple(found))


def _described(photo: Photograph) -> tuple[Features, NDArray[np.complex128]]:
    """Features of a photograph at reduced size, and the ground offsets of their rays."""
    if photo.path is None:
        raise ProjectError("has no file", field=photo.name)
    pixels, valid, step = read_thumbnail(photo.path, _LONGEST_PX)
    features = detect_features(grey_image(pixels), FeatureOptions(max_features=_FEATURES), valid)
    rays = photo.camera.rays_from_image(features.pixels * step)
    return features, ground_offsets(rays, photo.orientation.object_from_camera)


def _neighbours(centres: Array) -> list[tuple[int, int]]:
    """Pairs of every photograph with its nearest neighbours."""
    distance = np.linalg.norm(centres[:, None, :2] - centres[None, :, :2], axis=2)
    np.fill_diagonal(distance, np.inf)
    count = min(_NEIGHBOURS, len(centres) - 1)
    nearest = np.argsort(distance, axis=1)[:, :count]
    return sorted({(min(a, b), max(a, b)) for a, row in enumerate(nearest.tolist()) for b in row})
