"""The tutorial on georeferencing: its program and commands run, and its figures are those it states."""

from __future__ import annotations

import re
import shlex

import pytest
from pages import ROOT, blocks, commands

from stereomate.cli import main
from stereomate.formats.orientation_table import read_orientation_table

PAGE = ROOT / "docs" / "georeferencing.md"


def run(line: str) -> int:
    with pytest.raises(SystemExit) as end:
        main.run(shlex.split(line)[1:])
    return int(end.value.code or 0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("georeferencing")


@pytest.mark.slow
def test_the_page_runs_as_it_is_written(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    text = " ".join(PAGE.read_text().split())
    exec("\n".join(blocks(PAGE, "python", marked=True)), {})
    assert "15 orientations" in capsys.readouterr().out
    said = {}
    for line in commands(PAGE):
        assert run(line) == 0, line
        said[line.split()[2]] = " ".join(capsys.readouterr().out.split())
    assert {path.name for path in folder.iterdir()} >= {"predict.png", "audit.png", "true.csv"}
    # What the page quotes is what was printed.
    for sentence in (
        "points 0.704 m too high in the middle of a model",
        "centres -0.704 m, new points at worst",
    ):
        assert sentence in said["predict"]
        assert sentence in text
    for row in re.findall(r'^  (photos\S+|control\S+) +("\w+") +(\w[\w ]*)$', PAGE.read_text(), re.MULTILINE):
        assert " ".join(row) in said["audit"]
    before, after = (
        read_orientation_table(folder / name).rows for name in ("delivery/orientation.csv", "true.csv")
    )
    shift = [a.numbers["z"] - b.numbers["z"] for a, b in zip(after, before, strict=True)]
    assert sum(shift) / len(shift) == pytest.approx(0.704, abs=0.001)


@pytest.mark.slow
def test_commands_that_refuse_or_need_the_audits_answer(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    lines = [
        line[2:]
        for text in blocks(PAGE, "console")
        for line in text.splitlines()
        if line.startswith("$ ") and line[2:] not in commands(PAGE)
    ]
    refused, *fixes = lines
    assert run(refused) == 2
    assert "does not say about which axes its angles turn (declare one of: grid" in capsys.readouterr().err
    project = folder / "delivery" / "project.toml"
    project.write_text(
        project.read_text().replace(
            "[photos]\n", '[photos]\nangles = "grid"\nangle_unit = "gon"\nadjusted_in = "grid"\n'
        )
    )
    (folder / "results.csv").write_text("filename,x,y,z\np1,510000,5300000,449.789\n")
    for line in fixes:
        assert run(line) == 0, line
    assert {"orientation.csv", "control.csv", "observations.mes", "fix.json"} <= {
        path.name for path in (folder / "m4").iterdir()
    }
    (row,) = read_orientation_table(folder / "results_true.csv").rows
    assert row.numbers["z"] == pytest.approx(450.0, abs=1e-3)
