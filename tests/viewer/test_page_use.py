"""The page as people use it: mark, correlation, measuring, files, links, keys, touch, what breaks."""

from __future__ import annotations

import dataclasses
import json
import shutil

import numpy as np
import pytest
from browsing import Opened, serving, wait
from written_surface import write_surface_file

from stereomate.frames.transform import map_from_tangent, tangent_from_map
from stereomate.stereo.surface_bands import ABOVE, BANDS, SIGMA
from stereomate.terrain.intersection import ground_distances
from stereomate.viewer.site import Site

TOGGLE_ALL = """async (on) => {
  for (const [id] of stereomate.layers.available()) await stereomate.layers.toggle(id, on);
}"""


@pytest.fixture(scope="module")
def shared(browser, address):
    """One page for the tests that leave it as they found it."""
    context = browser.new_context(viewport={"width": 800, "height": 600}, accept_downloads=True)
    opened = Opened(context.new_page())
    opened.open(address)
    yield opened
    context.close()


@pytest.fixture
def fresh(shared):
    shared.page.evaluate(
        "stereomate.measurements.clear(); stereomate.setTool('look'); stereomate.setMode('half-colour');"
        "stereomate.mark.toGround(); stereomate.view.exaggeration = 1; stereomate.fit(); stereomate.touched()"
    )
    return shared


def at_pixel(page, col, row):
    """Screen position of a place of the orthophoto, after the view was moved there at full resolution."""
    page.evaluate(
        f"stereomate.motion.target = null; Object.assign(stereomate.view, {{cx: {col}, cy: {row}, zoom: 2}})"
    )
    box = page.evaluate("(b => [b.x, b.y, b.width, b.height])(stereomate.canvas.getBoundingClientRect())")
    return box[0] + box[2] / 2, box[1] + box[3] / 2


def middle(product):
    cols, rows = product.job.grid.size
    return cols * 0.5, rows * 0.5


def reading(page):
    wait(page, "stereomate.reading && stereomate.reading.point && !stereomate.readPending")
    return page.evaluate("stereomate.reading")


def test_loads_without_a_word_and_asks_nobody_else(shared, address):
    assert shared.errors == []
    assert all(url.startswith((address, "data:", "blob:")) for url in shared.requests)
    assert shared.page.evaluate("stereomate.renderer.cache.uploadedTwice") == 0


def test_wheel_raises_the_mark_as_the_law_says(fresh, product):
    page, job = fresh.page, product.job
    page.keyboard.press("p")
    x, y = at_pixel(page, *middle(product))
    page.mouse.move(x, y)
    before = reading(page)
    for _ in range(4):
        page.mouse.wheel(0, -100)
    wait(page, f"Math.abs(stereomate.reading.lawHeight - {before['lawHeight']}) > 0.01")
    wait(page, "stereomate.mark.raised >= 2")
    page.wait_for_timeout(100)
    after = reading(page)
    q = job.law.q(before["lawHeight"]) + 2.0 * job.grid.gsd
    assert after["lawHeight"] == pytest.approx(float(job.law.inverse(q)), abs=1e-6)
    assert after["point"][2] > before["point"][2] + 0.5
    assert after["left"] == pytest.approx(before["left"])


def test_correlation_finds_the_ground(fresh, product):
    """Within 0.3 px on open ground, from marks that are 6 pixels off."""
    page, job = fresh.page, product.job
    rng = np.random.default_rng(3)
    cols, rows = job.grid.size
    found = page.evaluate(
        """async (places) => {
          const { correlate } = await import(location.origin + '/measure/correlate.js');
          const out = [];
          for (const [col, row] of places) {
            await stereomate.product.prepare([col, row], [col, row]);
            const ground = await stereomate.product.ground(col, row);
            const p = stereomate.product.parallaxOfHeight(ground.h);
            const shown = [0, 1].map((side) => stereomate.product.photographAt(side, col - side * p, row));
            const match = await correlate(stereomate.grey, [col, row], [col - p + 6, row]);
            out.push(match && shown[0] && shown[1] && shown[0] !== shown[1]
              ? [match.right[0] - (col - p), match.right[1] - row, match.score, match.sigma[0]] : null);
          }
          return out;
        }""",
        rng.uniform([0.35 * cols, 0.3 * rows], [0.65 * cols, 0.7 * rows], (40, 2)).tolist(),
    )
    good = np.array([m for m in found if m])
    assert len(good) > 20
    # houses and trees stand on the ground here and there
    assert np.median(np.abs(good[:, :2]), axis=0).max() < 0.1
    assert np.mean(np.abs(good[:, 0]) < 0.3) > 0.8


