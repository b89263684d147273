"""The one block loop of the product: tasks over chunks, on threads or on a Dask cluster.

A task is a function of one item that reads shared files and returns its result; it knows nothing of the
executor. Results go to the ledger as they come; the order in which they come changes nothing.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import Final, Generic, Protocol, TypeVar

from stereomate.errors import InputError
from stereomate.raster.files import Buffer
from stereomate.tiles.ledger import Ledger
from stereomate.tiles.plan import Chunk, TilePlan
from stereomate.tiles.threads import limit_library_threads

Item = TypeVar("Item")
Result = TypeVar("Result")

Blobs = Mapping[str, Buffer]
ChunkTask = Callable[[Chunk], Blobs]

_POLL_SECONDS: Final = 0.1


class Executor(Protocol):
    """Runs a task over items; results reach `sink` as they come."""

    def each(
        self, task: Callable[[Item], Result], items: Sequence[Item], sink: Callable[[Item, Result], None]
    ) -> None:
        """Run `task` on every item and hand each result to `sink` in this process.

        The first error of a task or of `sink` stops what has not begun and is raised, once.
        """


@dataclass(frozen=True)
class Progress:
    """How far a run is: chunks made now, chunks found in the ledger, chunks in all."""

    made: int
    reused: int
    total: int

    @property
    def done(self) -> int:
        """Chunks that are finished."""
        return self.made + self.reused


@dataclass(frozen=True)
class RunSummary:
    """What a run did: chunks made now, and chunks found in the ledger."""

    made: int
    reused: int


def run(
    plan: TilePlan,
    task: ChunkTask,
    ledger: Ledger,
    executor: Executor | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> RunSummary:
    """Make every chunk of a plan that the ledger does not hold yet.

    Parameters
    ----------
    plan : TilePlan
        What to make.
    task : callable
        Makes the blobs of one chunk, by name. They are written before the same thread begins its next
        task, so they may be views of buffers that the thread uses again. Picklable for Dask.
    ledger : Ledger
        Where blobs go; chunks it holds already are not made again.
    executor : Executor, optional
        `Threads` or `Dask`; one thread without.
    progress : callable, optional
        Called at the start and after every chunk, by one thread at a time.

    Raises
    ------
    Exception
        The first error of a task, unchanged; StorageError when a blob cannot be written. Finished chunks
        stay in the ledger, also after KeyboardInterrupt.
    """
    todo = [chunk for chunk in plan.chunks if not ledger.has(chunk.index)]
    reused = len(plan.chunks) - len(todo)
    made = 0
    lock = threading.Lock()

    def report() -> None:
        if progress is not None:
            progress(Progress(made, reused, len(plan.chunks)))

    def keep(chunk: Chunk, blobs: Blobs) -> None:
        nonlocal made
        ledger.put(chunk.index, blobs)
        with lock:
            made += 1
            report()

    report()
    (executor or Threads(1)).each(task, todo, keep)
    return RunSummary(made, reused)


def map_items(
    function: Callable[[Item], Result], items: Sequence[Item], executor: Executor | None = None
) -> list[Result]:
    """Results of a function over items, in the order of the items whoever computed them.

    Raises
    ------
    Exception
        The first error of the function, unchanged.
    """
    results: dict[int, Result] = {}

    def keep(numbered: tuple[int, Item], result: Result) -> None:
        results[numbered[0]] = result

    (executor or Threads(1)).each(_OfSecond(function), list(enumerate(items)), keep)
    return [results[i] for i in range(len(items))]


@dataclass(frozen=True)
class _OfSecond(Generic[Item, Result]):
    """A function of an item as a function of (number, item); picklable, unlike a lambda."""

    function: Callable[[Item], Result]

    def __call__(self, numbered: tuple[int, Item]) -> Result:
        return self.function(numbered[1])


@dataclass(frozen=True)
class Threads:
    """Threads of this process. As many items are in work as there are threads, which bounds memory.

    Parameters
    ----------
    count : int
        Threads; with 1, everything runs in the calling thread.
    """

    count: int = 1

    def __post_init__(self) -> None:
        if self.count < 1:
            raise InputError("must be 1 or more", field="threads", value=self.count)

    def each(
        self, task: Callable[[Item], Result], items: Sequence[Item], sink: Callable[[Item, Result], None]
    ) -> None:
        """Run `task` on every item; `sink` is called by the thread that made the result."""
        limit_library_threads()
        workers = min(self.count, len(items))
        if workers <= 1:
            for item in items:
                sink(item, task(item))
            return
        queue = _Queue(items)
        with ThreadPoolExecutor(workers, thread_name_prefix="stereomate") as pool:
            futures = [pool.submit(_work, queue, task, sink) for _ in range(workers)]
            try:
                # Waiting in short turns keeps Ctrl-C alive on every platform.
                while wait(futures, timeout=_POLL_SECONDS).not_done:
                    pass
            except BaseException:
                queue.stop()
                raise
        if queue.error is not None:
            raise queue.error


class _Queue(Generic[Item]):
    """Items handed out to threads in order, until the first error."""

    def __init__(self, items: Sequence[Item]) -> None:
        self._items: Iterator[Item] = iter(items)
        self._lock = threading.Lock()
        self._stopped = False
        self.error: BaseException | None = None

    def __iter__(self) -> Iterator[Item]:
        return self

    def __next__(self) -> Item:
        with self._lock:
            if self._stopped:
                raise StopIteration
            return next(self._items)

    def stop(self, error: BaseException | None = None) -> None:
        with self._lock:
            self._stopped = True
            if self.error is None:
                self.error = error


def _work(queue: _Queue[Item], task: Callable[[Item], Result], sink: Callable[[Item, Result], None]) -> None:
    try:
        for item in queue:
            sink(item, task(item))
    # Whatever it is, it must stop the other threads and be raised in the caller's.
    except BaseException as error:  # noqa: BLE001
        queue.stop(error)


@dataclass(frozen=True)
class Dask:
    """A running Dask cluster; its workers must see the same files and have the same stereomate.

    Parameters
    ----------
    address : str
        Of the scheduler, as ``tcp://host:8786``.
    """

    address: str

    def each(
        self, task: Callable[[Item], Result], items: Sequence[Item], sink: Callable[[Item, Result], None]
    ) -> None:
        """Run `task` on the workers; `sink` is called here, so only this process writes results."""
        from stereomate.tiles.cluster import run_on_cluster

        run_on_cluster(self.address, task, items, sink)


def executor_of(threads: int, scheduler: str | None = None) -> Executor:
    """The executor of ``--threads`` and ``--scheduler``."""
    return Dask(scheduler) if scheduler else Threads(threads)
