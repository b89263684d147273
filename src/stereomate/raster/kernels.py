"""Kernels of the readers. Arrays in, arrays out."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from stereomate.jit import kernel


@kernel
def interleave(planes: NDArray[Any], out: NDArray[Any]) -> None:
    """Bands one after the other (bands, rows, cols) to bands pixel by pixel (rows, cols, bands)."""
    bands, rows, cols = planes.shape
    for r in range(rows):
        target = out[r].reshape(cols * bands)
        if bands == 3:
            first, second, third = planes[0, r], planes[1, r], planes[2, r]
            for c in range(cols):
                target[3 * c] = first[c]
                target[3 * c + 1] = second[c]
                target[3 * c + 2] = third[c]
        else:
            for b in range(bands):
                source = planes[b, r]
                for c in range(cols):
                    target[c * bands + b] = source[c]
