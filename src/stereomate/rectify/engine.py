"""Orthophoto and stereomate of one window of a product, straight from the photographs.

The work of a chunk: ground under the window, the model that serves each pixel's ground, positions in the
photographs, resampling. The stereomate differs only in that its ground positions come from inverting
x - q(h(x)) along the rows; both ask the same surface and the same serving rule, so their seams coincide
on the ground.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from stereomate.raster import PhotoReader, Window
from stereomate.rectify.blend import photographs_across
from stereomate.rectify.ground import Ground, ground_of, heights_of, mate_positions, shown_ground
from stereomate.rectify.job import RectifyJob
from stereomate.rectify.kernels.seam_levels import lift
from stereomate.rectify.kernels.seams import balance as balance_pixels
from stereomate.rectify.kernels.seams import mix
from stereomate.rectify.kernels.warp import clear_invalid, take_valid, warp
from stereomate.rectify.layout import StereoModel
from stereomate.rectify.radiometry import TABLE_NODES, Balance
from stereomate.rectify.readers import reader_of
from stereomate.rectify.resample import clear_frame, resample
from stereomate.rectify.scratch import scratch
from stereomate.rectify.serving import Pixels, camera_nodes, in_window, models_of_window, serve_pixels

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Side = Literal["left", "right"]

NO_PHOTOGRAPH = np.empty((0, 0), np.uint16)
NOT_MIXED = np.empty((0, 0), np.float32)


@dataclass(frozen=True, eq=False)
class Part:
    """A product over a window.

    Attributes
    ----------
    pixels : (rows, cols, bands)
        0 where not valid.
    valid : (rows, cols) uint8
        255 where a photograph was resampled.
    photograph : (rows, cols) uint16
        Which photograph each pixel comes from, counted from 1; 0 where none.

    All are buffers of the thread: use them before the next window is made.
    """

    pixels: NDArray[Any]
    valid: NDArray[np.uint8]
    photograph: NDArray[np.uint16]


def rectify_window(job: RectifyJob, window: Window) -> tuple[Part, Part | None]:
    """Orthophoto and (in a stereo job) stereomate of a window of the product's pixels."""
    ortho = orthophoto_part(job, window, "left")
    return ortho, stereomate_part(job, window) if job.is_stereo else None


def orthophoto_part(job: RectifyJob, window: Window, side: Side) -> Part:
    """Orthophoto of a window from the left (or, for checks of the orientation, the right) photographs."""
    ground = ground_of(job, window)
    heights = heights_of(job, ground, "ortho heights")
    columns = scratch("ortho columns", (1, window.cols), np.float32)
    columns[0] = np.arange(window.cols, dtype=np.float32) + np.float32(0.5)
    return _render(job, ground, Pixels(window, columns, heights), side, "ortho")


def stereomate_part(job: RectifyJob, window: Window) -> Part:
    """Stereomate of a window from the right photographs."""
    ground = shown_ground(job, window)
    columns, heights, _ = mate_positions(job, window, ground)
    return _render(job, ground, Pixels(window, columns, heights), "right", "mate")


def _render(job: RectifyJob, ground: Ground, pixels: Pixels, side: Side, name: str) -> Part:
    shape = (pixels.window.rows, pixels.window.cols)
    out = scratch(f"{name} pixels", (*shape, len(job.bands)), job.dtype)
    valid = scratch(f"{name} valid", shape, np.uint8)
    photograph = scratch(f"{name} photograph", shape, np.uint16)
    valid.fill(0)
    photograph.fill(0)
    if ground.is_void:
        out.fill(0)
        return Part(out, valid, photograph)
    nodes = camera_nodes(job, ground)
    models = models_of_window(job, ground, nodes)
    if not models:
        out.fill(0)
        return Part(out, valid, photograph)
    serving = serve_pixels(job, ground, pixels, models, nodes)
    if isinstance(serving.model, int):
        p = _photograph(models[serving.model], side)
        _resample_photograph(job, ground, pixels, nodes[p], p, NO_PHOTOGRAPH, out, valid)
        np.multiply(valid != 0, np.uint16(p + 1), out=photograph)
    else:
        wanted = serving.photographs(models, 0 if side == "left" else 1, job.options.hidden)
        for p in np.unique(wanted[wanted > 0]):
            _composite(
                job, ground, pixels, nodes[int(p) - 1], int(p) - 1, wanted, Part(out, valid, photograph)
            )
        part = Part(out, valid, photograph)
        # what mixing asks for goes to the same buffers
        model = serving.model.copy()
        mixed = photographs_across(job, ground, pixels, models, nodes, serving, side == "left")
        if mixed is not None:
            for p in np.unique(mixed[0][mixed[0] > 0]):
                _mix(job, ground, pixels, nodes[int(p) - 1], int(p) - 1, mixed, part)
        _level(job, pixels, models, model, side, mixed, part)
    if cv2.countNonZero(valid) < valid.size:
        clear_invalid(out, valid)
    return Part(out, valid, photograph)


def _photograph(model: StereoModel, side: Side) -> int:
    return model.left if side == "left" else model.right


def _composite(
    job: RectifyJob,
    ground: Ground,
    pixels: Pixels,
    nodes: Floats,
    p: int,
    wanted: NDArray[np.uint16],
    part: Part,
) -> None:
    """Resample one of several photographs and copy the pixels it serves."""
    box, values, valid = _one_photograph(job, ground, pixels, nodes, p, wanted)
    take_valid(values, valid, p + 1, part.pixels[box], part.valid[box], part.photograph[box])


