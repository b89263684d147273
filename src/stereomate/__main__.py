"""``python -m stereomate``."""

from __future__ import annotations

from stereomate.cli.main import run

run()
