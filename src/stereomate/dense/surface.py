"""The surface of a block from its oriented photographs, with the terrain below it.

Pair by pair: epipolar images, dense matching, intersection, cells of the map grid. Then chunk by chunk: the
pairs are fused, outliers taken out, small holes filled; from the surface the terrain. Every finished pair and
chunk is kept in a ledger: a run that was killed goes on there, and memory does not grow with the block.
"""

from __future__ import annotations

import json
import shutil
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from stereomate import __version__
from stereomate.dense.fusion import FILLED, MEASURED, Fused, FusionOptions, fuse, stacked
from stereomate.dense.pair_cells import common, packed, unpacked
from stereomate.dense.pair_surface import CellGrid, PairOptions, match_pair
from stereomate.dense.surface_plan import PlanOptions, SurfacePlan
from stereomate.dense.terrain_model import (
    TerrainOptions,
    reduced,
    reference_heights,
    terrain_window,
    upsampled,
)
from stereomate.measurement.features import grey_image
from stereomate.raster import open_heights, open_photo
from stereomate.raster.cog import CogProfile, Georeference, assemble_cog, encode_chunk
from stereomate.raster.windows import Window
from stereomate.tiles import executor as tiles
from stereomate.tiles.executor import Executor
from stereomate.tiles.ledger import Ledger, run_key
from stereomate.tiles.plan import Chunk, TilePlan

Floats32 = NDArray[np.float32]
Bytes = NDArray[np.uint8]
Progress = Callable[[str, int, int], None]

SURFACE: Final = "surface.tif"
TERRAIN: Final = "terrain.tif"
QUALITY: Final = "surface_quality.tif"
QUALITY_BANDS: Final = (
    "standard deviation of the height",
    "pairs that agree on it",
    "0 void, 1 measured, 2 filled from the cells around",
)
NODATA: Final = -9999.0
_BLOCK: Final = 256
_CHUNK_TILES: Final = 2
# Neighbouring cells may differ by the height of so many cells' edges and still belong together.
_ROOM: Final = 3.0
# Photographs whose reduced grey values are kept.
_KEPT: Final = 6


@dataclass(frozen=True)
class SurfaceModelOptions:
    """How a surface is made.

    Attributes
    ----------
    plan : PlanOptions
    pair : stereomate.dense.pair_surface.PairOptions
    speckle_cells, filled_cells : int
        As in `FusionOptions`.
    terrain : stereomate.dense.terrain_model.TerrainOptions
    """

    plan: PlanOptions = field(default_factory=PlanOptions)
    pair: PairOptions = field(default_factory=PairOptions)
    speckle_cells: int = 40
    filled_cells: int = 6
    terrain: TerrainOptions = field(default_factory=TerrainOptions)


@dataclass(frozen=True, eq=False)
class SurfaceResult:
    """Files and figures of a surface.

    Attributes
    ----------
    surface, terrain, quality : Path
    figures : dict
        Plain values.
    """

    surface: Path
    terrain: Path
    quality: Path
    figures: dict[str, Any]


