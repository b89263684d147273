"""`stereomate demo`: refuses to write over a user's project; makes everything and says how far off it is."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from stereomate.cli.demo import _require_ours
from stereomate.errors import InputError


def stereomate_command(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "stereomate", *arguments], capture_output=True, text=True, check=False
    )


def test_a_users_project_is_left_alone(tmp_path):
    _require_ours(tmp_path)
    _require_ours(tmp_path / "new")
    (tmp_path / "project.toml").write_text("mine")
    with pytest.raises(InputError, match="earlier demo"):
        _require_ours(tmp_path)
    done = stereomate_command("demo", str(tmp_path))
    assert done.returncode == 2
    assert "earlier demo" in done.stderr
    assert (tmp_path / "project.toml").read_text() == "mine"
    assert [p.name for p in tmp_path.iterdir()] == ["project.toml"]
    (tmp_path / "truth.json").write_text("{}")
    _require_ours(tmp_path)


@pytest.mark.slow
def test_the_demo_keeps_what_it_promises(tmp_path):
    done = stereomate_command("demo", str(tmp_path), "--strips", "1", "--photos", "2", "--json")
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert len(said["errors"]) == 7
    assert all(row["good"] for row in said["errors"]), said["errors"]
    assert all(row["count"] > 100 for row in said["errors"])
    assert (tmp_path / "products" / "mate.tif").is_file()
    again = stereomate_command("demo", str(tmp_path), "--strips", "1", "--photos", "2")
    assert again.returncode == 0, again.stderr
    assert "How far from the truth" in again.stdout
    assert "NO" not in again.stdout
    assert "Open " in again.stdout
