"""Every key of `[products]` is checked once, and the message names it."""

from __future__ import annotations

import math

import pytest

from stereomate.errors import ProjectError
from stereomate.rectify.options import RectifyOptions


def test_defaults_are_valid():
    options = RectifyOptions()
    assert (options.hidden, options.resampling, options.heights_interpolation) == (
        "fill",
        "cubic",
        "bilinear",
    )
    assert options.object_height_m == 20.0


@pytest.mark.parametrize(
    "keys",
    [
        {"gsd": 0.0},
        {"gsd": math.nan},
        {"base_m": -1.0},
        {"w0_m": math.inf},
        {"reference_m": math.nan},
        {"law": "quadratic"},
        {"hidden": "shown"},
        {"resampling": "average"},
        {"rotation": "south-up"},
        {"rotation": math.nan},
        {"object_height_m": -1.0},
        {"bounds": (0.0, 0.0, 0.0, 1.0)},
        {"bounds": (0.0, 0.0, math.nan, 1.0)},
        {"min_base_height": -0.1},
        {"max_base_height": 0.01},
        {"blocksize": 500},
        {"blocksize": 64},
        {"compression_level": 23},
        {"compression_level": 5, "compression": "jpeg"},
        {"quality": 0},
        {"dtype": "uint16", "compression": "jpeg"},
        {"nodata": 0.0, "compression": "webp"},
        {"nodata": 256.0, "dtype": "uint8"},
        {"nodata": 0.0, "masking": "mask"},
        {"bands": (1, 1)},
        {"bands": (0,)},
        {"bands": ()},
    ],
)
def test_wrong_values_are_named(keys):
    with pytest.raises(ProjectError) as caught:
        RectifyOptions(**keys)
    field = caught.value.field
    assert field is not None
    assert field.removeprefix("products.") in keys
    assert repr(getattr(caught.value, "value", None)) in str(caught.value)


@pytest.mark.parametrize(
    "keys",
    [
        {"nodata": math.nan, "dtype": "float32"},
        {"nodata": -32768.0, "dtype": "int16", "masking": "nodata"},
        {"rotation": -12.5},
        {"compression": "deflate", "compression_level": 9},
        {"bands": (4, 1)},
    ],
)
def test_right_values_pass(keys):
    assert RectifyOptions(**keys) == RectifyOptions(**keys)
