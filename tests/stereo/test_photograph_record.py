"""What stereo.json keeps of a photograph."""

from dataclasses import replace

import numpy as np
import pytest

from stereomate.camera.model import Camera
from stereomate.coverage.survey import Photograph
from stereomate.frames.orientation import ExteriorOrientation
from stereomate.stereo.record import photograph_from_record, photograph_record


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
