"""The balanced mosaic end to end for photographs of 16 bits and of floats: as of 8 bits, in their units."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio

from stereomate.project import load
from stereomate.project.run import RunOptions, run
from stereomate.synthetic.files import write_survey
from stereomate.synthetic.options import SurveyOptions
from stereomate.synthetic.survey import make_survey

pytestmark = pytest.mark.slow

OPTIONS = SurveyOptions(
    seed=3, strips=1, photos_per_strip=3, size_px=(220, 170), gsd_m=0.6, flying_height_m=210.0,
    pixel_pitch_mm=0.1, relief_m=20.0, terrain_step_m=6.0, buildings=3, trees=6, control_points=0,
    check_points=0, exposure_sigma=0.05, colour_sigma=0.02, gradient_sigma=0.03, vignetting=0.2,
)  # fmt: skip
# What one digital number of 8 bits is in the other types.
UNITS = {"uint16": 200.0, "float32": 1.0 / 255.0}


@pytest.fixture(scope="module")
def eight_bits(tmp_path_factory):
    files = write_survey(make_survey(OPTIONS), tmp_path_factory.mktemp("types"))
    return files, products(files.project)


def products(project):
    out = project.parent / f"out_{project.stem}"
    run(load(project), out, RunOptions(agreement=False))
    found = []
    for name in ("ortho.tif", "mate.tif"):
        with rasterio.open(out / name) as file:
            found.append((file.read().astype(float), file.read_masks(1) > 0, file.dtypes[0]))
    return found


@pytest.mark.parametrize("kind", UNITS)
def test_other_types_give_what_eight_bits_give(eight_bits, kind):
    files, expected = eight_bits
    for path in files.folder.glob("strip*.tif"):
        with rasterio.open(path) as file:
            pixels, profile = file.read(), file.profile
        (files.folder / kind).mkdir(exist_ok=True)
        profile.update(dtype=kind, driver="GTiff", photometric="rgb")
        profile.pop("compress", None)
        with rasterio.open(files.folder / kind / path.name, "w", **profile) as file:
            file.write((pixels * UNITS[kind]).astype(kind))
    text = files.project.read_text().replace("strip*", f"{kind}/strip*")
    assert kind in text
    project = files.folder / f"{kind}.toml"
    project.write_text(text)
    for (pixels, valid, dtype), (wanted, there, _) in zip(products(project), expected, strict=True):
        assert dtype == kind
        both = valid & there
        assert both.mean() > 0.3
        assert (valid != there).mean() < 1e-3
        difference = np.abs(pixels / UNITS[kind] - wanted)[:, both]
        # 8 bits are rounded three times, and seams may run elsewhere in a few places
        assert np.median(difference) < 0.5
        assert np.percentile(difference, 95) < 2.0
