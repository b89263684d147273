"""The number read off the drawing is the number of the formula."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from stereomate.errors import InputError, NotDeterminedError
from stereomate.relative.drawing import section_drawing
from stereomate.relative.overcorrection import overcorrection_factor


@st.composite
def terrains(draw):
    """A section with relief up to four fifths of the flying height, points in any order and place."""
    z1 = draw(st.floats(200.0, 9000.0))
    tangents = draw(st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3))
    assume(min(abs(tangents[0] - tangents[1]), abs(tangents[0] - tangents[2])) > 0.03)
    depths = [z1 * draw(st.floats(0.2, 1.8)) for _ in range(3)]
    return np.array([[t * z, z] for t, z in zip(tangents, depths, strict=True)])


@settings(deadline=None, max_examples=300)
@given(terrains(), st.sampled_from([1, 3, 5, 2, 4, 6]))
def test_read_off_equals_formula(section, corrected):
    n = overcorrection_factor(section, corrected)
    first, second = (row for row in range(3) if row != (corrected - 1) // 2)
    t = section[:, 0] / section[:, 1]
    assume(abs(t[first] - t[second]) > 0.03 and abs(n) < 1e4)
    drawing = section_drawing(section, corrected)
    assert drawing.factor == pytest.approx(n, rel=1e-9)
    assert drawing.numbers[drawing.roles[2]] == corrected
    if drawing.factor_primed is not None and abs(t[(corrected - 1) // 2] - t[first]) > 0.03:
        assert drawing.factor_primed == pytest.approx(n, rel=1e-9)


@settings(deadline=None)
@given(terrains())
def test_lines_stand_where_they_should(section):
    drawing = section_drawing(section)
    p1, p3, p5 = section
    size = np.abs(section).max()
    a3, foot = np.array(drawing.meeting_3), np.array(drawing.foot)
    near = 1e-7 * size**2 * (1 + np.abs(a3).max() / size)
    assert (a3 - p1) @ p1 == pytest.approx(0.0, abs=near)
    assert (a3 - p3) @ p3 == pytest.approx(0.0, abs=near)
    assert (a3 - foot) @ p5 == pytest.approx(0.0, abs=near)
    assert drawing.circle.signed_distance(foot) == pytest.approx(0.0, abs=1e-7 * (size + np.abs(a3).max()))
    np.testing.assert_allclose(drawing.circle.antipode, a3, rtol=1e-7, atol=1e-7 * size)
    a5, end = np.array(drawing.meeting_5), np.array(drawing.end_d)
    far = 1e-7 * size**2 * (1 + max(np.abs(a5).max(), np.abs(end).max()) / size)
    assert (a5 - p5) @ p5 == pytest.approx(0.0, abs=far)
    assert (end - p5) @ p5 == pytest.approx(0.0, abs=far)
    assert end @ p1 == pytest.approx(0.0, abs=far)
    assert drawing.d == pytest.approx(math.hypot(*p5), rel=1e-14)


def test_both_say_critical():
    # Equal heights 0.1 z1 at 3 and 5: Table I's diagonal.
    section = [[0.0, 1500.0], [-450.0, 1350.0], [450.0, 1350.0]]
    assert math.isinf(overcorrection_factor(section))
    drawing = section_drawing(section)
    assert math.isinf(drawing.factor)
    assert drawing.a == 0.0
    assert abs(drawing.a_primed) < 1e-9 * 1500


def test_negative_inside_the_circle():
    drawing = section_drawing([[0, 1500], [-400, 1200], [400, 1200]])
    assert drawing.a < 0 < drawing.d
    assert drawing.factor == pytest.approx(-4.0, abs=1e-12)  # Table I, +0.20 and +0.20


@pytest.mark.parametrize(
    ("section", "kind"),
    [
        ([[0, 1500], [-500, 1500], [500, 1500]], "flat"),
        ([[0, 1500], [-500, 1400], [500, 1600]], "nadir"),
        ([[80, 1500], [-500, 1400], [500, 1600]], "general"),
        ([[80, 1500], [-500, 1500], [500, 1500]], "general"),
    ],
)
def test_number_of_perpendiculars(section, kind):
    assert section_drawing(section).construction == kind


def test_flat_terrain_needs_one_perpendicular():
    drawing = section_drawing([[0, 1500], [-500, 1500], [500, 1500]])
    np.testing.assert_allclose(drawing.meeting_3, (-500, 1500), atol=1e-9)
    np.testing.assert_allclose(drawing.meeting_5, (500, 1500), atol=1e-9)
    assert drawing.a_primed == pytest.approx(1000.0)
    assert drawing.d_primed == pytest.approx(500 * (1 + 9))


def test_corrected_point_on_the_ray_of_point_1():
    section = [[0, 1500], [-500, 1400], [0, 1200]]
    drawing = section_drawing(section)
    assert drawing.meeting_5 is None
    assert drawing.end_d is None
    assert drawing.factor_primed is None
    assert drawing.factor == pytest.approx(overcorrection_factor(section), rel=1e-12)


def test_bounds_hold_everything_drawn():
    profile = np.array([[-900.0, 1700.0], [0.0, np.nan], [900.0, 1200.0]])
    drawing = section_drawing([[0, 1500], [-500, 1400], [500, 1600]], profile=profile)
    y0, y1, z0, z1 = drawing.bounds
    assert (y0, z0) == (-900.0, 0.0)
    assert y1 >= drawing.end_d[0]
    assert z1 >= 1700.0
    assert drawing.profile.shape == (2, 2)


def test_wrong_drawings_are_refused():
    flat = [[0, 1500], [-500, 1500], [500, 1500]]
    with pytest.raises(InputError, match="section"):
        section_drawing([flat, flat])
    with pytest.raises(InputError, match="section"):
        section_drawing([[0, math.nan], [-500, 1500], [500, 1500]])
    with pytest.raises(NotDeterminedError, match="one ray"):
        section_drawing([[0, 1500], [0, 1200], [500, 1500]])
    with pytest.raises(InputError, match="profile"):
        section_drawing(flat, profile=[1.0, 2.0])
    with pytest.raises(InputError, match="profile"):
        section_drawing(flat, profile=[[0.0, math.nan], [1.0, 2.0]])
