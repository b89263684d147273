"""Models to practise on: the six standard points over terrain of given heights, and wrong orientations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import InputError
from stereomate.relative.empirical.projectors import PlotterModel, Projector, Setting, model_from_points

FloatArray = NDArray[np.float64]

STANDARD_POINTS = ("1", "2", "3", "4", "5", "6")


@dataclass(frozen=True)
class StandardTerrain:
    """The six points of von Gruber and the terrain between them.

    Attributes
    ----------
    heights : tuple of float
        Heights of points 1 to 6 above the level of the flying height, in units of it.
    tangent : float
        y/z of the rays to points 3, 4, 5 and 6: image ordinate over principal distance.
    flying_height : float
        Metres.
    base : float
        Metres.
    """

    heights: tuple[float, ...] = (0.0,) * 6
    tangent: float = 2.0 / 3.0
    flying_height: float = 1500.0
    base: float = 1000.0

    def __post_init__(self) -> None:
        if len(self.heights) != 6:
            raise InputError("must be six heights, of points 1 to 6", field="heights", value=self.heights)
        if not all(math.isfinite(h) and h < 1.0 for h in self.heights):
            raise InputError(
                "must be finite and below 1 (the projection centres), in units of the flying height",
                field="heights",
                value=self.heights,
            )
        for name in ("tangent", "flying_height", "base"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise InputError("must be positive and finite", field=name, value=getattr(self, name))

    def points(self) -> FloatArray:
        """Model coordinates (6, 3) of points 1 to 6; z up, the projection centres at z = 0."""
        depth = self.flying_height * (1.0 - np.array(self.heights))
        across = self.tangent * np.array([0.0, 0.0, -1.0, -1.0, 1.0, 1.0]) * depth
        return np.stack((self.base * np.array([0.0, 1.0] * 3), across, -depth), axis=-1)

    def section(self, right: bool = False) -> FloatArray:
        """Cross-section (3, 2) of points 1, 3, 5, or 2, 4, 6, by y and z down."""
        chosen = self.points()[1 if right else 0 :: 2]
        return np.stack((chosen[:, 1], -chosen[:, 2]), axis=-1)

    def grid(self, columns: int = 5, rows: int = 9) -> tuple[tuple[str, ...], FloatArray]:
        """Check points over the whole model: names and coordinates; heights linear between the six points."""
        u = np.linspace(0.0, 1.0, columns)
        v = np.linspace(-1.0, 1.0, rows)
        h = np.array(self.heights).reshape(3, 2)  # rows: middle, the side of 3 and 4, that of 5 and 6
        along = h[:, :1] + (h[:, 1:] - h[:, :1]) * u
        sides = np.where(v[:, None] < 0.0, along[1], along[2])
        height = along[0] + (sides - along[0]) * np.abs(v)[:, None]
        depth = self.flying_height * (1.0 - height)
        x = np.broadcast_to(self.base * u, depth.shape)
        points = np.stack((x, self.tangent * v[:, None] * depth, -depth), axis=-1)
        names = tuple(f"g{row + 1}.{column + 1}" for row in range(rows) for column in range(columns))
        return names, points.reshape(-1, 3)

    def model(self, truth: Setting, with_grid: bool = True) -> PlotterModel:
        """What photographs with the orientation `truth` see of it."""
        names: tuple[str, ...] = STANDARD_POINTS
        points = self.points()
        if with_grid:
            more, grid = self.grid()
            names, points = names + more, np.concatenate((points, grid))
        return model_from_points(names, points, truth)


def wrong_orientation(
    base: float,
    seed: int,
    tilt: float = math.radians(1.0),
    shift_ratio: float = 0.02,
    independent: bool = False,
) -> Setting:
    """A random orientation of the photographs for the instrument to find from zero.

    Parameters
    ----------
    base : float
        Metres.
    seed : int
    tilt : float
        Largest angle in radians; each is uniform between it and its negative.
    shift_ratio : float
        Largest by and bz in units of the base.
    independent : bool
        Angles of both projectors (not ω of the left) without by and bz, instead of all elements of the right.

    Raises
    ------
    InputError
        If the tilt or the shifts are negative or not finite.
    """
    for name, value in (("tilt", tilt), ("shift_ratio", shift_ratio)):
        if not (math.isfinite(value) and value >= 0.0):
            raise InputError("must be finite and not negative", field=name, value=value)
    random = np.random.default_rng(seed)
    angles = (tilt * random.uniform(-1.0, 1.0, 6)).tolist()
    by, bz = (base * shift_ratio * random.uniform(-1.0, 1.0, 2)).tolist()
    if independent:
        return Setting(base, Projector(phi=angles[1], kappa=angles[2]), Projector(0.0, 0.0, *angles[3:]))
    return Setting(base, right=Projector(by, bz, *angles[:3]))


def section_profiles(
    terrain: StandardTerrain, truth: Setting, positions: Sequence[float]
) -> tuple[PlotterModel, tuple[tuple[str, str, str], ...]]:
    """The model with cross-sections at several places along the base, and their points by name.

    Parameters
    ----------
    terrain : StandardTerrain
    truth : Setting
    positions : sequence of float
        Places of the sections in units of the base, 0 at the left projector.
    """
    names: list[str] = list(STANDARD_POINTS)
    points = [terrain.points()]
    profiles = []
    for number, place in enumerate(positions, start=1):
        six = terrain.points().reshape(3, 2, 3)
        points.append(six[:, 0] + (six[:, 1] - six[:, 0]) * place)
        profiles.append((f"p{number}.1", f"p{number}.3", f"p{number}.5"))
        names += profiles[-1]
    return model_from_points(names, np.concatenate(points), truth), tuple(profiles)
