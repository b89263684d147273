"""Every viewing mode shows the right pixels of both eyes: patterns that say their pixel, one to one."""

from __future__ import annotations

import io

import numpy as np
import pytest
from browsing import Opened, serving
from patterns import PatternSite, pattern
from PIL import Image

GREY = np.array([0.299, 0.587, 0.114])
DUBOIS = (
    np.array([[0.456, 0.500, 0.176], [-0.040, -0.038, -0.016], [-0.015, -0.021, -0.005]]),
    np.array([[-0.043, -0.088, -0.002], [0.378, 0.734, -0.018], [-0.072, -0.113, 1.226]]),
)
# Right pictures are shifted by whole pixels, so that the pattern stays on the pixels of the screen.
SHIFT = 7


@pytest.fixture(scope="module")
def shown(browser, site):
    with serving(PatternSite(site)) as address:
        context = browser.new_context(viewport={"width": 800, "height": 600})
        opened = Opened(context.new_page())
        opened.open(address)
        yield opened
        context.close()


def canvas(opened, mode, **view):
    """Pixels of the picture at one product pixel per screen pixel; the product pixel of its first one."""
    page = opened.page
    settings = {
        "accommodate": False,
        "accommodation": SHIFT,
        "exaggeration": 1,
        "offset": 0,
        "swap": False,
        **view,
    }
    page.evaluate(
        """([mode, settings]) => {
          const a = stereomate, [cols, rows] = a.product.grid.size;
          Object.assign(a.view, settings, { mode, zoom: 1 });
          const [w, h] = a.renderer.viewSize(mode);
          a.view.cx = Math.round(cols / 2) + (w % 2) / 2; a.view.cy = Math.round(rows / 2) + (h % 2) / 2;
          a.mark.left = null; a.motion.target = null; a.touched();
        }""",
        [mode, settings],
    )
    opened.settle()
    page.evaluate("for (const one of document.querySelectorAll('#stage > :not(#view)')) one.hidden = true")
    data = page.locator("#view").screenshot()
    pixels = np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)
    width, height = page.evaluate("stereomate.renderer.viewSize(stereomate.view.mode)")
    cx, cy = page.evaluate("[stereomate.view.cx, stereomate.view.cy]")
    assert pixels.shape[0] == height
    return pixels, (int(cx - width / 2), int(cy - height / 2)), width


def eyes(first, width, height, size):
    """What both eyes show: (rows, cols, 3) each, black outside."""
    col, row = np.meshgrid(np.arange(width) + first[0], np.arange(height) + first[1])
    out = []
    for eye, shift in (("ortho", 0), ("mate", SHIFT)):
        inside = (col - shift >= 0) & (col - shift < size[0]) & (row >= 0) & (row < size[1])
        values = pattern(eye, np.where(inside, col - shift, 0), np.where(inside, row, 0)).astype(int)
        out.append(values * inside[..., None])
    return out


def mixed(mode, left, right):
    if mode == "difference":
        return np.abs(left - right)
    if mode == "interlaced":
        out = left.copy()
        out[1::2] = right[1::2]
        return out
    if mode == "dubois":
        return np.clip(left @ DUBOIS[0].T + right @ DUBOIS[1].T, 0, 255)
    out = right.astype(float)
    out[..., 0] = left[..., 0] if mode == "colour" else left @ GREY
    if mode == "grey":
        out[..., 1] = out[..., 2] = right @ GREY
    return out


def size_of(opened):
    return opened.page.evaluate("stereomate.product.grid.size")


@pytest.mark.parametrize("mode", ["half-colour", "colour", "grey", "dubois", "interlaced", "difference"])
def test_mixed_modes(shown, mode):
    pixels, first, _ = canvas(shown, mode)
    left, right = eyes(first, pixels.shape[1], pixels.shape[0], size_of(shown))
    assert left.any()
    assert right.any()
    # rounding of both eyes to bytes, and of the mixture
    np.testing.assert_allclose(pixels, mixed(mode, left, right), atol=2.01)


def test_swapped_eyes(shown):
    pixels, first, _ = canvas(shown, "half-colour", swap=True)
    left, right = eyes(first, pixels.shape[1], pixels.shape[0], size_of(shown))
    np.testing.assert_allclose(pixels, mixed("half-colour", right, left), atol=2.01)


@pytest.mark.parametrize("mode", ["left", "right"])
def test_one_eye(shown, mode):
    pixels, first, _ = canvas(shown, mode)
    both = eyes(first, pixels.shape[1], pixels.shape[0], size_of(shown))
    np.testing.assert_allclose(pixels, both[mode == "right"], atol=1)


def test_side_by_side(shown):
    for mode in ("parallel", "crossed"):
        pixels, first, width = canvas(shown, mode)
        both = eyes(first, width, pixels.shape[0], size_of(shown))
        halves = pixels[:, :width], pixels[:, -width:]
        for half, eye in zip(halves, both if mode == "parallel" else both[::-1], strict=True):
            np.testing.assert_allclose(half, eye, atol=1)


def test_wiggle_shows_both_eyes_by_turns(shown):
    seen = set()
    _, first, _ = canvas(shown, "wiggle")
    for look in range(40):
        pixels = np.asarray(
            Image.open(io.BytesIO(shown.page.locator("#view").screenshot())).convert("RGB")
        ).astype(int)
        both = eyes(first, pixels.shape[1], pixels.shape[0], size_of(shown))
        seen |= {k for k, eye in enumerate(both) if np.abs(pixels - eye).max() <= 1}
        if seen == {0, 1}:
            return
        # never in step with the eyes, however long a picture takes
        shown.page.wait_for_timeout(40 + 67 * look % 210)
    pytest.fail(f"seen: {seen}")


def test_brightness_contrast_and_gamma_of_one_eye(shown):
    changed = {"brightness": 0.1, "contrast": 1.5, "gamma": 1.8}
    pixels, first, _ = canvas(shown, "colour", eyes=[changed, {"brightness": 0, "contrast": 1, "gamma": 1}])
    left, right = eyes(first, pixels.shape[1], pixels.shape[0], size_of(shown))
    inside = left.any(axis=-1)
    bright = 255.0 * np.clip((left / 255.0 - 0.5) * 1.5 + 0.6, 0.0, 1.0) ** (1.0 / 1.8)
    np.testing.assert_allclose(pixels[inside][:, 0], bright[inside][:, 0], atol=1.01)
    np.testing.assert_allclose(pixels[..., 1:], right[..., 1:], atol=1)


def test_parallax_offset_moves_only_the_right_eye(shown):
    pixels, first, _ = canvas(
        shown,
        "colour",
        offset=4,
        accommodation=SHIFT + 4,
        eyes=[{"brightness": 0, "contrast": 1, "gamma": 1}] * 2,
    )
    left, right = eyes(first, pixels.shape[1], pixels.shape[0], size_of(shown))
    np.testing.assert_allclose(pixels, mixed("colour", left, right), atol=1)
