"""The code blocks of the documentation, as the tests of this folder run them."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TESTED = "<!-- tested -->"


def blocks(page: Path, language: str, *, marked: bool = False) -> list[str]:
    """Fenced blocks of a language; with `marked` those alone that follow a line ``<!-- tested -->``."""
    found = re.findall(
        rf"^({re.escape(TESTED)}\n)?```{language}\n(.*?)^```$",
        page.read_text(encoding="utf-8"),
        flags=re.MULTILINE | re.DOTALL,
    )
    return [text for mark, text in found if mark or not marked]


def commands(page: Path) -> list[str]:
    """Lines after ``$`` of the tested console blocks of a page."""
    lines = [line for text in blocks(page, "console", marked=True) for line in text.splitlines()]
    return [line[2:] for line in lines if line.startswith("$ ")]