def test_key_correlates_the_mark(fresh, product):
    page = fresh.page
    page.keyboard.press("p")
    page.mouse.move(*at_pixel(page, *middle(product)))
    reading(page)
    page.keyboard.press("PageUp")
    page.keyboard.press("PageUp")
    page.keyboard.press("c")
    wait(page, "stereomate.mark.matched && stereomate.mark.matched.score > 0.5")
    page.wait_for_timeout(150)
    assert abs(reading(page)["residualPx"]) < 0.5


def seen_by_both(job, lineage, points):
    """Positions (col, row) of map points on both products where these show them; else NaN."""
    at = tangent_from_map(job.tangent, job.frame, points)
    out = np.full((len(points), 2, 2), np.nan)
    for p, photograph in enumerate(job.photographs):
        centre = np.array(photograph.orientation.centre)
        ray = (at - centre) / np.linalg.norm(at - centre, axis=1, keepdims=True)
        distance = ground_distances(job.heights, job.tangent, centre, ray)
        met = np.flatnonzero(np.isfinite(distance))
        ground = map_from_tangent(job.tangent, job.frame, centre + distance[met, None] * ray[met])
        for side in range(2):
            pixel = job.grid.pixel_from_map(ground[:, :2])
            pixel[:, 0] -= side * job.law.q(ground[:, 2]) / job.grid.gsd
            shows = lineage.photographs(side, pixel) == p + 1
            out[met[shows], side] = pixel[shows]
    return out


@pytest.fixture(scope="module")
def houses(survey_folder, product):
    """Roof corners over the ground that both eyes show: positions of foot and top, and the true height."""
    from stereomate.stereo.lineage import LineageRaster

    job = product.job
    truth = json.loads((survey_folder / "truth.json").read_text())
    tops = np.array([corner for house in truth["buildings"] for corner in house["roof_corners"]])
    lineage = LineageRaster(product.folder / product.files.lineage)
    feet = np.column_stack([tops[:, :2], job.heights.heights_at(tops[:, :2])])
    top, foot = seen_by_both(job, lineage, tops), seen_by_both(job, lineage, feet)
    both = np.isfinite(top).all(axis=(1, 2)) & np.isfinite(foot).all(axis=(1, 2))
    assert both.sum() > 3
    return foot[both], top[both], (tops - feet)[both, 2]


def test_object_height_of_known_houses(fresh, houses):
    """Foot and top with 0.3 px of noise, set by the tool: within three stated deviations of the truth."""
    page = fresh.page
    rng = np.random.default_rng(4)
    page.keyboard.press("h")
    foot, top, heights = houses
    for ends in zip(foot, top, strict=True):
        for left, right in (end + 0.3 * rng.standard_normal((2, 2)) for end in ends):
            page.evaluate(f"stereomate.mark.set({left.tolist()}, {right.tolist()})")
            page.evaluate(
                f"Object.assign(stereomate.view, {{cx: {left[0]}, cy: {left[1]}}}); stereomate.setPoint()"
            )
    wait(page, "stereomate.measurements.isSettled")
    results = page.evaluate(
        "stereomate.measurements.items.map(i => [i.result.height, i.result.heightSigma, i.result.lawHeight,"
        "i.result.points.map(p => p.flags)])"
    )
    assert len(results) == len(heights)
    normalised = [
        (height - true) / sigma
        for (height, sigma, _, flags), true in zip(results, heights, strict=True)
        if height is not None and not any(f & (16 | 32 | 512) for f in flags)
    ]
    assert len(normalised) > 3
    assert np.abs(normalised).max() < 3.5
    assert 0.4 < np.sqrt(np.mean(np.square(normalised))) < 1.7


