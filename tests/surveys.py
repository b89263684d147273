"""Synthetic surveys and the command line, as tests of several folders need them."""

from __future__ import annotations

from typing import Final

from typer.testing import CliRunner

from stereomate.cli.main import application
from stereomate.synthetic.options import SurveyOptions

# Two photographs of a few thousand pixels.
SMALLEST: Final = SurveyOptions(
    seed=3,
    strips=1,
    photos_per_strip=2,
    size_px=(160, 120),
    gsd_m=1.0,
    flying_height_m=200.0,
    pixel_pitch_mm=0.2,
    relief_m=30.0,
    terrain_step_m=4.0,
    buildings=3,
    trees=10,
    control_points=2,
    check_points=2,
)


def stereomate_says(*arguments: object) -> str:
    """What a command prints, one thread; its error is raised."""
    result = CliRunner().invoke(application(), ["--threads", "1", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.output
