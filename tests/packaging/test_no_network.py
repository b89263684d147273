"""No telemetry, no downloads: the main job runs with the network forbidden to Python and watched for PROJ."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from stereomate.synthetic.files import write_survey
from stereomate.synthetic.options import SurveyOptions
from stereomate.synthetic.survey import make_survey

# Python reads sitecustomize before anything else: every connection and every question to a name server is
# written down and refused.
GUARD = """
import os, sys
EVENTS = {"socket.connect", "socket.getaddrinfo", "socket.gethostbyname", "socket.sendto", "urllib.Request"}
def refuse(event, args):
    if event in EVENTS:
        with open(os.environ["ASKED"], "a") as file:
            file.write(f"{event} {args!r}\\n")
        raise OSError("the network is forbidden in this test")
sys.addaudithook(refuse)
"""
TINY = SurveyOptions(
    seed=3, strips=1, photos_per_strip=2, size_px=(240, 180), gsd_m=0.5, flying_height_m=200.0,
    pixel_pitch_mm=0.1, relief_m=20.0, terrain_step_m=4.0, buildings=2, trees=4, control_points=0,
    check_points=0,
)  # fmt: skip
# Heights above the German quasigeoid, whose grid PROJ does not bring along.
CAREFUL = """
from stereomate.errors import MissingGridError
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
try:
    MapFrame("EPSG:25832", HeightSystem.vertical_crs("EPSG:7837")).geodetic_from_map([5e5, 5.4e6, 300.0])
except MissingGridError as error:
    print("missing grid:", error)
"""
# Both commands in one process: loading what they stand on takes longer than they do.
MAIN_JOB = """
import sys
from stereomate.cli import main
for arguments in (["check", sys.argv[1]], ["--threads", "1", "run", sys.argv[1], "-o", sys.argv[2]]):
    try:
        main.run(arguments)
    except SystemExit as end:
        if end.code:
            raise
"""
CARELESS = """
import pyproj
pyproj.Transformer.from_crs("EPSG:25832+7837", "EPSG:4937").transform(5e5, 5.4e6, 300.0)
"""
Guarded = Callable[..., tuple[subprocess.CompletedProcess[str], str]]


@pytest.fixture
def guarded(tmp_path: Path) -> Iterator[Guarded]:
    """Run Python with the network forbidden; returns what came of it, and whatever it asked for.

    PROJ asks in C, where Python sees nothing: its network is switched on from outside, with a server on this
    machine as its source of grids.
    """
    (tmp_path / "guard").mkdir()
    (tmp_path / "guard" / "sitecustomize.py").write_text(GUARD)
    asked = tmp_path / "asked.txt"
    asked.touch()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            with asked.open("a") as file:
                file.write(f"PROJ {self.path}\n")
            self.send_error(404)

        do_HEAD = do_GET

        def log_message(self, *args: object) -> None:
            pass

    def run(*arguments: object) -> tuple[subprocess.CompletedProcess[str], str]:
        environment = {
            **os.environ,
            "PYTHONPATH": str(tmp_path / "guard"),
            "ASKED": str(asked),
            "PROJ_NETWORK": "ON",
            "PROJ_NETWORK_ENDPOINT": f"http://127.0.0.1:{server.server_port}",
            "PROJ_USER_WRITABLE_DIRECTORY": str(tmp_path),
            "no_proxy": "127.0.0.1",
        }
        done = subprocess.run(
            [sys.executable, *map(str, arguments)],
            env=environment, capture_output=True, text=True, check=False, timeout=300, cwd=tmp_path,
        )  # fmt: skip
        return done, asked.read_text()

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield run
        server.shutdown()
        thread.join()


def test_the_guard_sees_python_and_proj(guarded):
    done, asked = guarded("-c", "import socket; socket.create_connection(('127.0.0.1', 9), timeout=1)")
    assert done.returncode == 1
    assert "socket." in asked
    assert "PROJ" not in asked
    _, asked = guarded("-c", CARELESS)
    assert "PROJ /" in asked


def test_the_main_job_asks_for_nothing(guarded, tmp_path):
    project = write_survey(make_survey(TINY), tmp_path / "survey").project
    done, asked = guarded("-c", MAIN_JOB, project, tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert asked == ""
    # A person who opens the report fetches nothing either.
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    for reference in ('src="http', "url(http", "@import", 'src="//'):
        assert reference not in report


def test_a_missing_grid_is_named_and_not_fetched(guarded):
    done, asked = guarded("-c", CAREFUL)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("missing grid:")
    assert asked == ""
