"""A pair of a project on the instrument: its points, how it is laid in, the given orientation there."""

from __future__ import annotations

import json

import numpy as np
import pytest

from stereomate.cli import main
from stereomate.errors import InputError, NotDeterminedError
from stereomate.project import load
from stereomate.project import measured_pair as module
from stereomate.project.measured_pair import measured_pair
from stereomate.project.orientation_sections import ProjectSectionOptions
from stereomate.relative.empirical.projectors import model_points, y_parallaxes

OPTIONS = ProjectSectionOptions(texture_radius_px=2, profiles=4)


@pytest.fixture
def exact_matches(monkeypatch):
    """Matches computed from the given orientation instead of measured."""

    def match(left, right, points):
        return tuple(
            photo.camera.image_from_camera(photo.orientation.camera_from_tangent(points))[0]
            for photo in (left, right)
        )

    monkeypatch.setattr(module, "_match", match)


@pytest.mark.parametrize("names", [("photo_1", "photo_2"), ("photo_2", "photo_1")])
def test_given_orientation_has_no_parallax_on_the_instrument(small, exact_matches, names):
    pair = measured_pair(load(small.path), names, OPTIONS)
    assert pair.names == names
    assert pair.failed == ()
    assert pair.start.base == pytest.approx(24.0, rel=1e-3)
    np.testing.assert_allclose(y_parallaxes(pair.model, pair.given), 0.0, atol=1e-7)
    assert abs(pair.given.right.kappa) < np.radians(1.5)  # laid in by whole degrees
    places = dict(zip(pair.model.names, model_points(pair.model, pair.given), strict=True))
    base = pair.given.base
    for near, far in (("1", "2"), ("3", "4"), ("5", "6")):
        assert places[near][0] < places[far][0]
    assert places["3"][1] < places["1"][1] < places["5"][1]
    assert places["4"][1] < places["2"][1] < places["6"][1]
    # 300 m above rising ground.
    assert -330 < places["1"][2] * 24.0 / base < -280
    assert pair.profiles[0] == ("1", "3", "5")
    assert pair.profiles[-1] == ("2", "4", "6")
    assert len(pair.profiles) == len(pair.model.names) / 3


def test_pair_that_is_none(small, exact_matches):
    with pytest.raises(InputError, match="photo_9"):
        measured_pair(load(small.path), ("photo_1", "photo_9"), OPTIONS)


def test_noise_cannot_be_matched(small):
    # The photographs of this project are random numbers.
    with pytest.raises(NotDeterminedError, match="photo_1"):
        measured_pair(load(small.path), ("photo_1", "photo_2"), OPTIONS)


def test_matches_far_from_the_points_do_not_count(small, monkeypatch):
    def match(left, right, points):
        found = np.tile([[10.0, 10.0]], (len(points), 1))
        return found, np.full_like(found, np.nan)

    monkeypatch.setattr(module, "_match", match)
    with pytest.raises(NotDeterminedError, match="no match at point 1, 3, 5, 2, 4, 6"):
        measured_pair(load(small.path), ("photo_1", "photo_2"), OPTIONS)


@pytest.mark.real
def test_real_pair_by_hand(data_folder, tmp_path, capsys):
    """The two DMC frames: four points cleared and the tilt over-corrected come near the given orientation."""
    from test_orientation_sections import NGI

    (tmp_path / "project.toml").write_text(NGI.format(folder=data_folder / "ngi_strip05"))
    names = ("3324c_2015_1004_05_0182_RGB", "3324c_2015_1004_05_0184_RGB")
    arguments = ["empirical", str(tmp_path / "project.toml"), "--pair", *names, "--json"]
    errors = {}
    given = measured_pair(load(tmp_path / "project.toml"), names).given.right
    for name, extra in (("one", []), ("mean", ["--profiles", "1"])):
        with pytest.raises(SystemExit) as end:
            main.run([*arguments, *extra])
        assert end.value.code == 0
        value = json.loads(capsys.readouterr().out)
        assert value["outcome"] == "cleared"
        found = value["settings"][-1]["right"]
        errors[name] = {
            key: np.degrees(found[key] - getattr(given, key)) for key in ("omega", "phi", "kappa")
        }
        rms = float(np.sqrt(np.mean(np.square(value["parallaxes_m"][-1]))))
        assert rms < 1.5  # a quarter of a pixel: one is 6 m on the ground
    # A parallax known to 0.2 px has, by (4), 0.02° in ω of a single section; the mean of nine a third of it.
    assert abs(errors["one"]["omega"]) < 0.06
    assert abs(errors["mean"]["omega"]) < 0.03
    assert abs(errors["one"]["phi"]) < 0.2
    assert abs(errors["one"]["kappa"]) < 0.08
