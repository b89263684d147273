"""Tables I and II as the paper prints them, its errors listed one by one."""

from __future__ import annotations

import csv
import io
import math

import numpy as np
import pytest

from stereomate.errors import InputError
from stereomate.relative.tables import normal_angle_table, overcorrection_table, wide_angle_table

INF = math.inf
# Rows h3/z1 from +0.20 down, columns h5/z1 from -0.20 up.
TABLE_I = [
    [6.0, 7.7, 11.0, 21.0, INF, -19.0, -9.0, -5.6, -4.0],
    [4.8, 5.8, 7.3, 10.5, 20.0, INF, -18.0, -8.5, -5.3],
    [4.0, 4.6, 5.5, 7.9, 10.0, 19.0, INF, -17.0, -8.0],
    [3.4, 3.8, 4.4, 5.3, 6.7, 9.5, 18.0, INF, -16.0],
    [3.0, 3.3, 3.7, 4.2, 5.0, 6.3, 9.0, 17.0, INF],
    [2.7, 2.9, 3.2, 3.5, 4.0, 4.8, 6.0, 8.5, 16.0],
    [2.4, 2.6, 2.8, 3.0, 3.3, 3.8, 4.5, 5.6, 8.0],
    [2.2, 2.3, 2.5, 2.6, 2.9, 3.2, 3.6, 4.3, 5.3],
    [2.0, 2.1, 2.2, 2.4, 2.5, 2.8, 3.0, 3.4, 4.0],
]
TABLE_II = [
    [2.1, 2.3, 2.6, 3.0, 4.2, 6.9, 45.5],
    [1.8, 1.9, 2.1, 2.3, 2.8, 3.7, 6.1],
    [1.6, 1.7, 1.8, 1.9, 2.2, 2.5, 3.3],
    [1.4, 1.5, 1.5, 1.6, 1.7, 1.9, 2.2],
    [1.3, 1.3, 1.3, 1.4, 1.5, 1.5, 1.7],
    [1.2, 1.2, 1.2, 1.2, 1.3, 1.3, 1.4],
    [1.1, 1.1, 1.1, 1.1, 1.1, 1.1, 1.1],
]
# (h3, h5): printed, true. Errors of the paper or of its scan.
ERRORS_I = {
    (0.10, -0.05): (7.9, 7.000),
    (0.20, 0.15): (-5.6, -5.667),
    (-0.05, -0.10): (3.2, 3.143),
    (-0.10, 0.15): (5.6, 5.667),
    (-0.15, -0.10): (2.5, 2.444),
    (-0.20, -0.05): (2.4, 2.333),
    (-0.20, 0.05): (2.8, 2.714),
}
ERRORS_II = {
    (0.3, 0.0): (3.0, 3.171),
    (0.2, 0.0): (2.3, 2.407),
    (0.2, 0.1): (2.8, 2.854),
    (-0.1, 0.2): (1.5, 1.552),
}
# Printed to one decimal; the rest is the error rounding may make, and 5.25 or 1.95 printed up or down.
PRINTED = 0.0501


@pytest.mark.parametrize(
    ("table", "printed", "errors"),
    [(normal_angle_table(), TABLE_I, ERRORS_I), (wide_angle_table(), TABLE_II, ERRORS_II)],
    ids=["I", "II"],
)
def test_printed_tables(table, printed, errors):
    found = {}
    for i, h3 in enumerate(table.h3):
        for j, h5 in enumerate(table.h5):
            n, paper = table.factors[i, j], printed[i][j]
            if math.isinf(paper):
                assert math.isinf(n), (h3, h5)
            elif abs(n - paper) > PRINTED:
                found[(h3, h5)] = (paper, round(n, 3))
    assert found == errors


def test_tables_are_the_formulas_above_them():
    table = normal_angle_table()
    h3, h5 = np.meshgrid(table.h3, table.h5, indexing="ij")
    finite = np.isfinite(table.factors)
    np.testing.assert_allclose(table.factors[finite], (1 - h5[finite]) / (0.2 - (h3 + h5)[finite]), rtol=1e-9)
    assert (~finite).sum() == 5
    wide = wide_angle_table()
    h3, h5 = np.meshgrid(wide.h3, wide.h5, indexing="ij")
    np.testing.assert_allclose(wide.factors, 13 * (1 - h5) / (8 - 13 * (h3 + h5)), rtol=1e-9)


@pytest.mark.parametrize("tangent", [0.2, 1 / 3, 2 / 3, 1.1])
def test_critical_sum_is_where_the_factor_is_infinite(tangent):
    total = overcorrection_table(tangent, [0.0], [0.0]).critical_sum
    assert math.isinf(overcorrection_table(tangent, [total / 3], [total * 2 / 3]).factors[0, 0])
    assert overcorrection_table(tangent, [total / 3], [total * 0.6]).factors[0, 0] > 0
    assert overcorrection_table(tangent, [total / 3], [total * 0.7]).factors[0, 0] < 0


def test_text():
    lines = normal_angle_table().to_text().splitlines()
    assert "1/3" not in lines[0]
    assert "0.333333" in lines[0]
    assert "0.2" in lines[0]
    assert lines[4].split("|")[1].split()[:5] == ["6.0", "7.7", "11.0", "21.0", "±∞"]
    assert len({len(line) for line in lines[2:]}) == 1
    assert normal_angle_table().to_text(3).splitlines()[4].split("|")[1].split()[1] == "7.667"


def test_csv_holds_every_value():
    table = wide_angle_table()
    rows = list(csv.DictReader(io.StringIO(table.to_csv())))
    assert len(rows) == 49
    values = np.array([float(row["n"]) for row in rows]).reshape(7, 7)
    np.testing.assert_array_equal(values, table.factors)
    assert (float(rows[1]["h3_over_z1"]), float(rows[1]["h5_over_z1"])) == (0.3, -0.2)


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ((0.0, [0.0], [0.0]), "tangent"),
        ((math.nan, [0.0], [0.0]), "tangent"),
        ((0.5, [1.0], [0.0]), "h3"),
        ((0.5, [0.0], [math.nan]), "h5"),
        ((0.5, [], [0.0]), "h3"),
        ((0.5, [[0.0]], [0.0]), "h3"),
    ],
)
def test_wrong_tables_are_refused(arguments, name):
    with pytest.raises(InputError, match=name):
        overcorrection_table(*arguments)
