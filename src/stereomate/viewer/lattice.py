"""The lattice with which a page measures exactly: the map, the height model and the tangent frame on nodes.

A page in a browser has no PROJ. On nodes over the product everything it needs is computed rigorously here:
the point at height 0 and the direction of the plumb line in the tangent frame (a point with height h is
``base + h normal``, exactly), its position in the height model, and its longitude and latitude. Between nodes
the page interpolates with cubics through 4 x 4 nodes. The step is halved until what that costs, measured at
places between the nodes, is nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import CrsError, HeightSystemError
from stereomate.frames.heights import HeightSystem
from stereomate.frames.lattice import ground_lattice
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.transform import map_from_map
from stereomate.raster import Window
from stereomate.rectify.job import RectifyJob
from stereomate.viewer.sight import sight_reach_m

Floats = NDArray[np.float64]

# Of a node: base (3), normal (3), column, row and height offset in the height model (3), longitude, latitude.
VALUES: Final = 11
# What interpolation may cost: a tenth of a millimetre of height or of ground at any place.
TOLERANCE_M: Final = 2e-5
TOLERANCE_DEM_PX: Final = 2e-5
_LARGEST_STEP: Final = 4096
_SMALLEST_STEP: Final = 8
_MOST_NODES: Final = 400_000
# Places along each side at which interpolation is proved.
_PROOFS: Final = 6


@dataclass(frozen=True, eq=False)
class MeasuringLattice:
    """Nodes over a product, in its pixel coordinates.

    Attributes
    ----------
    col0, row0, step : int
        First node and distance of nodes.
    values : (rows, cols, 11) float64
        Base (3), normal (3), column, row and offset in the height model (3), longitude, latitude (degrees).
    dem_scale : float
        Units of the law's heights per unit of the height model.
    error_m, error_dem_px : float
        Largest error of interpolation found.
    datum : str
        Of longitude and latitude.
    """

    col0: int
    row0: int
    step: int
    values: Floats
    dem_scale: float
    error_m: float
    error_dem_px: float
    datum: str

    def at(self, col: Floats, row: Floats) -> Floats:
        """Values (n, 11) at pixel positions, interpolated as the page does it."""
        x, y = (col - self.col0) / self.step, (row - self.row0) / self.step
        rows, cols = self.values.shape[:2]
        j = np.clip(np.floor(x).astype(int), 1, cols - 3)
        i = np.clip(np.floor(y).astype(int), 1, rows - 3)
        wx, wy = _weights(x - j), _weights(y - i)
        out = np.zeros((len(x), self.values.shape[2]))
        for k in range(4):
            for m in range(4):
                out += (wy[k] * wx[m])[:, None] * self.values[i - 1 + k, j - 1 + m]
        return out


def _weights(f: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Of the nodes at -1, 0, 1, 2 for the cubic through them (Lagrange)."""
    return (
        -f * (f - 1.0) * (f - 2.0) / 6.0,
        (f + 1.0) * (f - 1.0) * (f - 2.0) / 2.0,
        -(f + 1.0) * f * (f - 2.0) / 2.0,
        (f + 1.0) * f * (f - 1.0) / 6.0,
    )


def measuring_lattice(job: RectifyJob) -> MeasuringLattice:
    """The coarsest lattice of a product that loses nothing.

    Raises
    ------
    CrsError, HeightSystemError, MissingGridError
        If a node lies outside a projection, a geoid grid or a datum transformation.
    """
    size = max(job.grid.size)
    margin, proof = _margin_px(job), _proof(job)
    step = min(_LARGEST_STEP, max(_SMALLEST_STEP, 2 ** math.floor(math.log2(max(size, 2) / 2))))
    while True:
        lattice = _lattice(job, step, margin, proof)
        good = lattice.error_m <= TOLERANCE_M and lattice.error_dem_px <= TOLERANCE_DEM_PX
        finer = 4 * lattice.values.shape[0] * lattice.values.shape[1]
        if good or step <= _SMALLEST_STEP or finer > _MOST_NODES:
            return lattice
        step //= 2


def _margin_px(job: RectifyJob) -> int:
    """Pixels beside the product over which rays to hidden ground are followed."""
    if not job.is_stereo:
        return 0
    cols, rows = job.grid.size
    corners = [_exact_at(job, float(col), float(row))[6:8] for col in (0, cols) for row in (0, rows)]
    known = np.array([corner for corner in corners if np.isfinite(corner).all()])
    return math.ceil(sight_reach_m(job, known) / (job.grid.gsd * job.frame.unit_m)) if len(known) else 0


