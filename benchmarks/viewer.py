"""The viewer over a pair of 20,000 x 20,000 pixels in Chromium at 1920 x 1080, served by `stereomate view`.

What the first picture waits for, the page's own work per frame, how long tiles take after a pan, and the CPU
time of the server for a tile. Frames are drawn in software here: the page's own time is judged, not theirs.
"""

from __future__ import annotations

import dataclasses
import os
import re
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

SIZE = int(os.environ.get("STEREOMATE_BENCH_PAIR", "20000"))
PANS, OPENINGS = 12, 5
CLAIM_FIRST_MS, CLAIM_PAN_MS, CLAIM_FRAME_MS = 1000.0, 300.0, 4.0

FIRST = """(() => {
  const [at, drawn] = ['first picture', 'first picture drawn'].map(
    (name) => performance.getEntriesByName(name)[0].startTime);
  const asked = performance.getEntriesByType('resource').filter((r) => r.responseEnd <= at);
  return [at, drawn, 1 + asked.length, asked.reduce((sum, r) => sum + r.transferSize, 0)];
})()"""
PAN = """async ([dx, dy]) => {
  const app = stereomate, frame = () => new Promise((done) => requestAnimationFrame(done));
  for (let k = 0; k < 8; k++) {
    app.motion.drag(dx / 8, dy / 8);
    app.touched();
    await frame();
  }
  const start = performance.now();
  while (app.renderer.cache.isBusy) await frame();
  return performance.now() - start;
}"""


@dataclasses.dataclass(frozen=True)
class SameBlobs:
    """Blobs of chunks by the shape of their window: every chunk of one shape looks alike."""

    blobs: dict[tuple[int, int], bytes]
    shapes: dict[int, tuple[int, int]]

    def read(self, index: int, name: str, offset: int, size: int) -> bytes:
        """As the ledger of a run."""
        return self.blobs[self.shapes[index]][offset : offset + size]


def write_pair(folder: Path, size: int) -> None:
    """A product of `size` x `size` pixels over a tiny synthetic survey; its tiles are noise, all alike."""
    from stereomate.project import load
    from stereomate.project.run import RunOptions, run
    from stereomate.rectify.grid import ProductGrid
    from stereomate.rectify.task import lineage_profile, product_profile
    from stereomate.stereo.product import ProductFiles, StereoProduct, write_stereo_json
    from stereomate.synthetic.files import write_survey
    from stereomate.synthetic.options import SurveyOptions
    from stereomate.synthetic.survey import make_survey

    options = SurveyOptions(
        strips=1, photos_per_strip=3, size_px=(320, 240), flying_height_m=260.0, pixel_pitch_mm=0.1,
        buildings=4, trees=10, control_points=0, check_points=0,
    )  # fmt: skip
    project = load(write_survey(make_survey(options), folder / "survey").project)
    made = run(project, folder / "small", RunOptions(agreement=False)).products[0].product
    grid = made.job.grid
    finer = ProductGrid(grid.u0, grid.v0, grid.gsd * min(grid.size) / size, (size, size), grid.rotation)
    job = dataclasses.replace(made.job, grid=finer)
    out = folder / "pair"
    out.mkdir()
    rng = np.random.default_rng(1)
    low = rng.integers(0, 190, (256, 256, len(job.bands)), np.uint8)
    noise = np.kron(low, np.ones((4, 4, 1), np.uint8)) + rng.integers(0, 60, (1024, 1024, 1), np.uint8)
    colours = product_profile(job, ("red", "green", "blue"))
    _write(out / "ortho.tif", colours, job, noise)
    _write(out / "mate.tif", colours, job, np.roll(noise, -7, axis=1))
    _write(out / "lineage.tif", lineage_profile(job), job, np.full((1024, 1024, 2), [1, 2], np.uint16))
    files = ProductFiles("ortho.tif", "lineage.tif", "mate.tif", {})
    write_stereo_json(
        out / "stereo.json",
        [StereoProduct(job, files, out, made.height_model_hash)],
        {"key": "benchmark", "documents": []},
    )