def measure_something(page, product):
    """A point, a line and an area around the middle, by keys and mouse."""
    col, row = middle(product)
    page.keyboard.press("p")
    page.mouse.click(*at_pixel(page, col, row))
    for key, places in (
        ("l", [(-20, -10), (15, 5), (25, 20)]),
        ("a", [(-20, -15), (20, -15), (25, 15), (-15, 20)]),
    ):
        page.keyboard.press(key)
        for dx, dy in places:
            page.mouse.click(*at_pixel(page, col + dx, row + dy))
            page.wait_for_timeout(30)
        page.keyboard.press("Escape")
    wait(page, "stereomate.measurements.items.length === 3 && stereomate.measurements.isSettled")


def vertices(page):
    return page.evaluate("stereomate.measurements.records().map(r => [r.kind, r.name, r.vertices])")


def test_measurements_undo_table_and_results(fresh, product):
    page = fresh.page
    measure_something(page, product)
    names = page.evaluate("stereomate.measurements.items.map(i => i.kind)")
    assert names == ["point", "line", "area"]
    line, area = page.evaluate("stereomate.measurements.items.slice(1).map(i => i.result)")
    gsd = product.job.grid.gsd
    on_map = sum(
        np.hypot(*(np.array(a["point"][:2]) - b["point"][:2]))
        for a, b in zip(line["points"], line["points"][1:], strict=False)
    )
    assert line["onMap"] == pytest.approx(on_map, abs=1e-6)
    assert line["spatial"] > 0.99 * on_map
    assert len(line["profile"]["ground"]) > 100
    # shoelace formula of the measured points
    x, y = np.array([p["point"][:2] for p in area["points"]]).T
    shoelace = 0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))
    assert area["area"] == pytest.approx(shoelace, rel=1e-6)
    assert 20 * 20 * gsd**2 < area["area"] < 60 * 60 * gsd**2
    assert page.locator("#table tbody tr").count() == 3
    for _ in range(3):
        page.keyboard.press("Control+z")
    assert page.evaluate("stereomate.measurements.items.length") < 4
    for _ in range(3):
        page.keyboard.press("Control+y")
    wait(page, "stereomate.measurements.isSettled")
    assert page.evaluate("stereomate.measurements.items.map(i => i.kind)") == names


@pytest.mark.parametrize(
    "kind", ["geojson", *(pytest.param(k, marks=pytest.mark.slow) for k in ("csv", "kml"))]
)
def test_export_and_import(fresh, product, tmp_path, kind):
    page = fresh.page
    measure_something(page, product)
    before = vertices(page)
    with page.expect_download() as download:
        page.click(f"[data-export={kind}]")
    path = tmp_path / download.value.suggested_filename
    download.value.save_as(path)
    point = page.evaluate("stereomate.measurements.items[0].result")["points"][0]
    page.click("#clear")
    page.set_input_files("#import", path)
    wait(page, "stereomate.measurements.items.length === 3 && stereomate.measurements.isSettled")
    after = vertices(page)
    assert [(k, n) for k, n, _ in after] == [(k, n) for k, n, _ in before]
    for (_, _, old), (_, _, new) in zip(before, after, strict=True):
        for a, b in zip(old, new, strict=True):
            assert b["left"] == pytest.approx(a["left"], abs=1e-3)
            assert b["right"] == pytest.approx(a["right"], abs=1e-3)
    check_file(kind, path, point, product)


