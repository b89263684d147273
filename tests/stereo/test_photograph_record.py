"""What stereo.json keeps of a photograph."""

import json
from dataclasses import replace

import numpy as np
import pytest

from stereomate.camera.distortion import EbnerDeformation
from stereomate.camera.model import Camera
from stereomate.coverage.survey import Photograph
from stereomate.errors import FormatError
from stereomate.formats.lens import lens_of
from stereomate.frames.orientation import ExteriorOrientation
from stereomate.stereo.record import (
    camera_from_record,
    camera_record,
    photograph_from_record,
    photograph_record,
)


@pytest.mark.parametrize("time", [None, 1554980828.25])
def test_time_of_exposure_is_kept_where_it_is_known(tmp_path, time):
    camera = Camera.from_pixel_pitch("c", (60, 40), 50.0, 0.1)
    orientation = ExteriorOrientation((1.0, 2.0, 3.0), np.eye(3))
    photograph = replace(Photograph("a", tmp_path / "a.tif", camera, orientation), time=time)
    record = photograph_record(photograph, tmp_path)
    assert ("time_s" in record) == (time is not None)
    again = photograph_from_record(record, {"c": camera}, tmp_path)
    assert again.time == time
    assert (again.name, again.path, again.orientation.centre) == ("a", tmp_path / "a.tif", (1.0, 2.0, 3.0))


def test_film_is_kept_with_its_frame_its_scan_and_its_deformation():
    film = replace(
        Camera.from_pixel_pitch("f", (60, 40), 50.0, 0.1),
        format_mm=(5.0, 3.5),
        projective_per_mm=(1e-5, -2e-5),
        deformation=EbnerDeformation(2.0, b3=0.01, b12=-0.02),
    )
    record = json.loads(json.dumps(camera_record(film)))
    assert camera_from_record(record) == film
    with pytest.raises(FormatError, match=r"deformation\.model"):
        camera_from_record(record | {"deformation": {"model": "gruen", "spacing_mm": 2.0}})
    # Other programs know neither.
    with pytest.raises(FormatError, match="Ebner"):
        lens_of(film)
    with pytest.raises(FormatError, match="cannot hold"):
        lens_of(replace(film, deformation=None))
