"""Bring a joined model into the tangent frame: by positions of photographs, by control points, or neither.

Three places in space that are not on a line determine the seven parameters of a similarity; gross errors
among more are weighted down. What determines less (a single strip, control in plan only) is helped by the
angles that the photographs state, or else by their mean axis, taken as the plumb line; the result says so.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import NotDeterminedError
from stereomate.geometry.adjustment import AdjustmentOptions
from stereomate.geometry.rotations import rotation_angle, rotation_z
from stereomate.geometry.similarity import SpaceTransform, estimate_space_transform

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_ROBUST: Final = AdjustmentOptions(loss="huber", max_iterations=50)
# Places within this part of their extent of a line say too little about turns around it.
_ON_A_LINE: Final = 0.05
# Stated angles that turn the model alike are within this of each other, and more than half of them are.
_ALIKE: Final = math.radians(15.0)


@dataclass(frozen=True)
class Places:
    """Places known both in the model and in the tangent frame.

    Parameters
    ----------
    kind : {"positions", "control"}
        Projection centres from GNSS, or control points.
    names : tuple of str
    model, target : ndarray, shape (n, 3)
        NaN in `target` for an axis that is not known.
    sigma : ndarray, shape (n, 3)
        Standard deviations of the targets, metres.
    """

    kind: Literal["positions", "control"]
    names: tuple[str, ...]
    model: Array
    target: Array
    sigma: Array

    @property
    def full(self) -> Mask:
        """Places known in all three axes."""
        return np.asarray(np.isfinite(self.target).all(axis=1))


@dataclass(frozen=True)
class Datum:
    """How a model was brought into the tangent frame.

    Attributes
    ----------
    transform : SpaceTransform
        Tangent frame from model.
    kind : {"positions", "control", "none"}
    residuals : ndarray, shape (n, 3)
        Known minus transformed; NaN for unknown axes.
    outliers : tuple of str
        Places that contradict the others.
    notes : tuple of str
        What was assumed.
    """

    transform: SpaceTransform
    kind: Literal["positions", "control", "none"]
    residuals: Array
    outliers: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def find_datum(rotations: Array, sources: tuple[Places, ...], stated: Array | None = None) -> Datum:
    """The transform from a model to the tangent frame.

    Parameters
    ----------
    rotations : ndarray, shape (n, 3, 3)
        Object from camera of the photographs of the model, in its frame.
    sources : tuple of Places
        In the order of preference; the first that determines a datum is used.
    stated : ndarray, shape (n, 3, 3), optional
        Rotations of the same photographs in the tangent frame as they are stated beforehand; NaN for unknown.

    Returns
    -------
    Datum
        Of kind "none" where nothing determines one: levelled by the photographs' mean axis, scale as it was.
    """
    for places in sources:
        full = places.full
        if np.count_nonzero(full) >= 3 and not _on_a_line(places.model[full]):
            return _by_similarity(places)
    for places in sources:
        plan = np.asarray(np.isfinite(places.target[:, :2]).all(axis=1))
        if np.count_nonzero(plan) >= 2 and np.isfinite(places.target[:, 2]).any():
            return _by_vertical(places, plan, rotations, stated)
    level = SpaceTransform.from_arrays(_levelling(rotations), np.zeros(3))
    return Datum(
        level,
        "none",
        np.empty((0, 3)),
        (),
        ("neither positions nor control points determine place, direction and scale: they are arbitrary",),
    )


def _on_a_line(points: Array) -> bool:
    singular = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(singular[1] <= _ON_A_LINE * singular[0])


def _by_similarity(places: Places) -> Datum:
    full = places.full
    found = estimate_space_transform(
        places.model[full], places.target[full], sigma=places.sigma[full], options=_ROBUST
    )
    residuals = places.target - found.transform.apply(places.model)
    size = np.linalg.norm(np.nan_to_num(residuals) / places.sigma, axis=1)
    # Robust scatter, so that one wrong place does not hide another.
    scatter = max(1.0, 1.4826 * float(np.median(size[full])) / math.sqrt(3.0))
    bad = size > 6.0 * scatter
    names = tuple(name for name, is_bad in zip(places.names, bad, strict=True) if is_bad)
    return Datum(found.transform, places.kind, residuals, names)


def _by_vertical(places: Places, plan: Mask, rotations: Array, stated: Array | None) -> Datum:
    """Levelled by stated angles or the mean axis, then turned, scaled and moved in plan, then lifted."""
    what = "control points" if places.kind == "control" else "positions"
    note = f"the {what} lie on a line or lack heights: they leave a tilt open, and "
    levels = [] if stated is None else _by_stated_angles(rotations, stated)
    if not levels:
        turn, scale = _in_plan(places, plan, _levelling(rotations))
        note += "the mean axis of the photographs was taken as the plumb line to start with"
    else:
        # Of pixels stored as stated or turned by half a turn, what leaves less to turn in plan.
        fits = [(_in_plan(places, plan, level), level) for level in levels]
        (turn, scale), _ = min(fits, key=lambda fit: float(rotation_angle(fit[0][0] @ fit[1].T)))
        note += "the angles that the photographs state were taken to start with"
    there = places.target[plan, :2]
    moved = scale * (places.model @ turn.T)
    shift = np.array([*(there.mean(axis=0) - moved[plan, :2].mean(axis=0)), 0.0])
    known = np.isfinite(places.target[:, 2])
    shift[2] = float(np.median(places.target[known, 2] - moved[known, 2]))
    transform = SpaceTransform.from_arrays(turn, shift, scale)
    return Datum(transform, places.kind, places.target - transform.apply(places.model), (), (note,))


def _in_plan(places: Places, plan: Mask, level: Array) -> tuple[Array, float]:
    """Rotation and scale of a levelled model by its places in plan."""
    here, there = (places.model @ level.T)[plan, :2], places.target[plan, :2]
    a, b = here - here.mean(axis=0), there - there.mean(axis=0)
    square = float(np.sum(a * a))
    if not square > 0.0:
        raise NotDeterminedError(f"datum: all {places.kind} are in one place")
    cosine = float(np.sum(a * b)) / square
    sine = float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])) / square
    scale = math.hypot(cosine, sine)
    if not scale > 0.0:
        raise NotDeterminedError(f"datum: the {places.kind} do not correspond to the model")
    return rotation_z(math.atan2(sine, cosine)) @ level, scale


def _by_stated_angles(rotations: Array, stated: Array) -> list[Array]:
    """Rotations to the tangent frame by stated angles, and by these with the pixels turned by half a turn.

    What more than half of the photographs agree on; nothing where they do not.
    """
    known = np.isfinite(stated).all(axis=(1, 2))
    if not known.any():
        return []
    found = []
    for half_turn in (np.eye(3), np.diag([-1.0, -1.0, 1.0])):
        each = stated[known] @ half_turn @ np.swapaxes(rotations[known], 1, 2)
        apart = rotation_angle(each[:, None] @ np.swapaxes(each, 1, 2)[None])
        alike = apart < _ALIKE
        best = int(alike.sum(axis=1).argmax())
        if 2 * int(alike[best].sum()) > len(each):
            u, _, v = np.linalg.svd(each[alike[best]].sum(axis=0))
            found.append(np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v))
    return found


def _levelling(rotations: Array) -> Array:
    """The smallest turn that makes the mean camera axis point down."""
    up = rotations[:, :, 2].mean(axis=0)
    length = float(np.linalg.norm(up))
    if not length > 1e-6:
        return np.eye(3)
    up = up / length
    axis = np.cross(up, [0.0, 0.0, 1.0])
    sine, cosine = float(np.linalg.norm(axis)), float(up[2])
    if sine < 1e-12:
        return np.eye(3) if cosine > 0.0 else np.diag([1.0, -1.0, -1.0])
    x, y, z = axis / sine
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turn: Array = np.eye(3) + sine * cross + (1.0 - cosine) * (cross @ cross)
    return turn
