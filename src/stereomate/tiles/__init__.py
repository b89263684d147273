"""The one block loop: tile plan, executors (threads, Dask), and the ledger that resume stands on."""

from stereomate.tiles.executor import (
    Dask,
    Executor,
    Progress,
    RunSummary,
    Threads,
    executor_of,
    map_items,
    run,
)
from stereomate.tiles.ledger import Ledger, run_key
from stereomate.tiles.plan import Chunk, TilePlan
from stereomate.tiles.threads import limit_library_threads

__all__ = [
    "Chunk",
    "Dask",
    "Executor",
    "Ledger",
    "Progress",
    "RunSummary",
    "Threads",
    "TilePlan",
    "executor_of",
    "limit_library_threads",
    "map_items",
    "run",
    "run_key",
]
