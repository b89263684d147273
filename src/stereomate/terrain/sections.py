"""Cross-sections of the ground under a projection centre, perpendicular to a base.

The section that decides how well a pair can be oriented (Kasper 1956): the plane through a projection centre
square to the base, with y across the strip and z the depth below the centre.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import InputError
from stereomate.frames.tangent import TangentFrame
from stereomate.terrain.intersection import ground_distances
from stereomate.terrain.model import HeightModel

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CrossSection:
    """What rays from a projection centre meet in the plane square to the base.

    Attributes
    ----------
    tangents : ndarray (n,)
        y / z of the rays.
    y, z : ndarray (n,)
        Metres: y to the left of the base, z down in the plane, both from the centre. NaN where a ray meets
        a void or leaves the height model.
    points : ndarray (n, 3)
        The same points in the tangent frame.
    """

    tangents: Floats
    y: Floats
    z: Floats
    points: Floats

    @property
    def section(self) -> Floats:
        """(y, z) as rows, (n, 2): the form that the over-correction factor takes."""
        return np.column_stack([self.y, self.z])

    @property
    def known(self) -> NDArray[np.bool_]:
        """Which rays meet the ground."""
        return np.isfinite(self.y)


def section_axes(tangent: TangentFrame, centre: ArrayLike, base: ArrayLike) -> Floats:
    """Axes of the section as rows of (3, 3), in the tangent frame: along the base, to its left, downwards.

    Raises
    ------
    InputError
        If the base is zero or vertical.
    """
    place, along = np.asarray(centre, np.float64), np.asarray(base, np.float64)
    length = float(np.linalg.norm(along))
    lon, lat, _ = tangent.geodetic_from_tangent(place)
    up = tangent.rotation_tangent_from_enu(lon, lat)[:, 2]
    left = np.cross(up, along)
    sideways = float(np.linalg.norm(left))
    if not sideways > 1e-9 * max(length, 1e-300):
        raise InputError("must be neither zero nor vertical", field="base", value=tuple(map(float, along)))
    along, left = along / length, left / sideways
    return np.stack([along, left, np.cross(left, along)])


def cross_section(
    model: HeightModel, tangent: TangentFrame, centre: ArrayLike, base: ArrayLike, tangents: ArrayLike
) -> CrossSection:
    """The cross-section of a height model under a projection centre.

    Parameters
    ----------
    model : HeightModel
    tangent : TangentFrame
        Frame of centre and base.
    centre, base : array_like (3,)
        Projection centre, and the vector to the other one.
    tangents : array_like (n,)
        y / z of the rays to follow: a few for orientation points, many for a profile. What a ray meets first
        is taken, as the photograph does.

    Raises
    ------
    InputError
        If the base is zero or vertical, or a tangent is not finite.
    """
    (section,) = cross_sections(model, tangent, np.asarray(centre, np.float64)[None], base, tangents)
    return section


def cross_sections(
    model: HeightModel, tangent: TangentFrame, centres: ArrayLike, base: ArrayLike, tangents: ArrayLike
) -> tuple[CrossSection, ...]:
    """Several cross-sections square to one base, followed all at once: for as many profiles much faster.

    Parameters
    ----------
    centres : array_like (m, 3)
        Points of the base line the sections are taken from.
    model, tangent, base, tangents
        As for `cross_section`, which says what is raised.
    """
    t = np.asarray(tangents, np.float64).ravel()
    if not np.isfinite(t).all():
        raise InputError("must be finite", field="tangents")
    starts = np.asarray(centres, np.float64).reshape(-1, 3)
    cosine = 1.0 / np.sqrt(1.0 + t**2)
    directions = np.empty((len(starts), len(t), 3))
    for k, start in enumerate(starts):
        _, left, down = section_axes(tangent, start, base)
        directions[k] = cosine[:, None] * (t[:, None] * left + down)
    origins = np.repeat(starts, len(t), axis=0)
    distances = ground_distances(model, tangent, origins, directions.reshape(-1, 3)).reshape(len(starts), -1)
    return tuple(
        CrossSection(
            tangents=t,
            y=distance * cosine * t,
            z=distance * cosine,
            points=start + distance[:, None] * rays,
        )
        for start, distance, rays in zip(starts, distances, directions, strict=True)
    )
