"""A small product, its server, and a browser: made once for all tests of the viewer."""

from __future__ import annotations

import shutil
import socket
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import uvicorn

from stereomate.stereo.product import StereoProduct
from stereomate.viewer.server import application
from stereomate.viewer.site import Site, SiteOptions

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "project"))

SURVEY = {
    "size_px": (480, 360),
    "flying_height_m": 260.0,
    "pixel_pitch_mm": 0.1,
    "buildings": 14,
    "trees": 10,
    "seed": 5,
}


@contextmanager
def serving(files: object) -> Iterator[str]:
    """Files on a free port of loopback, as `serve` gives them."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        server = uvicorn.Server(uvicorn.Config(application(files), log_level="error", lifespan="off"))
        thread = threading.Thread(target=lambda: server.run(sockets=[listener]))
        thread.start()
        while not server.started:
            time.sleep(0.01)
        try:
            yield f"http://127.0.0.1:{listener.getsockname()[1]}/"
        finally:
            server.should_exit = True
            server.force_exit = True
            thread.join()


@pytest.fixture(scope="session")
def survey_folder(tmp_path_factory) -> Path:
    from run_survey import write_tiny

    return write_tiny(tmp_path_factory.mktemp("survey"), **SURVEY).parent


@pytest.fixture(scope="session")
def run_folder(survey_folder) -> Path:
    """The products; the folder's name has a space and letters beyond ASCII."""
    from run_survey import make

    out = survey_folder / "Größe 1 – prodükte"
    make(survey_folder / "project.toml", out, agreement=False, threads=1)
    return out


@pytest.fixture(scope="session")
def product(run_folder) -> StereoProduct:
    return StereoProduct.open(run_folder, verify=False)


@pytest.fixture(scope="session")
def site(product) -> Iterator[Site]:
    made = Site([product], SiteOptions(title="Test block", credits="Synthetic"))
    yield made
    made.close()


@pytest.fixture(scope="session")
def address(site) -> Iterator[str]:
    with serving(site) as found:
        yield found


@pytest.fixture(scope="session")
def browser():
    from playwright.sync_api import sync_playwright

    path = shutil.which("chromium") or shutil.which("chromium-browser")
    if path is None:
        pytest.fail("Chromium is missing: apt-get install chromium (make test does)")
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(
            executable_path=path,
            args=["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
        )
        yield started
        started.close()


def wait(page, condition: str, seconds: float = 20.0) -> None:
    """Until an expression is true in the page. Playwright's own way is forbidden by the page's policy."""
    end = time.monotonic() + seconds
    while not page.evaluate(f"Boolean({condition})"):
        assert time.monotonic() < end, f"never true: {condition}"
        time.sleep(0.02)


READY = (
    "window.stereomate && stereomate.renderer.relief && !stereomate.renderer.cache.isBusy"
    " && stereomate.renderer.times.length > 1 && !stereomate.dirty"
)


class Opened:
    """A page, with what its console said and what it asked for."""

    def __init__(self, page) -> None:
        self.page, self.errors, self.requests = page, [], []
        page.on("console", lambda m: self.errors.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("request", lambda request: self.requests.append(request.url))

    def open(self, address: str) -> None:
        self.page.goto(address)
        wait(self.page, READY)

    def settle(self) -> None:
        """Until all tiles are there and a frame shows them."""
        self.page.evaluate("stereomate.dirty = true")
        wait(self.page, READY + " && !stereomate.motion.target")


@pytest.fixture
def opened(browser):
    context = browser.new_context(viewport={"width": 800, "height": 600})
    yield Opened(context.new_page())
    context.close()
