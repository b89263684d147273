"""The report of a run: one self-contained HTML file.

Figures are embedded; nothing is loaded from elsewhere. Values come as a `ReportContent`; what they are is
decided by the project layer, how they look here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2

from stereomate.forms import RUN_PAGE
from stereomate.raster.files import write_whole


@dataclass(frozen=True)
class Table:
    """Rows under headings; cells are text as shown."""

    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""


@dataclass(frozen=True)
class Picture:
    """A figure: a data URI of PNG or SVG, what it shows, and the numbers behind it."""

    source: str
    caption: str
    alt: str
    table: Table | None = None
    wide: bool = False


@dataclass(frozen=True)
class Section:
    """A part of the report; `fragments` are HTML made by this package, put in as they are."""

    title: str
    paragraphs: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    pictures: tuple[Picture, ...] = ()
    items: tuple[str, ...] = ()
    fragments: tuple[str, ...] = ()


@dataclass(frozen=True)
class ReportContent:
    """Everything a report shows.

    Attributes
    ----------
    title, subtitle : str
    facts : pairs of label and text
        The summary at the top.
    sections : sequence of Section
    footer : str
    """

    title: str
    subtitle: str
    facts: Sequence[tuple[str, str]]
    sections: Sequence[Section]
    footer: str
    meta: Mapping[str, Any]


def report_html(content: ReportContent) -> str:
    """The page as text."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("stereomate.report", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("run.html").render(content=content, format=RUN_PAGE.version)


def write_report(path: Path, content: ReportContent) -> None:
    """Write the page, whole or not at all."""
    write_whole(path, [report_html(content).encode()])
