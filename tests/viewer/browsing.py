"""What tests of the page share: a server of files, a page that says what went wrong, and waiting for it."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import uvicorn

from stereomate.viewer.server import application

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
