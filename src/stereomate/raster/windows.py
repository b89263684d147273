"""Windows of pixels: integers only, clamped to their raster in one place."""

from __future__ import annotations

from typing import NamedTuple


class Window(NamedTuple):
    """A rectangle of whole pixels: first column and row, number of columns and rows."""

    col0: int
    row0: int
    cols: int
    rows: int

    @property
    def col1(self) -> int:
        """First column after the window."""
        return self.col0 + self.cols

    @property
    def row1(self) -> int:
        """First row after the window."""
        return self.row0 + self.rows

    @property
    def is_empty(self) -> bool:
        """Whether it holds no pixel."""
        return self.cols <= 0 or self.rows <= 0

    def clamped(self, size: tuple[int, int]) -> Window:
        """The part inside a raster of (columns, rows); with 0 columns or rows when there is none."""
        col0, row0 = min(max(self.col0, 0), size[0]), min(max(self.row0, 0), size[1])
        col1, row1 = min(max(self.col1, col0), size[0]), min(max(self.row1, row0), size[1])
        return Window(col0, row0, col1 - col0, row1 - row0)
