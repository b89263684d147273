"""A second orientation of the same photographs beside the one that is used: how far apart the two are."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stereomate.coverage.survey import Survey
from stereomate.geometry.rotations import rotation_angle
from stereomate.project.orientations import Reading, read_orientations
from stereomate.project.photos import match_names
from stereomate.project.schema import OrientationSection

# Above this the two orientations are not the same one written in two ways.
_SAME_DEG = 0.02
_SAME_PX = 1.0


@dataclass(frozen=True)
class OrientationDifference:
    """Second orientation against the first, for one photograph.

    Attributes
    ----------
    name : str
    angle_deg : float
        Angle of the rotation between the two.
    angle_px : float
        What it moves the middle of the image by.
    shift_m : (float, float, float)
        Second centre minus first, east, north, up of the tangent frame.
    """

    name: str
    angle_deg: float
    angle_px: float
    shift_m: tuple[float, float, float]


@dataclass(frozen=True)
class Comparison:
    """All photographs that both orientations have."""

    source: str
    differences: tuple[OrientationDifference, ...]

    @property
    def is_same(self) -> bool:
        """Whether the two are one orientation, up to rounding."""
        return all(d.angle_deg <= _SAME_DEG or d.angle_px <= _SAME_PX for d in self.differences)

    @property
    def sentence(self) -> str:
        """The finding in words."""
        if not self.differences:
            return f"{self.source} orients none of these photographs"
        angles = [d.angle_deg for d in self.differences]
        pixels = float(np.mean([d.angle_px for d in self.differences]))
        shift = float(np.sqrt(np.mean([np.sum(np.square(d.shift_m)) for d in self.differences])))
        return (
            f"the orientation in {self.source} "
            + ("agrees with" if self.is_same else "is not the same as")
            + f" the one used: angles differ by {np.mean(angles):.2f}° on average ({min(angles):.2f}° to "
            f"{max(angles):.2f}°, {pixels:.1f} px), centres by {shift:.2f} m rms"
        )


def compare_orientations(section: OrientationSection, reading: Reading, survey: Survey) -> Comparison:
    """Differences of a second orientation to that of a survey.

    Raises
    ------
    ProjectError, FormatError, OrientationError, CrsError, HeightSystemError
        As reading any orientation.
    """
    written = read_orientations(section, reading)
    photos = {photo.path: photo for photo in survey.photographs if photo.path is not None}
    matched, _ = match_names(written.names, sorted(photos), written.source)
    centres = written.centres(survey.tangent)
    rotations = written.placed(survey.tangent, centres)
    differences = []
    for index, name in enumerate(written.names):
        if name not in matched:
            continue
        photo = photos[matched[name]]
        turn = photo.orientation.object_from_camera.T @ rotations[index]
        angle = float(rotation_angle(turn))
        shift = centres[index] - np.array(photo.orientation.centre)
        focal_px = photo.camera.principal_distance_mm * abs(_pixels_per_mm(photo.camera.pixel_from_photo))
        differences.append(
            OrientationDifference(
                photo.name,
                math.degrees(angle),
                angle * focal_px,
                (float(shift[0]), float(shift[1]), float(shift[2])),
            )
        )
    return Comparison(written.source.name, tuple(sorted(differences, key=lambda d: d.name)))


def _pixels_per_mm(affine: tuple[tuple[float, ...], ...]) -> float:
    (a, b, _), (d, e, _) = affine
    return math.sqrt(abs(a * e - b * d))
