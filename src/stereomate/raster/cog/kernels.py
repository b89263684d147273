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
        below = min(2 * r + 1, rows - 1)
        upper, lower = src2[2 * r], src2[below]
        count = 4
        if masked:
            count = _count_valid(valid[2 * r], valid[below], out_valid[r])
        if count:
            for i in range(width):
                sums[i] = upper[i] + sums.dtype.type(lower[i])
            _halve_sums(sums, cols, bands, out[r])
        if count < 4:
            _mend_masked_integers(upper, lower, valid[2 * r], valid[below], bands, out[r])


@kernel
def _count_valid(upper: Bytes, lower: Bytes, out: Bytes) -> int:
    """Validity of a row of 2 x 2 pixels; 4 if all are valid everywhere, 0 if none is anywhere, else 1."""
    cols = upper.shape[0]
    least, most = np.uint8(1), np.uint8(0)
    for c in range(cols):
        least = min(least, upper[c] & lower[c])
        most = max(most, upper[c] | lower[c])
    for c in range(out.shape[0]):
        d = min(2 * c + 1, cols - 1)
        out[c] = upper[2 * c] | upper[d] | lower[2 * c] | lower[d]
    if least:
        return 4
    return 1 if most else 0


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
def _mend_masked_integers(
    upper: Image, lower: Image, valid_upper: Bytes, valid_lower: Bytes, bands: int, out: Image
) -> None:
    """Means again where not all of the four pixels are valid."""
    cols = valid_upper.shape[0]
    for c in range(out.shape[0]):
        d = min(2 * c + 1, cols - 1)
        a00, a01 = np.int64(valid_upper[2 * c]), np.int64(valid_upper[d])
        a10, a11 = np.int64(valid_lower[2 * c]), np.int64(valid_lower[d])
        count = a00 + a01 + a10 + a11
        if count == 4:
            continue
        if count == 0:
            for b in range(bands):
                out[c, b] = 0
            continue
        for b in range(bands):
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
            _count_valid(valid[r0], valid[r1], out_valid[r])
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
            byte = 3 - plane
            for i in range(bands):
                # The last samples of the plane before this one; nothing before the first.
                before = source[4 * (count - bands + i) + byte + 1] if plane else np.uint8(0)
                target[plane * count + i] = source[4 * i + byte] - before
            differences = target[plane * count + bands : (plane + 1) * count]
            for i in range(count - bands):
                differences[i] = source[4 * (i + bands) + byte] - source[4 * i + byte]


@kernel
def valid_by_nodata(src: Image, nodata: Any, out: Bytes) -> int:
    """Which pixels have a sample that is neither `nodata` nor NaN; how many."""
    rows, cols, bands = src.shape
    count = 0
    for r in range(rows):
        known = out[r]
        # Band by band, so that the loops over pixels become vector instructions.
        for b in range(bands):
            band = src[r, :, b]
            for c in range(cols):
                found = (band[c] != nodata) & (band[c] == band[c])
                known[c] = found if b == 0 else known[c] | found
        for c in range(cols):
            count += known[c]
    return count


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
    src2 = src.reshape(src.shape[0], src.shape[1] * bands)
    out2 = out.reshape(out.shape[0], out.shape[1] * bands)
    for r in range(rows):
        source, target = src2[row0 + r, col0 * bands : (col0 + cols) * bands], out2[r]
        for i in range(cols * bands):
            target[i] = source[i]
        if nudged != fill:
            for i in range(cols * bands):
                target[i] = nudged if target[i] == fill else target[i]
        if masked:
            known = valid[row0 + r, col0 : col0 + cols]
            for c in range(cols):
                if not known[c]:
                    for b in range(bands):
                        target[c * bands + b] = fill
        for i in range(cols * bands, target.shape[0]):
            target[i] = target[i - bands]
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
    src2 = src.reshape(rows, cols * bands)
    pixels = 0
    for r in range(rows):
        begin = 0
        # Runs of valid pixels, so that the loops over their samples become vector instructions.
        while begin < cols:
            end = cols
            if masked:
                while begin < cols and not valid[r, begin]:
                    begin += 1
                end = begin
                while end < cols and valid[r, end]:
                    end += 1
            pixels += end - begin
            first, last = begin * bands, end * bands
            run, run_low, run_high = src2[r, first:last], low[first:last], high[first:last]
            run_total, run_squares = total[first:last], squares[first:last]
            for i in range(last - first):
                value = total.dtype.type(run[i])
                run_total[i] += value
                run_squares[i] += value * value
            for i in range(last - first):
                run_low[i] = min(run_low[i], run[i])
                run_high[i] = max(run_high[i], run[i])
            begin = end
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