def _mix(
    job: RectifyJob,
    ground: Ground,
    pixels: Pixels,
    nodes: Floats,
    p: int,
    mixed: tuple[NDArray[np.uint16], Floats32],
    part: Part,
) -> None:
    """Mix one photograph into the pixels beside a seam; the lineage keeps the photograph that serves them."""
    box, values, valid = _one_photograph(job, ground, pixels, nodes, p, mixed[0])
    valid[part.valid[box] == 0] = 0
    mix(part.pixels[box], values, valid, mixed[1][box], job.dtype.kind != "f")


def _level(
    job: RectifyJob,
    pixels: Pixels,
    models: list[StereoModel],
    model: NDArray[np.int16],
    side: Side,
    mixed: tuple[NDArray[np.uint16], Floats32] | None,
    part: Part,
) -> None:
    """Bring both sides of seams to one brightness, where the models of the seams really serve."""
    if job.seams is None or not job.seams.is_levelled:
        return
    owner = scratch("level owner", model.shape, np.int16)
    job.seams.labels(pixels.window, pixels.columns, owner)
    owner[in_window(job, models)[owner] != model] = -1
    levels = job.seams.level(pixels.window, pixels.columns, owner, side == "right", len(job.bands))
    if levels is None:
        return
    share = NOT_MIXED if mixed is None else np.where(mixed[0] > 0, mixed[1], np.float32(0.0))
    lift(part.pixels, part.valid, levels, share, *_limits(job.dtype))


def _limits(dtype: np.dtype[Any]) -> tuple[float, float]:
    """Range of integers; floats, which are not limited, as (1, 0)."""
    if dtype.kind == "f":
        return 1.0, 0.0
    limits = np.iinfo(np.zeros(0, dtype).dtype)
    return float(limits.min), float(limits.max)


def _one_photograph(
    job: RectifyJob, ground: Ground, pixels: Pixels, nodes: Floats, p: int, wanted: NDArray[np.uint16]
) -> tuple[tuple[slice, slice], NDArray[Any], NDArray[np.uint8]]:
    """The smallest box around the pixels that want a photograph, its values there, and where it has any."""
    mine = wanted == p + 1
    rows = np.flatnonzero(mine.any(axis=1))
    cols = np.flatnonzero(mine.any(axis=0))
    r0, r1, c0, c1 = int(rows[0]), int(rows[-1]) + 1, int(cols[0]), int(cols[-1]) + 1
    w = pixels.window
    box = Pixels(
        Window(w.col0, w.row0 + r0, c1 - c0, r1 - r0),
        pixels.columns[:, c0:c1] if pixels.columns.shape[0] == 1 else pixels.columns[r0:r1, c0:c1],
        pixels.heights[r0:r1, c0:c1],
    )
    shape = (r1 - r0, c1 - c0)
    values = scratch("photograph pixels", (*shape, len(job.bands)), job.dtype)
    valid = scratch("photograph valid", shape, np.uint8)
    _resample_photograph(job, ground, box, nodes, p, wanted[r0:r1, c0:c1], values, valid)
    return (slice(r0, r1), slice(c0, c1)), values, valid


def _resample_photograph(
    job: RectifyJob,
    ground: Ground,
    pixels: Pixels,
    nodes: Floats,
    p: int,
    wanted: NDArray[np.uint16],
    out: NDArray[Any],
    valid: NDArray[np.uint8],
) -> None:
    window = pixels.window
    photograph = job.photographs[p]
    reduction = job.reductions[p]
    map_x = scratch("map x", (window.rows, window.cols), np.float32)
    map_y = scratch("map y", (window.rows, window.cols), np.float32)
    # Counted from the middle of the photograph, float32 positions stay small.
    shift = tuple(size // reduction // 2 for size in photograph.camera.size_px)
    code, parameters = photograph.camera.kernel_parameters()
    lattice = ground.lattice
    count = warp(
        pixels.columns,
        pixels.heights,
        wanted,
        p + 1,
        nodes,
        lattice.col0 - window.col0,
        lattice.row0,
        lattice.step,
        float(window.row0),
        code,
        parameters,
        float(reduction),
        float(shift[0]),
        float(shift[1]),
        map_x,
        map_y,
        valid,
    )
    method = job.options.resampling
    if count == 0 or not clear_frame(
        photograph.camera, (map_x, map_y), (shift[0], shift[1]), reduction, method, valid
    ):
        return
    reader: PhotoReader = reader_of(photograph)
    origin = resample(
        reader,
        job.bands,
        (map_x, map_y),
        _extremes(map_x, map_y, valid),
        (shift[0], shift[1]),
        reduction,
        method,
        out,
        valid,
    )
    if job.balance is not None:
        _balance(job, job.balance, p, (map_x, map_y), origin, out, valid)


def _balance(
    job: RectifyJob,
    balance: Balance,
    p: int,
    positions: tuple[Floats32, Floats32],
    origin: tuple[int, int],
    out: NDArray[Any],
    valid: NDArray[np.uint8],
) -> None:
    size = job.photographs[p].camera.size_px
    table = balance.table(p, size)
    steps = [edge / job.reductions[p] / (TABLE_NODES - 1) for edge in size]
    low, high = _limits(job.dtype)
    offset_x, offset_y = origin[0] + 0.5, origin[1] + 0.5
    map_x, map_y = positions
    balance_pixels(out, valid, map_x, map_y, offset_x, offset_y, table, steps[0], steps[1], low, high)


def _extremes(
    map_x: Floats32, map_y: Floats32, valid: NDArray[np.uint8]
) -> tuple[float, float, float, float]:
    """Least and greatest x and y of the valid positions."""
    (min_x, max_x), (min_y, max_y) = (
        cv2.minMaxLoc(positions, mask=valid)[:2] for positions in (map_x, map_y)
    )
    return min_x, max_x, min_y, max_y
