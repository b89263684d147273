"""What commands print: tables for people, one JSON value for programs."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table


def print_json(value: Any) -> None:
    """Print one JSON value; dataclasses, paths and numpy values are turned into plain ones, nan into null."""
    typer.echo(json.dumps(plain(value), indent=2, ensure_ascii=False))


def plain(value: Any) -> Any:
    """The value made of dicts, lists, strings, numbers and None only."""
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Path):
        return str(value)
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):  # numpy arrays and scalars, without importing numpy here
        return plain(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    return str(value)


def console() -> Console:
    """Console for tables; a file or a pipe gets lines of 140 characters without colours."""
    from rich.console import Console

    out = Console()
    return out if out.is_terminal else Console(width=140)


def table(
    title: str,
    heads: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    left: Sequence[int] = (0,),
    rest: int = 0,
) -> Table:
    """A table with numbers to the right; `left` are the columns of text, `rest` rows are only counted."""
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    result = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD)
    for index, head in enumerate(heads):
        result.add_column(head, justify="left" if index in left else "right", overflow="fold")
    for row in rows:
        result.add_row(*(escape(cell) for cell in row))
    if rest > 0:
        result.caption = f"and {rest} more (--json lists all)"
        result.caption_justify = "left"
    return result
