"""Where the data of other people and the golden vectors are; tests that need them are skipped without."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

# The first example compiles kernels, and a green run stays green: the same examples every time.
settings.register_profile(
    "stereomate", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("stereomate")

SHARED = Path(__file__).resolve().parents[2] / "shared"
DATA = Path(os.environ.get("STEREOMATE_DATA", SHARED / "data"))
GOLDEN = Path(os.environ.get("STEREOMATE_GOLDEN", SHARED / "golden"))


@pytest.fixture(scope="session")
def data_folder() -> Path:
    if not DATA.is_dir():
        pytest.skip(f"no real data at {DATA} (set STEREOMATE_DATA)")
    return DATA


@pytest.fixture(scope="session")
def golden():
    def load(name: str) -> Any:
        path = GOLDEN / name
        if not path.is_file():
            pytest.skip(f"no golden vectors at {GOLDEN} (set STEREOMATE_GOLDEN)")
        return json.loads(path.read_text())

    return load


@pytest.fixture(scope="session")
def browser():
    """Chromium, started once for all tests in a browser; absent it is a failure, not a skip."""
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
