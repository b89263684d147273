"""Makes the pictures of the tutorial on measuring: ``python docs/make_measuring_pictures.py FOLDER``.

FOLDER gets a synthetic survey and its products, if they are not there yet; the pictures are the figures that
the commands of the page write.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2

from stereomate.synthetic.files import write_survey
from stereomate.synthetic.options import SurveyOptions
from stereomate.synthetic.survey import make_survey

PICTURES = Path(__file__).parent / "pictures"
SURVEY = SurveyOptions(
    seed=7, strips=1, photos_per_strip=3, size_px=(800, 600), gsd_m=0.4, flying_height_m=500.0,
    pixel_pitch_mm=0.12, relief_m=40.0, buildings=14, trees=60, control_points=2, check_points=2,
)  # fmt: skip


def main(folder: Path) -> None:
    """Write the pictures."""
    project = folder / "project.toml"
    if not project.is_file():
        write_survey(make_survey(SURVEY), folder)
    _stereomate("laws", project, "--figure", folder / "laws.png")
    _stereomate("homogeneity", project, "--object-height", 10, "--out", folder / "maps")
    _stereomate("run", project, "--out", folder / "out")
    _stereomate("heights", folder / "out")
    _picture(folder / "laws.png", "measuring_laws.png")
    _picture(folder / "maps" / "homogeneity_10m.png", "measuring_homogeneity.png")
    _picture(folder / "out" / "surface.png", "measuring_heights.png")


def _stereomate(*words: object) -> None:
    subprocess.run([sys.executable, "-m", "stereomate", *map(str, words)], check=True)


def _picture(source: Path, name: str) -> None:
    image = cv2.imread(str(source))
    if image is None:
        raise SystemExit(f"{source}: no picture")
    scale = min(1.0, 1200 / image.shape[1])
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(PICTURES / name), small, [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
