"""A report as PDF: made where its extra is complete, one clear error where it is not."""

from __future__ import annotations

import importlib

import pytest
from typer.testing import CliRunner

from stereomate.cli.main import application
from stereomate.errors import InputError
from stereomate.report.page import Picture, ReportContent, Section, write_report
from stereomate.report.pdf import write_pdf

DOT = (
    "data:image/png;base64,iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5E"
    "rkJggg=="
)


@pytest.fixture
def page(tmp_path):
    section = Section(
        "Part", ("text",), pictures=(Picture(DOT, "a dot", "dot", wide=True),), fragments=("<p>x</p>",)
    )
    content = ReportContent(
        "Block", "Orthophoto", [("GSD", "0.1 m")], [section], "made by", {"software": "s"}
    )
    path = tmp_path / "report.html"
    write_report(path, content)
    return path


def pango_is_here() -> bool:
    try:
        importlib.import_module("weasyprint")
    except OSError:
        return False
    return True


def test_pdf_or_the_name_of_what_is_missing(page, tmp_path):
    target = tmp_path / "report.pdf"
    if not pango_is_here():
        # Machines without Pango are told so, with what to install; nothing is left behind.
        with pytest.raises(InputError, match=r"Pango.*libpango"):
            write_pdf(page, target)
        assert not target.exists()
        return
    write_pdf(page, target)
    data = target.read_bytes()
    assert data.startswith(b"%PDF-")
    assert data.rstrip().endswith(b"%%EOF")


@pytest.mark.parametrize(
    ("missing", "named"),
    [(ModuleNotFoundError("weasyprint"), r"stereomate\[pdf\]"), (OSError("cannot load library"), "Pango")],
)
def test_a_missing_part_is_one_clear_error(page, tmp_path, monkeypatch, missing, named):
    def absent(name):
        raise missing

    monkeypatch.setattr(importlib, "import_module", absent)
    with pytest.raises(InputError, match=named):
        write_pdf(page, tmp_path / "report.pdf")
    assert not (tmp_path / "report.pdf").exists()


def test_a_folder_without_a_report_is_named(tmp_path):
    result = CliRunner().invoke(application(), ["report", str(tmp_path)])
    assert result.exit_code != 0
    assert "stereomate run writes it" in str(result.exception)
    with pytest.raises(InputError, match="a run writes it"):
        write_pdf(tmp_path / "report.html", tmp_path / "report.pdf")
