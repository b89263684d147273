"""Makes the pictures of the page on seamless blocks: ``python docs/make_mosaic_pictures.py FOLDER``.

FOLDER gets a synthetic block of 4 strips of 8 photographs, if it is not there yet.
"""

from __future__ import annotations

import io
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stereomate.project import load
from stereomate.project.run import RunOptions, plan
from stereomate.raster import Window
from stereomate.rectify.engine import orthophoto_part
from stereomate.rectify.mosaic import plan_mosaics
from stereomate.report.seams import seams_figure
from stereomate.synthetic.files import write_survey
from stereomate.synthetic.options import SurveyOptions
from stereomate.synthetic.survey import make_survey

PICTURES = Path(__file__).parent / "pictures"
BLOCK = SurveyOptions(
    seed=5, strips=4, photos_per_strip=8, size_px=(280, 210), gsd_m=0.5, flying_height_m=210.0,
    pixel_pitch_mm=0.1, relief_m=30.0, terrain_step_m=3.0, buildings=24, trees=120, control_points=0,
    check_points=0, forward_overlap=0.65, side_overlap=0.35, exposure_sigma=0.06, colour_sigma=0.03,
    gradient_sigma=0.04, vignetting=0.25,
)  # fmt: skip


def main(folder: Path) -> None:
    """Write both pictures."""
    if not (folder / "project.toml").is_file():
        write_survey(make_survey(BLOCK), folder)
    (plain,) = plan(load(folder / "project.toml"), RunOptions())[1]
    ((made, _),) = plan_mosaics([plain])
    whole = Window(0, 0, *plain.grid.size)
    before, after = (_picture(orthophoto_part(job, whole, "left")) for job in (plain, made))
    drawn = io.BytesIO()
    seams_figure(made, after).savefig(drawn, format="png", dpi=95, bbox_inches="tight")
    figure = cv2.imdecode(np.frombuffer(drawn.getvalue(), np.uint8), cv2.IMREAD_COLOR_RGB)
    _jpeg("mosaic_seams.jpg", figure, 84)
    pair = np.vstack([before, np.full((8, before.shape[1], 3), 255, np.uint8), after])
    _jpeg("mosaic_balance.jpg", cv2.resize(pair, None, fx=0.8, fy=0.8, interpolation=cv2.INTER_AREA), 74)


def _jpeg(name: str, pixels: Any, quality: int) -> None:
    done, data = cv2.imencode(
        ".jpg", np.ascontiguousarray(pixels[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, quality]
    )
    if not done:
        raise SystemExit("the picture cannot be encoded")
    (PICTURES / name).write_bytes(data.tobytes())


def _picture(part: Any) -> NDArray[np.uint8]:
    pixels: NDArray[np.uint8] = part.pixels.copy()
    pixels[part.valid == 0] = 235
    return pixels


if __name__ == "__main__":
    main(Path(sys.argv[1]))
