"""Tables of over-correction factors by relative heights (Kasper 1956, Tables I and II, and any other)."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import InputError
from stereomate.relative.overcorrection import overcorrection_factor

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class OverCorrectionTable:
    """Over-correction factors for heights of points 3 and 5 above point 1, in units of z1.

    Attributes
    ----------
    tangent : float
        y/z of the rays to 5 and, with the other sign, to 3 (equal image ordinates, point 1 at the nadir).
    h3 : tuple of float
        h3/z1 of the rows, in the order of printing.
    h5 : tuple of float
        h5/z1 of the columns.
    factors : ndarray (rows, columns)
        n; ±inf on the critical line.
    """

    tangent: float
    h3: tuple[float, ...]
    h5: tuple[float, ...]
    factors: FloatArray

    @property
    def critical_sum(self) -> float:
        """(h3 + h5)/z1 on the critical line: 2 t²/(1 + t²)."""
        return 2.0 * self.tangent**2 / (1.0 + self.tangent**2)

    def to_text(self, decimals: int = 1) -> str:
        """The table as aligned text, as the paper prints it."""
        height_decimals = _decimals_of(self.h3 + self.h5)
        heads = [_signed(h, height_decimals) for h in self.h5]
        cells = [[_factor_text(n, decimals) for n in row] for row in self.factors]
        width = max(len(text) for text in [*heads, *(text for row in cells for text in row)]) + 2
        labels = [_signed(h, height_decimals) for h in self.h3]
        left = max(5, *(len(text) for text in labels))
        title = f"over-correction factor n, y/z = {self.tangent:.6g}; "
        lines = [
            title + f"critical where (h3 + h5)/z1 = {self.critical_sum:.6g}",
            "rows h3/z1, columns h5/z1",
            " " * left + " |" + "".join(text.rjust(width) for text in heads),
            "-" * left + "-+" + "-" * (width * len(heads)),
        ]
        for label, row in zip(labels, cells, strict=True):
            lines.append(label.rjust(left) + " |" + "".join(text.rjust(width) for text in row))
        return "\n".join(lines)

    def to_csv(self) -> str:
        """One line per value: tangent, h3/z1, h5/z1, n (full precision, inf on the critical line)."""
        buffer = io.StringIO()
        writer = csv.writer(buffer, lineterminator="\n")
        writer.writerow(["y_over_z", "h3_over_z1", "h5_over_z1", "n"])
        for h3, row in zip(self.h3, self.factors, strict=True):
            for h5, n in zip(self.h5, row, strict=True):
                writer.writerow([repr(self.tangent), repr(h3), repr(h5), repr(float(n))])
        return buffer.getvalue()


def overcorrection_table(tangent: float, h3: ArrayLike, h5: ArrayLike) -> OverCorrectionTable:
    """Table of over-correction factors; point 1 at the nadir, points 3 and 5 at equal image ordinates.

    Parameters
    ----------
    tangent : float
        y/z = y'/f of points 3 and 5: 1/3 in Table I (normal angle), 2/3 in Table II (wide angle).
    h3, h5 : array_like, shape (rows,), (columns,)
        Heights of points 3 and 5 above point 1 in units of z1, below 1.

    Raises
    ------
    InputError
        If the tangent is not positive, or a height is not finite or at or above the projection centre.
    """
    if not (math.isfinite(tangent) and tangent > 0.0):
        raise InputError("must be a positive number", field="tangent", value=tangent)
    rows, columns = _heights(h3, "h3"), _heights(h5, "h5")
    sections = np.zeros((len(rows), len(columns), 3, 2))
    sections[..., 0, 1] = 1.0
    sections[..., 1, 1] = 1.0 - rows[:, None]
    sections[..., 2, 1] = 1.0 - columns
    sections[..., 1, 0] = -tangent * sections[..., 1, 1]
    sections[..., 2, 0] = tangent * sections[..., 2, 1]
    factors = overcorrection_factor(sections)
    factors.flags.writeable = False
    return OverCorrectionTable(float(tangent), tuple(rows.tolist()), tuple(columns.tolist()), factors)


def normal_angle_table() -> OverCorrectionTable:
    """Table I: normal-angle cameras, y/z = 1/3, heights to a fifth of the flying height."""
    heights = [-0.20, -0.15, -0.10, -0.05, 0.0, 0.05, 0.10, 0.15, 0.20]
    return overcorrection_table(1.0 / 3.0, heights[::-1], heights)


def wide_angle_table() -> OverCorrectionTable:
    """Table II: wide-angle cameras, y/z = 2/3, heights to three tenths of the flying height."""
    heights = [-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3]
    return overcorrection_table(2.0 / 3.0, heights[::-1], heights)


def _heights(values: ArrayLike, name: str) -> FloatArray:
    heights = np.atleast_1d(np.asarray(values, dtype=np.float64))
    if heights.ndim != 1 or heights.size == 0:
        raise InputError("must be a list of heights", field=name, value=heights.shape)
    if not (np.isfinite(heights).all() and (heights < 1.0).all()):
        raise InputError(
            "must be finite and below 1 (the projection centre), in units of z1",
            field=name,
            value=heights.tolist(),
        )
    return heights


def _decimals_of(values: tuple[float, ...]) -> int:
    """Decimals, 1 to 6, that show every value."""
    return next((d for d in range(1, 6) if all(abs(v - round(v, d)) < 1e-9 for v in values)), 6)


def _signed(value: float, decimals: int) -> str:
    return f"{value:+.{decimals}f}" if round(value, decimals) != 0.0 else f"{0.0:.{decimals}f}"


def _factor_text(n: float, decimals: int) -> str:
    return "±∞" if math.isinf(n) else f"{n:.{decimals}f}"