def check_file(kind, path, point, product):
    """What others read in the file: GDAL the vector formats, `stereomate measure` the table."""
    if kind == "csv":
        from stereomate.formats.measured_pairs import read_measured_pairs

        pairs = read_measured_pairs(path)
        assert len(pairs.left) == 8
        again = product.measure(pairs.left[:1], pairs.right[:1])
        np.testing.assert_allclose(again.points[0], point["point"], atol=1e-3)
        return
    from stereomate.formats.vector import read_features
    from stereomate.frames.heights import HeightSystem
    from stereomate.frames.mapframe import MapFrame
    from stereomate.frames.transform import map_from_map

    features = read_features(path).features
    assert sorted(f.geometry.geom_type for f in features) == ["LineString", "Point", "Polygon"]
    place = next(f.geometry for f in features if f.geometry.geom_type == "Point")
    flat = MapFrame(product.job.frame.crs, HeightSystem.ellipsoidal())
    world = MapFrame("EPSG:4326", HeightSystem.ellipsoidal())
    there = map_from_map(flat, world, np.array([[place.x, place.y, 0.0]]))[0]
    np.testing.assert_allclose(there[:2], point["point"][:2], atol=1e-3)


def test_link_reproduces_view_and_measurements(fresh, product, browser):
    page = fresh.page
    measure_something(page, product)
    page.select_option("#mode", "dubois")
    page.evaluate("stereomate.view.exaggeration = 1.4; stereomate.touched()")
    page.click("#link")
    wait(page, "location.hash.startsWith('#s=')")
    page.wait_for_timeout(50)
    address, state = page.evaluate("[location.href, stereomate.state()]")
    context = browser.new_context(viewport={"width": 800, "height": 600})
    other = Opened(context.new_page())
    other.open(address)
    wait(other.page, "stereomate.measurements.items.length === 3 && stereomate.measurements.isSettled")
    there = other.page.evaluate("stereomate.state()")
    assert there["measurements"] == state["measurements"]
    for key in ("mode", "zoom", "exaggeration"):
        assert there["view"][key] == state["view"][key]
    assert [there["view"][k] for k in ("cx", "cy")] == pytest.approx(
        [state["view"][k] for k in ("cx", "cy")], abs=0.02
    )
    heights = "stereomate.measurements.items.flatMap(i => i.result.points.map(p => p.point[2]))"
    assert other.page.evaluate(heights) == pytest.approx(page.evaluate(heights), abs=0.01)
    # kept in the browser, too: the bare address shows them again
    other.page.wait_for_timeout(600)
    other.page.goto("about:blank")
    other.open(address.split("#")[0])
    wait(other.page, "stereomate.measurements.items.length === 3")
    context.close()


@pytest.mark.slow
def test_damaged_links_and_files_are_refused(fresh, address, tmp_path):
    page = fresh.page
    for hash_ in ("#s=AAAA", "#s=%3Cscript", "#s=q1bKTSxKzk9JLVKyqlbKLS1KTc5PSVWyUjIyMDJS0oGpUKqtBQA"):
        page.evaluate(f"location.hash = {json.dumps(hash_)}")
        page.wait_for_timeout(30)
    bad = tmp_path / "bad.geojson"
    bad.write_text(
        '{"type": "FeatureCollection", "features": [{"properties": {"stereomate": 1, "vertices": [1]}}]}'
    )
    page.set_input_files("#import", bad)
    wait(page, "document.getElementById('notice').textContent.includes('bad.geojson')")
    assert fresh.errors == []
    assert page.evaluate("stereomate.measurements.items.length") == 0


def test_keyboard_alone(browser, address):
    """From the address to an object height and its file without a pointer."""
    context = browser.new_context(viewport={"width": 800, "height": 600})
    opened = Opened(context.new_page())
    opened.open(address)
    page = opened.page
    page.keyboard.press("Tab")
    for _ in range(30):
        if page.evaluate("document.activeElement.id") == "view":
            break
        page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.id") == "view"
    zoom = page.evaluate("stereomate.view.zoom")
    page.keyboard.press("+")
    page.keyboard.press("ArrowRight")
    wait(page, f"stereomate.view.zoom > 1.4 * {zoom} && !stereomate.motion.target")
    page.keyboard.press("h")
    page.keyboard.press("Enter")
    page.keyboard.press("Shift+ArrowUp")
    for _ in range(4):
        page.keyboard.press("PageUp")
    page.keyboard.press("Enter")
    wait(page, "stereomate.measurements.items.length === 1 && stereomate.measurements.isSettled")
    assert page.evaluate("stereomate.measurements.items[0].result.height") > 0.5
    page.keyboard.press("5")
    assert page.evaluate("stereomate.view.mode") == "parallel"
    page.keyboard.press("?")
    wait(page, "document.getElementById('help').open")
    page.keyboard.press("Escape")
    wait(page, "!document.getElementById('help').open")
    assert opened.errors == []
    context.close()


