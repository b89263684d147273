"""The Dask executor on a cluster inside this process: order of results, errors, buffers, versions."""

from __future__ import annotations

import threading
import time

import pytest

from stereomate.errors import ImageError, InputError
from stereomate.tiles import Dask, Ledger, TilePlan, map_items, run

distributed = pytest.importorskip("distributed")

pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.fixture(scope="module")
def cluster():
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None
    ) as cluster:
        yield Dask(cluster.scheduler_address)


def square(item: int) -> int:
    return item * item


def test_results_come_in_the_order_of_the_items(cluster):
    assert map_items(square, range(30), cluster) == [i * i for i in range(30)]


def test_the_first_error_of_a_task_is_raised_as_it_was_and_stops_the_rest(cluster):
    begun = []

    def task(item):
        begun.append(item)
        if item == 5:
            raise ImageError("no such file", file="photo.tif")
        # What the cluster has been given runs on while the error travels; a second of work bounds that.
        time.sleep(0.02)
        return item

    with pytest.raises(ImageError, match=r"^photo\.tif: no such file$"):
        map_items(task, range(200), cluster)
    assert len(begun) < 150


def test_buffers_that_a_thread_uses_again_come_back_whole(cluster, tmp_path):
    plan = TilePlan((200, 160), 16, 2)
    scratch = threading.local()

    def task(chunk):
        if not hasattr(scratch, "buffer"):
            scratch.buffer = bytearray(8)
        scratch.buffer[:] = chunk.index.to_bytes(8, "little")
        return {"index": memoryview(scratch.buffer)}

    ledger = Ledger.open(tmp_path, "k")
    seen = []
    run(plan, task, ledger, cluster, seen.append)
    assert seen[-1].done == len(plan.chunks)
    for chunk in plan.chunks:
        assert int.from_bytes(ledger.get(chunk.index, "index"), "little") == chunk.index


def test_workers_of_another_version_are_refused(cluster, monkeypatch):
    from stereomate.tiles import cluster as module

    monkeypatch.setattr(module, "_version", lambda: "0.0.1")
    with pytest.raises(InputError, match=r"workers must have stereomate .*, got '0\.0\.1'"):
        map_items(square, [1], cluster)
