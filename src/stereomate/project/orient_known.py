"""Control points as the photographs of a block show them.

Apart from `orient_control`, which every run reads its control with: what adjusts blocks loads much more.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stereomate.block.photos import BlockPhoto
from stereomate.block.start import KnownPoints
from stereomate.project.orient_control import Control

Array = NDArray[np.float64]


def known_points(control: Control, photos: Sequence[BlockPhoto]) -> KnownPoints | None:
    """Control points that are not check points, for the start; None where none is measured."""
    measured = control_measurements(control, photos)
    if measured is None:
        return None
    point, photo, pixels, _ = measured
    keep = ~control.check[point]
    return KnownPoints(
        control.names, control.tangent_xyz, control.sigma_m, point[keep], photo[keep], pixels[keep]
    )


def control_measurements(
    control: Control, photos: Sequence[BlockPhoto]
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array, Array] | None:
    """Point, photograph, pixels and standard deviation of the measurements of control points.

    Those outside their photograph are left out: `outside_findings` names them.
    """
    given = control.measurements
    if given is None:
        return None
    index = {Path(photo.name).stem: k for k, photo in enumerate(photos)}
    index |= {photo.name: k for k, photo in enumerate(photos)}
    names = {name: k for k, name in enumerate(control.names)}
    rows = [
        (names[point], k, row)
        for row, (point, name) in enumerate(zip(given.points, given.photographs, strict=True))
        if point in names and (k := index.get(name, index.get(Path(name).stem))) is not None
    ]
    if not rows:
        return None
    table = np.array(sorted(rows), dtype=np.int64)
    pixels = given.pixels[table[:, 2]]
    sizes = np.array([photo.camera.size_px for photo in photos], dtype=np.float64)[table[:, 1]]
    inside = ((pixels >= 0.0) & (pixels <= sizes)).all(axis=1)
    table, pixels = table[inside], pixels[inside]
    sigma = given.sigma_px[table[:, 2]]
    return (
        table[:, 0].copy(),
        table[:, 1].copy(),
        pixels,
        np.where(np.isfinite(sigma), sigma, control.measurement_sigma_px),
    )


def once_findings(control: Control, photos: Sequence[BlockPhoto]) -> list[str]:
    """Control points that one photograph alone shows, in words: they are used, but hardly checked."""
    measured = control_measurements(control, photos)
    if measured is None:
        return []
    counts = np.bincount(measured[0], minlength=len(control.names))
    names = [name for name, count in zip(control.names, counts.tolist(), strict=True) if count == 1]
    if not names:
        return []
    more = f" and {len(names) - 5} more" if len(names) > 5 else ""
    return [
        "control: measured in one photograph only, so that hardly anything checks them: "
        + ", ".join(names[:5])
        + more
    ]


def outside_findings(control: Control, photos: Sequence[BlockPhoto]) -> list[str]:
    """Measurements of control points that lie outside their photograph, in words."""
    given = control.measurements
    if given is None:
        return []
    size = {Path(photo.name).stem: photo.camera.size_px for photo in photos}
    size |= {photo.name: photo.camera.size_px for photo in photos}
    outside = []
    for point, name, (col, row) in zip(given.points, given.photographs, given.pixels.tolist(), strict=True):
        columns, rows = size.get(name) or size.get(Path(name).stem) or (math.inf, math.inf)
        if point in control.names and not (0.0 <= col <= columns and 0.0 <= row <= rows):
            outside.append(f"{point} in {name} ({col:g}, {row:g})")
    if not outside:
        return []
    return [
        f"control: {len(outside)} measurements lie outside their photograph and are left out: "
        + ", ".join(outside[:5])
    ]
