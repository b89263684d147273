"""The block loop: every chunk once, the first error once, nothing begun after it, resume."""

from __future__ import annotations

import signal
import threading
import time

import numpy as np
import pytest

from stereomate.errors import InputError, StorageError
from stereomate.tiles import Ledger, Threads, TilePlan, executor_of, limit_library_threads, map_items, run

PLAN = TilePlan((1000, 700), 64, 2)


def content(chunk) -> dict[str, bytes]:
    return {"place": repr(chunk).encode()}


@pytest.mark.parametrize("threads", [1, 3])
def test_every_chunk_is_made_once_and_reported(tmp_path, threads):
    ledger = Ledger.open(tmp_path, "k")
    seen = []
    summary = run(PLAN, content, ledger, Threads(threads), seen.append)
    total = len(PLAN.chunks)
    assert (summary.made, summary.reused) == (total, 0)
    assert [p.done for p in seen] == list(range(total + 1))
    assert {p.total for p in seen} == {total}
    for chunk in PLAN.chunks:
        assert ledger.get(chunk.index, "place") == repr(chunk).encode()


def test_only_what_is_missing_is_made_again(tmp_path):
    run(PLAN, content, Ledger.open(tmp_path, "k"))
    (tmp_path / "chunks" / "000005.chunk").unlink()
    damaged = tmp_path / "chunks" / "000007.chunk"
    damaged.write_bytes(damaged.read_bytes()[:-1])
    made = []

    def task(chunk):
        made.append(chunk.index)
        return content(chunk)

    summary = run(PLAN, task, Ledger.open(tmp_path, "k"))
    assert sorted(made) == [5, 7]
    assert summary.reused == len(PLAN.chunks) - 2


@pytest.mark.parametrize("threads", [1, 2])
def test_the_first_error_is_raised_once_and_stops_the_rest(tmp_path, threads):
    begun = []

    def task(chunk):
        begun.append(chunk.index)
        if len(begun) == 10:
            raise ArithmeticError("tenth")
        time.sleep(0.001)
        return content(chunk)

    with pytest.raises(ArithmeticError, match="tenth"):
        run(PLAN, task, Ledger.open(tmp_path, "k"), Threads(threads))
    assert 10 <= len(begun) <= 10 + threads
    again = run(PLAN, content, Ledger.open(tmp_path, "k"))
    assert again.reused >= 9


def test_an_error_of_the_ledger_stops_the_run(tmp_path, monkeypatch):
    ledger = Ledger.open(tmp_path, "k")

    def full(index, blobs):
        raise StorageError("disk full")

    monkeypatch.setattr(ledger, "put", full)
    with pytest.raises(StorageError, match="disk full"):
        run(PLAN, content, ledger, Threads(2))


def test_ctrl_c_stops_all_threads_and_keeps_what_is_finished(tmp_path):
    begun = []
    # A shell that starts tests in the background has them ignore SIGINT.
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)

    def task(chunk):
        begun.append(chunk.index)
        if len(begun) == 6:
            signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
        time.sleep(0.01)
        return content(chunk)

    try:
        with pytest.raises(KeyboardInterrupt):
            run(PLAN, task, Ledger.open(tmp_path, "k"), Threads(2))
    finally:
        signal.signal(signal.SIGINT, previous)
    assert len(begun) < len(PLAN.chunks)
    assert not [t for t in threading.enumerate() if t.name.startswith("stereomate")]
    assert run(PLAN, content, Ledger.open(tmp_path, "k")).reused >= 4


def test_a_buffer_may_be_used_again_by_the_next_task_of_the_thread(tmp_path):
    scratch = threading.local()

    def task(chunk):
        if not hasattr(scratch, "buffer"):
            scratch.buffer = bytearray(8)
        scratch.buffer[:] = chunk.index.to_bytes(8, "little")
        return {"index": memoryview(scratch.buffer)}

    ledger = Ledger.open(tmp_path, "k")
    run(PLAN, task, ledger, Threads(4))
    for chunk in PLAN.chunks:
        assert int.from_bytes(ledger.get(chunk.index, "index"), "little") == chunk.index


def test_no_more_items_are_in_work_than_threads():
    lock, now, most = threading.Lock(), 0, 0

    def task(item):
        nonlocal now, most
        with lock:
            now += 1
            most = max(most, now)
        time.sleep(0.002)
        with lock:
            now -= 1
        return item

    map_items(task, range(40), Threads(3))
    assert most == 3


def test_results_come_in_the_order_of_the_items():
    def slow_first(item):
        time.sleep(0.02 if item == 0 else 0)
        return item * item

    assert map_items(slow_first, range(20), Threads(4)) == [i * i for i in range(20)]
    assert map_items(slow_first, []) == []


def test_libraries_run_one_thread():
    import cv2

    from stereomate.tiles.threads import _loaded_openblas

    np.linalg.norm(np.ones((3, 3)) @ np.ones((3, 3)))
    cv2.setNumThreads(2)
    limit_library_threads()
    assert cv2.getNumThreads() == 1
    counts = []
    for library in _loaded_openblas():
        for name in ("scipy_openblas_get_num_threads64_", "scipy_openblas_get_num_threads"):
            getter = getattr(library, name, None)
            if getter is not None:
                counts.append(getter())
    assert counts
    assert set(counts) == {1}


def test_the_executor_follows_the_options():
    assert executor_of(3) == Threads(3)
    assert executor_of(3, "tcp://somewhere:1").address == "tcp://somewhere:1"
    with pytest.raises(InputError, match="threads: must be 1 or more, got 0"):
        executor_of(0)
