"""`stereomate view` and `stereomate publish` as they are typed."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import urllib.request

import pytest

from stereomate.cli.main import run
from stereomate.viewer.publish import is_site


def ask(address: str, name: str) -> bytes:
    with urllib.request.urlopen(address + name, timeout=60) as answer:
        return answer.read()


def started(arguments: list[str]) -> tuple[subprocess.Popen[str], str]:
    """The command, running, and its address."""
    command = [sys.executable, "-m", "stereomate", "view", *arguments, "--no-browser"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    return process, process.stdout.readline().split(" ")[0]


def ended(process: subprocess.Popen[str]) -> None:
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert errors == ""
    assert process.returncode == 0


@pytest.mark.slow
def test_publish_then_view_both(run_folder, tmp_path, capsys):
    out = tmp_path / "my site"
    with pytest.raises(SystemExit) as left:
        run(["-q", "publish", str(run_folder), "-o", str(out), "--title", "A & B", "--object-height", "5,20"])
    assert not left.value.code
    assert is_site(out)
    record = json.loads((out / "data/0/product.json").read_text())
    assert record["title"] == "A & B"
    assert record["homogeneity"] == [5.0, 20.0]
    project = json.loads((run_folder / "stereo.json").read_text())["run"]["project"]
    assert project
    for arguments, title in (([str(run_folder), "--no-verify"], project), ([str(out)], "A & B")):
        process, address = started(arguments)
        assert address.startswith("http://127.0.0.1:")
        assert b"<title>" in ask(address, "")
        asked = json.loads(ask(address, "data/0/product.json"))
        assert (asked["key"], asked["title"]) == (record["key"], title)
        ended(process)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["publish", "RUN", "-o", "OUT", "--object-height", "x"], "--object-height"),
        (["publish", "RUN", "-o", "OUT", "--product", "none"], "product"),
        (["publish", "RUN", "-o", "OUT", "--points", "OUT"], "CSV"),
        (["view", "OUT"], "does not exist"),
        (["publish", "RUN", "-o", "RUN"], "must be new, empty"),
    ],
)
def test_wrong_input_is_one_line(run_folder, tmp_path, capsys, arguments, text):
    places = {"RUN": str(run_folder), "OUT": str(tmp_path / "out")}
    with pytest.raises(SystemExit) as left:
        run([places.get(argument, argument) for argument in arguments])
    assert left.value.code == 2
    errors = capsys.readouterr().err.strip()
    assert errors.startswith("error: ")
    assert errors.count("\n") == 0
    assert text in errors
