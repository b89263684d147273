"""The exports of PhotoModeler that come with DBAT, read into a network."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereomate.geometry.rotations import rotation_from_opk


@dataclass(frozen=True, eq=False)
class Export:
    """Camera (c, px, py, width, height mm), photographs, points, image points (photo, id, x, y)."""

    size: tuple[int, int]
    interior: list[float]
    centres: np.ndarray
    rotations: np.ndarray
    points: dict[int, np.ndarray]
    marks: list[tuple[int, int, float, float]]


def read_export(path) -> Export:
    """Read a ``pmexport`` file."""
    lines = path.read_text().splitlines()
    head = lines[1].split()
    size = (int(head[2]), int(head[3]))
    count = int(head[1]) + 1
    interior = [float(v) for v in lines[3].split()[:10]]
    centres, rotations = [], []
    at = 5
    for _ in range(count):
        values = [float(v) for v in lines[at + 1].split()[1:7]]
        centres.append(values[:3])
        kappa, phi, omega = np.radians(values[3:])
        rotations.append(rotation_from_opk([omega, phi, kappa]))
        at += 6
    blocks = []
    block = []
    for line in lines[at:]:
        cells = line.split()
        if cells:
            block.append(cells)
        elif block:
            blocks.append(block)
            block = []
    points, marks = {}, []
    for block in blocks:
        if len(block[0]) == 7:
            points |= {int(c[0]): np.array([float(v) for v in c[1:4]]) for c in block if len(c) == 7}
        elif len(block[0]) == 6:
            marks += [(int(c[0]), int(c[1]), float(c[2]), float(c[3])) for c in block if len(c) == 6]
    return Export(size, interior, np.array(centres), np.array(rotations), points, marks)
