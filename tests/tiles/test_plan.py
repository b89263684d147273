"""The plan covers every pixel once, in quad-tree order."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stereomate.errors import InputError
from stereomate.tiles import TilePlan
from stereomate.tiles.plan import morton_code


@given(st.integers(1, 700), st.integers(1, 700), st.sampled_from([16, 32, 64]), st.sampled_from([1, 2, 4]))
@settings(deadline=None, max_examples=40)
def test_chunks_cover_every_pixel_once(cols, rows, block, chunk_tiles):
    plan = TilePlan((cols, rows), block, chunk_tiles)
    count = np.zeros((rows, cols), int)
    for chunk in plan.chunks:
        w = chunk.window
        assert not w.is_empty
        assert plan.chunk_at(chunk.col, chunk.row) is chunk
        count[w.row0 : w.row1, w.col0 : w.col1] += 1
    assert (count == 1).all()
    assert [chunk.index for chunk in plan.chunks] == list(range(len(plan.chunks)))


@given(st.integers(0, 10**6), st.integers(0, 10**6))
def test_the_morton_code_interleaves_bits(col, row):
    text = "".join(b + a for a, b in zip(f"{col:020b}", f"{row:020b}", strict=True))
    assert morton_code(col, row) == int(text, 2)


def test_the_four_chunks_of_a_quad_follow_each_other():
    plan = TilePlan((4096 * 4, 4096 * 4), 512, 4)
    places = [(chunk.col, chunk.row) for chunk in plan.chunks]
    for start in range(0, len(places), 4):
        assert len({(c // 2, r // 2) for c, r in places[start : start + 4]}) == 1


@pytest.mark.parametrize(
    ("arguments", "field"),
    [(((0, 5),), "size"), (((5, 5), 100), "block"), (((5, 5), 512, 3), "chunk_tiles")],
)
def test_impossible_plans_are_refused(arguments, field):
    with pytest.raises(InputError, match=field):
        TilePlan(*arguments)
