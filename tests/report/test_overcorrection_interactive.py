"""The drawing with points to drag: its script computes what the formula says, and it runs in a browser."""

from __future__ import annotations

import json
import re
from importlib import resources

import numpy as np
import pytest

from stereomate.errors import InputError
from stereomate.relative.critical import critical_circle
from stereomate.relative.drawing import section_drawing
from stereomate.relative.overcorrection import overcorrection_factor
from stereomate.report.overcorrection_interactive import interactive_fragment, interactive_page

SCRIPT = resources.files("stereomate.report") / "overcorrection_interactive.js"
SECTION = [[90.0, 1503.0], [-640.0, 1446.0], [700.0, 1480.0]]
PROFILE = [[-900.0, 1450.0], [0.0, 1500.0], [900.0, 1400.0]]


@pytest.fixture(scope="module")
def script(browser):
    """A page in which the script is loaded and nothing else."""
    page = browser.new_page()
    page.set_content("<!doctype html><title>script</title>")
    page.add_script_tag(content=SCRIPT.read_text(encoding="utf-8"))
    yield page
    page.close()


def test_script_agrees_with_the_formula(script):
    rng = np.random.default_rng(8)
    sections = np.stack((rng.uniform(-900, 900, (50, 3)), rng.uniform(600, 2000, (50, 3))), axis=-1)
    sections = np.concatenate((sections, [[[0, 1500], [-450, 1350], [450, 1350]]]))
    results = script.evaluate(
        """(all) => all.map((points) => {
          const found = StereomateOverCorrection.construct(...points);
          const n = Number.isFinite(found.n) ? found.n : null;
          return [n, found.side, found.centre, StereomateOverCorrection.reading(found)];
        })""",
        sections.tolist(),
    )
    for section, (n, side, centre, reading) in zip(sections[:-1], results[:-1], strict=True):
        expected = overcorrection_factor(section)
        assert n == pytest.approx(expected, rel=1e-9)
        assert side == ("outside" if expected > 0 else "inside")
        circle = critical_circle(section)
        assert centre == pytest.approx((circle.centre_y, circle.centre_z), rel=1e-9)
        assert f"n = d/a = {expected:.3f}"[:14] in reading
    assert results[-1][:2] == [None, "on"]
    assert "not determined" in results[-1][3]


def test_terrain_is_followed(script):
    heights = script.evaluate(
        "(profile) => [450, -900, 901].map((y) => StereomateOverCorrection.heightAt(profile, y))", PROFILE
    )
    assert heights == [1450.0, 1450.0, None]


def test_fragment_is_self_contained():
    fragment = interactive_fragment(section_drawing(SECTION, profile=PROFILE), "pair-1", "Pair <1> & 2.")
    assert not re.search(r"https?://(?!www\.w3\.org/2000/svg)", fragment)
    assert "src=" not in fragment
    assert fragment.count('id="pair-1"') == 1
    assert "Pair &lt;1&gt; &amp; 2." in fragment
    data = json.loads(re.search(r'<script type="application/json">(.*?)</script>', fragment).group(1))
    assert data["section"] == SECTION
    assert (data["numbers"], data["roles"], data["profile"]) == ([1, 3, 5], [0, 1, 2], PROFILE)
    assert "stay on the terrain" in fragment
    assert "stay on the terrain" not in interactive_fragment(section_drawing(SECTION))


@pytest.mark.parametrize("identifier", ["", "1a", 'a"b', "a b", "a</script>"])
def test_identifiers_are_plain_names(identifier):
    with pytest.raises(InputError, match="identifier"):
        interactive_fragment(section_drawing(SECTION), identifier)


def test_points_move_in_a_browser(tmp_path, browser):
    drawing = section_drawing(SECTION, profile=PROFILE)
    two = interactive_fragment(drawing, "first") + interactive_fragment(section_drawing(SECTION, 3), "second")
    moving = """<p id="log"></p><script>
    const seen = [];
    const root = document.getElementById("first");
    root.addEventListener("overcorrection", (event) => seen.push(event.detail));
    const handle = root.querySelectorAll(".smoc-handle")[2];
    handle.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight", shiftKey: true, bubbles: true }));
    root.querySelector("[data-role='follow']").checked = false;
    handle.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowUp", bubbles: true }));
    const svg = root.querySelector("svg");
    const box = handle.getBoundingClientRect();
    const x = box.x + box.width / 2, y = box.y + 5;
    const pointer = { pointerId: 1, bubbles: true, clientX: x, clientY: y, isPrimary: true };
    handle.setPointerCapture = () => {}; handle.hasPointerCapture = () => true;
    handle.dispatchEvent(new PointerEvent("pointerdown", pointer));
    handle.dispatchEvent(new PointerEvent("pointermove", { ...pointer, clientX: x - 40, clientY: y - 30 }));
    const texts = [...document.querySelectorAll("[data-role='reading']")].map((p) => p.textContent);
    root.querySelector("[data-role='reset']").click();
    document.getElementById("log").textContent = JSON.stringify({ seen, texts });
    </script>"""
    page = interactive_page(drawing).replace(interactive_fragment(drawing), two + moving)
    (tmp_path / "page.html").write_text(page, encoding="utf-8")
    opened = browser.new_page()
    opened.goto((tmp_path / "page.html").as_uri())
    log = json.loads(opened.text_content("#log"))
    opened.close()
    assert len(log["seen"]) == 4
    for event in log["seen"]:
        assert event["n"] == pytest.approx(overcorrection_factor(event["section"]), rel=1e-9)
    right, up, dragged, back = (np.array(event["section"][2]) for event in log["seen"])
    assert right[0] > 700.0
    assert right[1] == pytest.approx(np.interp(right[0], *np.transpose(PROFILE)))
    assert up[0] == right[0]
    assert up[1] < right[1]
    # 40 and 30 px of a drawing with one scale for both axes.
    assert dragged[0] < up[0]
    assert (up - dragged)[1] / (up - dragged)[0] == pytest.approx(30 / 40, rel=1e-6)
    np.testing.assert_array_equal(back, SECTION[2])
    second = overcorrection_factor(SECTION, 3)
    assert f"n = d/a = {second:.3f}" in log["texts"][1]