def _write(path: Path, profile: Any, job: Any, pattern: Any) -> None:
    from stereomate.raster.cog import Georeference, assemble_cog, encode_chunk
    from stereomate.tiles.plan import TilePlan

    plan = TilePlan(job.grid.size, 512, 4)
    blobs: dict[tuple[int, int], bytes] = {}
    shapes = {}
    for chunk in plan.chunks:
        shape = shapes[chunk.index] = (chunk.window.rows, chunk.window.cols)
        if shape not in blobs:
            repeats = (-(-shape[0] // pattern.shape[0]), -(-shape[1] // pattern.shape[1]), 1)
            pixels = np.ascontiguousarray(np.tile(pattern, repeats)[: shape[0], : shape[1]])
            blobs[shape] = encode_chunk(profile, plan, pixels)
    place = Georeference(job.frame.crs, job.grid.affine, {})
    assemble_cog(path, profile, plan, SameBlobs(blobs, shapes), path.stem, place)


def _cpu_s(process: int) -> float:
    fields = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def run() -> list[dict[str, Any]]:
    """Rows for the first picture, frames, pans and the server."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_pair(folder, SIZE)
        command = [sys.executable, "-m", "stereomate", "view", str(folder / "pair"), "--no-browser"]
        started = time.perf_counter()
        server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            assert server.stdout is not None
            found = re.match(r"http://\S+", server.stdout.readline())
            assert found is not None
            return _measured(found[0], server.pid, time.perf_counter() - started)
        finally:
            server.send_signal(signal.SIGINT)
            server.wait()


def _measured(address: str, server: int, ready_s: float) -> list[dict[str, Any]]:
    from playwright.sync_api import sync_playwright

    ready_cpu = _cpu_s(server)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"),
            args=["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
        )
        first: list[list[float]] = []
        while True:
            context = browser.new_context(viewport={"width": 1920, "height": 1080})
            page = context.new_page()
            begun = _cpu_s(server)
            page.goto(address, wait_until="commit")
            _wait(page, "performance.getEntriesByName('first picture drawn').length")
            first.append([*page.evaluate(FIRST), _cpu_s(server) - begun])
            if len(first) == OPENINGS:
                break
            context.close()
        first_ms, drawn_ms, requests, size, first_cpu = map(statistics.median, zip(*first, strict=True))
        _wait(page, "stereomate.renderer.relief && !stereomate.renderer.cache.isBusy")
        page.evaluate("stereomate.motion.goTo(9000, 9000, 0.9); stereomate.touched()")
        _wait(page, "!stereomate.motion.target && !stereomate.renderer.cache.isBusy")
        page.wait_for_timeout(1500)
        page.evaluate("stereomate.renderer.times.length = 0")
        begun, uploads = _cpu_s(server), page.evaluate("stereomate.renderer.cache.uploads")
        pans = []
        for k in range(PANS):
            pans.append(page.evaluate(PAN, [-400 if k % 4 < 2 else 300, 150 if k % 2 else -250]))
            page.wait_for_timeout(400)
        frame_ms = page.evaluate("stereomate.renderer.medianMs")
        tiles = page.evaluate("stereomate.renderer.cache.uploads") - uploads
        tile_cpu = (_cpu_s(server) - begun) / max(tiles, 1)
        browser.close()
    load = f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors"
    asked = f"of {OPENINGS} openings, after {requests:.0f} requests, {size / 1e3:.0f} kB; {load}"
    rows = [
        (
            "command to address",
            1e3 * ready_s,
            None,
            "ms",
            f"{1e3 * ready_cpu:.0f} CPU ms, nearly all imports",
        ),
        ("first picture", first_ms, CLAIM_FIRST_MS, "ms", f"median {asked}"),
        ("first picture, drawn", drawn_ms, None, "ms", "when the GPU, here software, has finished it"),
        ("first picture, server", 1e3 * first_cpu, None, "CPU ms", "median"),
        ("pan of 400 px", statistics.median(pans), CLAIM_PAN_MS, "ms", f"largest {max(pans):.0f} ms; {load}"),
        ("page's own work per frame", frame_ms, CLAIM_FRAME_MS, "ms", "median while panning"),
        ("tile, server", 1e3 * tile_cpu, None, "CPU ms", f"{tiles} shown, those fetched ahead in it"),
    ]
    return [
        {"name": n, "ours": v, "peer": c, "ratio": v / c if c else None, "unit": u, "note": note}
        for n, v, c, u, note in rows
    ]


def _wait(page: Any, condition: str, seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not page.evaluate(f"Boolean({condition})"):
        if time.monotonic() > end:
            raise TimeoutError(condition)
        time.sleep(0.02)
