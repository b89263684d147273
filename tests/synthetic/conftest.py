"""A small survey that every test of this folder looks at."""

from __future__ import annotations

import pytest

from stereomate.synthetic.options import SurveyOptions
from stereomate.synthetic.survey import SyntheticSurvey, make_survey

SMALL = SurveyOptions(
    seed=7,
    strips=2,
    photos_per_strip=3,
    size_px=(480, 360),
    gsd_m=0.5,
    flying_height_m=260.0,
    pixel_pitch_mm=0.1,
    relief_m=50.0,
    terrain_step_m=3.0,
    buildings=16,
    trees=120,
    control_points=3,
    check_points=5,
)


@pytest.fixture(scope="session")
def small_survey() -> SyntheticSurvey:
    return make_survey(SMALL)
