"""Fiducial marks found in a scan of film, and with them how the film lay in the scanner.

A mark is looked for by its picture: a crop the user cut out of a scan, or one drawn here (cross, dot, circle,
notch). It is found by normalised correlation in a reduced image near its nominal place and then fitted in the
full one by least-squares matching of its parts, to some hundredths of a pixel. All eight ways a film can lie
are tried: turned by quarters, and mirrored.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from stereomate.errors import InputError, NotDeterminedError
from stereomate.measurement.mark_fit import fitted_centre

Array = NDArray[np.float64]
Picture = NDArray[np.float32]
Point = tuple[float, float]
MarkKind = Literal["cross", "dot", "circle", "notch"]
# Column, row, columns, rows of a window -> its grey values (fewer at the edge of the scan).
Reader = Callable[[int, int, int, int], NDArray[Any]]

# Supersampling of drawn marks.
_FINE: Final = 8
# Longer side of a template in the first search.
_COARSE_PX: Final = 48
# Correlations that differ by less do not tell two ways of lying apart.
_SAME: Final = 0.03


@dataclass(frozen=True, eq=False)
class MarkTemplate:
    """The picture of a mark in an upright scan, and where in it the mark's centre is.

    Parameters
    ----------
    picture : ndarray of float32, shape (rows, cols)
    centre_px : (float, float)
        Column and row.
    """

    picture: Picture
    centre_px: Point

    def __post_init__(self) -> None:
        picture = np.asarray(self.picture, dtype=np.float32)
        if picture.ndim != 2 or min(picture.shape) < 8:
            raise InputError(
                "must be a grey picture of 8 x 8 pixels or more", field="template", value=picture.shape
            )
        if not float(picture.std()) > 0.0:
            raise InputError("must show something", field="template")
        rows, cols = picture.shape
        if not (0.0 <= self.centre_px[0] <= cols and 0.0 <= self.centre_px[1] <= rows):
            raise InputError("must lie in the picture", field="template.centre_px", value=self.centre_px)
        object.__setattr__(self, "picture", picture)

    def lying(self, rotation: int, mirrored: bool) -> MarkTemplate:
        """As it looks in a scan that is mirrored left to right and then turned clockwise."""
        picture, (col, row) = self.picture, self.centre_px
        if mirrored:
            picture, col = picture[:, ::-1], picture.shape[1] - col
        for _ in range(rotation // 90):
            col, row = picture.shape[0] - row, col
            picture = np.rot90(picture, -1)
        return MarkTemplate(np.ascontiguousarray(picture), (col, row))


def drawn_mark(kind: MarkKind, size_px: float, line_px: float = 3.0, bright: bool = True) -> MarkTemplate:
    """Draw a mark.

    Parameters
    ----------
    kind : {"cross", "dot", "circle", "notch"}
        A notch is cut into the frame from the image: its centre is the tip, pointing right.
    size_px : float
        Length of the cross's arms together, diameter of dot and circle, depth of the notch.
    line_px : float
        Width of lines.
    bright : bool
        The mark is brighter than its surroundings.

    Raises
    ------
    InputError
        If the sizes are not positive.
    """
    if kind not in ("cross", "dot", "circle", "notch"):
        raise InputError("must be cross, dot, circle or notch", field="kind", value=kind)
    if not (size_px > 0.0 and line_px > 0.0):
        raise InputError("must be positive", field="size_px, line_px", value=(size_px, line_px))
    side = max(math.ceil(1.5 * size_px + 2.0 * line_px), 8)
    fine = (np.arange(side * _FINE) + 0.5) / _FINE - side / 2.0
    x, y = np.meshgrid(fine, fine)
    radius = np.hypot(x, y)
    if kind == "cross":
        on = (np.abs(x) <= size_px / 2) & (np.abs(y) <= line_px / 2)
        on |= (np.abs(y) <= size_px / 2) & (np.abs(x) <= line_px / 2)
    elif kind == "dot":
        on = radius <= size_px / 2
    elif kind == "circle":
        on = np.abs(radius - size_px / 2) <= line_px / 2
    else:
        # The tip at the middle, the flanks at 45 degrees to the left, the frame to the right.
        on = (x <= 0.0) & (np.abs(y) <= -x) | (x <= -size_px / 2)
    picture = on.reshape(side, _FINE, side, _FINE).mean(axis=(1, 3))
    return MarkTemplate((picture if bright else 1.0 - picture).astype(np.float32), (side / 2.0, side / 2.0))


@dataclass(frozen=True)
class FoundMark:
    """A mark found: its name, its centre (column, row) and the correlation with its picture, -1 to 1."""

    name: str
    pixel: Point
    correlation: float


@dataclass(frozen=True)
class FoundFiducials:
    """Marks of one scan.

    Attributes
    ----------
    marks : tuple of FoundMark
        Those that were found well enough.
    missing : tuple of str
        Marks that were not.
    rotation : int
        Degrees by which the scan is turned clockwise.
    mirrored : bool
        The scan is mirrored left to right (before it is turned).
    others : tuple of (int, bool)
        Other ways of lying that the pictures of the marks do not exclude.
    """

    marks: tuple[FoundMark, ...]
    missing: tuple[str, ...]
    rotation: int
    mirrored: bool
    others: tuple[tuple[int, bool], ...]

    @property
    def measured_px(self) -> dict[str, Point]:
        """Mark -> (column, row), for `stereomate.camera.fiducials.interior_orientation`."""
        return {mark.name: mark.pixel for mark in self.marks}


@dataclass(frozen=True)
class FiducialOptions:
    """How marks are looked for.

    Parameters
    ----------
    search_mm : float
        How far a mark may be from its nominal place.
    least_correlation : float
        With its picture.
    centre_px : (float, float) or None
        Where the middle of the frame lies in the scan; its middle if None.
    rotation, mirrored : optional
        How the film lies, if it is known.
    """

    search_mm: float = 8.0
    least_correlation: float = 0.6
    centre_px: Point | None = None
    rotation: Literal[0, 90, 180, 270] | None = None
    mirrored: bool | None = None


def find_fiducials(
    read: Reader,
    size_px: tuple[int, int],
    nominal_mm: Mapping[str, Point],
    templates: Mapping[str, MarkTemplate] | MarkTemplate,
    pitch_mm: float,
    options: FiducialOptions | None = None,
) -> FoundFiducials:
    """Find the fiducial marks of a scan.

    Parameters
    ----------
    read : callable
        Gives the grey values of a window.
    size_px : (int, int)
        Columns and rows of the scan.
    nominal_mm : mapping
        Mark -> (x, y) in the fiducial system, to some millimetres; the certificate does.
    templates : MarkTemplate or mapping
        Picture of every mark in an upright scan, at the resolution of this scan. One for all tells nothing
        about how the film lies unless it looks different when turned.
    pitch_mm : float
        Of the scan, roughly.
    options : FiducialOptions, optional

    Raises
    ------
    InputError
        If a mark has no picture, or the pitch is not positive.
    NotDeterminedError
        If fewer than two marks are found.
    """
    options = options or FiducialOptions()
    if not pitch_mm > 0.0:
        raise InputError("must be positive", field="pitch_mm", value=pitch_mm)
    pictures = (
        dict.fromkeys(nominal_mm, templates) if isinstance(templates, MarkTemplate) else dict(templates)
    )
    lacking = sorted(set(nominal_mm) - set(pictures))
    if lacking:
        raise InputError("must have a picture each", field="templates", value=", ".join(lacking))
    search = _Search(read, size_px, pitch_mm, options)
    tried: list[tuple[float, int, bool]] = []
    for mirrored, rotation in itertools.product((False, True), (0, 90, 180, 270)):
        if options.rotation not in (None, rotation) or options.mirrored not in (None, mirrored):
            continue
        scores = [
            search.coarse(pictures[name].lying(rotation, mirrored), _placed(xy, rotation, mirrored))[1]
            for name, xy in nominal_mm.items()
        ]
        tried.append((float(np.mean(scores)), rotation, mirrored))
    # Upright before turned, plain before mirrored, where nothing tells.
    top = max(t[0] for t in tried)
    best = min((t for t in tried if t[0] >= top - _SAME), key=lambda t: (t[2], t[1]))
    others = tuple((r, m) for score, r, m in tried if score >= top - _SAME and (r, m) != best[1:])
    marks, missing = [], []
    for name, xy in nominal_mm.items():
        found = search.fine(name, pictures[name].lying(best[1], best[2]), _placed(xy, best[1], best[2]))
        if found is not None and found.correlation >= options.least_correlation:
            marks.append(found)
        else:
            missing.append(name)
    if len(marks) < 2:
        raise NotDeterminedError(
            f"fiducial marks: only {len(marks)} of {len(nominal_mm)} were found near their nominal places; "
            "check the pictures, the pitch and how far they may be off"
        )
    return FoundFiducials(tuple(marks), tuple(missing), best[1], best[2], others)


def _placed(xy: Point, rotation: int, mirrored: bool) -> Point:
    """Millimetres right and down from the middle of the scan, of a film that lies in one of eight ways."""
    right, down = xy[0], -xy[1]
    if mirrored:
        right = -right
    for _ in range(rotation // 90):
        right, down = -down, right
    return right, down


class _Search:
    """One scan; windows round the places of marks are read once."""

    def __init__(
        self, read: Reader, size_px: tuple[int, int], pitch_mm: float, options: FiducialOptions
    ) -> None:
        self.read, self.size, self.pitch = read, size_px, pitch_mm
        self.reach = options.search_mm / pitch_mm
        self.middle = options.centre_px or (size_px[0] / 2.0, size_px[1] / 2.0)
        self.windows: dict[tuple[int, int, int, int], Picture] = {}

    def _window(self, template: MarkTemplate, place_mm: Point) -> tuple[Picture, int, int]:
        """Grey values round a place, with the window's column and row."""
        rows, cols = template.picture.shape
        col = self.middle[0] + place_mm[0] / self.pitch
        row = self.middle[1] + place_mm[1] / self.pitch
        left, top = col - template.centre_px[0] - self.reach, row - template.centre_px[1] - self.reach
        first = max(0, math.floor(left)), max(0, math.floor(top))
        last = (
            min(self.size[0], math.ceil(left + cols + 2 * self.reach)),
            min(self.size[1], math.ceil(top + rows + 2 * self.reach)),
        )
        key = (first[0], first[1], last[0] - first[0], last[1] - first[1])
        if min(key[2:]) <= 0:
            return np.zeros((0, 0), np.float32), first[0], first[1]
        if key not in self.windows:
            values = np.asarray(self.read(*key), dtype=np.float32)
            self.windows[key] = values if values.ndim == 2 else values.mean(axis=2)
        return self.windows[key], first[0], first[1]

    def coarse(self, template: MarkTemplate, place_mm: Point) -> tuple[Point | None, float]:
        """Where in its window the template fits best, in pixels of the scan, and the correlation."""
        window, left, top = self._window(template, place_mm)
        factor = max(1, max(template.picture.shape) // _COARSE_PX)
        small, little = _reduced(window, factor), _reduced(template.picture, factor)
        if small.shape[0] < little.shape[0] or small.shape[1] < little.shape[1]:
            return None, 0.0
        score = np.nan_to_num(cv2.matchTemplate(small, little, cv2.TM_CCOEFF_NORMED))
        row, col = np.unravel_index(int(score.argmax()), score.shape)
        return (left + float(col) * factor, top + float(row) * factor), float(score.max())

    def fine(self, name: str, template: MarkTemplate, place_mm: Point) -> FoundMark | None:
        """The mark's centre from a fit in the full scan."""
        corner, _ = self.coarse(template, place_mm)
        if corner is None:
            return None
        window, left, top = self._window(template, place_mm)
        factor = max(1, max(template.picture.shape) // _COARSE_PX)
        rows, cols = template.picture.shape
        col, row = (round(corner[0]) - left, round(corner[1]) - top)
        c0, r0 = max(0, col - 2 * factor), max(0, row - 2 * factor)
        part = window[r0 : row + rows + 2 * factor, c0 : col + cols + 2 * factor]
        if part.shape[0] < rows or part.shape[1] < cols:
            return None
        score = np.nan_to_num(cv2.matchTemplate(part, template.picture, cv2.TM_CCOEFF_NORMED))
        at_row, at_col = np.unravel_index(int(score.argmax()), score.shape)
        x, y = fitted_centre(template.picture, template.centre_px, part, float(at_col), float(at_row))
        return FoundMark(name, (left + c0 + x, top + r0 + y), float(score.max()))


def _reduced(picture: Picture, factor: int) -> Picture:
    if factor <= 1 or not picture.size:
        return picture
    rows, cols = (side // factor * factor for side in picture.shape)
    if not rows or not cols:
        return np.zeros((0, 0), np.float32)
    size = (cols // factor, rows // factor)
    return np.asarray(cv2.resize(picture[:rows, :cols], size, interpolation=cv2.INTER_AREA), dtype=np.float32)