def _lattice(job: RectifyJob, step: int, margin: int, proof: _Proof) -> MeasuringLattice:
    cols, rows = job.grid.size
    largest = max((abs(float(q)) for q in job.law.q(job.height_range) if np.isfinite(q)), default=0.0)
    reach = math.ceil(largest / job.grid.gsd) if job.is_stereo else 0
    wide, high = max(reach, margin) + 2 * step, margin + 2 * step
    window = Window(-wide, -high, cols + 2 * wide, rows + 2 * high)
    found = ground_lattice(
        job.grid.affine,
        window,
        job.frame,
        job.tangent,
        job.heights.frame,
        job.heights.affine,
        height_range=job.height_range,
        gsd=job.grid.gsd,
        step=step,
    )
    node_rows, node_cols = found.base.shape[:2]
    col = found.col0 + step * np.arange(node_cols, dtype=np.float64)
    row = found.row0 + step * np.arange(node_rows, dtype=np.float64)
    pixels = np.stack(np.meshgrid(col, row), axis=-1)
    degrees, datum = _degrees(job, pixels)
    values = np.concatenate([found.base, found.normal, found.dem, degrees], axis=-1)
    lattice = MeasuringLattice(found.col0, found.row0, step, values, found.dem_scale, 0.0, 0.0, datum)
    error_m, error_px = _errors(job, lattice, proof)
    return MeasuringLattice(found.col0, found.row0, step, values, found.dem_scale, error_m, error_px, datum)


def _degrees(job: RectifyJob, pixels: Floats) -> tuple[Floats, str]:
    """Longitude and latitude on WGS 84; on the datum of the map where PROJ lacks the way there."""
    flat = MapFrame(job.frame.crs, HeightSystem.ellipsoidal())
    points = np.concatenate([job.grid.map_from_pixel(pixels), np.zeros((*pixels.shape[:-1], 1))], axis=-1)
    try:
        world = MapFrame("EPSG:4326", HeightSystem.ellipsoidal())
        return map_from_map(world, flat, points)[..., :2], "WGS 84"
    except (CrsError, HeightSystemError):
        return flat.geodetic_from_map(points)[..., :2], job.frame.geodetic.name


@dataclass(frozen=True, eq=False)
class _Proof:
    """Places between any nodes, and the rigorous values there."""

    col: Floats
    row: Floats
    exact: Floats


def _proof(job: RectifyJob) -> _Proof:
    cols, rows = job.grid.size
    # irrational parts of the product, so that no place is a node whatever the step
    spread = (np.arange(_PROOFS) + 0.5 * math.sqrt(2.0)) / (_PROOFS + 0.5)
    col, row = (n.ravel() for n in np.meshgrid(spread * cols, spread * rows))
    exact = [_exact_at(job, c, r) for c, r in zip(col.tolist(), row.tolist(), strict=True)]
    return _Proof(col, row, np.array(exact))


def _errors(job: RectifyJob, lattice: MeasuringLattice, proof: _Proof) -> tuple[float, float]:
    """Largest errors in the tangent frame and in the height model, at places between the nodes."""
    off = np.abs(lattice.at(proof.col, proof.row)[:, :9] - proof.exact)
    # the direction of the plumb line counts by the heights that are laid along it
    off[:, 3:6] *= max(map(abs, job.height_range))
    metres, pixels = np.delete(off, (6, 7), axis=1), off[:, 6:8]
    return float(metres.max()), float(pixels.max())


def _exact_at(job: RectifyJob, col: float, row: float) -> Floats:
    """Base, normal and position in the height model of one place, by the same rigorous way as the nodes."""
    a, b, c, d, e, f = job.grid.affine
    moved = (a, b, a * col + b * row + c, d, e, d * col + e * row + f)
    found = ground_lattice(
        moved,
        Window(0, 0, 1, 1),
        job.frame,
        job.tangent,
        job.heights.frame,
        job.heights.affine,
        height_range=job.height_range,
        gsd=job.grid.gsd,
        step=1,
    )
    return np.concatenate([found.base[0, 0], found.normal[0, 0], found.dem[0, 0]])
