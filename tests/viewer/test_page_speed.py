"""A pair of 20,000 x 20,000 pixels at 1920 x 1080: what the page itself does per frame, and what it uploads.

Software rendering is not judged: the figure is the time of the page's own code, which a GPU does not change.
"""

from __future__ import annotations

import json
import re
import time

import numpy as np
import pytest
from browsing import READY, Opened, serving, wait

from stereomate.viewer.binary import encode_floats
from stereomate.viewer.imagery import TILE

SIZE = 20_000
_TILE = re.compile(r"data/0/(ortho|mate)/(\d+)/(\d+)_(\d+)\.jpg")


PAN = """async (frames) => {
  for (let k = 0; k < frames; k++) {
    stereomate.motion.drag(k < frames / 2 ? -60 : 60, k % 10 < 5 ? 40 : -40);
    stereomate.touched();
    await new Promise((done) => requestAnimationFrame(done));
  }
}"""


class LargeSite:
    """The site of the small product, said to be large: every tile is one picture."""

    def __init__(self, site) -> None:
        self.site, self.step = site, -(-SIZE // 1024)
        self.tile = site.read("data/0/ortho/0/0_0.jpg")
        self.asked: list[str] = []

    def read(self, name: str) -> bytes:
        """As `Site.read`."""
        self.asked.append(name)
        if name == "data/0/product.json":
            record = json.loads(self.site.read(name))
            cells = -(-SIZE // self.step)
            record["grid"]["size"] = [SIZE, SIZE]
            record["tiles"]["levels"] = 1 + int(np.ceil(np.log2(SIZE / TILE)))
            record["layers"] = {"cols": cells, "rows": cells, "step": self.step}
            record["key"] = record["version"] = "large"
            return json.dumps(record).encode()
        if name == "data/0/relief.bin":
            cells = -(-SIZE // self.step)
            row, col = np.mgrid[0:cells, 0:cells]
            low, high = self.site.sources[0].product.job.height_range
            return encode_floats(low + (high - low) * (0.5 + 0.5 * np.sin(col / 40.0) * np.cos(row / 50.0)))
        return self.tile if _TILE.fullmatch(name) else self.site.read(name)


@pytest.mark.slow
def test_panning_a_large_pair(browser, site):
    files = LargeSite(site)
    with serving(files) as address:
        context = browser.new_context(viewport={"width": 1920, "height": 1080})
        opened = Opened(context.new_page())
        opened.open(address)
        page = opened.page
        page.keyboard.press("b")
        page.evaluate("stereomate.motion.goTo(9000, 9000, 0.9); stereomate.touched()")
        wait(page, "!stereomate.motion.target", 60)
        wait(page, READY, 60)
        page.evaluate("stereomate.renderer.times.length = 0")
        page.evaluate(PAN, 30)
        started = time.monotonic()
        wait(page, READY, 60)
        complete = time.monotonic() - started
        median, count, again = page.evaluate(
            "(r => [r.medianMs, r.times.length, r.cache.uploadedTwice])(stereomate.renderer)"
        )
        print(f"{count} frames, median {median:.2f} ms, tiles complete {complete:.2f} s after the last one")
        assert count > 20
        assert median < 4.0
        assert again == 0
        # nothing is asked for twice either
        tiles = [name for name in files.asked if _TILE.fullmatch(name)]
        assert len(tiles) == len(set(tiles))
        assert opened.errors == []
        context.close()


def test_shaders_know_no_power(site):
    """Brightness and gamma are looked up in a table: no power, logarithm or exponential per pixel."""
    text = site.read("view/shaders.js").decode()
    fragments = re.findall(r"_FRAGMENT = `(.*?)`", text, re.DOTALL)
    assert len(fragments) == 4
    assert not any(re.search(r"\b(pow|exp2?|log2?)\s*\(", fragment) for fragment in fragments)
