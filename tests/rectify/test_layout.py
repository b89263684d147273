import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stereomate.coverage.pairs import Pair
from stereomate.rectify import layout
from stereomate.rectify.grid import ProductGrid


def pair(first, second, base, overlap=0.6, height=1000.0):
    return Pair(
        first,
        second,
        (str(first), str(second)),
        (*base, 0.0),
        math.hypot(*base),
        overlap,
        overlap,
        overlap,
        height,
        0.1,
    )


def test_left_is_the_smaller_u_never_the_exposure_order():
    models = layout.oriented_models([pair(0, 1, (-600.0, 5.0))], 0.0)
    assert (models[0].left, models[0].right) == (1, 0)
    assert models[0].base_u_m == pytest.approx(600.0)
    assert models[0].base_v_m == pytest.approx(-5.0)


def test_strips_flown_both_ways_make_one_product():
    pairs = [
        pair(0, 1, (600.0, 20.0)),
        pair(1, 2, (590.0, -10.0)),
        pair(3, 4, (-610.0, 0.0)),
        pair(0, 4, (30.0, 900.0), 0.3),
    ]
    groups = layout.serving_groups(layout.suitable_pairs(pairs, 0.05, 2.0))
    assert len(groups) == 1
    assert {(p.first, p.second) for p in groups[0]} == {(0, 1), (1, 2), (3, 4)}


def test_a_photograph_across_opens_another_product():
    pairs = [pair(0, 1, (600.0, 0.0)), pair(2, 3, (10.0, 700.0), 0.5)]
    groups = layout.serving_groups(pairs)
    assert [[(p.first, p.second) for p in g] for g in groups] == [[(0, 1)], [(2, 3)]]


def test_too_little_overlap_or_base_makes_no_model():
    pairs = [pair(0, 1, (600.0, 0.0), 0.1), pair(0, 2, (20.0, 0.0), 0.97)]
    assert layout.suitable_pairs(pairs, 0.05, 2.0) == []


def test_north_up_while_objects_show_less_than_a_pixel_of_y_parallax():
    near = pair(0, 1, (600.0, 4.0))
    # 600 m x sin(0.38 deg) x 20 / 980 = 0.082 m
    assert layout.y_parallax_px(near, 0.0, 20.0, 0.1) == pytest.approx(4.0 * 20.0 / 980.0 / 0.1, rel=1e-4)
    assert layout.choose_rotation([near], 20.0, 0.1) == 0.0
    turned = pair(0, 1, (600.0, 60.0))
    assert layout.choose_rotation([near, turned], 20.0, 0.1) == pytest.approx(
        layout.base_axis(turned) / 2, rel=0.1
    )


@pytest.mark.parametrize(
    ("dx", "dy", "expected"), [(-1.0, -1.0, math.pi / 4), (0.0, -3.0, math.pi / 2), (1.0, -1.0, -math.pi / 4)]
)
def test_axis_has_its_east_component_not_negative(dx, dy, expected):
    assert layout.axis_direction(dx, dy) == pytest.approx(expected)


def test_base_of_every_second_photograph_serves_where_overlap_is_large():
    strip = [pair(i, i + 1, (150.0, 0.0), 0.85) for i in range(6)] + [
        pair(i, i + 2, (300.0, 0.0), 0.7) for i in range(5)
    ]
    models = layout.oriented_models(strip, 0.0)
    assert models[0].right - models[0].left == 2


@settings(deadline=None)
@given(
    st.floats(-1e6, 1e6),
    st.floats(-1e6, 1e6),
    st.floats(0.05, 20.0),
    st.floats(-1.5, 1.5),
    st.floats(1.0, 5e3),
    st.floats(1.0, 5e3),
)
def test_grid_covers_snaps_and_inverts(x, y, gsd, rotation, width, height):
    corners = np.array([(x, y), (x + width, y), (x + width, y + height), (x, y + height)])
    grid = ProductGrid.covering(corners, gsd, rotation)
    pixels = grid.pixel_from_map(corners)
    assert (pixels >= -1e-5).all()
    assert (pixels <= np.array(grid.size) + 1e-5).all()
    np.testing.assert_allclose(grid.map_from_pixel(pixels), corners, atol=1e-6)
    assert abs(grid.u0 / gsd - round(grid.u0 / gsd)) < 1e-6
    a, b, c, d, e, f = grid.affine
    col, row = 3.5, 7.25
    np.testing.assert_allclose(
        grid.map_from_pixel((col, row)), (a * col + b * row + c, d * col + e * row + f), atol=1e-6
    )
    assert a * e - b * d < 0  # never mirrored
