"""Mixing of two models along a seam, where the seams say that both show the same ground at the same place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from stereomate.rectify.ground import Ground
from stereomate.rectify.job import RectifyJob
from stereomate.rectify.kernels.serve import LEFT_SEES, RIGHT_SEES
from stereomate.rectify.layout import StereoModel
from stereomate.rectify.scratch import scratch
from stereomate.rectify.serving import Pixels, Serving, in_window, serve_pixels

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]


def photographs_across(
    job: RectifyJob,
    ground: Ground,
    pixels: Pixels,
    models: list[StereoModel],
    nodes: Floats,
    serving: Serving,
    left: bool,
) -> tuple[NDArray[np.uint16], Floats32] | None:
    """Photograph (from 1; 0 for none) that is mixed into each pixel of a window, and its share.

    A pixel is mixed where the model of its polygon really serves it, the model across the seam shows the
    ground too, and takes it from another photograph. None where there is nothing to mix.
    """
    if job.seams is None or not job.seams.lines or isinstance(serving.model, int):
        return None
    shape = (pixels.window.rows, pixels.window.cols)
    owner = scratch("seam owner", shape, np.int16)
    job.seams.labels(pixels.window, pixels.columns, owner)
    partner = scratch("seam partner", shape, np.int16)
    weight = scratch("seam weight", shape, np.float32)
    if not job.seams.feather(pixels.window, pixels.columns, owner, partner, weight):
        return None
    table = in_window(job, models)
    served = serving.model.copy()
    mixed = (partner >= 0) & (table[owner] == served)
    wanted = np.where(mixed, table[partner], np.int16(-1)).astype(np.int16)
    mixed &= wanted >= 0
    if not mixed.any():
        return None
    # The kernel answers with the model that is asked first wherever it can serve; elsewhere nothing is asked.
    heights = scratch("seam heights", shape, pixels.heights.dtype)
    np.copyto(heights, pixels.heights)
    heights[~mixed] = np.nan
    asked = serve_pixels(job, ground, replace(pixels, heights=heights), models, nodes, wanted)
    assert isinstance(asked.sees, np.ndarray)
    bit = LEFT_SEES if left else RIGHT_SEES
    mixed &= (asked.model == wanted) & ((asked.sees & bit) != 0)
    number = np.array([(m.left if left else m.right) + 1 for m in models] + [0], np.uint16)
    across = np.where(mixed, number[wanted], 0).astype(np.uint16)
    across[across == number[served]] = 0
    return (across, weight) if across.any() else None
