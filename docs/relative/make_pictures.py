"""Makes the pictures of these pages: python docs/relative/make_pictures.py"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stereomate.relative.drawing import section_drawing
from stereomate.relative.empirical.procedure import RULES, dependent_pair
from stereomate.relative.empirical.projectors import Setting
from stereomate.relative.empirical.run import EmpiricalOptions, run_empirical
from stereomate.relative.empirical.scenes import StandardTerrain, wrong_orientation
from stereomate.relative.tables import normal_angle_table
from stereomate.report.overcorrection import draw_section
from stereomate.report.overcorrection_empirical import parallax_course, residual_parallaxes
from stereomate.report.overcorrection_style import save_figure
from stereomate.report.overcorrection_tables import heat_map

PICTURES = Path(__file__).parent / "pictures"
MOUNTAINS = (0.0, 0.05, 0.2, 0.1, 0.15, -0.1)


def terrain(y):
    """A valley side: depth below the projection centre in metres."""
    return 1500.0 - 120.0 * np.exp(-(((y + 600.0) / 300.0) ** 2)) - 60.0 * np.sin(y / 170.0) - 0.1 * y


def section(*places: float) -> list[list[float]]:
    """Points of the terrain at places y."""
    return [[y, float(terrain(y))] for y in places]


def drawings() -> None:
    """The construction on four sections."""
    y = np.linspace(-950.0, 950.0, 120)
    profile = np.column_stack((y, terrain(y)))
    general = section_drawing(section(90.0, -640.0, 700.0), profile=profile)
    save_figure(draw_section(general).figure, PICTURES / "general.svg")
    save_figure(draw_section(general, construction_lines=True).figure, PICTURES / "construction.svg")
    flat = section_drawing([[0.0, 1500.0], [-750.0, 1500.0], [750.0, 1500.0]])
    save_figure(draw_section(flat).figure, PICTURES / "flat.svg")
    inside = section_drawing([[0.0, 1500.0], [-400.0, 1200.0], [400.0, 1200.0]])
    save_figure(draw_section(inside).figure, PICTURES / "inside.svg")


def runs() -> None:
    """Four rules in the mountains, and the residual parallaxes of two of them."""
    ground = StandardTerrain(MOUNTAINS, 1.0 / 3.0, 1500.0, 500.0)
    model = ground.model(wrong_orientation(500.0, 2))
    options = EmpiricalOptions(given_section=ground.section())
    made = {
        name: run_empirical(model, Setting(500.0), dependent_pair(), rule, options)
        for name, rule in RULES.items()
    }
    save_figure(parallax_course(made, "mountains, normal angle"), PICTURES / "course.svg")
    for name in ("general", "flat"):
        title = f"rule: {name}; {made[name].outcome}"
        save_figure(residual_parallaxes(made[name], title), PICTURES / f"residuals_{name}.svg")


if __name__ == "__main__":
    PICTURES.mkdir(exist_ok=True)
    drawings()
    runs()
    save_figure(
        heat_map(normal_angle_table(), "Table I: normal angle, y/z = 1/3"), PICTURES / "table_1.png", dpi=110
    )
