"""A million points from tangent frame to map grid with geoid heights, against PROJ; corrections M4."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pyproj
import rasterio
from numpy.typing import NDArray
from rasterio.transform import Affine

from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.remedies import GridBlock
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_tangent

Floats = NDArray[np.float64]

POINTS = 1_000_000
OBSERVATIONS = 10_000_000
RUNS = 5
THROUGHPUT_GOAL = 0.8
M4_GOAL_S = 10.0
MAP = "+proj=lcc +lat_0=46.5 +lon_0=3 +lat_1=49 +lat_2=44 +x_0=700000 +y_0=6600000 +ellps=GRS80"


def write_geoid(folder: Path) -> Path:
    """A geoid grid of the size and spacing of the French one."""
    lat, lon = 51.5 - 0.025 * np.arange(381), -5.5 + 0.0333333333333 * np.arange(421)
    values = 48.0 + 3.0 * np.sin(lon[None, :]) * np.cos(lat[:, None])
    path = folder / "geoid.tif"
    transform = Affine(0.0333333333333, 0.0, lon[0] - 0.01666666666665, 0.0, -0.025, lat[0] + 0.0125)
    profile = {"driver": "GTiff", "height": 381, "width": 421, "count": 1, "dtype": "float32"}
    with rasterio.open(path, "w", crs="EPSG:4171", transform=transform, **profile) as out:
        out.write(values.astype(np.float32), 1)
    return path


def pyproj_pipeline(tangent: TangentFrame, geoid: Path) -> pyproj.Transformer:
    """The same steps as one PROJ pipeline."""
    x, y, z = (float(value) for value in tangent.origin_geocentric)
    return pyproj.Transformer.from_pipeline(
        f"+proj=pipeline +step +inv +proj=topocentric +ellps=GRS80 +X_0={x!r} +Y_0={y!r} +Z_0={z!r} "
        "+step +inv +proj=cart +ellps=GRS80 "
        f"+step +inv +proj=vgridshift +grids={geoid} +multiplier=1 +step {MAP}"
    )


def timed(job: Callable[[], object]) -> tuple[float, float]:
    """Seconds by the clock, and of processors in all threads, of one run."""
    start, busy = time.perf_counter(), time.process_time()
    job()
    return time.perf_counter() - start, time.process_time() - busy


def alternating_medians(ours: Callable[[], object], peer: Callable[[], object]) -> Floats:
    """Median seconds (job, clock or processor) of two jobs run in turn, so that both see the same machine."""
    runs = [(timed(ours), timed(peer)) for _ in range(RUNS + 1)]
    return np.median(np.array(runs[1:]), axis=0)


def tangent_to_map(folder: Path) -> dict[str, object]:
    geoid = write_geoid(folder)
    frame = MapFrame(MAP, HeightSystem.grid_file(geoid))
    tangent = TangentFrame.at_map(frame, (815_000.0, 6_285_000.0, 0.0))
    rng = np.random.default_rng(0)
    points = rng.uniform(-10_000.0, 10_000.0, (POINTS, 3)) * (1.0, 1.0, 0.05)
    pipeline = pyproj_pipeline(tangent, geoid)
    x, y, z = (np.ascontiguousarray(column) for column in points.T)
    theirs = np.column_stack(pipeline.transform(x, y, z))
    difference = float(np.abs(map_from_tangent(tangent, frame, points) - theirs).max())
    (ours, ours_cpu), (peer, peer_cpu) = alternating_medians(
        lambda: map_from_tangent(tangent, frame, points), lambda: pipeline.transform(x, y, z)
    ).tolist()
    return {
        "name": "1M points tangent to grid with geoid heights, one thread, peer PROJ's pipeline",
        "ours": ours,
        "peer": peer,
        "ratio": ours / peer,
        "unit": "s",
        "note": (
            f"throughput {peer / ours:.2f} of PROJ's, {peer_cpu / ours_cpu:.2f} by processor time "
            f"({ours_cpu:.2f} and {peer_cpu:.2f} s), goal {THROUGHPUT_GOAL}; difference {difference:.1e} m"
        ),
    }


def corrections_m4() -> dict[str, object]:
    frame = MapFrame(MAP, HeightSystem.ellipsoidal())
    tangent = TangentFrame.at_map(frame, (815_000.0, 6_285_000.0, 0.0))
    rng = np.random.default_rng(0)
    photographs, count = 400, OBSERVATIONS // 4
    centres = np.column_stack([rng.uniform(-5000.0, 5000.0, (photographs, 2)), np.full(photographs, 1700.0)])
    rotations = np.broadcast_to(np.eye(3), (photographs, 3, 3)).copy()
    block = GridBlock(tangent, frame, centres, rotations, np.full(photographs, 0.12))
    points = rng.uniform(-5000.0, 5000.0, (count, 3)) * (1.0, 1.0, 0.02)
    points = map_from_tangent(tangent, frame, points)
    point_of = np.repeat(np.arange(count), 4)
    photo_of = rng.integers(0, photographs, OBSERVATIONS)
    half = count // 2

    def part(k: int) -> Floats:
        rows = slice(4 * half * k, 4 * half * (k + 1))
        return block.corrections(points[half * k : half * (k + 1)], point_of[rows] - half * k, photo_of[rows])

    def both() -> None:
        with ThreadPoolExecutor(2) as pool:
            list(pool.map(part, (0, 1)))

    seconds, busy = np.median([timed(both) for _ in range(4)][1:], axis=0).tolist()
    return {
        "name": f"M4 for {OBSERVATIONS:,} observations of {count:,} points, two threads",
        "ours": seconds,
        "peer": None,
        "ratio": None,
        "unit": "s",
        "note": f"goal {M4_GOAL_S} s; {busy:.1f} s of processors in both threads together",
    }


def run() -> list[dict[str, object]]:
    """Rows of the benchmark: name, ours, peer, ratio, unit, note."""
    with tempfile.TemporaryDirectory() as folder:
        return [tangent_to_map(Path(folder)), corrections_m4()]


if __name__ == "__main__":
    for row in run():
        print(row)
