"""A run that is killed, cut among threads or sent to a cluster gives the same bytes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from run_survey import make, variant, write_tiny

RESULTS = ("ortho.tif", "mate.tif", "lineage.tif", "stereo.json")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Project file and the products of an uninterrupted run on one thread, many chunks."""
    folder = tmp_path_factory.mktemp("whole")
    (folder / "survey").mkdir()
    project = variant(write_tiny(folder / "survey"), folder, gsd="0.35")
    make(project, folder / "out", chunk_tiles=1)
    return project, folder / "out"


def results(out: Path) -> dict[str, bytes]:
    return {name: (out / name).read_bytes() for name in RESULTS}


def test_two_threads_give_the_same_bytes(whole):
    project, out = whole
    result = make(project, project.parent / "two", threads=2, chunk_tiles=1)
    assert result.products[0].chunks_made > 8
    assert results(project.parent / "two") == results(out)


def start(project: Path, out: Path, *options: str) -> subprocess.Popen[bytes]:
    """`stereomate run` as its own process: one thread, small chunks."""
    code = (
        "import sys; import stereomate.project.run as r; from dataclasses import replace;"
        "plain = r.RunOptions;"
        "r.RunOptions = lambda **k: plain(**{**k, 'chunk_tiles': 1});"
        "from stereomate.cli import main; main.run(sys.argv[1:])"
    )
    command = [
        sys.executable,
        "-c",
        code,
        "run",
        str(project),
        "-o",
        str(out),
        "--threads",
        "1",
        "-q",
        *options,
    ]
    return subprocess.Popen(command, env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"})


@pytest.mark.slow
@pytest.mark.parametrize("chunks", [2, 7])
def test_killed_in_the_middle_and_resumed(whole, chunks):
    project, out = whole
    other = project.parent / f"killed{chunks}"
    process = start(project, other)
    ledger = other / ".stereomate" / "tiles" / "chunks"
    deadline = time.monotonic() + 300
    while len(list(ledger.glob("*.chunk"))) < chunks:
        assert process.poll() is None, "was done before it could be killed"
        assert time.monotonic() < deadline
        time.sleep(0.002)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    kept = sorted(ledger.glob("*.chunk"))
    assert not (other / "stereo.json").exists()
    assert not (other / "ortho.tif").exists()
    # A torn chunk, as a power cut leaves it, is made again.
    kept[0].write_bytes(kept[0].read_bytes()[:-100])
    result = make(project, other, chunk_tiles=1)
    (product,) = result.products
    assert product.chunks_reused == len(kept) - 1
    assert product.chunks_made > 0
    assert results(other) == results(out)
    assert not (other / ".stereomate").exists()


@pytest.mark.slow
def test_killed_while_files_are_assembled(whole):
    """From the first raster that is replaced on, the folder does not say that it is whole."""
    project, out = whole
    other = project.parent / "assembly"
    make(project, other, chunk_tiles=1, agreement=False)
    process = start(project, other)
    deadline = time.monotonic() + 300
    retired = other / ".stereomate" / "retired.json"
    while not retired.exists():
        assert process.poll() is None, "was done before it could be killed"
        assert time.monotonic() < deadline
        time.sleep(0.002)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not (other / "stereo.json").exists()
    result = make(project, other, chunk_tiles=1)
    assert result.products[0].chunks_made == 0
    assert results(other) == results(out)


@pytest.mark.slow
def test_two_worker_processes_of_a_cluster_give_the_same_bytes(whole):
    distributed = pytest.importorskip("distributed")
    project, out = whole
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as cluster:
        other = project.parent / "cluster"
        result = make(project, other, scheduler=cluster.scheduler_address, chunk_tiles=1)
        # The same from the command line, with its own size of chunks.
        command = [
            sys.executable,
            "-m",
            "stereomate",
            "run",
            str(project),
            "-o",
            str(project.parent / "line"),
        ]
        command += ["--scheduler", cluster.scheduler_address, "--ortho-only", "--json", "-q"]
        said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    assert result.products[0].chunks_made > 8
    assert results(other) == results(out)
    assert json.loads(said)["products"][0]["files"] == ["lineage.tif", "ortho.tif"]


# --- memory ------------------------------------------------------------------------------------------------


# Of the program itself: on Linux `getrusage` counts too what the process was before it became this program.
MEASURED = """
import pathlib, resource, sys
from stereomate.cli import main
try:
    main.run(sys.argv[1:])
except SystemExit as end:
    status = pathlib.Path("/proc/self/status")
    if status.exists():
        text = status.read_text()
        peak = int(text[text.index("VmHWM:"):].split()[1])
    else:
        unit = 1024 if sys.platform == "darwin" else 1
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // unit
    print("PEAK", peak)
    sys.exit(end.code)
"""


def peak_megabytes(project: Path, out: Path, memory: str = "256MB") -> float:
    command = [sys.executable, "-c", MEASURED, "run", str(project), "-o", str(out), "--threads", "1", "-q"]
    command += ["--memory", memory, "--no-agreement"]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return int(done.stdout.split("PEAK ")[1]) / 1024.0


@pytest.mark.slow
def test_memory_does_not_grow_with_the_product(tmp_path):
    """Peak resident memory of the whole command, for a product of 5 and of 49 million pixels."""
    (tmp_path / "survey").mkdir()
    base = write_tiny(
        tmp_path / "survey", size_px=(1600, 1200), gsd_m=0.1, pixel_pitch_mm=0.02, photos_per_strip=2
    )
    peaks = []
    for name, gsd in (("small", "0.08"), ("large", "0.0253")):
        folder = tmp_path / name
        folder.mkdir()
        project = folder / "project.toml"
        text = base.read_text().replace("gsd = 0.1", f"gsd = {gsd}")
        for file in ("orientation.csv", "heights.tif", "strip*.tif"):
            text = text.replace(f'"{file}"', f'"{base.parent / file}"')
        project.write_text(text)
        peaks.append(peak_megabytes(project, folder / "out"))
        size = json.loads((folder / "out" / "stereo.json").read_text())["products"][0]["grid"]["size"]
        peaks.append(size[0] * size[1] / 1e6)
    small, small_size, large, large_size = peaks
    print(f"{small:.0f} MB for {small_size:.1f} Mpix, {large:.0f} MB for {large_size:.1f} Mpix")
    assert large_size > 9.5 * small_size
    assert large < small + 60.0
    assert large < 500.0
