"""The drawing on paper: what is measured on it, its scale, its files; the other figures of the factor."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import matplotlib as mpl
import numpy as np
import pytest

from stereomate.errors import InputError, StorageError
from stereomate.relative.drawing import section_drawing
from stereomate.relative.empirical.procedure import RULES, dependent_pair
from stereomate.relative.empirical.projectors import Setting
from stereomate.relative.empirical.run import EmpiricalOptions, run_empirical
from stereomate.relative.empirical.scenes import StandardTerrain, wrong_orientation
from stereomate.relative.overcorrection import overcorrection_factor
from stereomate.relative.tables import normal_angle_table, overcorrection_table, wide_angle_table
from stereomate.report.overcorrection import draw_section
from stereomate.report.overcorrection_empirical import parallax_course, residual_parallaxes
from stereomate.report.overcorrection_style import save_figure
from stereomate.report.overcorrection_tables import heat_map

SVG = "{http://www.w3.org/2000/svg}"
SECTIONS = [
    [[90.0, 1503.0], [-640.0, 1446.0], [700.0, 1480.0]],
    [[0.0, 1500.0], [-500.0, 1400.0], [620.0, 1610.0]],
    [[0.0, 1500.0], [-750.0, 1500.0], [750.0, 1500.0]],
    [[0.0, 1500.0], [-400.0, 1200.0], [400.0, 1200.0]],
    [[-30.0, 1300.0], [520.0, 1400.0], [-610.0, 1250.0]],
]


def measured_lines(path: Path) -> tuple[dict[str, np.ndarray], tuple[float, float]]:
    """Straight lines of an SVG by gid as points in mm, and the size of the page in mm."""
    root = ElementTree.parse(path).getroot()
    size = tuple(float(root.get(key).removesuffix("pt")) * 25.4 / 72 for key in ("width", "height"))
    lines = {}
    for group in root.iter(f"{SVG}g"):
        found = group.find(f"{SVG}path")
        if found is not None and group.get("id"):
            numbers = [float(n) for n in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", found.get("d"))]
            lines.setdefault(group.get("id"), np.array(numbers).reshape(-1, 2) * 25.4 / 72)
    return lines, size


@pytest.mark.parametrize("section", SECTIONS)
@pytest.mark.parametrize("corrected", [5, 3])
def test_the_number_read_off_the_paper_is_that_of_the_formula(tmp_path, section, corrected):
    sheet = draw_section(section_drawing(section, corrected))
    save_figure(sheet.figure, tmp_path / "drawing.svg")
    lines, _ = measured_lines(tmp_path / "drawing.svg")
    d, a = lines["d"], lines["a"]
    along = (d[1] - d[0]) / np.linalg.norm(d[1] - d[0])
    n = np.linalg.norm(d[1] - d[0]) / ((a[1] - a[0]) @ along)
    # SVG coordinates have six decimals of a point.
    assert n == pytest.approx(overcorrection_factor(section, corrected), rel=1e-4)
    point = np.array(section[(corrected - 1) // 2])
    assert np.linalg.norm(d[1] - d[0]) * sheet.scale / 1000 == pytest.approx(np.linalg.norm(point), rel=1e-5)
    # Perpendiculars are perpendicular on paper too.
    if "foot" in lines:  # not where A3 lies on the ray itself
        foot = lines["foot"]
        assert abs((foot[1] - foot[0]) @ along) < 1e-3


def test_construction_lines_give_the_same_number(tmp_path):
    section = SECTIONS[0]
    sheet = draw_section(section_drawing(section), construction_lines=True)
    save_figure(sheet.figure, tmp_path / "drawing.svg")
    lines, _ = measured_lines(tmp_path / "drawing.svg")
    lengths = {key: np.linalg.norm(lines[key][1] - lines[key][0]) for key in ("d-primed", "a-primed")}
    assert lengths["d-primed"] / lengths["a-primed"] == pytest.approx(
        overcorrection_factor(section), rel=1e-4
    )
    assert {
        "perpendicular-1",
        "perpendicular-3",
        "perpendicular-5",
        "ray-5",
        "critical-circle",
    } <= lines.keys()


@pytest.mark.parametrize(
    ("section", "drawn"), [(SECTIONS[0], {1, 3}), (SECTIONS[1], {1, 3}), (SECTIONS[2], set())]
)
def test_only_the_needed_perpendiculars(tmp_path, section, drawn):
    save_figure(draw_section(section_drawing(section)).figure, tmp_path / "drawing.svg")
    lines, _ = measured_lines(tmp_path / "drawing.svg")
    assert {int(key[-1]) for key in lines if key.startswith("perpendicular")} == drawn


def test_scale_as_asked(tmp_path):
    profile = np.column_stack((np.linspace(-900, 900, 50), np.full(50, 1500.0)))
    sheet = draw_section(section_drawing(SECTIONS[2], profile=profile), scale=25_000)
    assert sheet.scale == 25_000
    save_figure(sheet.figure, tmp_path / "drawing.svg")
    lines, size = measured_lines(tmp_path / "drawing.svg")
    terrain = lines["terrain"]
    assert np.ptp(terrain[:, 0]) == pytest.approx(1800 / 25, rel=1e-4)
    assert size[0] < 210
    with pytest.raises(InputError, match="scale"):
        draw_section(section_drawing(SECTIONS[2]), scale=10)
    with pytest.raises(InputError, match="scale"):
        draw_section(section_drawing(SECTIONS[2]), scale=-5)


def test_default_scale_is_round_and_fits_a_page():
    for section in SECTIONS:
        sheet = draw_section(section_drawing(section))
        width, height = sheet.figure.get_size_inches() * 25.4
        assert width < 210
        assert height < 297
        assert float(f"{sheet.scale:.3g}") == sheet.scale


def test_critical_section_is_drawn():
    drawing = section_drawing([[0, 1500], [-450, 1350], [450, 1350]])
    texts = [text.get_text() for text in draw_section(drawing).figure.texts]
    assert any("±∞: on the critical circle" in text for text in texts)


@pytest.mark.parametrize("suffix", ["svg", "pdf", "png"])
def test_files_are_whole_and_the_same_every_time(tmp_path, suffix):
    for name in ("one", "two"):
        save_figure(draw_section(section_drawing(SECTIONS[0])).figure, tmp_path / f"{name}.{suffix}")
    one = (tmp_path / f"one.{suffix}").read_bytes()
    assert one == (tmp_path / f"two.{suffix}").read_bytes()
    assert len(one) > 3000
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"one.{suffix}", f"two.{suffix}"]


def test_places_that_cannot_be_written(tmp_path):
    figure = draw_section(section_drawing(SECTIONS[0])).figure
    with pytest.raises(InputError, match=r"\.svg, \.pdf or \.png"):
        save_figure(figure, tmp_path / "drawing.jpg")
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="cannot write"):
        save_figure(figure, tmp_path / "file" / "drawing.png")
    with pytest.raises(StorageError, match="cannot write"):
        save_figure(figure, tmp_path / "missing" / "drawing.png")


@pytest.mark.parametrize(
    "table", [normal_angle_table(), wide_angle_table(), overcorrection_table(0.5, [0.1], [0.0])]
)
def test_heat_map_has_every_value_and_the_critical_line(table):
    figure = heat_map(table)
    axes = figure.axes[0]
    texts = [text.get_text() for text in axes.texts]
    assert len(texts) == table.factors.size
    assert texts.count("±∞") == np.isinf(table.factors).sum()
    line = next(line for line in axes.lines if line.get_gid() == "critical-line")
    h5, h3 = line.get_data()
    np.testing.assert_allclose(np.asarray(h3) + np.asarray(h5), table.critical_sum)


@pytest.fixture(scope="module")
def runs():
    terrain = StandardTerrain((0, 0.05, 0.2, 0.1, 0.15, -0.1), 1 / 3, 1500.0, 500.0)
    model = terrain.model(wrong_orientation(500.0, 2))
    options = EmpiricalOptions(cycles=3, given_section=terrain.section())
    return {
        name: run_empirical(model, Setting(500.0), dependent_pair(), rule, options)
        for name, rule in RULES.items()
    }


def test_residual_parallaxes_one_panel_per_cycle(runs):
    figure = residual_parallaxes(runs["general"])
    shown = [axes for axes in figure.axes if axes.get_visible()]
    assert [axes.get_title().split("\n")[0] for axes in shown] == [
        "start", "after cycle 1", "after cycle 2", "after cycle 3",
    ]  # fmt: skip
    largest = [float(axes.get_title().split()[-2]) for axes in shown]
    expected = np.abs(runs["general"].parallaxes).max(axis=1)
    np.testing.assert_allclose(largest, expected, rtol=0.06)


def test_course_has_one_line_per_rule(runs):
    axes = parallax_course(runs).axes[0]
    named = {
        line.get_label().split(":")[0]: line for line in axes.lines if not line.get_label().startswith("_")
    }
    assert set(named) == set(RULES)
    np.testing.assert_allclose(named["flat"].get_ydata(), runs["flat"].largest)


def test_figures_leave_matplotlib_as_it_was(tmp_path):
    def settings():
        return {key: value for key, value in mpl.rcParams.items() if key != "backend"}

    before = settings()
    save_figure(heat_map(overcorrection_table(0.5, [0.0], [0.0])), tmp_path / "map.png")
    assert settings() == before
