"""The ground of a product for exact measuring: rigorous at every point, without the lattice of the warp."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.frames.transform import map_from_map, tangent_from_map
from stereomate.parallax.laws import ParallaxLaw
from stereomate.rectify.ground import method_code
from stereomate.rectify.job import RectifyJob
from stereomate.stereo.kernels.surface import heights_and_gradients, shown_columns

Floats = NDArray[np.float64]

# Edge of the groups of points that share a patch of the height model, and nodes around it.
_BLOCK: Final = 1024
_APRON: Final = 3
# Step of numeric derivatives of smooth transformations, map and height units.
_STEP: Final = 1.0


@dataclass(frozen=True, eq=False)
class JobSurface:
    """Ground of a product: the height model as the product interpolates it, in product axes.

    Attributes
    ----------
    job : RectifyJob
    """

    job: RectifyJob

    def heights(self, uv: Floats) -> Floats:
        """(h, dh/du, dh/dv) at positions (n, 2); NaN outside the height model and at voids."""
        at, by = self._in_height_model(uv)
        values = self._sampled(at[:, :2])
        scale = self._scale
        out = np.empty((len(uv), 3))
        out[:, 0] = scale * values[:, 0] + at[:, 2]
        out[:, 1:] = scale * np.einsum("nk,nkj->nj", values[:, 1:], by[:, :2]) + by[:, 2]
        return out

    def shown(self, law: ParallaxLaw, uv: Floats) -> tuple[Floats, NDArray[np.int64]]:
        """Column u of the ground that stereomate positions (n, 2) show, and how many branches there are."""
        job = self.job
        low, high = (float(q) for q in law.q(job.height_range))
        step = 0.5 * min(job.grid.gsd, min(job.heights.cell_size_m) / job.frame.unit_m)
        starts, ends = uv[:, 0] + low - 2.0 * step, uv[:, 0] + high + 2.0 * step
        nodes = np.stack(
            [self._position(np.column_stack([u, uv[:, 1]])) for u in (starts, 0.5 * (starts + ends), ends)],
            axis=1,
        )
        code, parameters = law.kernel_parameters()
        columns, branches = np.full(len(uv), np.nan), np.zeros(len(uv), np.int64)
        for members, patch, offset in self._patches(nodes[:, :, :2]):
            found, count = np.empty(members.size), np.empty(members.size, np.int64)
            shown_columns(
                method_code(job), patch, self._scale, code, parameters, nodes[members] - offset,
                uv[members, 0].copy(), starts[members], ends[members], step, found, count,
            )  # fmt: skip
            columns[members], branches[members] = found, count
        return columns, branches

    def points(self, uvh: Floats) -> tuple[Floats, Floats]:
        """Points (n, 3) in the tangent frame, and derivatives (n, 3, 3) by u, v and h as columns."""
        derivatives = np.empty((len(uvh), 3, 3))
        for k in range(3):
            shift = _STEP * np.eye(3)[k]
            derivatives[:, :, k] = (self._tangent(uvh + shift) - self._tangent(uvh - shift)) / (2.0 * _STEP)
        return self._tangent(uvh), derivatives

    def _tangent(self, uvh: Floats) -> Floats:
        xy = self.job.grid.map_from_uv(uvh[:, :2])
        return tangent_from_map(self.job.tangent, self.job.frame, np.column_stack([xy, uvh[:, 2]]))

    @property
    def _scale(self) -> float:
        """Height units of the law per unit of the height model."""
        model = self.job.heights.frame
        if model == self.job.frame:
            return 1.0
        return float(model.heights.metres_per_unit / self.job.frame.heights.metres_per_unit)

    def _position(self, uv: Floats) -> Floats:
        """(column, row, height offset) in the height model of positions (n, 2), as the product takes them."""
        job = self.job
        xy = job.grid.map_from_uv(uv)
        if job.heights.frame == job.frame:
            return np.column_stack([job.heights.pixel_from_map(xy), np.zeros(len(uv))])
        middle = 0.5 * (job.height_range[0] + job.height_range[1])
        there = map_from_map(job.heights.frame, job.frame, np.column_stack([xy, np.full(len(uv), middle)]))
        return np.column_stack([job.heights.pixel_from_map(there[:, :2]), middle - self._scale * there[:, 2]])

    def _in_height_model(self, uv: Floats) -> tuple[Floats, Floats]:
        """`_position` and its derivatives (n, 3, 2) by u and v."""
        by = np.empty((len(uv), 3, 2))
        for k in range(2):
            shift = _STEP * np.eye(2)[k]
            by[:, :, k] = (self._position(uv + shift) - self._position(uv - shift)) / (2.0 * _STEP)
        return self._position(uv), by

    def _sampled(self, pixels: Floats) -> Floats:
        """(h, dh/dcol, dh/drow) of the height model at pixel positions (n, 2)."""
        out = np.full((len(pixels), 3), np.nan)
        for members, patch, offset in self._patches(pixels[:, None]):
            values = np.empty((members.size, 3))
            local = pixels[members] - offset[:2]
            heights_and_gradients(
                method_code(self.job), patch, local[:, 0].copy(), local[:, 1].copy(), values
            )
            out[members] = values
        return out

    def _patches(self, pixels: Floats) -> list[tuple[NDArray[np.int64], Floats, Floats]]:
        """Groups of nearby places (n, k, 2): members, a patch that holds them, and its (col, row, 0)."""
        rows, cols = self.job.heights.shape
        low = np.floor(pixels.min(axis=1)) - _APRON
        high = np.floor(pixels.max(axis=1)) + _APRON + 1
        meets = np.isfinite(low).all(axis=1) & (high > 0).all(axis=1) & (low < (cols, rows)).all(axis=1)
        inside = np.flatnonzero(meets)
        if inside.size == 0:
            return []
        blocks = np.clip(pixels[inside].mean(axis=1), 0, (cols, rows)).astype(np.int64) // _BLOCK
        key = blocks[:, 1] * (cols // _BLOCK + 2) + blocks[:, 0]
        order = np.argsort(key, kind="stable")
        starts = np.flatnonzero(np.diff(key[order], prepend=-1))
        groups = []
        for members in np.split(inside[order], starts[1:]):
            first = np.maximum(low[members].min(axis=0), 0).astype(int)
            last = np.minimum(high[members].max(axis=0), (cols, rows)).astype(int)
            size = np.maximum(last - first, 2)
            patch = self.job.heights.patch(int(first[0]), int(first[1]), int(size[0]), int(size[1])).heights
            groups.append((members, patch, np.array([first[0], first[1], 0.0])))
        return groups
