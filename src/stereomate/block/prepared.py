"""A network made ready for the kernels: sorted, weighted, its photographs in an order of small bandwidth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from stereomate.block.kernels.structure import bandwidth, neighbours, order_by
from stereomate.block.network import Network
from stereomate.block.unknowns import Layout, layout_of

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

# From this part of the matrix on a band is no gain over a dense matrix.
_DENSE: Final = 0.7
# Up to so many photographs a band is not looked for.
_SMALL: Final = 30


@dataclass(frozen=True, eq=False)
class Prepared:
    """What stays the same in all iterations.

    Attributes
    ----------
    network : Network
    layout : Layout
    order : ndarray of int, shape (m,)
        Rows of ``network.image`` sorted by point and by place of the photograph.
    start : ndarray of int, shape (p + 1,)
        First sorted observation of each point.
    photo, point, xy, weight : ndarray
        Sorted observations; the weight is 0 for those that take no part.
    place : ndarray of int, shape (n,)
        Position of each photograph in the matrix.
    width : int
        Rows of the band (unknowns), or of the dense matrix.
    skew : int
        1 for the band form, 0 for the dense form.
    control : ndarray of int, shape (p,)
        Row in the control arrays, -1 for none; check points have none.
    control_xyz, control_weight, control_free : ndarray, shape (k, 3), (k, 3, 3), (k, 3)
    free_photo : ndarray, shape (n, 6)
        0 for unknowns held fixed.
    any_held : bool
        Whether there are such.
    camera_start, camera_of : ndarray of int, shape (p + 1,), (cameras of points,)
        Cameras with unknowns that see each point, ascending.
    """

    network: Network
    layout: Layout
    order: Integers
    start: Integers
    photo: Integers
    point: Integers
    xy: Array
    weight: Array
    place: Integers
    width: int
    skew: int
    control: Integers
    control_xyz: Array
    control_weight: Array
    control_free: Array
    free_photo: Array
    any_held: bool
    camera_start: Integers
    camera_of: Integers


def prepare(network: Network, used: Mask | None = None) -> Prepared:
    """Sort and weight a network.

    Parameters
    ----------
    network : Network
    used : ndarray of bool, shape (m,), optional
        Image observations that take part; all if None. Those of points that fewer than two rays and no
        control determine are left out in any case (their weight is zero).
    """
    image, photographs = network.image, network.photographs
    n, p = len(photographs.names), len(network.points.names)
    order = np.arange(len(image.photo))
    photo_start = order_by(image.photo, n, order)
    by_photo_unsorted = order.copy()
    start = order_by(image.point, p, order)
    photo, point = image.photo[order], image.point[order]
    place, reach = np.arange(n), n
    if n > _SMALL:
        rank = np.empty(len(order), np.int64)
        rank[order] = np.arange(len(order))
        starts, others = neighbours(photo, start, rank[by_photo_unsorted], photo_start, point)
        place, reach = _best_order(starts, others, photographs.centres)
    # Within each point by place in the matrix.
    if not np.array_equal(place, np.arange(n)):
        order = np.arange(len(image.photo))
        order_by(place[image.photo], n, order)
        order_by(image.point, p, order)
        photo = image.photo[order]
    unknowns = 6 * n
    width = min(6 * reach + 6, unknowns)
    dense = width >= _DENSE * unknowns
    control, xyz, weight, free = _control(network)
    weights = 1.0 / image.sigma[order] ** 2
    if used is not None:
        weights[~used[order]] = 0.0
    active = (weights[:, 0] > 0.0) & _solvable(point, weights, control, weight, free)[point]
    weights[~active] = 0.0
    fixed = photographs.fixed
    free_photo: Array = np.ones((n, 6)) if fixed is None else 1.0 - fixed.astype(np.float64)
    layout = layout_of(network)
    return Prepared(
        network, layout, order, start, photo, point, image.xy[order], weights, place,
        unknowns if dense else width, 0 if dense else 1, control, xyz, weight, free, free_photo,
        fixed is not None and bool(fixed.any()), *_cameras_of_points(network, layout, photo, point),
    )  # fmt: skip


def _cameras_of_points(
    network: Network, layout: Layout, photo: Integers, point: Integers
) -> tuple[Integers, Integers]:
    """Cameras with unknowns that see each point, as (starts, indices)."""
    p, count = len(network.points.names), len(network.cameras)
    if not layout.free.any():
        return np.zeros(p + 1, np.int64), np.empty(0, np.int64)
    if count == 1:
        return np.arange(p + 1), np.zeros(p, np.int64)
    camera = network.photographs.camera[photo]
    pairs = np.unique((point * count + camera)[layout.free[camera] > 0])
    starts = np.searchsorted(pairs, np.arange(p + 1) * count)
    return starts.astype(np.int64), pairs % count


def _solvable(point: Integers, weights: Array, control: Integers, info: Array, free: Array) -> Mask:
    """Points that two rays determine, or one ray and enough control."""
    rays = np.bincount(point[weights[:, 0] > 0.0], minlength=len(control))
    known = np.zeros(len(control))
    has = control >= 0
    rows = control[has]
    known[has] = ((info[rows][:, [0, 1, 2], [0, 1, 2]] > 0.0) | (free[rows] == 0.0)).sum(axis=1)
    return np.asarray((rays >= 2) | ((rays == 1) & (known >= 1)))


def _best_order(starts: Integers, others: Integers, centres: Array) -> tuple[Integers, int]:
    """Place of each photograph in the order of least bandwidth, and that bandwidth (photographs).

    Tried: as they come, along the two main directions of the flight, and reverse Cuthill-McKee.
    """
    n = len(starts) - 1
    orders = [np.arange(n)]
    spread = centres - centres.mean(axis=0)
    _, _, axes = np.linalg.svd(spread, full_matrices=False) if n > 2 else (0, 0, np.eye(3))
    orders += [np.argsort(spread @ axis, kind="stable") for axis in axes[:2]]
    graph = csr_array((np.ones(len(others), np.int8), others, starts), shape=(n, n))
    orders.append(np.asarray(reverse_cuthill_mckee(graph, symmetric_mode=True), dtype=np.int64))
    best: tuple[int, Integers] | None = None
    for order in orders:
        place = np.empty(n, np.int64)
        place[order] = np.arange(n)
        reach = int(bandwidth(starts, others, place))
        if best is None or reach < best[0]:
            best = reach, place
    assert best is not None
    return best[1], best[0]


def _control(network: Network) -> tuple[Integers, Array, Array, Array]:
    """Row of each point, coordinates, information matrices and free axes of the control points."""
    p = len(network.points.names)
    rows = np.full(p, -1)
    control = network.control
    if control is None or not len(control.point):
        return rows.astype(np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3))
    assert control.check is not None
    use = np.flatnonzero(~control.check)
    rows[control.point[use]] = np.arange(len(use))
    sigma = control.sigma[use]
    held = sigma == 0.0
    with np.errstate(divide="ignore"):
        info = np.where(held, 0.0, 1.0 / sigma**2)
    xyz = np.where(held | (info > 0.0), control.xyz[use], 0.0)
    weight = np.zeros((len(use), 3, 3))
    weight[:, [0, 1, 2], [0, 1, 2]] = info
    if control.covariance is not None:
        full = np.isfinite(control.covariance[use]).all(axis=(1, 2))
        weight[full] = np.linalg.inv(control.covariance[use][full])
        held[full] = False
    return rows.astype(np.int64), xyz, weight, np.where(held, 0.0, 1.0)


def fixed_axes_applied(prepared: Prepared, points: Array) -> Array:
    """Points with the coordinates that control holds fixed."""
    has = prepared.control >= 0
    rows = prepared.control[has]
    points = points.copy()
    points[has] = np.where(prepared.control_free[rows] == 0.0, prepared.control_xyz[rows], points[has])
    return points
