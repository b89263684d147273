"""Processes that are killed, run out of disk, or are spread over a cluster: the same bytes, or one error."""

from __future__ import annotations

import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import tile_job

from stereomate.errors import InputError, StorageError
from stereomate.tiles import Dask, Threads, map_items

NAMES = ("picture.tif", "lineage.tif")
CHUNKS = 48


def start(folder: Path, *options: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, tile_job.__file__, str(folder), *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(job: subprocess.Popen[str]) -> str:
    out, errors = job.communicate(timeout=300)
    assert job.returncode == 0, errors
    return out


def dead_process() -> int:
    job = subprocess.Popen([sys.executable, "-c", ""])
    job.wait()
    return job.pid


def products(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in NAMES}


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("undisturbed")
    assert tile_job.make(folder).made == CHUNKS
    return products(folder)


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Files of this process may not grow beyond a size: what a full disk looks like from inside."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_killed_run_goes_on_and_gives_the_same_bytes(tmp_path, undisturbed):
    job = start(tmp_path, "--pause", "0.05", "--threads", "2")
    while len(chunks := sorted(tmp_path.glob("ledger/chunks/*.chunk"))) < 7:
        assert job.poll() is None
        time.sleep(0.01)
    job.send_signal(signal.SIGKILL)
    job.communicate()
    assert not [path for path in tmp_path.iterdir() if path.name != "ledger"]
    # A power cut may leave a torn chunk as well.
    chunks[3].write_bytes(chunks[3].read_bytes()[:-100])
    summary = tile_job.make(tmp_path, executor=Threads(2))
    assert summary.made + summary.reused == CHUNKS
    assert 6 <= summary.reused < CHUNKS - 1
    assert products(tmp_path) == undisturbed


def test_a_run_that_is_finished_makes_nothing_again(tmp_path, undisturbed):
    tile_job.make(tmp_path)
    (tmp_path / "picture.tif").unlink()
    assert tile_job.make(tmp_path).reused == CHUNKS
    assert products(tmp_path) == undisturbed


@pytest.mark.parametrize(("limit", "stops"), [(5_000, "chunk"), (100_000, "picture.tif")])
def test_a_disk_that_fills_up_is_one_error_and_leaves_no_half_file(tmp_path, limit, stops, undisturbed):
    assert len(undisturbed["picture.tif"]) > 100_000
    with largest_file(limit), pytest.raises(StorageError, match="File too large"):
        tile_job.make(tmp_path, executor=Threads(2))
    assert not list(tmp_path.rglob("*.part"))
    assert not (tmp_path / "picture.tif").exists()
    whole = len(list(tmp_path.glob("ledger/chunks/*.chunk"))) == CHUNKS
    assert whole == (stops == "picture.tif")
    tile_job.make(tmp_path)
    assert products(tmp_path) == undisturbed


def test_an_old_product_stays_until_the_new_one_is_complete(tmp_path):
    (tmp_path / "picture.tif").write_bytes(b"old")
    with largest_file(100_000), pytest.raises(StorageError):
        tile_job.make(tmp_path)
    assert (tmp_path / "picture.tif").read_bytes() == b"old"


def test_what_a_killed_assembly_left_is_swept_away(tmp_path, undisturbed):
    (tmp_path / f".picture.tif.{dead_process()}-01234567.part").write_bytes(b"half")
    tile_job.make(tmp_path)
    assert not list(tmp_path.glob(".*.part"))
    assert products(tmp_path) == undisturbed


def test_a_folder_below_a_file_is_one_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="Not a directory"):
        tile_job.make(tmp_path / "file" / "out")


def test_a_scheduler_that_does_not_answer_is_one_error(monkeypatch):
    pytest.importorskip("distributed")
    from stereomate.tiles import cluster

    monkeypatch.setattr(cluster, "_CONNECT_SECONDS", 0.3)
    with pytest.raises(InputError, match="--scheduler: must be a scheduler that answers"):
        map_items(abs, [1], Dask("tcp://127.0.0.1:9"))


@pytest.mark.slow
def test_two_worker_processes_of_dask_give_the_same_bytes(tmp_path, undisturbed):
    pytest.importorskip("distributed")
    finish(start(tmp_path, "--dask-workers", "2"))
    assert products(tmp_path) == undisturbed


@pytest.mark.slow
def test_workers_that_die_are_one_error(tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setenv("DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES", "0")
    job = start(tmp_path, "--dask-workers", "1", "--pause", "-1")
    _, errors = job.communicate(timeout=120)
    assert job.returncode == 1
    assert re.search(r"StereomateError: .*: workers died over Chunk\(index=\d", errors)


@pytest.mark.slow
def test_memory_does_not_grow_with_the_size_of_the_product(tmp_path):
    peaks = []
    for cols in (4000, 40000):
        folder = tmp_path / str(cols)
        options = ("--size", str(cols), "4000", "--tile", "512", "2", "--threads", "2")
        peaks.append(int(re.search(r"peak MB (\d+)", finish(start(folder, *options)))[1]))
    assert peaks[1] < peaks[0] + 40
    assert peaks[1] < 400