def make_surface(
    plan: SurfacePlan,
    out: Path,
    key: str,
    options: SurfaceModelOptions | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> SurfaceResult:
    """Make surface, quality and terrain of a block in a folder.

    Parameters
    ----------
    plan : SurfacePlan
    out : Path
    key : str
        Hash of the inputs: what an earlier run of the same key left is gone on with.
    options : SurfaceModelOptions, optional
    executor : Executor, optional
    progress : callable, optional
        Gets the stage, what is done and what there is to do.

    Raises
    ------
    ImageError, StorageError
        About the files.
    """
    options = options or SurfaceModelOptions()
    tell = progress or (lambda stage, done, total: None)
    out.mkdir(parents=True, exist_ok=True)
    maker = _Maker(plan, options, TilePlan(plan.grid.size, _BLOCK, _CHUNK_TILES))
    key = run_key(version=__version__, inputs=key, options=repr(options), grid=repr(plan.grid))
    pairs = Ledger.open(out / ".pairs", key)
    figures = maker.match(pairs, executor, tell)
    cells = Ledger.open(out / ".surface", key)
    tiles.run(
        maker.tiles,
        lambda chunk: maker.fused(pairs, chunk),
        cells,
        executor,
        lambda p: tell("surface", p.done, p.total),
    )
    crs = plan.survey.frame.crs
    place = Georeference(crs, plan.grid.affine, _items("surface"))
    assemble_cog(out / SURFACE, _heights_profile(), maker.tiles, cells, "surface", place)
    assemble_cog(out / QUALITY, _quality_profile(), maker.tiles, cells, "quality", place)
    figures |= _total([json.loads(cells.get(chunk.index, "counts")) for chunk in maker.tiles.chunks])
    ground = Ledger.open(out / ".terrain", key)
    figures |= maker.terrain(out / SURFACE, ground, executor, tell)
    coarse = maker.terrain_grid
    place = Georeference(crs, coarse.affine, _items("terrain"))
    assemble_cog(out / TERRAIN, _heights_profile(), maker.terrain_tiles, ground, "terrain", place)
    for folder in (".pairs", ".surface", ".terrain"):
        shutil.rmtree(out / folder, ignore_errors=True)
    return SurfaceResult(out / SURFACE, out / TERRAIN, out / QUALITY, figures)


class _Maker:
    """The steps, with what they share."""

    def __init__(self, plan: SurfacePlan, options: SurfaceModelOptions, tiles_: TilePlan) -> None:
        self.plan, self.options, self.tiles = plan, options, tiles_
        self._grey: dict[str, Bytes] = {}
        self._lock = threading.Lock()
        self.unit = plan.survey.frame.heights.metres_per_unit
        room = _ROOM * plan.grid.cell * plan.survey.frame.unit_m / self.unit
        self.fusion = FusionOptions(options.speckle_cells, room, options.filled_cells)
        factor = options.terrain.factor
        cols, rows = plan.grid.size
        grid = plan.grid
        self.terrain_grid = CellGrid(
            grid.west, grid.north, grid.cell * factor, (-(-cols // factor), -(-rows // factor))
        )
        self.terrain_tiles = TilePlan(self.terrain_grid.size, _BLOCK, _CHUNK_TILES)

    # ---- pairs

    def match(self, ledger: Ledger, executor: Executor | None, tell: Progress) -> dict[str, Any]:
        """Match every pair that the ledger does not hold."""
        count = len(self.plan.pairs)
        todo = [k for k in range(count) if not ledger.has(k)]
        done = count - len(todo)
        tell("matching", done, count)

        def keep(number: int, blobs: dict[str, bytes]) -> None:
            nonlocal done
            ledger.put(number, blobs)
            with self._lock:
                done += 1
                tell("matching", done, count)

        (executor or tiles.Threads(1)).each(self.matched, todo, keep)
        self._grey.clear()
        records = [json.loads(ledger.get(k, "record")) for k in range(count)]
        return {"pairs": records}

    def matched(self, number: int) -> dict[str, bytes]:
        """Blobs of a pair: its cells in every chunk of the grid, and its record."""
        pair = self.plan.pairs[number]
        cells = match_pair(
            self.plan.survey, pair, self.grey, self.plan.ground, self.plan.grid, self.options.pair
        )
        known = cells.sigma[np.isfinite(cells.sigma)]
        record = {
            "left": pair.left.name,
            "right": pair.right.name,
            "base_m": pair.base_m,
            "points": cells.points,
            "matched": cells.points * self.options.pair.dense.step_px**2 / max(cells.common, 1),
            "y_parallax_px": None if np.isnan(cells.row_parallax_px) else cells.row_parallax_px,
            "sigma_median": float(np.median(known)) if known.size else None,
        }
        blobs = {"record": json.dumps(record).encode()}
        for chunk in self.tiles.chunks:
            part = packed(cells, chunk.window)
            if part is not None:
                blobs[f"cells {chunk.index}"] = part
        return blobs

    def grey(self, name: str) -> Bytes:
        """Reduced grey values of a photograph; those of the last few are kept."""
        with self._lock:
            if name in self._grey:
                return self._grey[name]
        photo = self.plan.survey.photographs[self.plan.survey.index(name)]
        assert photo.path is not None  # pairs are of photographs that are there
        columns, rows = photo.camera.size_px
        with open_photo(photo.path) as reader:
            pixels, _ = reader.read_window(0, 0, columns, rows)
        grey, factor = grey_image(pixels), self.plan.reduction
        if factor > 1:
            cols, lines = columns // factor, rows // factor
            whole = grey[: lines * factor, : cols * factor]
            grey = np.asarray(cv2.resize(whole, (cols, lines), interpolation=cv2.INTER_AREA))
        with self._lock:
            while len(self._grey) >= _KEPT:
                self._grey.pop(next(iter(self._grey)))
            self._grey[name] = grey
        return grey

    # ---- surface

    def fused(self, pairs: Ledger, chunk: Chunk) -> dict[str, bytes]:
        """Blobs of a chunk of the surface."""
        margin = self.fusion.margin
        w = chunk.window
        cols, rows = self.tiles.size
        col0, row0 = max(0, w.col0 - margin), max(0, w.row0 - margin)
        col1, row1 = min(cols, w.col1 + margin), min(rows, w.row1 + margin)
        wide = Window(col0, row0, col1 - col0, row1 - row0)
        near = [c for c in self.tiles.chunks if not common(c.window, wide).is_empty]
        layers = []
        for number in range(len(self.plan.pairs)):
            names = pairs.names(number)
            parts = [pairs.get(number, f"cells {c.index}") for c in near if f"cells {c.index}" in names]
            if parts:
                layers.append(unpacked(parts, wide))
        shape = wide.rows, wide.cols
        found = fuse(
            stacked([layer[0] for layer in layers], shape),
            stacked([layer[1] for layer in layers], shape),
            self.fusion,
        )
        return self._encoded(chunk, found, (w.row0 - row0, w.col0 - col0))

    def _encoded(self, chunk: Chunk, found: Fused, start: tuple[int, int]) -> dict[str, bytes]:
        part = (
            slice(start[0], start[0] + chunk.window.rows),
            slice(start[1], start[1] + chunk.window.cols),
        )
        heights, kind = found.heights[part], found.kind[part]
        known = np.isfinite(heights)
        values = np.where(known, heights, np.float32(NODATA))[..., None]
        quality = np.stack([found.sigma[part], found.pairs[part], kind], axis=-1).astype(np.float32)
        quality[~known] = NODATA
        measured = found.sigma[part][kind == MEASURED]
        counts = {
            "measured": int((kind == MEASURED).sum()),
            "filled": int((kind == FILLED).sum()),
            "of_one_pair": int((found.pairs[part] == 1).sum()),
            "sigma": float(measured.sum(dtype=np.float64)),
        }
        return {
            "surface": bytes(encode_chunk(_heights_profile(), self.tiles, np.ascontiguousarray(values))),
            "quality": bytes(encode_chunk(_quality_profile(), self.tiles, quality)),
            "counts": json.dumps(counts).encode(),
        }

    # ---- terrain

    def terrain(
        self, surface: Path, ledger: Ledger, executor: Executor | None, tell: Progress
    ) -> dict[str, Any]:
        """Make the chunks of the terrain model."""
        options, grid = self.options.terrain, self.terrain_grid
        cell_m = grid.cell * self.plan.survey.frame.unit_m
        squares = max(2, round(options.ground.largest_object_m / cell_m))
        reference = self._reference(surface, squares)
        margin = options.margin(cell_m)

        def work(chunk: Chunk) -> dict[str, bytes]:
            w = chunk.window
            wide = Window(w.col0 - margin, w.row0 - margin, w.cols + 2 * margin, w.rows + 2 * margin)
            wide = wide.clamped(grid.size)
            heights = self._coarse(surface, wide)
            level = upsampled(reference, squares, wide.col0, wide.row0, heights.shape)
            scale = np.float32(self.unit)
            found, ground = terrain_window(heights * scale, level * scale, cell_m, options)
            found /= scale
            part = (
                slice(w.row0 - wide.row0, w.row0 - wide.row0 + w.rows),
                slice(w.col0 - wide.col0, w.col0 - wide.col0 + w.cols),
            )
            values = np.where(np.isfinite(found), found, np.float32(NODATA))[part]
            counts = {"known": int((values != NODATA).sum()), "ground": int(ground[part].sum())}
            blob = encode_chunk(
                _heights_profile(), self.terrain_tiles, np.ascontiguousarray(values[..., None])
            )
            return {"terrain": bytes(blob), "counts": json.dumps(counts).encode()}

        tiles.run(self.terrain_tiles, work, ledger, executor, lambda p: tell("terrain", p.done, p.total))
        found = [json.loads(ledger.get(chunk.index, "counts")) for chunk in self.terrain_tiles.chunks]
        known, ground = (sum(part[name] for part in found) for name in ("known", "ground"))
        return {"terrain_cell": grid.cell, "ground_share": ground / known if known else 0.0}

    def _coarse(self, surface: Path, window: Window) -> Floats32:
        """The surface in cells of the terrain model."""
        factor = self.options.terrain.factor
        with open_heights(surface) as reader:
            heights, read = reader.read_window(*(v * factor for v in window))
        wide = np.full((window.rows * factor, window.cols * factor), np.nan, np.float32)
        wide[: read.rows, : read.cols] = heights
        return reduced(wide, factor)

    def _reference(self, surface: Path, squares: int) -> Floats32:
        """Reference heights of the whole surface, a band of squares at a time."""
        cols, rows = self.terrain_grid.size
        bands = [
            self._coarse(surface, Window(0, row0, cols, min(squares, rows - row0)))
            for row0 in range(0, rows, squares)
        ]
        low = [reference_heights(band, squares, fill=False) for band in bands]
        return reference_heights(np.concatenate(low), 1)


def _total(counts: list[dict[str, Any]]) -> dict[str, Any]:
    measured, filled, single = (
        sum(part[name] for part in counts) for name in ("measured", "filled", "of_one_pair")
    )
    sigma = sum(part["sigma"] for part in counts)
    return {
        "measured_cells": measured,
        "filled_cells": filled,
        "cells_of_one_pair": single,
        "sigma_mean": sigma / measured if measured else None,
    }


def _items(product: str) -> dict[str, str]:
    return {"TIFFTAG_SOFTWARE": f"stereomate {__version__}", "STEREOMATE_PRODUCT": product}


def _heights_profile() -> CogProfile:
    return CogProfile("float32", 1, nodata=NODATA)


def _quality_profile() -> CogProfile:
    return CogProfile(
        "float32", len(QUALITY_BANDS), nodata=NODATA, overviews="nearest", descriptions=QUALITY_BANDS
    )
