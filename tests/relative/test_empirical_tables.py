"""Tables of points for the instrument, and the operator's notes."""

from __future__ import annotations

import numpy as np
import pytest

from stereomate.errors import FormatError
from stereomate.relative.empirical.notes import comparison_table, motion_symbol, operator_notes
from stereomate.relative.empirical.procedure import dependent_pair, flat_rule, general_rule
from stereomate.relative.empirical.projectors import Setting
from stereomate.relative.empirical.run import EmpiricalOptions, run_empirical
from stereomate.relative.empirical.scenes import StandardTerrain, wrong_orientation
from stereomate.relative.point_table import read_point_table

IMAGE = """# measured by hand
point, x_left, y_left, x_right, y_right
1, 0.1, 0.2, -60, 0.3
2, 60, 0.2, 0, 0.3
3, 0, -60, -60, -60
4, 60, -60, 0, -60
5, 0, 60, -60, 60
"""


def test_image_table():
    table = read_point_table("\ufeff" + IMAGE, "points.csv")
    assert (table.kind, table.names) == ("image", ("1", "2", "3", "4", "5"))
    np.testing.assert_array_equal(table.values[0], [0.1, 0.2, -60.0, 0.3])


def test_terrain_table_with_columns_in_any_order():
    rows = "\n".join(f"{h},p{i},{i},{-i}" for i, h in enumerate([1.5, 2.5, 3.5, 4.5, 5.5]))
    table = read_point_table(f"h,point,x,y\n{rows}\n", "t.csv")
    assert table.kind == "terrain"
    np.testing.assert_array_equal(table.values[2], [2.0, -2.0, 3.5])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "columns"),
        ("point,x,y\n1,2,3\n", "columns"),
        (IMAGE.replace("60, 0.2, 0,", "60, nan, 0,"), "point 2, y_left"),
        (IMAGE.replace("60, 0.2, 0,", "60, , 0,"), "point 2, y_left"),
        (IMAGE.replace("2, 60, 0.2, 0, 0.3", "2, 60"), "point 2, y_left"),
        (IMAGE.replace("\n2,", "\n1,"), "come once"),
        (IMAGE.replace("\n2,", "\n ,"), "come once"),
        ("\n".join(IMAGE.splitlines()[:5]), "five points"),
    ],
)
def test_wrong_tables_are_refused(text, message):
    with pytest.raises(FormatError, match=message) as caught:
        read_point_table(text, "points.csv")
    assert "points.csv" in str(caught.value)


def make(rule, heights=(0.0, 0.05, 0.2, 0.1, 0.15, -0.1), cycles=2):
    terrain = StandardTerrain(heights, tangent=1 / 3, flying_height=1500.0, base=500.0)
    model = terrain.model(wrong_orientation(500.0, 1), with_grid=False)
    options = EmpiricalOptions(cycles=cycles, given_section=terrain.section())
    return run_empirical(model, Setting(500.0), dependent_pair(), rule, options)


def test_notes_hold_every_step():
    run = make(general_rule)
    text = operator_notes(run, every_round=True)
    assert sum(line.startswith("  1 ") for line in text.splitlines()) == sum(
        n.point == "1" for n in run.notes
    )
    assert "over-corrected -5.667 times" in text
    assert text.splitlines()[-1].startswith("cleared: ")
    short = operator_notes(run)
    assert "rounds in all" in short
    assert len(short.splitlines()) < len(text.splitlines())
    first = next(line for line in short.splitlines() if line.startswith("  2 "))
    assert first.split()[:4] == ["2", "by''", f"{run.notes[0].parallax_before:+.4f}", "0.0000"]


def test_notes_of_a_critical_section_say_so():
    run = make(general_rule, (0.0, 0.0, 0.1, 0.1, 0.1, 0.1))
    assert operator_notes(run).splitlines()[-1].startswith("critical: no over-correction factor exists")


def test_comparison():
    text = comparison_table(
        {
            "flat": make(flat_rule, cycles=3),
            "general": make(general_rule),
            "critical": make(general_rule, (0, 0, 0.1, 0.1, 0.1, 0.1)),
        }
    )
    lines = text.splitlines()
    assert lines[1].split() == ["rule", "n", "start", "cycle", "1", "cycle", "2", "cycle", "3", "outcome"]
    assert lines[3].split()[-1] == "diverging"
    assert lines[4].split()[1] == "-5.667"
    assert lines[5].split()[1] == "±∞"


def test_symbols():
    assert [motion_symbol(m) for m in ("by2", "omega1", "kappa2", "phi1", "bz2")] == [
        "by''",
        "ω'",
        "κ''",
        "φ'",
        "bz''",
    ]
