"""The unknowns that photographs share (the border of the normal equations), and the state of the loop."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from stereomate.block.kernels import system
from stereomate.block.network import PIXEL_PARAMETERS, Attitudes, BlockCamera, Network, Positions
from stereomate.camera.kernels import BROWN_INVERSE, FILM_INVERSE
from stereomate.camera.kernels.layout import R2_MAX
from stereomate.camera.model import Camera
from stereomate.camera.packing import moved_entries, pack_parameters
from stereomate.geometry.rotations import rotation_from_vector

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Entries = list[tuple[int, int, float]]

_AXES: Final = ("x", "y", "z")


@dataclass(frozen=True, eq=False)
class Layout:
    """Where the shared unknowns stand in the border.

    Attributes
    ----------
    names : tuple of str (q)
    first, free : ndarray of int, shape (cameras,)
        First column and number of the unknowns of each camera.
    chosen : tuple of ndarray of int
        For each camera, which of its values (`camera_values`) are unknown.
    shift, drift : ndarray of int, shape (strips,)
        First of three columns of each strip, -1 for none; the strip itself is in `strips`.
    strips : ndarray of int
    lever_arm, boresight : ndarray of int, shape (mounts,)
        First of three columns of each mount, -1 for none.
    prior_sigma : ndarray, shape (q,)
        Of each unknown, infinite for none.
    """

    names: tuple[str, ...]
    first: Integers
    free: Integers
    chosen: tuple[Integers, ...]
    strips: Integers
    shift: Integers
    drift: Integers
    lever_arm: Integers
    boresight: Integers
    prior_sigma: Array


@dataclass(frozen=True, eq=False)
class State:
    """Values of all unknowns at one moment.

    Attributes
    ----------
    centres, rotations, points
        As in the network.
    cameras : tuple of ndarray
        `camera_values` of each.
    shared : ndarray, shape (q,)
        Shifts, drifts and corrections of lever arms at their columns (the rest is not used).
    boresight : ndarray, shape (mounts, 3, 3)
    """

    centres: Array
    rotations: Array
    points: Array
    cameras: tuple[Array, ...]
    shared: Array
    boresight: Array


def camera_values(camera: Camera) -> Array:
    """Interior parameters followed by `PIXEL_PARAMETERS`, which are zero."""
    return np.array([*camera.parameters, *(0.0,) * len(PIXEL_PARAMETERS)])


def camera_from_values(camera: Camera, values: Array) -> Camera:
    """The camera with other values; aspect and shear go into `pixel_from_photo`."""
    n = len(PIXEL_PARAMETERS)
    moved = camera.with_parameters(values[:-n])
    if not values[-n:].any():
        return moved
    (a, b, c), (d, e, f) = (map(float, row) for row in _affine(camera, values))
    return replace(moved, pixel_from_photo=((a, b, c), (d, e, f)))


def _affine(camera: Camera, values: Any) -> Any:
    """`pixel_from_photo` with the aspect and the shear of `values` (n,)."""
    aspect, shear = values[-2:]
    return [[a * (1.0 + aspect), a * shear + b, c] for a, b, c in camera.pixel_from_photo]


def packed_camera(camera: Camera, values: Array, chosen: Integers) -> tuple[Array, Entries]:
    """Parameter array of the kernels (LENGTH,), and how the chosen unknowns move its entries.

    Returns
    -------
    packed : ndarray
    entries : list of (entry, unknown, derivative)
        What is not zero, by complex steps.
    """
    film, start = camera.film_stage, values.tolist()
    sheared = bool(values[-2:].any() or np.any(chosen >= len(values) - 2))

    def pack_at(now: list[Any]) -> list[Any]:
        matrix: Any = _affine(camera, now) if sheared else camera.pixel_from_photo
        packed: list[Any] = pack_parameters(now[:-2], matrix, camera.distortion, film)
        return packed

    entries = moved_entries(pack_at, start, chosen.tolist())
    if camera.jacobian_model in (BROWN_INVERSE, FILM_INVERSE):
        # The inverse needs its bracket.
        return np.array(camera_from_values(camera, values).kernel_parameters()[1]), entries
    packed = np.array(pack_at(start))
    packed[R2_MAX] = math.inf
    return packed, entries


def layout_of(network: Network) -> Layout:
    """Columns of the shared unknowns: cameras, shifts and drifts of strips, lever arm, boresight."""
    names: list[str] = []
    sigma: list[float] = []
    first, chosen = [], []
    for entry in network.cameras:
        first.append(len(names))
        numbers = _chosen(entry)
        chosen.append(numbers)
        labels = (*entry.camera.parameter_names, *PIXEL_PARAMETERS)
        names += [f"{entry.camera.name}: {labels[i]}" for i in numbers]
        sigma += [float(entry.free[labels[i]]) for i in numbers]
    positions = network.positions
    strips = np.empty(0, np.int64)
    if positions is not None and positions.strip is not None and (positions.shift or positions.drift):
        strips = np.unique(positions.strip[positions.strip >= 0])
    shift, drift = np.full(len(strips), -1), np.full(len(strips), -1)
    if positions is not None:
        for what, columns in (("shift", shift), ("drift", drift)):
            if not getattr(positions, what):
                continue
            for i, strip in enumerate(strips.tolist()):
                columns[i] = len(names)
                names += [f"strip {positions.strip_name(strip)}: {what} {axis}" for axis in _AXES]
                sigma += getattr(positions, f"{what}_sigma").tolist()
    lever_arm = boresight = np.full(1, -1)
    if positions is not None and (positions.lever_arm_sigma > 0.0).any():
        lever_arm = _of_mounts(positions, "lever arm", positions.lever_arm_sigma, names, sigma)
    attitudes = network.attitudes
    if attitudes is not None and attitudes.boresight:
        prior = np.full(3, attitudes.boresight_sigma)
        boresight = _of_mounts(attitudes, "boresight", prior, names, sigma)
    return Layout(
        tuple(names),
        np.array(first, dtype=np.int64),
        np.array([len(c) for c in chosen], dtype=np.int64),
        tuple(chosen),
        strips,
        shift.astype(np.int64),
        drift.astype(np.int64),
        lever_arm,
        boresight,
        np.array(sigma, dtype=np.float64),
    )


def _of_mounts(
    part: Positions | Attitudes, what: str, prior: Array, names: list[str], sigma: list[float]
) -> Integers:
    """Columns of what the observations of a mount share; names and priors are added."""
    assert part.mount is not None  # filled in by the network
    columns = np.full(int(part.mount.max(initial=0)) + 1, -1)
    present = np.unique(part.mount).tolist()
    for mount in present:
        columns[mount] = len(names)
        label = what
        if len(present) > 1:
            label += f" of {part.mount_names[mount] if mount < len(part.mount_names) else mount}"
        names += [f"{label} {axis}" for axis in _AXES]
        sigma += prior.tolist()
    return columns


def _chosen(entry: BlockCamera) -> Integers:
    labels = (*entry.camera.parameter_names, *PIXEL_PARAMETERS)
    return np.array([i for i, label in enumerate(labels) if label in entry.free], dtype=np.int64)


def start_of(network: Network, layout: Layout) -> State:
    """The state that the network gives."""
    return State(
        network.photographs.centres,
        network.photographs.rotations,
        network.points.xyz,
        tuple(camera_values(entry.camera) for entry in network.cameras),
        np.zeros(len(layout.names)),
        np.broadcast_to(np.eye(3), (len(layout.boresight), 3, 3)),
    )


def moved(state: State, layout: Layout, photos: Array, points: Array, shared: Array) -> State:
    """State after corrections: photographs (n, 6), points (p, 3), shared unknowns (q,)."""
    cameras = []
    for values, first, chosen in zip(state.cameras, layout.first.tolist(), layout.chosen, strict=True):
        values = values.copy()
        values[chosen] += shared[first : first + len(chosen)]
        cameras.append(values)
    boresight = state.boresight
    if (layout.boresight >= 0).any():
        boresight = boresight @ rotation_from_vector(of_mounts(layout.boresight, shared))
    centres, rotations = state.centres.copy(), state.rotations.copy()
    system.move(photos, centres, rotations)
    return State(
        centres,
        rotations,
        state.points + points,
        tuple(cameras),
        state.shared + shared,
        boresight,
    )


def prior_residuals(state: State, start: State, layout: Layout) -> Array:
    """Observed minus computed of the priors of the shared unknowns, shape (q,)."""
    residual = -state.shared
    for now, then, first, chosen in zip(
        state.cameras, start.cameras, layout.first.tolist(), layout.chosen, strict=True
    ):
        residual[first : first + len(chosen)] = then[chosen] - now[chosen]
    for at, boresight in zip(layout.boresight.tolist(), state.boresight, strict=True):
        if at >= 0:
            residual[at : at + 3] = -vector_from_rotation(boresight)
    return residual


def of_mounts(columns: Integers, shared: Array) -> Array:
    """Three numbers of each mount (mounts, 3) out of the shared unknowns; zeros where it has none."""
    taken = shared[np.maximum(columns, 0)[:, None] + np.arange(3)] if len(shared) else np.zeros((1, 3))
    return np.where((columns >= 0)[:, None], taken, 0.0)


def vector_from_rotation(rotation: Array) -> Array:
    """Rotation vectors (..., 3) of rotations (..., 3, 3) by less than 180°: the inverse of Rodrigues."""
    axis = 0.5 * np.stack(
        [
            rotation[..., 2, 1] - rotation[..., 1, 2],
            rotation[..., 0, 2] - rotation[..., 2, 0],
            rotation[..., 1, 0] - rotation[..., 0, 1],
        ],
        axis=-1,
    )
    sine = np.linalg.norm(axis, axis=-1)
    cosine = 0.5 * (np.trace(rotation, axis1=-2, axis2=-1) - 1.0)
    angle = np.arctan2(sine, cosine)
    factor = np.where(sine > 1e-9, angle / np.where(sine > 1e-9, sine, 1.0), 1.0)
    result: Array = axis * factor[..., None]
    return result
