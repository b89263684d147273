"""Which model serves each pixel of a window, and what of the ground its photographs see."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.model import Camera
from stereomate.raster import Window
from stereomate.rectify.ground import Ground, height_patch
from stereomate.rectify.job import RectifyJob
from stereomate.rectify.kernels.serve import BOTH_SEE, LEFT_SEES, RIGHT_SEES, serve
from stereomate.rectify.layout import StereoModel
from stereomate.rectify.options import Hidden
from stereomate.rectify.scratch import scratch
from stereomate.terrain.kernels.sight import sight_bounds, steepest_slope

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

# Ground counts as hidden only where the surface rises this far above its ray (metres): the lattice's own
# accuracy and the rounding of heights stay below it.
HIDDEN_TOLERANCE_M = 0.02

NO_PREFERENCE = np.empty((0, 0), np.int16)
NOT_FILLED = np.empty((2, 0, 0), np.int16)


@dataclass(frozen=True, eq=False)
class Pixels:
    """Ground positions of the pixels of a window: columns relative to its first one, and heights."""

    window: Window
    columns: Floats32
    heights: Floats32


@dataclass(frozen=True, eq=False)
class Serving:
    """Which model serves each pixel and which of its photographs see the ground; or one model for all.

    Attributes
    ----------
    filled : (2, rows, cols) or (2, 0, 0) int16
        Photographs that show left and right eye ground which no model shows to both; -1 where the model's
        own do, -2 where there is none. Empty: nowhere.
    """

    model: NDArray[np.int16] | int
    sees: NDArray[np.uint8] | int
    filled: NDArray[np.int16] = field(default_factory=lambda: NOT_FILLED)

    def photographs(self, models: list[StereoModel], side: int, hidden: Hidden) -> NDArray[np.uint16]:
        """Photograph (from 1) that each pixel shows an eye; 0 where none sees the ground.

        Parameters
        ----------
        side : int
            0 for the left eye, 1 for the right one.
        """
        table = np.array([(m.left, m.right)[side] + 1 for m in models] + [0], np.uint16)
        shown = np.asarray(table[self.model])
        if hidden != "keep":
            shown = np.where(np.asarray(self.sees) & (LEFT_SEES, RIGHT_SEES)[side], shown, np.uint16(0))
        if self.filled.size:
            there = self.filled[side] != -1
            shown[there] = np.maximum(self.filled[side][there] + 1, 0)
        return np.ascontiguousarray(shown)


def camera_nodes(job: RectifyJob, ground: Ground) -> Floats:
    """Per photograph and node the camera-frame point at height 0 and its change per metre, (P, ny, nx, 6)."""
    lattice = ground.lattice
    result = np.empty((len(job.photographs), *lattice.base.shape[:2], 6))
    for p, photograph in enumerate(job.photographs):
        camera_from_object = photograph.orientation.object_from_camera.T
        offset = lattice.base - np.asarray(photograph.orientation.centre)
        result[p, ..., :3] = offset @ camera_from_object.T
        result[p, ..., 3:] = lattice.normal @ camera_from_object.T
    return result


def models_of_window(job: RectifyJob, ground: Ground, nodes: Floats) -> list[StereoModel]:
    """The models whose photographs may show ground of the window (some may turn out not to)."""
    reach = [_may_show(job, ground, nodes[p], p) for p in range(len(job.photographs))]
    return [m for m in job.models if reach[m.left] and (m.right < 0 or reach[m.right])]


def _node_image(job: RectifyJob, nodes: Floats, p: int, height: float) -> tuple[Floats, Floats]:
    """Pixel positions of the nodes at a height as if the camera had no distortion, and their depth."""
    point = nodes[..., :3] + height * nodes[..., 3:]
    depth = -point[..., 2]
    return point, depth


def _may_show(job: RectifyJob, ground: Ground, nodes: Floats, p: int) -> bool:
    """Whether the bounding box of the window's image meets the cone of the photograph's own corners."""
    limit = field_of_view(job.photographs[p].camera)
    low = high = None
    for height in ground.height_range:
        point, depth = _node_image(job, nodes, p, height)
        front = depth > 0.0
        if not front.any():
            continue
        tangents = point[front][:, :2] / depth[front][:, None]
        if not front.all():
            return True
        box = tangents.min(axis=0), tangents.max(axis=0)
        low = box[0] if low is None else np.minimum(low, box[0])
        high = box[1] if high is None else np.maximum(high, box[1])
    if low is None or high is None:
        return False
    return bool((low <= limit[1]).all() and (high >= limit[0]).all())


@functools.lru_cache(maxsize=256)
def field_of_view(camera: Camera) -> tuple[Floats, Floats]:
    """Least and greatest (x/-z, y/-z) over the border of a photograph, with a margin of 2 %."""
    t = np.linspace(0.0, 1.0, 17)
    zero, one = np.zeros_like(t), np.ones_like(t)
    border = np.concatenate([np.stack(side, axis=-1) for side in ((t, zero), (t, one), (zero, t), (one, t))])
    rays = camera.rays_from_image(camera.picture_px(border))
    tangents = rays[:, :2] / -rays[:, 2:]
    tangents = tangents[np.isfinite(tangents).all(axis=1)]
    if len(tangents) < 8:
        # A camera of more than its distortion covers: nothing is excluded beforehand.
        return np.full(2, -math.inf), np.full(2, math.inf)
    low, high = tangents.min(axis=0), tangents.max(axis=0)
    margin = 0.02 * (high - low)
    return low - margin, high + margin


def preferred_models(
    job: RectifyJob, pixels: Pixels, models: list[StereoModel], name: str
) -> NDArray[np.int16]:
    """Index in `models` of the model that the seams give each pixel's ground (a buffer of this thread).

    -1 where they give none, or one that does not show the window at all; empty without seams.
    """
    if job.seams is None:
        return NO_PREFERENCE
    labels = scratch(name, (pixels.window.rows, pixels.window.cols), np.int16)
    job.seams.labels(pixels.window, pixels.columns, labels)
    return np.take(in_window(job, models), labels, out=labels)


def in_window(job: RectifyJob, models: list[StereoModel]) -> NDArray[np.int16]:
    """Index in `models` of each model of the job, and of none (the last): -1 where it is not there."""
    index = {id(m): k for k, m in enumerate(models)}
    return np.array([*(index.get(id(m), -1) for m in job.models), -1], np.int16)


def _camera_field(camera: Camera) -> tuple[float, ...]:
    """Least and greatest x/-z and y/-z of a photograph with a margin, columns and rows."""
    low, high = field_of_view(camera)
    return (low[0], high[0], low[1], high[1], *camera.size_px)


def serve_pixels(
    job: RectifyJob,
    ground: Ground,
    pixels: Pixels,
    models: list[StereoModel],
    nodes: Floats,
    preferred: NDArray[np.int16] | None = None,
) -> Serving:
    """Choose the model of every pixel's ground; one model for all where nothing is to be decided.

    A model of `models` that cannot win anywhere in the window is left aside first.

    Parameters
    ----------
    preferred : (rows, cols) int16, optional
        Index in `models` of what is asked first at each pixel; that of the job's seams if absent.
    """
    hidden = _can_be_hidden(job, ground, nodes, models)
    scores = _scores(job, models, nodes)
    if preferred is None and not hidden.any():
        alone = _uncontested(job, ground, nodes, models, scores)
        if alone is not None:
            return Serving(alone, BOTH_SEE)
    if preferred is None:
        preferred = preferred_models(job, pixels, models, "preferred model")
    if hidden.any():
        ground = _with_way_to_centres(job, ground, nodes[hidden])
    centres = centres_in_patch(job, ground)
    window = pixels.window
    model = scratch("model", (window.rows, window.cols), np.int16)
    sees = scratch("sees", (window.rows, window.cols), np.uint8)
    filled, along, least_base = _filling(job, window, bool(hidden.any()))
    cameras = [p.camera.kernel_parameters() for p in job.photographs]
    serve(
        pixels.columns,
        pixels.heights,
        ground.lattice.col0 - window.col0,
        ground.lattice.row0,
        ground.lattice.step,
        float(window.row0),
        scores,
        np.array([m.left for m in models]),
        np.array([m.right for m in models]),
        nodes,
        np.array([code for code, _ in cameras]),
        np.array([parameters for _, parameters in cameras]),
        np.array([_camera_field(p.camera) for p in job.photographs]),
        ground.surface_nodes,
        ground.patch,
        sight_bounds_of(ground.patch, centres[hidden]),
        np.where(hidden, np.cumsum(hidden) - 1, -1),
        HIDDEN_TOLERANCE_M,
        centres,
        along,
        least_base,
        preferred,
        model,
        sees,
        filled,
    )
    return Serving(model, sees, filled)


def _filling(job: RectifyJob, window: Window, some_hidden: bool) -> tuple[NDArray[np.int16], Floats, float]:
    """Where photographs that fill eyes go, positions of centres along the rows, the base they need."""
    if job.options.hidden != "fill" or not some_hidden:
        return NOT_FILLED, np.zeros(len(job.photographs)), 0.0
    filled = scratch("filled", (2, window.rows, window.cols), np.int16)
    filled.fill(-1)
    along = job.grid.uv_from_map(job.centres_map[:, :2])[:, 0]
    # two photographs that fill both eyes want no shorter base than some model has
    bases = [m.base_u_m for m in job.models if m.right >= 0]
    return filled, np.ascontiguousarray(along), min(bases, default=0.0) / job.frame.unit_m


def _scores(job: RectifyJob, models: list[StereoModel], nodes: Floats) -> Floats:
    """Per node and model: tangent of the steeper of the two rays' nadir angles, plus the base's penalty.

    At one height for the whole product, so that it is a function of the ground position alone: orthophoto and
    stereomate, whatever their windows, choose alike.
    """
    tangent = _nadir_tangents(nodes, 0.5 * (job.height_range[0] + job.height_range[1]))
    return np.stack(
        [np.maximum(tangent[m.left], tangent[m.right] if m.right >= 0 else 0.0) + m.penalty for m in models],
        axis=-1,
    )


def _uncontested(
    job: RectifyJob, ground: Ground, nodes: Floats, models: list[StereoModel], scores: Floats
) -> int | None:
    """The model that serves every pixel of the window, if one does (scores between nodes are bilinear).

    A single photograph that has no rival need not show all of the window: what it does not show, nobody does.
    """
    if job.seams is not None and len(models) > 1:
        label = job.seams.only(ground.window)
        if label is None:
            return None
        winner = int(in_window(job, models)[label])
        return winner if winner >= 0 and _all_inside(job, ground, nodes, models[winner]) else None
    winner = int(np.argmin(scores[0, 0]))
    if (scores < scores[..., winner, None]).any():
        return None
    if len(models) == 1 and models[0].right < 0:
        return winner
    return winner if _all_inside(job, ground, nodes, models[winner]) else None


def _nadir_tangents(nodes: Floats, height: float) -> Floats:
    """Tangent of the angle between ray and plumb line at the nodes, per photograph; 1e6 from below."""
    point = nodes[..., :3] + height * nodes[..., 3:]
    up = nodes[..., 3:]
    rise = -np.sum(point * up, axis=-1)
    across = np.linalg.norm(point + rise[..., None] * up, axis=-1)
    return np.where(rise > 0.0, across / np.where(rise > 0.0, rise, 1.0), 1e6)


def _can_be_hidden(
    job: RectifyJob, ground: Ground, nodes: Floats, models: list[StereoModel]
) -> NDArray[np.bool_]:
    """Per photograph: whether it may serve and any slope of the ground is as steep as a ray to it."""
    serves = np.zeros(len(job.photographs), np.bool_)
    if job.options.hidden == "keep":
        return serves
    serves[[p for m in models for p in (m.left, m.right) if p >= 0]] = True
    spacing = job.heights.cell_size_m
    slope = steepest_slope(ground.patch, spacing[0], spacing[1])
    tangents = _nadir_tangents(nodes, ground.height_range[1]).reshape(len(nodes), -1).max(axis=1)
    # The product of slope and tangent reaches 1 where the ray runs along the slope; 5 % for the projection.
    return np.asarray(serves & (slope * tangents > 0.95))


def sight_bounds_of(patch: Floats, centres: Floats) -> Floats:
    """`sight_bounds` of each centre, (centres, rows - 1, cols - 1)."""
    rows, cols = patch.shape
    bounds = np.empty((len(centres), max(rows - 1, 0), max(cols - 1, 0)))
    for k, (col, row, height) in enumerate(centres):
        bounds[k] = sight_bounds(patch, float(col), float(row), float(height))
    return bounds


def _with_way_to_centres(job: RectifyJob, ground: Ground, nodes: Floats) -> Ground:
    """The same ground with the height patch widened to where it can still hide something."""
    tangents = _nadir_tangents(nodes, ground.height_range[1])
    steepest = float(np.max(tangents[tangents < 1e6], initial=0.0))
    relief = job.height_range[1] - ground.height_range[0]
    reach = math.ceil(relief * steepest / min(job.heights.cell_size_m)) + 3
    rows, cols = job.heights.shape
    height, width = ground.patch.shape
    reach = min(reach, max(rows, cols))
    old_col, old_row = ground.patch_origin
    col0, row0 = max(old_col - reach, 0), max(old_row - reach, 0)
    col1, row1 = min(old_col + width + reach, cols), min(old_row + height + reach, rows)
    patch = height_patch(job, ground.lattice, col0, row0, col1 - col0, row1 - row0)
    surface = ground.surface_nodes.copy()
    surface[..., 0] += old_col - col0
    surface[..., 1] += old_row - row0
    return replace(ground, patch=patch, surface_nodes=surface, patch_origin=(col0, row0))


def centres_in_patch(job: RectifyJob, ground: Ground) -> Floats:
    """Projection centres as (column, row, height) of the height patch."""
    centres = job.centres_in_height_model.copy()
    offset = float(np.mean(ground.surface_nodes[..., 2]))
    centres -= [ground.patch_origin[0], ground.patch_origin[1], offset]
    return centres


def _all_inside(job: RectifyJob, ground: Ground, nodes: Floats, model: StereoModel) -> bool:
    """Whether all nodes, from the lowest to the highest ground, lie well inside the model's photographs."""
    for p in (model.left, model.right):
        if p < 0:
            continue
        camera = job.photographs[p].camera
        cols, rows = camera.size_px
        for height in ground.height_range:
            pixels, inside = camera.image_from_camera(nodes[p][..., :3] + height * nodes[p][..., 3:])
            if not inside.all():
                return False
            if (pixels < 2.0).any() or (pixels > np.array([cols - 2.0, rows - 2.0])).any():
                return False
    return True
