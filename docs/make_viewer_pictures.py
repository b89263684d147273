"""Make the pictures of the viewer's page from a demo: ``python docs/make_viewer_pictures.py DEMO_FOLDER``.

Needs Chromium and the development requirements, and `stereomate heights` run on the demo's products.
"""

from __future__ import annotations

import io
import shutil
import socket
import sys
import threading
import time
from pathlib import Path

import uvicorn
from PIL import Image, ImageDraw, ImageFont
from playwright.sync_api import Browser, Page, sync_playwright

from stereomate.stereo.product import read_products
from stereomate.viewer.server import application
from stereomate.viewer.site import Site, SiteOptions

PICTURES = Path(__file__).parent / "pictures"
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
MODES = (
    "half-colour", "colour", "grey", "dubois", "parallel", "crossed", "interlaced", "wiggle", "left", "right",
    "difference",
)  # fmt: skip
VIEW = "Object.assign(stereomate.view, {cx: 1290, cy: 1080, zoom: 0.8}); stereomate.touched()"


def main(folder: Path) -> None:
    """Take all pictures."""
    options = SiteOptions(title="Synthetic block", points=folder / "points.csv")
    site = Site(read_products(folder / "products" / "stereo.json"), options)
    listener = socket.socket()
    listener.bind(("127.0.0.1", 0))
    server = uvicorn.Server(uvicorn.Config(application(site), log_level="error", lifespan="off"))
    thread = threading.Thread(target=lambda: server.run(sockets=[listener]))
    thread.start()
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
            page = browser.new_page(viewport={"width": 1000, "height": 650})
            address = f"http://127.0.0.1:{listener.getsockname()[1]}/"
            page.goto(address)
            settle(page)
            modes(page)
            measuring(page)
            layers(page)
            sheet(page)
            phone(browser, address)
            browser.close()
    finally:
        server.should_exit = True
        thread.join()


def settle(page: Page) -> None:
    """Until everything that is wanted is shown."""
    time.sleep(0.6)
    while not page.evaluate(
        "Boolean(window.stereomate?.renderer.relief && !stereomate.renderer.cache.isBusy && !stereomate.dirty"
        " && stereomate.measurements.isSettled)"
    ):
        time.sleep(0.1)
    time.sleep(0.6)


def save(page: Page, name: str) -> None:
    """The page as a picture."""
    Image.open(io.BytesIO(page.screenshot())).convert("RGB").save(PICTURES / name, quality=82)


def modes(page: Page) -> None:
    """One sheet of all viewing modes."""
    width, height, across = 440, 300, 3
    rows = -(-len(MODES) // across)
    sheet = Image.new("RGB", (across * width, rows * height))
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(16)
    page.evaluate(VIEW.replace("0.8", "1.2"))
    for k, mode in enumerate(MODES):
        page.evaluate(f"stereomate.setMode('{mode}')")
        settle(page)
        shot = page.screenshot(clip={"x": 0, "y": 120, "width": width * 1.4, "height": height * 1.4})
        place = (k % across * width, k // across * height)
        sheet.paste(Image.open(io.BytesIO(shot)).convert("RGB").resize((width - 4, height - 4)), place)
        title = page.evaluate("document.getElementById('mode').selectedOptions[0].textContent")
        draw.text((place[0] + 8, place[1] + 6), title, "white", font, stroke_width=2, stroke_fill="black")
    sheet.save(PICTURES / "viewer_modes.jpg", quality=80)


def measuring(page: Page) -> None:
    """A line, an area, a point and an object height."""
    page.evaluate(f"stereomate.setMode('half-colour'); {VIEW}")
    settle(page)
    for key, places in (
        ("l", [(150, 200), (260, 330), (420, 300)]),
        ("a", [(330, 420), (480, 410), (500, 520), (340, 540)]),
        ("p", [(560, 200)]),
    ):
        page.keyboard.press(key)
        for x, y in places:
            page.mouse.click(x, y)
            page.wait_for_timeout(150)
        page.keyboard.press("Escape")
    page.keyboard.press("h")
    page.mouse.click(210, 470)
    page.wait_for_timeout(200)
    page.mouse.move(214, 462)
    for _ in range(10):
        page.mouse.wheel(0, -100)
    page.wait_for_timeout(300)
    page.keyboard.press("Enter")
    page.mouse.move(300, 380)
    settle(page)
    page.evaluate("stereomate.measurements.selected = 1; stereomate.panel.table.draw()")
    save(page, "viewer_measuring.jpg")


def layers(page: Page) -> None:
    """Homogeneity, contours, projection centres and points over the whole block."""
    page.evaluate(
        "stereomate.measurements.clear(); stereomate.fit(); stereomate.setMode('left');"
        "(async () => { for (const id of ['homogeneity', 'contours', 'photographs', 'points'])"
        " await stereomate.layers.toggle(id, true) })()"
    )
    time.sleep(2)
    settle(page)
    save(page, "viewer_layers.jpg")
    if page.evaluate("stereomate.product.objects"):
        page.evaluate(
            "async () => { for (const id of ['homogeneity', 'contours', 'photographs', 'points'])"
            " await stereomate.layers.toggle(id, false);"
            f" await stereomate.layers.toggle('objects', true); stereomate.setMode('half-colour'); {VIEW} }}"
        )
        page.mouse.move(340, 300)
        settle(page)
        save(page, "viewer_objects.jpg")


def phone(browser: Browser, address: str) -> None:
    """A narrow touch screen."""
    context = browser.new_context(viewport={"width": 390, "height": 760}, has_touch=True, is_mobile=True)
    page = context.new_page()
    page.goto(address)
    settle(page)
    page.evaluate(VIEW)
    page.touchscreen.tap(190, 330)
    settle(page)
    page.click("#panel-toggle")
    settle(page)
    save(page, "viewer_phone.jpg")
    context.close()


def sheet(page: Page) -> None:
    """The sheet for print."""
    page.evaluate(
        "window.print = () => {}; stereomate.setMode('half-colour'); stereomate.mark.left = null;"
        "(async () => { for (const id of ['homogeneity', 'contours', 'photographs', 'points'])"
        f" await stereomate.layers.toggle(id, false) }})(); {VIEW}"
    )
    time.sleep(1)
    settle(page)
    page.click("#print")
    page.emulate_media(media="print")
    # what an A4 sheet holds between its margins
    page.set_viewport_size({"width": 1047, "height": 718})
    save(page, "viewer_sheet.jpg")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
