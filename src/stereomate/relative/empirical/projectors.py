"""Two projectors, the model they project, and its y-parallaxes, exactly.

Model axes: x along the base from the left to the right projector, y across, z up; the left projector stands
at (0, by1, bz1), the right one at (b, by2, bz2). R = Rx(ω) Ry(φ) Rz(κ), camera to model. An image vector is
(x, y, -c) in any unit, or any multiple of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import InputError
from stereomate.geometry.rotations import rotation_from_opk
from stereomate.relative.kernels import projectors as kernels

FloatArray = NDArray[np.float64]

Motion = Literal[
    "by1", "bz1", "omega1", "phi1", "kappa1", "by2", "bz2", "omega2", "phi2", "kappa2"
]  # fmt: skip
MOTIONS: Final[tuple[Motion, ...]] = get_args(Motion)
ANGLES: Final = ("omega", "phi", "kappa")


@dataclass(frozen=True)
class Projector:
    """Setting of one projector: shifts in metres, rotations in radians."""

    by: float = 0.0
    bz: float = 0.0
    omega: float = 0.0
    phi: float = 0.0
    kappa: float = 0.0

    @property
    def rotation(self) -> FloatArray:
        """Rotation camera to model, shape (3, 3)."""
        return rotation_from_opk([self.omega, self.phi, self.kappa])


@dataclass(frozen=True)
class Setting:
    """Both projectors and the length of the base bx in metres."""

    base: float
    left: Projector = Projector()
    right: Projector = Projector()

    def __post_init__(self) -> None:
        if not (np.isfinite(self.base) and self.base > 0.0):
            raise InputError("must be positive and finite", field="base", value=self.base)

    def parameters(self) -> FloatArray:
        """All of it as an array (11,): the motions in the order of `MOTIONS`, then the base."""
        return np.array([*(self.value(motion) for motion in MOTIONS), self.base])

    def value(self, motion: Motion) -> float:
        """What the scale of a motion reads."""
        name, projector = self._split(motion)
        return float(getattr(projector, name))

    def moved(self, motion: Motion, value: float) -> Setting:
        """The setting with one motion set to a value."""
        name, projector = self._split(motion)
        changed = replace(projector, **{name: float(value)})
        return replace(self, left=changed) if motion.endswith("1") else replace(self, right=changed)

    def centre(self, projector: int) -> FloatArray:
        """Projection centre of projector 1 or 2 in the model, shape (3,)."""
        if projector == 1:
            return np.array([0.0, self.left.by, self.left.bz])
        return np.array([self.base, self.right.by, self.right.bz])

    def _split(self, motion: Motion) -> tuple[str, Projector]:
        if motion not in MOTIONS:
            raise InputError(f"must be one of {', '.join(MOTIONS)}", field="motion", value=motion)
        return motion[:-1], self.left if motion.endswith("1") else self.right


@dataclass(frozen=True)
class PlotterModel:
    """Points of a model as seen in both photographs.

    Attributes
    ----------
    names : tuple of str
    left, right : ndarray (n, 3)
        Image vectors in the camera frames, z negative.
    """

    names: tuple[str, ...]
    left: FloatArray
    right: FloatArray

    def __post_init__(self) -> None:
        if len(set(self.names)) != len(self.names):
            twice = sorted({name for name in self.names if self.names.count(name) > 1})
            raise InputError("must be unique", field="point names", value=twice)
        for side, vectors in (("left", self.left), ("right", self.right)):
            if vectors.shape != (len(self.names), 3):
                raise InputError(
                    f"must have shape ({len(self.names)}, 3)",
                    field=f"{side} image vectors",
                    value=vectors.shape,
                )
            bad = ~(np.isfinite(vectors).all(axis=1) & (vectors[:, 2] < 0.0))
            if bad.any():
                raise InputError(
                    "must be finite and point away from the camera (z below zero)",
                    field=f"{side} image vector of point {self.names[int(np.argmax(bad))]}",
                    value=vectors[int(np.argmax(bad))].tolist(),
                )

    def index(self, name: str) -> int:
        """Row of a point.

        Raises
        ------
        InputError
            If the model has no such point.
        """
        if name not in self.names:
            raise InputError(
                f"must be one of the model's points {', '.join(self.names)}", field="point", value=name
            )
        return self.names.index(name)

    def only(self, names: Sequence[str]) -> PlotterModel:
        """The model of some of its points, in the order asked for."""
        rows = [self.index(name) for name in names]
        return PlotterModel(tuple(names), self.left[rows], self.right[rows])


def model_from_points(names: Sequence[str], points: ArrayLike, truth: Setting) -> PlotterModel:
    """What two photographs with a known orientation see of given points.

    Parameters
    ----------
    names : sequence of str
    points : array_like, shape (n, 3)
        Model coordinates x, y, z in metres (z up; the left projection centre of an untouched setting at 0).
    truth : Setting
        Orientation of the photographs.

    Raises
    ------
    InputError
        If a coordinate is not finite or a point is behind a photograph.
    """
    ground = np.asarray(points, dtype=np.float64)
    if ground.ndim != 2 or ground.shape[1] != 3:
        raise InputError("must have shape (n, 3)", field="points", value=ground.shape)
    vectors = [
        (ground - truth.centre(number)) @ projector.rotation
        for number, projector in ((1, truth.left), (2, truth.right))
    ]
    return PlotterModel(tuple(names), *vectors)


def model_from_image_coordinates(
    names: Sequence[str], left: ArrayLike, right: ArrayLike, principal_distance: float
) -> PlotterModel:
    """The model of measured image coordinates, x right and y up, in the unit of the principal distance.

    Parameters
    ----------
    names : sequence of str
    left, right : array_like, shape (n, 2)
        Refined image coordinates (principal point and distortion removed).
    principal_distance : float
    """
    if not (np.isfinite(principal_distance) and principal_distance > 0.0):
        raise InputError("must be positive and finite", field="principal_distance", value=principal_distance)
    vectors = []
    for side, coordinates in (("left", left), ("right", right)):
        xy = np.asarray(coordinates, dtype=np.float64)
        if xy.ndim != 2 or xy.shape[1] != 2:
            raise InputError("must have shape (n, 2)", field=f"{side} image coordinates", value=xy.shape)
        vectors.append(np.column_stack((xy, np.full(len(xy), -principal_distance))))
    return PlotterModel(tuple(names), *vectors)


def y_parallaxes(model: PlotterModel, setting: Setting) -> FloatArray:
    """y-parallax at each point: left minus right where the x-parallax is removed, metres in the model.

    Returns
    -------
    ndarray, shape (n,)
        nan where the two rays do not meet below both projectors.
    """
    return _measure(model, setting)[0][:, 0]


def model_points(model: PlotterModel, setting: Setting) -> FloatArray:
    """Model coordinates (n, 3), x-parallax removed, y from the middle of the two rays; nan as above."""
    return _measure(model, setting)[0][:, 1:]


def parallax_jacobian(model: PlotterModel, setting: Setting, motions: Sequence[Motion]) -> FloatArray:
    """Derivatives of the y-parallaxes by motions, shape (n, motions), metres per metre or radian; or nan."""
    return _measure(model, setting)[1][:, [MOTIONS.index(motion) for motion in motions]]


def _measure(model: PlotterModel, setting: Setting) -> tuple[FloatArray, FloatArray]:
    points, jacobian = np.empty((len(model.names), 4)), np.empty((len(model.names), 10))
    kernels.measure(model.left, model.right, setting.parameters(), points, jacobian)
    return points, jacobian
