"""What is seen of seams in finished products: steps of brightness across them, and what the ground has.

Ground has steps of its own, and they are seen nowhere: a step across a seam counts for what it has more than
those beside it, along the same line moved off the seam. Seams that are mixed, on open ground, and those that
are cut, through crowns and past houses, are told apart: two photographs of a crown never continue each other.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.raster import PhotoReader, Window, open_photo
from stereomate.rectify.job import RectifyJob

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

# Places looked at per product, spread over its seams.
_PLACES: Final = 160
# Edge of the squares over which steps are averaged with their sign, and the least length of seam in one.
_EDGE: Final = 16
_LEAST: Final = 8
# Pixels by which a seam is moved, to both sides, to where there is none, and those averaged on each side.
_MOVED: Final = 13
_BESIDE: Final = 2
# Seams mixed over less than this to each side count as cut.
_MIXED_PX: Final = 2.0


@dataclass(frozen=True)
class SeamSteps:
    """Steps of brightness across the seams of a product, in its own values.

    Attributes
    ----------
    product : str
        "orthophoto" or "stereomate".
    mixed : bool
        Along seams where photographs are mixed (open ground); else along those that are cut.
    places : int
        Stretches of 16 pixels that were looked at.
    across, beside : float
        Median of the mean step over a stretch, of the band where it is largest: across the seam, and across
        the same lines 13 pixels off.
    """

    product: str
    mixed: bool
    places: int
    across: float
    beside: float

    @property
    def net(self) -> float:
        """What the seam adds."""
        return self.across - self.beside


def measured_seam_steps(job: RectifyJob, ortho: Path, mate: Path | None, lineage: Path) -> list[SeamSteps]:
    """Steps across the seams of finished rasters, for each product and kind of seam; empty without seams."""
    places, mixed = _places(job)
    if len(places) == 0:
        return []
    q = job.law.q(job.heights.heights_at(job.grid.map_from_pixel(places))) / job.grid.gsd
    found = []
    with open_photo(lineage) as photographs:
        for side, path in enumerate((ortho, mate)):
            if path is None:
                continue
            shown = places - np.column_stack([side * q, np.zeros(len(q))])
            with open_photo(path) as pixels:
                steps = [_steps_at(pixels, photographs, side, at) for at in shown]
            for kind in (True, False):
                mine = [s for s, m in zip(steps, mixed, strict=True) if m == kind]
                across, beside = (np.array([v for s in mine for v in s[k]]) for k in (0, 1))
                if across.size and beside.size:
                    name = ("orthophoto", "stereomate")[side]
                    medians = float(np.median(across)), float(np.median(beside))
                    found.append(SeamSteps(name, kind, len(across), *medians))
    return found


def _places(job: RectifyJob) -> tuple[Floats, Bools]:
    """Places (n, 2) on seams in product pixels, one in a square, and whether photographs are mixed there."""
    points: list[tuple[float, float, float]] = []
    if job.seams is not None:
        points = [p for line in job.seams.lines for p in line.points]
    if not points:
        return np.empty((0, 2)), np.empty(0, np.bool_)
    table = np.array(points)
    _, first = np.unique(np.floor(table[:, :2] / _EDGE), axis=0, return_index=True)
    first = first[np.unique(np.linspace(0, len(first) - 1, _PLACES).astype(int))]
    return table[first, :2], table[first, 2] >= _MIXED_PX


def _steps_at(
    pixels: PhotoReader, photographs: PhotoReader, side: int, at: Floats
) -> tuple[list[float], list[float]]:
    """Mean steps across the seams in the square around a place, and across the same lines beside them."""
    if not np.isfinite(at).all():
        return [], []
    pad = _MOVED + _BESIDE + 1
    col0, row0 = (np.floor(at / _EDGE).astype(int) * _EDGE - pad).tolist()
    edge = _EDGE + 2 * pad
    values, window = pixels.read_window(col0, row0, edge, edge)
    if window != Window(col0, row0, edge, edge):
        return [], []
    valid, _ = pixels.read_mask(col0, row0, edge, edge)
    label = photographs.read_window(col0, row0, edge, edge)[0][..., side].astype(np.int64)
    image = values.astype(np.float64)
    across: list[float] = []
    beside: list[float] = []
    for move in (0, _MOVED, -_MOVED):
        # along a line moved off the seam, one photograph serves
        moved = np.roll(label, (move, move), (0, 1))
        clear = valid if move == 0 else valid & (moved > 0) & ~_beside_change(label)
        turned = np.swapaxes(image, 0, 1), np.swapaxes(moved, 0, 1), np.swapaxes(clear, 0, 1)
        steps = _mean_step(image, moved, clear, pad + move), _mean_step(*turned, pad + move)
        (across if move == 0 else beside).extend(s for s in steps if s is not None)
    return across, beside


def _beside_change(label: Ints) -> Bools:
    """Pixels that touch one of another photograph."""
    change = np.zeros(label.shape, np.bool_)
    for axis in (0, 1):
        differs = np.diff(label, axis=axis) != 0
        change |= np.insert(differs, 0, False, axis=axis) | np.insert(
            differs, label.shape[axis] - 1, False, axis
        )
    return change


def _mean_step(image: Floats, label: Ints, valid: Bools, first: int) -> float | None:
    """Mean step down the columns where the label changes in the square from `first`; None if it hardly does.

    Of two pixels on each side; the sign is that of one order of the two labels, so that texture falls out.
    """
    a, b = label[1:-2], label[2:-1]
    line = (a != b) & (label[:-3] == a) & (label[3:] == b)
    line &= valid[:-3] & valid[1:-2] & valid[2:-1] & valid[3:]
    inner = np.zeros_like(line)
    inner[first - 2 : first - 2 + _EDGE, first : first + _EDGE] = True
    line &= inner
    if line.sum() < _LEAST:
        return None
    step = 0.5 * (image[2:-1] + image[3:] - image[1:-2] - image[:-3])
    low, high = np.minimum(a, b), np.maximum(a, b)
    pair = (low * (label.max() + 1) + high)[line]
    keys, count = np.unique(pair, return_counts=True)
    mine = pair == keys[np.argmax(count)]
    if mine.sum() < _LEAST:
        return None
    sign = np.where(a < b, 1.0, -1.0)[line][mine]
    return float(np.abs((sign[:, None] * step[line][mine]).mean(axis=0)).max())
