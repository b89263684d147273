"""The drawing from which the over-correction factor is read, to scale (Kasper 1956, Figs. 3-6)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from stereomate.errors import InputError
from stereomate.relative.drawing import Point, SectionDrawing
from stereomate.report.overcorrection_style import (
    CIRCLE,
    GROUND,
    INK,
    LENGTH_A,
    LENGTH_D,
    MM_PER_INCH,
    PERPENDICULAR,
    RAY,
    TERRAIN,
    figure_style,
)

FloatArray = NDArray[np.float64]

_BEHIND_TEXT: Final = {"facecolor": "white", "edgecolor": "none", "pad": 0.6, "alpha": 0.85}
# Paper of the drawing without margins, in mm, and the margins.
_PAPER: Final = (165.0, 205.0)
_MARGINS: Final = (8.0, 8.0, 9.0, 29.0)  # left, right, top, bottom (the caption)
_STEPS: Final = (1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 7.5, 10.0)
_CONSTRUCTIONS: Final = {
    "general": "three perpendiculars: at {first}, at {second}, and from A{second} to the ray of {last}",
    "nadir": "two perpendiculars, {first} at the nadir: at {second}, and from A{second} to the ray of {last}",
    "flat": "flat terrain, one perpendicular: from {second} to the ray of {last}",
}


@dataclass(frozen=True)
class DrawingSheet:
    """A drawing on paper.

    Attributes
    ----------
    figure : matplotlib.figure.Figure
    scale : float
        Scale denominator N of 1 : N; holds for SVG and PDF at their own size, for PNG at its resolution.
    """

    figure: Figure
    scale: float


def draw_section(
    drawing: SectionDrawing, scale: float | None = None, construction_lines: bool = False
) -> DrawingSheet:
    """Draw a section to scale.

    Every line carries a gid (``perpendicular-5``, ``d``, ``a``, ...), so that an SVG can be measured.

    Parameters
    ----------
    drawing : SectionDrawing
    scale : float, optional
        Scale denominator; the largest round one that fits a page by default.
    construction_lines : bool
        Draw a' and d' too, as in Fig. 3.

    Raises
    ------
    InputError
        If the scale is not positive, or makes a drawing of more than three metres.
    """
    window = _window(drawing, construction_lines)
    denominator = _round_scale(window) if scale is None else float(scale)
    width, height = ((window[i + 1] - window[i]) * 1000.0 / denominator for i in (0, 2))
    if not (denominator > 0.0 and math.isfinite(denominator)) or max(width, height) > 3000.0:
        raise InputError(
            "must be a scale denominator that makes a drawing below 3 m", field="scale", value=scale
        )
    left, right, top, bottom = _MARGINS
    # A narrow drawing still needs room for its caption.
    widest = max(width, 125.0)
    page = (left + widest + right, top + height + bottom)
    with figure_style():
        figure = Figure(figsize=(page[0] / MM_PER_INCH, page[1] / MM_PER_INCH))
        offset = left + 0.5 * (widest - width)
        axes = figure.add_axes((offset / page[0], bottom / page[1], width / page[0], height / page[1]))
        axes.set_xlim(window[0], window[1])
        axes.set_ylim(window[3], window[2])
        axes.set_axis_off()
        sheet = _Sheet(axes, drawing, denominator / 1000.0, window)
        sheet.terrain()
        sheet.circle()
        sheet.rays()
        if construction_lines:
            sheet.all_perpendiculars()
            sheet.primed_lengths()
        else:
            sheet.needed_perpendiculars()
        sheet.lengths(with_values=not construction_lines)
        sheet.points(with_a5=construction_lines)
        _caption(figure, _caption_lines(drawing, construction_lines), page)
        _scale_bar(figure, denominator, page)
    return DrawingSheet(figure, denominator)


class _Sheet:
    """The pieces of one drawing; `mm` is the length in metres of one millimetre on paper."""

    def __init__(
        self, axes: Any, drawing: SectionDrawing, mm: float, window: tuple[float, float, float, float]
    ) -> None:
        self.axes, self.drawing, self.mm, self.window = axes, drawing, mm, window
        self.number = {role: drawing.numbers[row] for role, row in enumerate(drawing.roles)}

    def line(self, points: list[Point], gid: str, **style: Any) -> None:
        y, z = zip(*points, strict=True)
        (line,) = self.axes.plot(y, z, solid_capstyle="butt", **style)
        line.set_gid(gid)

    def text(self, point: Point, text: str, offset: Point = (0.0, 0.0), **style: Any) -> None:
        """Text at a point, moved by millimetres to the right and down."""
        place = (point[0] + offset[0] * self.mm, point[1] + offset[1] * self.mm)
        style = {"ha": "center", "va": "center", "color": INK} | style
        self.axes.text(*place, text, **style)

    def terrain(self) -> None:
        profile = self.drawing.profile
        if profile is None:
            order = np.argsort(self.drawing.section[:, 0])
            line = [_pair(point) for point in self.drawing.section[order]]
            self.line(line, "terrain", color=TERRAIN, lw=0.8, ls=(0, (5, 3)), zorder=1)
            return
        below = self.window[3]
        self.axes.fill_between(profile[:, 0], profile[:, 1], below, color=GROUND, lw=0, zorder=0)
        self.line([_pair(p) for p in profile], "terrain", color=TERRAIN, lw=1.1, zorder=1)

    def circle(self) -> None:
        outline = [_pair(point) for point in self.drawing.circle.outline(721)]
        self.line(outline, "critical-circle", color=CIRCLE, lw=0.8, ls=(0, (7, 2, 1.5, 2)), zorder=2)

    def rays(self) -> None:
        for role, point in enumerate((self.drawing.first, self.drawing.second, self.drawing.corrected)):
            self.line([(0.0, 0.0), point], f"ray-{self.number[role]}", color=RAY, lw=0.7, zorder=3)

    def needed_perpendiculars(self) -> None:
        """Those that have to be drawn to read n off: three, two or one."""
        d = self.drawing
        if d.construction == "general":
            self.perpendicular(0, [d.meeting_3])
        elif d.construction == "nadir":
            # The perpendicular of the nadir ray is the level line through point 1.
            level = [d.first, d.meeting_3]
            self.line(level, f"perpendicular-{self.number[0]}", color=PERPENDICULAR, lw=0.5, zorder=4)
        if d.construction != "flat":
            self.perpendicular(1, [d.meeting_3])
        self.foot()

    def all_perpendiculars(self) -> None:
        """The perpendiculars at all three points, as far as they meet."""
        d = self.drawing
        self.perpendicular(0, [d.meeting_3, d.meeting_5])
        self.perpendicular(1, [d.meeting_3])
        self.perpendicular(2, [d.meeting_5])
        self.foot()

    def perpendicular(self, role: int, meets: list[Point | None]) -> None:
        """The perpendicular at a point to its ray, long enough to show what it meets."""
        foot = (self.drawing.first, self.drawing.second, self.drawing.corrected)[role]
        gid = f"perpendicular-{self.number[role]}"
        self.line(self._through(foot, meets), gid, color=PERPENDICULAR, lw=0.8, zorder=4)
        self.right_angle(foot, foot)

    def foot(self) -> None:
        """The perpendicular from A3 to the ray of the corrected point."""
        d = self.drawing
        if math.hypot(d.meeting_3[0] - d.foot[0], d.meeting_3[1] - d.foot[1]) > 0.1 * self.mm:
            self.line([d.meeting_3, d.foot], "foot", color=PERPENDICULAR, lw=0.8, zorder=4)
            self.right_angle(d.foot, d.corrected)

    def right_angle(self, at: Point, ray: Point) -> None:
        """The mark of a right angle on a ray, turned to O."""
        size = 1.8 * self.mm
        length = math.hypot(*ray)
        along = (-ray[0] / length * size, -ray[1] / length * size)
        across = (along[1], -along[0]) if ray[0] < 0.0 else (-along[1], along[0])
        corner = [
            (at[0] + along[0], at[1] + along[1]),
            (at[0] + along[0] + across[0], at[1] + along[1] + across[1]),
            (at[0] + across[0], at[1] + across[1]),
        ]
        self.line(corner, "right-angle", color=PERPENDICULAR, lw=0.5, zorder=4)

    def primed_lengths(self) -> None:
        d = self.drawing
        if d.end_d is None or d.meeting_5 is None:
            return
        self.line([(0.0, 0.0), d.end_d], "d-primed", color=LENGTH_D, lw=1.3, ls=(0, (3, 1.2)), zorder=5)
        self.line([d.meeting_3, d.meeting_5], "a-primed", color=LENGTH_A, lw=1.6, ls=(0, (3, 1.2)), zorder=5)
        self.line([d.corrected, d.end_d], "to-d-primed", color=PERPENDICULAR, lw=0.8, zorder=4)
        self.text(_middle((0.0, 0.0), d.end_d), "d'", (0, -2.6), color=LENGTH_D, fontsize=10)
        middle = _middle(d.meeting_3, d.meeting_5)
        self.text(middle, "a'", (0, -2.8), color=LENGTH_A, fontsize=10, bbox=_BEHIND_TEXT, zorder=8)
        if self.inside(d.end_d):
            self.text(d.end_d, f"D'$_{self.number[2]}$", (0, -3.0))

    def lengths(self, with_values: bool) -> None:
        """d and a beside the ray to the corrected point."""
        d = self.drawing
        self.line([(0.0, 0.0), d.corrected], "d", color=LENGTH_D, lw=1.6, zorder=5)
        self.line([d.foot, d.corrected], "a", color=LENGTH_A, lw=3.2, zorder=6)
        side = 1.0 if d.corrected[0] >= 0.0 else -1.0
        d_text = f"d = {d.d:.1f} m" if with_values else "d"
        a_text = f"a = {d.a:.1f} m" if with_values else "a"
        self.dimension((0.0, 0.0), d.corrected, 7.0 * side, d_text, LENGTH_D)
        self.dimension(d.foot, d.corrected, -5.0 * side, a_text, LENGTH_A)

    def dimension(self, start: Point, end: Point, aside: float, label: str, colour: str) -> None:
        """A dimension line parallel to a segment, `aside` millimetres to its right (seen from O)."""
        ray = self.drawing.corrected
        length = math.hypot(*ray)
        shift = (ray[1] / length * aside * self.mm, -ray[0] / length * aside * self.mm)
        ends = [(point[0] + shift[0], point[1] + shift[1]) for point in (start, end)]
        on_paper = math.hypot(end[0] - start[0], end[1] - start[1]) / self.mm
        if on_paper > 4.0:
            arrow = {"arrowstyle": "<|-|>", "color": colour, "lw": 0.6, "shrinkA": 0, "shrinkB": 0}
            self.axes.annotate("", ends[1], ends[0], arrowprops=arrow, zorder=6)
        for point, shifted in zip((start, end), ends, strict=True):
            self.line([point, shifted], "extension", color=colour, lw=0.4, zorder=4)
        angle = math.degrees(math.atan2(-ray[1], ray[0]))
        angle = (angle + 90.0) % 180.0 - 90.0
        if abs(abs(angle) - 90.0) < 1.0:
            angle = 90.0
        text_shift = 2.2 * math.copysign(1.0, aside)
        place = _middle(ends[0], ends[1])
        self.text(
            place,
            label,
            (ray[1] / length * text_shift, -ray[0] / length * text_shift),
            rotation=angle,
            rotation_mode="anchor",
            color=colour,
            fontsize=8.5,
            zorder=8,
            bbox=_BEHIND_TEXT,
        )

    def points(self, with_a5: bool) -> None:
        d = self.drawing
        self.axes.plot([0.0], [0.0], "o", ms=4.5, mfc="white", mec=INK, mew=0.9, zorder=9)
        side = "2" if d.numbers[0] == 2 else "1"
        self.text((0.0, 0.0), f"O$_{side}$", (0.0, -4.0), fontsize=10)
        for role, point in enumerate((d.first, d.second, d.corrected)):
            self.axes.plot(*[[value] for value in point], "o", ms=3.6, color=INK, zorder=9)
            outward = -1.0 if point[0] < 0.0 else 1.0
            offset = (0.0, 4.0) if abs(point[0]) < 3.0 * self.mm else (3.4 * outward, 2.6)
            self.text(point, str(self.number[role]), offset, fontsize=10, fontweight="bold", zorder=10)
        named: list[tuple[Point | None, str, Point]] = [
            (d.meeting_3, f"A$_{self.number[1]}$", (0.0, 4.0)),
            (d.meeting_5 if with_a5 else None, f"A$_{self.number[2]}$", (3.6, -2.6)),
        ]
        for meeting, name, offset in named:
            if meeting is not None and self.inside(meeting) and self.clear_of_points(meeting):
                self.axes.plot(*[[value] for value in meeting], "o", ms=2.6, color=PERPENDICULAR, zorder=9)
                self.text(meeting, name, offset, color=PERPENDICULAR, fontsize=9, zorder=10)
        from_point = math.hypot(d.foot[0] - d.corrected[0], d.foot[1] - d.corrected[1])
        from_a3 = math.hypot(d.foot[0] - d.meeting_3[0], d.foot[1] - d.meeting_3[1])
        if min(from_point, from_a3) > 5.0 * self.mm:
            outward = 1.0 if d.corrected[0] >= 0.0 else -1.0
            self.axes.plot(*[[value] for value in d.foot], "o", ms=2.6, color=CIRCLE, zorder=9)
            self.text(d.foot, "F", (3.2 * outward, -1.6), color=CIRCLE, fontsize=9, zorder=10)

    def inside(self, point: Point) -> bool:
        y0, y1, z0, z1 = self.window
        return y0 <= point[0] <= y1 and z0 <= point[1] <= z1

    def clear_of_points(self, meeting: Point) -> bool:
        """Whether a point has room for a name of its own beside those of 1, 3 and 5."""
        distances = np.hypot(*(self.drawing.section - np.array(meeting)).T)
        return bool(distances.min() > 2.0 * self.mm)

    def _through(self, foot: Point, meets: list[Point | None]) -> list[Point]:
        """The perpendicular at a point from a little before to a little behind all it meets."""
        direction = np.array([foot[1], -foot[0]]) / math.hypot(*foot)
        places = [0.0]
        for meeting in meets:
            if meeting is not None:
                places.append(float(np.dot(np.array(meeting) - np.array(foot), direction)))
        over = 5.0 * self.mm
        start, end = min(places) - over, max(places) + over
        # Nearly parallel perpendiculars meet far outside the sheet.
        reach = 2.0 * max(self.window[1] - self.window[0], self.window[3] - self.window[2])
        start, end = max(start, -reach), min(end, reach)
        return [_pair(np.array(foot) + start * direction), _pair(np.array(foot) + end * direction)]


def _window(drawing: SectionDrawing, construction_lines: bool) -> tuple[float, float, float, float]:
    """What of the section plane is on the sheet: y0, y1, z0, z1 in metres."""
    points: list[Point] = [(0.0, 0.0), *map(_pair, drawing.section)]
    size = float(np.abs(drawing.section).max())
    more: list[Point | None] = [drawing.meeting_3, drawing.foot, *map(_pair, drawing.circle.outline(9))]
    if construction_lines:
        more += [drawing.meeting_5, drawing.end_d]
    # What lies far off the section would make the section itself too small to see.
    reach = 6.0 if construction_lines else 1.5
    points += [point for point in more if point is not None and max(map(abs, point)) <= reach * size]
    array = np.array(points)
    if drawing.profile is not None:
        array = np.concatenate((array, drawing.profile))
    (y0, z0), (y1, z1) = array.min(axis=0), array.max(axis=0)
    margin = 0.09 * max(y1 - y0, z1 - z0)
    return float(y0 - margin), float(y1 + margin), float(z0 - 0.6 * margin), float(z1 + margin)


def _round_scale(window: tuple[float, float, float, float]) -> float:
    """The largest round scale that fits the paper."""
    needed = 1000.0 * max((window[1] - window[0]) / _PAPER[0], (window[3] - window[2]) / _PAPER[1])
    power = 10.0 ** math.floor(math.log10(needed))
    return next(power * step for step in _STEPS if power * step >= needed * (1 - 1e-12))


def _caption_lines(drawing: SectionDrawing, construction_lines: bool) -> list[str]:
    n = drawing.factor
    number = "±∞: on the critical circle" if math.isinf(n) else f"{n:.3f}"
    if not math.isinf(n):
        number += ", outside the critical circle" if n > 0.0 else ", inside the critical circle"
    lines = [f"n = d/a = {drawing.d:.1f} m / {drawing.a:.1f} m = {number}"]
    if construction_lines and drawing.d_primed is not None:
        lines.insert(0, f"n = d'/a' = {drawing.d_primed:.1f} m / {drawing.a_primed:.1f} m")
        lines[1] = lines[1][4:]
    names = dict(
        zip(("first", "second", "last"), (drawing.numbers[row] for row in drawing.roles), strict=True)
    )
    lines.append(_CONSTRUCTIONS[drawing.construction].format(**names))
    circle = drawing.circle
    # Adding zero makes a plain zero of a negative one.
    centre = f"y {round(circle.centre_y, 1) + 0.0:.1f} m, z {circle.centre_z:.1f} m"
    lines.append(f"critical circle: centre {centre}, radius {circle.radius:.1f} m")
    return lines


def _caption(figure: Figure, lines: list[str], page: tuple[float, float]) -> None:
    for row, line in enumerate(lines):
        bold = row < len(lines) - 2
        y = (_MARGINS[3] - 5.5 - 4.7 * row) / page[1]
        style: dict[str, Any] = {"fontsize": 9.5, "fontweight": "bold"} if bold else {"fontsize": 7.5}
        figure.text(0.5, y, line, ha="center", va="center", color=INK, **style)


def _scale_bar(figure: Figure, denominator: float, page: tuple[float, float]) -> None:
    metres = 40.0 * denominator / 1000.0
    power = 10.0 ** math.floor(math.log10(metres))
    metres = max(step * power for step in (1.0, 2.0, 5.0) if step * power <= metres)
    length = metres * 1000.0 / denominator
    axes = figure.add_axes(
        ((0.5 * page[0] - 0.5 * length) / page[0], 3.2 / page[1], length / page[0], 1.2 / page[1])
    )
    axes.set_xlim(0.0, 4.0)
    axes.set_ylim(0.0, 1.0)
    for part in range(4):
        axes.fill_between([part, part + 1.0], 0.0, 1.0, color=INK if part % 2 == 0 else "white", lw=0)
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(True)
        spine.set_linewidth(0.5)
    text = f"{metres:g} m     1 : {denominator:,.0f}".replace(",", " ")
    figure.text(
        (0.5 * page[0] + 0.5 * length + 3.0) / page[0], 3.8 / page[1], text, va="center", fontsize=7.0
    )
    figure.text((0.5 * page[0] - 0.5 * length - 3.0) / page[0], 3.8 / page[1], "0", va="center", fontsize=7.0)


def _pair(values: FloatArray | Point) -> Point:
    return float(values[0]), float(values[1])


def _middle(one: Point, other: Point) -> Point:
    return 0.5 * (one[0] + other[0]), 0.5 * (one[1] + other[1])
