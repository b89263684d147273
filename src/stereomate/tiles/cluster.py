"""Tasks on a Dask cluster: the only module that imports dask.distributed.

The workers read the photographs from the files this process named, and send their results back. Only this
process writes: nothing depends on who else may write to the folder, and a full disk is noticed in one place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import islice
from typing import Any, Final, TypeVar

from stereomate import __version__
from stereomate.errors import InputError, StereomateError
from stereomate.tiles.threads import limit_library_threads

Item = TypeVar("Item")
Result = TypeVar("Result")

_CONNECT_SECONDS: Final = 15
# One task in work and one waiting per worker thread: nobody idles, and results do not pile up.
_IN_FLIGHT_PER_THREAD: Final = 2


def run_on_cluster(
    address: str,
    task: Callable[[Item], Result],
    items: Sequence[Item],
    sink: Callable[[Item, Result], None],
) -> None:
    """Run a task over items on the cluster of a scheduler; see `stereomate.tiles.Executor`.

    Raises
    ------
    InputError
        If dask.distributed is not installed, no scheduler answers, no workers are there, or they have
        another version of stereomate.
    StereomateError
        If workers die over a task again and again.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(
            "needs dask.distributed", field="--scheduler", value=address, hint="install stereomate[dask]"
        ) from error
    try:
        client = Client(address, timeout=_CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError("must be a scheduler that answers", field="--scheduler", value=address) from error
    with client:
        _run(client, address, task, items, sink)


def _run(
    client: Any,
    address: str,
    task: Callable[[Item], Result],
    items: Sequence[Item],
    sink: Callable[[Item, Result], None],
) -> None:
    from distributed import KilledWorker, as_completed

    window = _IN_FLIGHT_PER_THREAD * _require_workers(client, address)
    waiting = iter(items)
    shared_task = client.scatter(task, broadcast=True, hash=False)
    item_of: dict[Any, Item] = {}

    def submit(more: Iterable[Item]) -> list[Any]:
        futures = []
        for item in more:
            future = client.submit(_call, shared_task, item, pure=False)
            item_of[future] = item
            futures.append(future)
        return futures

    completed = as_completed(submit(islice(waiting, window)), loop=client.loop)
    try:
        for future in completed:
            try:
                result = future.result()
            except KilledWorker as error:
                raise StereomateError(
                    f"{address}: workers died over {item_of[future]} (out of memory?)"
                ) from error
            sink(item_of.pop(future), result)
            future.release()
            for next_one in submit(islice(waiting, 1)):
                completed.add(next_one)
    finally:
        client.cancel(list(item_of))


def _require_workers(client: Any, address: str) -> int:
    """Threads of all workers; their versions are compared with this process's."""
    versions = client.run(_version)
    if not versions:
        raise InputError("must be a scheduler that has workers", field="--scheduler", value=address)
    for worker, version in versions.items():
        if version != __version__:
            raise InputError(
                f"workers must have stereomate {__version__}", field=f"--scheduler {worker}", value=version
            )
    threads: dict[str, int] = client.nthreads()
    return max(1, sum(threads.values()))


def _version() -> str:
    return __version__


def _call(task: Callable[[Any], Any], item: Any) -> Any:
    limit_library_threads()
    result = task(item)
    if isinstance(result, Mapping):
        # Views of buffers that the thread will use again must not leave it.
        return {name: _own(value) for name, value in result.items()}
    return result


def _own(value: Any) -> Any:
    return bytes(value) if isinstance(value, bytearray | memoryview) else value
