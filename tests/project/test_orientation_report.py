"""The page on the strength of relative orientations, and its drawings under a real mouse."""

from __future__ import annotations

import re
import shutil

import numpy as np
import pytest
from playwright.sync_api import sync_playwright

from stereomate.cli import main
from stereomate.project import load
from stereomate.project.orientation_report import strength_section, write_strength_report
from stereomate.project.orientation_sections import ProjectSectionOptions, project_sections
from stereomate.relative.overcorrection import overcorrection_factor

BLIND = ProjectSectionOptions(least_contrast=0.0, profiles=4)


def test_section_of_the_report(small):
    (pair,) = geometries = project_sections(load(small.path), BLIND)
    section = strength_section(geometries)
    ((names, _, ends, flat, strength, count, before, verdict),) = section.pictures[0].table.rows
    assert names == "photo_1 – photo_2"
    assert ends == " / ".join(f"{n:.2f}" for n in pair.end_factors)
    assert flat == f"{pair.sections.flat_factor:.2f}"
    assert strength == f"{pair.sections.strength:.2f}"
    assert (count, before, verdict) == ("4 of 4", "–", "near critical")
    assert len(section.fragments) == 1
    weakest = max(pair.sections.sections, key=lambda found: found.ratio)
    assert f"at {weakest.place:.2f} of the base" in section.fragments[0]
    for found, profile in zip(pair.sections.sections, pair.profiles, strict=True):
        np.testing.assert_array_equal(profile[list(found.indices)], found.strength.section)


def test_pair_without_a_section(small):
    everywhere_water = ProjectSectionOptions(least_contrast=1000.0, texture_radius_px=2, profiles=4)
    geometries = project_sections(load(small.path), everywhere_water)
    section = strength_section(geometries)
    ((*_, strength, _, _, verdict),) = section.pictures[0].table.rows
    assert (strength, verdict) == ("–", "no section")
    assert section.fragments == ()


def test_command_writes_the_page(small, tmp_path, capsys):
    page = tmp_path / "strength.html"
    with pytest.raises(SystemExit) as end:
        main.run(
            ["overcorrection", "section", str(small.path), "--least-contrast", "0", "--report", str(page)]
        )
    assert end.value.code == 0
    text = page.read_text(encoding="utf-8")
    assert "photo_1 – photo_2" in text
    assert not re.search(r'(src|href)="(?!data:)', text)
    with pytest.raises(SystemExit) as end:
        main.run(
            ["overcorrection", "section", str(small.path), "--report", str(tmp_path / "none" / "p.html")]
        )
    assert end.value.code != 0
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.slow
def test_points_of_the_report_are_dragged(small, tmp_path):
    """A mouse drags point 5 along the terrain: the number that is shown is that of the formula."""
    # Chromium is there: make test sets it up
    path = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    assert path is not None, "Chromium is missing: apt-get install chromium (make test does)"
    rows, cols = np.mgrid[0:40, 0:40]
    small.write_heights(200.0 + 0.3 * cols + 0.2 * rows)
    project = load(small.path)
    geometries = project_sections(project, BLIND)
    page_file = tmp_path / "strength.html"
    write_strength_report(page_file, project, geometries)
    sections = geometries[0].sections.sections
    index = max(range(len(sections)), key=lambda k: sections[k].ratio)
    profile = geometries[0].profiles[index]
    profile = profile[np.isfinite(profile).all(axis=1)]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1200, "height": 1000})
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(page_file.as_uri())
        page.evaluate(
            "() => { window.seen = []; document.getElementById('section-1')"
            ".addEventListener('overcorrection', (event) => window.seen.push(event.detail)); }"
        )
        reading = page.locator("#section-1 [data-role='reading']")
        before = reading.text_content()
        assert f"n = d/a = {sections[index].strength.factor:.3f}" in before
        handle = page.locator("#section-1 .smoc-handle").nth(2)
        handle.scroll_into_view_if_needed()
        box = handle.locator(".smoc-point").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x - 15, y + 40, steps=4)
        page.mouse.up()
        seen = page.evaluate("() => window.seen")
        after = reading.text_content()
        page.locator("#section-1 [data-role='reset']").click()
        again = reading.text_content()
        browser.close()
    assert errors == []
    assert len(seen) >= 4
    moved = np.array(seen[-1]["section"])
    start = sections[index].strength.section
    np.testing.assert_array_equal(moved[:2], start[:2])
    assert moved[2, 0] < start[2, 0]
    assert moved[2, 1] == pytest.approx(np.interp(moved[2, 0], profile[:, 0], profile[:, 1]), rel=1e-9)
    expected = overcorrection_factor(moved)
    assert seen[-1]["n"] == pytest.approx(expected, rel=1e-9)
    assert f"n = d/a = {expected:.3f}" in after
    assert again == before
