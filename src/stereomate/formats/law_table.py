"""Tables of a monotone parallax law: heights and their parallaxes, as CSV."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Final

from stereomate.errors import FormatError
from stereomate.parallax.laws import ParallaxLaw
from stereomate.raster.files import write_whole

COLUMNS: Final = ("height", "parallax")


def read_law_table(path: Path) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Heights in the project's system and parallaxes in ground units, as rows of a CSV with a header.

    Raises
    ------
    FormatError
        If the file is missing, lacks a column, or a value is no number, with its row.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise FormatError("does not exist", file=path) from error
    except UnicodeDecodeError as error:
        raise FormatError("is not a text file", file=path) from error
    rows = list(csv.DictReader(io.StringIO(text)))
    heads = list(rows[0]) if rows else []
    if not set(COLUMNS) <= set(heads):
        raise FormatError(
            f"must have the columns {' and '.join(COLUMNS)}", file=path, field="columns", value=heads
        )
    columns = []
    for name in COLUMNS:
        try:
            columns.append(tuple(float(row[name]) for row in rows))
        except (TypeError, ValueError) as error:
            raise FormatError("must be a number", file=path, field=name) from error
    return columns[0], columns[1]


def write_law_table(path: Path, law: ParallaxLaw) -> None:
    """The table of a law, for `read_law_table`."""
    out = io.StringIO(newline="")
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    for height, parallax in zip(law.table_heights_m, law.table_parallaxes_m, strict=True):
        writer.writerow([f"{height + law.reference_m:.6f}", f"{parallax:.6f}"])
    write_whole(path, [out.getvalue().encode()])
