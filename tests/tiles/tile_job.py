"""A small job for tests that need a process of its own: an image painted chunk by chunk, to a COG.

python tile_job.py FOLDER [--pause SECONDS] [--threads N] [--dask-workers N]
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stereomate.raster.cog import CogProfile, Georeference, assemble_cog, encode_chunk
from stereomate.tiles import Chunk, Executor, Ledger, RunSummary, TilePlan, executor_of, run, run_key


@dataclass(frozen=True)
class Paint:
    """The task: an orthophoto with a mask and its lineage, from the coordinates alone."""

    plan: TilePlan
    picture: CogProfile
    lineage: CogProfile
    pause: float  # seconds; a negative one kills the process

    def __call__(self, chunk: Chunk) -> dict[str, bytes]:
        w = chunk.window
        if self.pause < 0:
            os._exit(1)
        time.sleep(self.pause)
        col, row = np.arange(w.col0, w.col1), np.arange(w.row0, w.row1)[:, None]
        pixels = np.empty((w.rows, w.cols, 3), np.uint8)
        for band in range(3):
            pixels[..., band] = (col * (band + 1) // 3) ^ (row // 2)
        valid = (col // 100 + row // 130) % 5 > 0
        source = ((col // 300 + row // 200) % 4).astype(np.uint16)
        return {
            "picture": encode_chunk(self.picture, self.plan, pixels, valid),
            "lineage": encode_chunk(self.lineage, self.plan, source),
        }


def make(
    folder: Path,
    pause: float = 0.0,
    executor: Executor | None = None,
    size: tuple[int, int] = (900, 700),
    tile: tuple[int, int] = (64, 2),
) -> RunSummary:
    """The whole job: run what the ledger does not hold, assemble both files."""
    plan = TilePlan(size, *tile)
    task = Paint(
        plan,
        CogProfile("uint8", 3, mask=True),
        CogProfile("uint16", 1, nodata=0, overviews="nearest", statistics=False),
        pause,
    )
    ledger = Ledger.open(folder / "ledger", run_key(size=size, tile=tile))
    summary = run(plan, task, ledger, executor)
    place = Georeference("EPSG:32633", (1.0, 0.0, 5e5, 0.0, -1.0, 5e6))
    for name, profile in (("picture", task.picture), ("lineage", task.lineage)):
        assemble_cog(folder / f"{name}.tif", profile, plan, ledger, name, place)
    return summary


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--pause", type=float, default=0.0)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--dask-workers", type=int, default=0)
    parser.add_argument("--size", type=int, nargs=2, default=(900, 700))
    parser.add_argument("--tile", type=int, nargs=2, default=(64, 2))
    options = parser.parse_args()
    with contextlib.ExitStack() as stack:
        scheduler = None
        if options.dask_workers:
            from distributed import LocalCluster

            cluster = LocalCluster(
                n_workers=options.dask_workers, threads_per_worker=1, processes=True, dashboard_address=None
            )
            scheduler = stack.enter_context(cluster).scheduler_address
        executor = executor_of(options.threads, scheduler)
        make(options.folder, options.pause, executor, tuple(options.size), tuple(options.tile))
    # Not ru_maxrss: that begins with the memory of whoever started this process.
    print("peak MB", int(re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text())[1]) // 1024)
    return 0


if __name__ == "__main__":
    sys.exit(main())
