"""Kernels of the encoder: 2 x 2 reduction, differences, filling, sums. Arrays in, arrays out.

Images are C-contiguous (rows, cols, bands); validity is uint8 (rows, cols), 1 valid and 0 not. Loops run over
rows flattened to samples wherever that lets the compiler use vector instructions.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import kernel

Image = NDArray[Any]
Bytes = NDArray[np.uint8]


@kernel
def halve_integers(src: Image, valid: Bytes, masked: bool, sums: Image, out: Image, out_valid: Bytes) -> None:
    """Mean of the valid pixels among 2 x 2, rounded half up; an odd last row or column counts twice.

    `sums` is one row of samples of a type that holds four of them. Without `masked`, `valid` and
    `out_valid` are not looked at.
    """
    rows, cols, bands = src.shape
    width = cols * bands
    src2 = src.reshape(rows, width)
    for r in range(out.shape[0]):
        upper, lower = src2[2 * r], src2[min(2 * r + 1, rows - 1)]
        state = 1
        if masked:
            state = _halve_validity(valid[2 * r], valid[min(2 * r + 1, rows - 1)], out_valid[r])
        if state == 1:
            for i in range(width):
                sums[i] = upper[i] + sums.dtype.type(lower[i])
            _halve_sums(sums, cols, bands, out[r])
        elif state == 0:
            for c in range(out.shape[1]):
                for b in range(bands):
                    out[r, c, b] = 0
        else:
            _halve_masked_integers(
                upper, lower, valid[2 * r], valid[min(2 * r + 1, rows - 1)], cols, bands, out[r]
            )


@kernel
def _halve_validity(upper: Image, lower: Image, out: Image) -> int:
    """Validity of a row of 2 x 2 pixels; 1 if all four are valid everywhere, 0 if none anywhere, else 2."""
    cols = upper.shape[0]
    count = 0
    for c in range(cols):
        count += upper[c] + lower[c]
    if count == 2 * cols:
        out[:] = 1
        return 1
    if count == 0:
        out[:] = 0
        return 0
    for c in range(out.shape[0]):
        d = min(2 * c + 1, cols - 1)
        out[c] = upper[2 * c] | upper[d] | lower[2 * c] | lower[d]
    return 2


@kernel
def _halve_sums(sums: Image, cols: int, bands: int, out: Image) -> None:
    half = cols // 2
    if bands == 1:
        for c in range(half):
            out[c, 0] = (sums[2 * c] + sums[2 * c + 1] + 2) >> 2
    elif bands == 3:
        for c in range(half):
            out[c, 0] = (sums[6 * c] + sums[6 * c + 3] + 2) >> 2
            out[c, 1] = (sums[6 * c + 1] + sums[6 * c + 4] + 2) >> 2
            out[c, 2] = (sums[6 * c + 2] + sums[6 * c + 5] + 2) >> 2
    else:
        for c in range(half):
            for b in range(bands):
                out[c, b] = (sums[2 * c * bands + b] + sums[(2 * c + 1) * bands + b] + 2) >> 2
    if cols % 2:
        for b in range(bands):
            out[half, b] = (2 * sums[2 * half * bands + b] + 2) >> 2


@kernel
def _halve_masked_integers(
    upper: Image, lower: Image, valid_upper: Bytes, valid_lower: Bytes, cols: int, bands: int, out: Image
) -> None:
    for c in range(out.shape[0]):
        d = min(2 * c + 1, cols - 1)
        a00, a01 = np.int64(valid_upper[2 * c]), np.int64(valid_upper[d])
        a10, a11 = np.int64(valid_lower[2 * c]), np.int64(valid_lower[d])
        count = a00 + a01 + a10 + a11
        for b in range(bands):
            if count == 0:
                out[c, b] = 0
                continue
            i, k = 2 * c * bands + b, d * bands + b
            total = a00 * upper[i] + a01 * upper[k] + a10 * lower[i] + a11 * lower[k]
            out[c, b] = (2 * total + count) // (2 * count)


@kernel
def halve_floats(src: Image, valid: Bytes, masked: bool, out: Image, out_valid: Bytes) -> None:
    """Mean of the valid samples among 2 x 2 that are not NaN; NaN where there is none."""
    rows, cols, bands = src.shape
    for r in range(out.shape[0]):
        r0, r1 = 2 * r, min(2 * r + 1, rows - 1)
        if masked:
            _halve_validity(valid[r0], valid[r1], out_valid[r])
        for c in range(out.shape[1]):
            c0, c1 = 2 * c, min(2 * c + 1, cols - 1)
            for b in range(bands):
                total = 0.0
                count = 0
                for y, x in ((r0, c0), (r0, c1), (r1, c0), (r1, c1)):
                    value = src[y, x, b]
                    if (not masked or valid[y, x]) and value == value:
                        total += value
                        count += 1
                out[r, c, b] = total / count if count else np.nan


@kernel
def halve_nearest(src: Image, valid: Bytes, masked: bool, out: Image, out_valid: Bytes) -> None:
    """The first valid pixel among 2 x 2, in reading order."""
    rows, cols, bands = src.shape
    for r in range(out.shape[0]):
        r0, r1 = 2 * r, min(2 * r + 1, rows - 1)
        for c in range(out.shape[1]):
            c0, c1 = 2 * c, min(2 * c + 1, cols - 1)
            y, x = r0, c0
            if masked and not valid[r0, c0]:
                if valid[r0, c1]:
                    x = c1
                elif valid[r1, c0]:
                    y = r1
                else:
                    y, x = r1, c1
            for b in range(bands):
                out[r, c, b] = src[y, x, b]
            if masked:
                out_valid[r, c] = valid[y, x]


@kernel
def take_differences(src: Image, row0: int, col0: int, out: Image) -> None:
    """A tile of `src` as differences along its rows (TIFF predictor 2); zeros outside the image."""
    bands = src.shape[2]
    src2 = src.reshape(src.shape[0], src.shape[1] * bands)
    out2 = out.reshape(out.shape[0], out.shape[1] * bands)
    rows = min(out.shape[0], src.shape[0] - row0)
    width = min(out.shape[1], src.shape[1] - col0) * bands
    for r in range(rows):
        source = src2[row0 + r, col0 * bands : col0 * bands + width]
        target = out2[r]
        for i in range(bands):
            target[i] = source[i]
        # Slices begin at 0: no index can be negative, and the loop becomes vector instructions.
        shifted, differences = source[bands:], target[bands:]
        for i in range(width - bands):
            differences[i] = shifted[i] - source[i]
        for i in range(width, target.shape[0]):
            target[i] = 0
    for r in range(rows, out.shape[0]):
        target = out2[r]
        for i in range(target.shape[0]):
            target[i] = 0


@kernel
def take_float_differences(tile: Bytes, bands: int, out: Bytes) -> None:
    """A tile of float32, as bytes, in the order of TIFF predictor 3.

    `tile` and `out` are uint8 (rows, bytes of a row). Bytes of a row are sorted by significance, highest
    first, then differenced at a distance of `bands` (Adobe Photoshop TIFF technical note 3; little-endian
    samples).
    """
    rows, width = tile.shape
    count = width // 4
    for r in range(rows):
        source, target = tile[r], out[r]
        for plane in range(4):
            for i in range(count):
                target[plane * count + i] = source[4 * i + 3 - plane]
        for i in range(width - 1, bands - 1, -1):
            target[i] -= target[i - bands]


@kernel
def fill_tile(
    src: Image, valid: Bytes, masked: bool, row0: int, col0: int, fill: Any, nudged: Any, out: Image
) -> None:
    """A tile of `src`: invalid pixels as `fill`, valid samples equal to `fill` as `nudged`.

    Beyond the image the last column and row are repeated, which codecs like. Pass `nudged` equal to `fill`
    to leave valid samples alone.
    """
    bands = src.shape[2]
    rows = min(out.shape[0], src.shape[0] - row0)
    cols = min(out.shape[1], src.shape[1] - col0)
    for r in range(rows):
        for c in range(cols):
            if masked and not valid[row0 + r, col0 + c]:
                for b in range(bands):
                    out[r, c, b] = fill
            else:
                for b in range(bands):
                    value = src[row0 + r, col0 + c, b]
                    out[r, c, b] = nudged if value == fill else value
        for c in range(cols, out.shape[1]):
            for b in range(bands):
                out[r, c, b] = out[r, cols - 1, b]
    out2 = out.reshape(out.shape[0], out.shape[1] * bands)
    for r in range(rows, out.shape[0]):
        source, target = out2[rows - 1], out2[r]
        for i in range(source.shape[0]):
            target[i] = source[i]


@kernel
def add_statistics(
    src: Image, valid: Bytes, masked: bool, total: Image, squares: Image, low: Image, high: Image
) -> int:
    """Add the valid samples of an integer image to sums, one for each sample of a row. Exact.

    `total` and `squares` are of a type that holds the sums over all rows. Returns the number of valid
    pixels.
    """
    rows, cols, bands = src.shape
    width = cols * bands
    src2 = src.reshape(rows, width)
    pixels = 0
    for r in range(rows):
        count = cols
        if masked:
            count = 0
            for c in range(cols):
                count += valid[r, c]
        pixels += count
        row = src2[r]
        if count == cols:
            for i in range(width):
                value = total.dtype.type(row[i])
                total[i] += value
                squares[i] += value * value
            for i in range(width):
                low[i] = min(low[i], row[i])
                high[i] = max(high[i], row[i])
        elif count:
            for c in range(cols):
                if valid[r, c]:
                    for i in range(c * bands, (c + 1) * bands):
                        value = total.dtype.type(row[i])
                        total[i] += value
                        squares[i] += value * value
                        low[i] = min(low[i], row[i])
                        high[i] = max(high[i], row[i])
    return pixels


@kernel
def add_float_statistics(
    src: Image, valid: Bytes, masked: bool, counts: Image, sums: Image, limits: Image
) -> None:
    """Add the valid samples that are not NaN, in reading order, in double precision.

    `counts` is (bands,), `sums` (bands, 2): sum and sum of squares, `limits` (bands, 2): lowest and highest.
    """
    rows, cols, bands = src.shape
    for r in range(rows):
        for c in range(cols):
            if masked and not valid[r, c]:
                continue
            for b in range(bands):
                value = np.float64(src[r, c, b])
                if value == value:
                    counts[b] += 1
                    sums[b, 0] += value
                    sums[b, 1] += value * value
                    limits[b, 0] = min(limits[b, 0], value)
                    limits[b, 1] = max(limits[b, 1], value)
