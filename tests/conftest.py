"""Where the data of other people and the golden vectors are; tests that need them are skipped without."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

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
