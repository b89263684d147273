"""Tables of columns as Parquet files."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]

from stereomate.raster.files import write_whole


def write_parquet(path: Path, columns: Mapping[str, Sequence[Any]], meanings: Mapping[str, str]) -> None:
    """Write a table, whole or not at all; the same columns give the same bytes.

    Parameters
    ----------
    path : Path
    columns : mapping
        Name -> values of one type; NaN is written as a missing value.
    meanings : mapping
        Name -> what it is, with its unit; kept in the file beside the column.

    Raises
    ------
    StorageError
        If the file cannot be written.
    """
    arrays = [pa.array(values, from_pandas=True) for values in columns.values()]
    fields = [
        pa.field(name, array.type, metadata={"meaning": meanings.get(name, "")})
        for name, array in zip(columns, arrays, strict=True)
    ]
    data = io.BytesIO()
    pq.write_table(pa.Table.from_arrays(arrays, schema=pa.schema(fields)), data, compression="zstd")
    write_whole(path, [data.getvalue()])