def test_narrow_touch_screen(browser, address):
    context = browser.new_context(
        viewport={"width": 360, "height": 640}, has_touch=True, is_mobile=True, device_scale_factor=2
    )
    opened = Opened(context.new_page())
    opened.open(address)
    page = opened.page
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    box = page.locator("#view").bounding_box()
    page.touchscreen.tap(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    wait(page, "stereomate.mark.left")
    page.tap("[data-tool=point]")
    page.tap("#mark-up")
    page.tap("#mark-set")
    wait(page, "stereomate.measurements.items.length === 1 && stereomate.measurements.isSettled")
    page.tap("#panel-toggle")
    assert page.locator("#panel").is_visible()
    zoom = page.evaluate("stereomate.view.zoom")
    pinch(page, box)
    assert page.evaluate("stereomate.view.zoom") > 1.5 * zoom
    assert opened.errors == []
    context.close()


def pinch(page, box):
    """Two fingers that part."""
    page.evaluate(
        """([x, y]) => {
          const fire = (type, id, dx) => stereomate.canvas.dispatchEvent(new PointerEvent(type,
            { pointerId: id, pointerType: 'touch', clientX: x + dx, clientY: y, bubbles: true }));
          stereomate.canvas.setPointerCapture = () => {};
          fire('pointerdown', 11, -20); fire('pointerdown', 12, 20);
          for (let k = 1; k <= 5; k++) {
            fire('pointermove', 11, -20 - 8 * k); fire('pointermove', 12, 20 + 8 * k);
          }
          fire('pointerup', 11, -60); fire('pointerup', 12, 60);
        }""",
        [box["x"] + box["width"] / 2, box["y"] + box["height"] / 3],
    )


class Broken:
    """A site that fails in one of its files until it is mended."""

    def __init__(self, site, bad: str) -> None:
        self.site, self.bad, self.content = site, bad, b"no picture"

    def read(self, name: str) -> bytes:
        """As `Site.read`."""
        content = self.site.read(name)
        return self.content if name.startswith(self.bad) and self.content else content


@pytest.mark.slow
def test_broken_tile_is_said_and_tried_again(browser, site, opened):
    files = Broken(site, "data/0/mate/0/0_0")
    with serving(files) as address:
        opened.page.goto(address)
        wait(opened.page, "window.stereomate && stereomate.renderer.relief")
        opened.page.evaluate(
            "Object.assign(stereomate.view, {cx: 100, cy: 100, zoom: 1}); stereomate.touched()"
        )
        wait(opened.page, "document.getElementById('notice').textContent.includes('cannot be read')")
        files.content = None
        wait(
            opened.page,
            "stereomate.renderer.cache.get('mate', 0, 0, 0) && stereomate.renderer.cache.failures === 0",
        )
        assert [text for text in opened.errors if "Failed to load" not in text] == []


@pytest.mark.slow
def test_server_that_stops_in_between(browser, site, opened):
    with serving(site) as address:
        opened.open(address)
    page = opened.page
    page.evaluate("Object.assign(stereomate.view, {cx: 300, cy: 300, zoom: 1}); stereomate.touched()")
    wait(page, "document.getElementById('notice').textContent.includes('cannot be read')")
    # what was there is still looked at and moved in
    frames = page.evaluate("stereomate.frames")
    page.evaluate("stereomate.view.cx += 20; stereomate.touched()")
    wait(page, f"stereomate.frames > {frames}")
    assert all("ERR_CONNECTION" in text for text in opened.errors)


def test_without_webgl2_the_page_says_what_is_missing(browser, address):
    page = browser.new_page()
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    page.goto(address)
    wait(page, "document.getElementById('message').textContent.includes('WebGL2')")
    assert page.locator("#app").is_hidden()
    page.close()


def test_accommodation_keeps_the_ground_at_the_screen(fresh, product):
    page, job = fresh.page, product.job
    for part in (0.35, 0.6):
        cols, rows = job.grid.size
        page.evaluate(f"stereomate.motion.goTo({part * cols}, {0.5 * rows}, 1); stereomate.touched()")
        wait(page, "!stereomate.motion.target")
        ground = page.evaluate("stereomate.product.ground(stereomate.view.cx, stereomate.view.cy)")
        wanted = float(job.law.q(ground["h"])) / job.grid.gsd
        wait(page, f"Math.abs(stereomate.view.accommodation - {wanted}) < 0.5")
    page.keyboard.press("t")
    before = page.evaluate("stereomate.view.accommodation")
    page.evaluate(f"stereomate.motion.goTo({0.35 * cols}, {0.5 * rows}, 1)")
    wait(page, "!stereomate.motion.target")
    assert page.evaluate("stereomate.view.accommodation") == before
    page.keyboard.press("t")


@pytest.mark.slow
def test_layers_and_dropped_features(fresh, product, tmp_path):
    page = fresh.page
    ids = page.evaluate("stereomate.layers.available().map(([id]) => id)")
    assert {"homogeneity", "hillshade", "contours", "lineage", "seams", "photographs", "grid"} <= set(ids)
    page.evaluate(TOGGLE_ALL, True)
    wait(page, "stereomate.layers.images().length === 4 && stereomate.renderer.lines.length > 0")
    assert page.locator("#legend").is_visible()
    lon, lat = page.evaluate(
        f"stereomate.product.surface.lattice.degrees({middle(product)[0]}, {middle(product)[1]})"
    )
    feature = {
        "type": "Feature",
        "properties": {"name": "hut"},
        "geometry": {"type": "Point", "coordinates": [lon, lat]},
    }
    path = tmp_path / "huts.geojson"
    path.write_text(json.dumps(feature))
    page.set_input_files("#import", path)
    wait(page, "stereomate.layers.features.length === 1")
    place = page.evaluate("stereomate.layers.features[0][0].places[0]")
    assert place == pytest.approx(middle(product), abs=1e-3)
    page.evaluate(TOGGLE_ALL, False)
    page.evaluate("stereomate.layers.features = []; stereomate.layers.changed()")
    assert fresh.errors == []


@pytest.mark.slow
def test_heights_of_objects_in_the_page(browser, run_folder, product, tmp_path):
    """The layer of a matched surface: colours from the threshold on, legend, readout; in a link."""
    folder = tmp_path / "out"
    shutil.copytree(run_folder, folder)
    cols, rows = product.job.grid.size
    values = np.zeros((rows, cols, len(BANDS)), np.float32)
    block = np.s_[rows // 2 - 20 : rows // 2 + 20, cols // 2 - 20 : cols // 2 + 20]
    values[(*block, ABOVE)], values[(*block, SIGMA)] = 9.0, 0.35
    write_surface_file(product, folder / "surface.tif", values, 1)
    site = Site([dataclasses.replace(product, folder=folder)])
    with serving(site) as address:
        context = browser.new_context(viewport={"width": 800, "height": 600})
        opened = Opened(context.new_page())
        opened.open(address)
        page = opened.page
        page.evaluate("for (const d of document.querySelectorAll('details')) d.open = true")
        page.check("#layer-objects")
        wait(page, "stereomate.renderer.layers.length === 1")
        assert "Heights of objects" in page.locator("#legend").inner_text()
        shown = "stereomate.layers.images()[0].image.data.filter((v, k) => k % 4 === 3 && v > 0).length"
        assert page.evaluate(shown) == 40 * 40
        page.fill("#least-height", "9.5")
        assert page.evaluate(shown) == 0
        page.fill("#least-height", "2")
        page.mouse.move(*at_pixel(page, *middle(product)))
        wait(page, "document.getElementById('readout').textContent.includes('9.0 ± 0.35 m')")
        state = page.evaluate("stereomate.state().layers")
        assert state == ["objects"]
        assert opened.errors == []
        context.close()
    site.close()


def test_print_sheet(fresh):
    page = fresh.page
    page.evaluate("window.print = () => { window.printed = true }")
    page.click("#print")
    wait(page, "window.printed")
    text = page.evaluate(
        "document.getElementById('sheet').innerText || document.getElementById('sheet').textContent"
    )
    assert "Test block" in text
    assert "Synthetic" in text
    assert page.evaluate("document.querySelectorAll('#sheet image').length") == 1
    assert page.pdf().startswith(b"%PDF")


THEMES = ["dark", *(pytest.param(name, marks=pytest.mark.slow) for name in ("light", "contrast"))]


@pytest.mark.parametrize("theme", THEMES)
def test_no_serious_accessibility_fault(fresh, product, theme):
    from axe_playwright_python.sync_playwright import Axe

    page = fresh.page
    page.evaluate("for (const d of document.querySelectorAll('details')) d.open = true")
    page.select_option("#theme", theme)
    page.keyboard.press("p")
    page.mouse.click(*at_pixel(page, *middle(product)))
    wait(page, "stereomate.measurements.isSettled")
    found = Axe().run(page).response["violations"]
    serious = [(v["id"], v["nodes"][0]["html"]) for v in found if v["impact"] in ("serious", "critical")]
    assert serious == []
    page.select_option("#theme", "auto")


def test_first_picture_waits_for_little(browser, address, opened):
    """One tile of each eye and two small records; lattice, heights and layers come after it."""
    opened.open(address)
    at, asked = opened.page.evaluate(
        "[performance.getEntriesByName('first picture')[0].startTime,"
        " performance.getEntriesByType('resource').map(r => [r.name, r.startTime, r.responseEnd])]"
    )
    needed = [name for name, _, end in asked if "/data/" in name and end <= at]
    assert sum(name.split("?")[0].endswith(".json") for name in needed) == 2
    assert sum("/ortho/" in name for name in needed) >= 1
    assert sum("/mate/" in name for name in needed) >= 1
    print(f"first picture after {at:.0f} ms")


@pytest.mark.slow
def test_orthophoto_alone_and_several_products(browser, survey_folder, product, tmp_path):
    """A product without stereomate is looked at and read; products of one run are chosen by name."""
    from run_survey import make

    from stereomate.stereo.product import read_products

    make(survey_folder / "project.toml", tmp_path / "out", agreement=False, stereo=False, threads=1)
    (plain,) = read_products(tmp_path / "out" / "stereo.json")
    assert plain.files.mate is None
    site = Site([product, plain])
    with serving(site) as address:
        context = browser.new_context(viewport={"width": 800, "height": 600})
        opened = Opened(context.new_page())
        opened.page.goto(address)
        wait(opened.page, "window.stereomate && stereomate.renderer.relief")
        assert opened.page.locator("#product option").count() == 2
        names = opened.page.evaluate("stereomate.products.map(p => p.stereo)")
        assert names == [True, False]
        page = opened.page
        page.route("**/data/products.json", lambda route: route.fulfill(json=only_second(site)))
        page.goto(address)
        wait(page, "window.stereomate && stereomate.renderer.relief && !stereomate.product.stereo")
        page.mouse.move(*at_pixel(page, *(0.5 * np.array(plain.job.grid.size))))
        wait(page, "document.getElementById('readout').textContent.includes('Height of the ground')")
        page.keyboard.press("p")
        page.keyboard.press("Enter")
        assert page.evaluate("stereomate.measurements.items.length") == 0
        assert opened.errors == []
        context.close()
    site.close()


def only_second(site):
    document = json.loads(site.read("data/products.json"))
    return {**document, "products": document["products"][1:]}
