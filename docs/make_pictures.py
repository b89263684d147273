"""Makes the pictures of the tutorial: ``make pictures``, or ``python docs/make_pictures.py DEMO``.

Everything shown is made by stereomate: the synthetic survey, its products, and the figures of the report.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stereomate.coverage.summary import survey_coverage
from stereomate.project import load
from stereomate.raster import open_photo
from stereomate.report.run_figures import law_figure, layout_figure
from stereomate.report.stereo_pictures import detail_anaglyph, product_pictures
from stereomate.stereo.product import StereoProduct, read_products

PICTURES = Path(__file__).parent / "pictures"
LIMIT_BYTES = 200_000


def main(demo: Path) -> None:
    """Write all pictures; a file that grows beyond 200 kB is an error."""
    out = demo / "products"
    product = read_products(out / "stereo.json")[0]
    PICTURES.mkdir(exist_ok=True)
    _photographs(demo)
    whole = product_pictures(out, product.files.ortho, product.files.mate, _middle_parallax(product), 900)
    _jpeg("anaglyph.jpg", whole["anaglyph"])
    _jpeg("ortho.jpg", whole["ortho"])
    centre = _village(demo, product)
    detail = detail_anaglyph(
        out, product.files.ortho, str(product.files.mate), centre, _parallax_at(product, centre), 560
    )
    _jpeg("anaglyph_village.jpg", detail)
    _jpeg("eyes.jpg", _both_eyes(out, product, centre))
    project = load(demo / "project.toml")
    coverage = survey_coverage(project.survey, product.job.heights)
    layout = layout_figure(project.survey, coverage, product.job.heights, [product.job])
    layout.savefig(PICTURES / "layout.png", dpi=85, bbox_inches="tight", metadata={"Software": None})
    law_figure(product.job).savefig(
        PICTURES / "law.svg", bbox_inches="tight", metadata={"Date": None, "Creator": None}
    )
    for path in sorted(PICTURES.iterdir()):
        size = path.stat().st_size
        print(f"{path.name}: {size / 1000:.0f} kB")
        if size > LIMIT_BYTES:
            raise SystemExit(f"{path}: is larger than {LIMIT_BYTES} bytes")


def _photographs(demo: Path) -> None:
    """Two photographs side by side, reduced."""
    pictures = []
    for name in ("strip1_02.tif", "strip1_03.tif"):
        with open_photo(demo / name) as reader:
            pixels = reader.read_window(0, 0, *reader.size)[0]
        pictures.append(cv2.resize(pixels, None, fx=0.28, fy=0.28, interpolation=cv2.INTER_AREA))
    _jpeg("photographs.jpg", _side_by_side(pictures))


def _both_eyes(out: Path, product: StereoProduct, centre: tuple[float, float]) -> NDArray[Any]:
    """The village in the orthophoto and in the stereomate, the ground of the middle at the same place."""
    edge = 400
    shift = round(_parallax_at(product, centre))
    col0, row0 = round(centre[0]) - edge // 2, round(centre[1]) - edge // 2
    pictures = []
    for name, moved in ((product.files.ortho, 0), (str(product.files.mate), shift)):
        with open_photo(out / name) as reader:
            pictures.append(reader.read_window(col0 - moved, row0, edge, edge)[0])
    return _side_by_side(pictures)


def _side_by_side(pictures: list[NDArray[Any]]) -> NDArray[Any]:
    gap = np.full((pictures[0].shape[0], 12, 3), 255, np.uint8)
    return np.hstack([pictures[0], gap, pictures[1]])


def _village(demo: Path, product: StereoProduct) -> tuple[float, float]:
    """Middle of the houses, as column and row of the product."""
    buildings = json.loads((demo / "truth.json").read_text())["buildings"]
    middle = np.median([corner[:2] for building in buildings for corner in building["roof_corners"]], axis=0)
    a, b, c, d, e, f = product.job.grid.affine
    col, row = np.linalg.solve([[a, b], [d, e]], middle - [c, f])
    return float(col), float(row)


def _parallax_at(product: StereoProduct, centre: tuple[float, float]) -> float:
    """Artificial parallax of the ground at a place of the orthophoto, pixels."""
    height = _height_at(product, centre)
    return float(product.job.law.q(height)) / product.job.grid.gsd


def _middle_parallax(product: StereoProduct) -> float:
    low, high = product.job.height_range
    return float(product.job.law.q(0.5 * (low + high))) / product.job.grid.gsd


def _height_at(product: StereoProduct, centre: tuple[float, float]) -> float:
    heights = product.job.heights
    a, b, c, d, e, f = product.job.grid.affine
    xy = np.array([[a * centre[0] + b * centre[1] + c, d * centre[0] + e * centre[1] + f]])
    return float(heights.heights_at(xy, "bilinear")[0])


def _jpeg(name: str, pixels: NDArray[Any]) -> None:
    options = [cv2.IMWRITE_JPEG_QUALITY, 84, cv2.IMWRITE_JPEG_OPTIMIZE, 1]
    if not cv2.imwrite(str(PICTURES / name), np.ascontiguousarray(pixels[..., ::-1]), options):
        raise SystemExit(f"{name}: cannot be written")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "demo"))
