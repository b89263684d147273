"""Interior orientation of film: published results to their digits, certificates, turned scans."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from stereomate.camera.certificate import radial_from_table
from stereomate.camera.distortion import BrownDistortion, FisheyeDistortion, OpenCVDistortion
from stereomate.camera.fiducials import (
    certificate_from_distances,
    interior_orientation,
    possible_arrangements,
)
from stereomate.camera.model import Camera
from stereomate.camera.refraction import refraction_constant, with_refraction
from stereomate.errors import InputError, NotDeterminedError
from stereomate.geometry.adjustment import AdjustmentOptions
from stereomate.geometry.transforms import PlaneTransform, algebraic_projective

# U.S. Geological Survey, Report of Calibration OSL/1785 (1992), a public document: marks and distances, mm.
USGS_MARKS = {
    "1": (-109.990, -110.002), "2": (110.010, 109.999), "3": (-109.989, 109.995), "4": (109.998, -110.002),
    "5": (-111.998, -0.004), "6": (112.004, 0.000), "7": (0.014, 111.993), "8": (0.000, -112.002),
}  # fmt: skip
USGS_DISTANCES = {
    ("1", "2"): 311.128, ("3", "4"): 311.116, ("1", "3"): 219.997, ("2", "3"): 220.000,
    ("1", "4"): 219.988, ("2", "4"): 220.001,
}  # fmt: skip
USGS_SIDES = {("5", "6"): 224.002, ("7", "8"): 223.996}
NOMINAL = {
    "1": (-110, -110), "2": (110, 110), "3": (-110, 110), "4": (110, -110),
    "5": (-112, 0), "6": (112, 0), "7": (0, 112), "8": (0, -112),
}  # fmt: skip


# Column of the affine and decimals it was printed with.
_PRINTED = ((0, 10), (1, 10), (2, 4))


def _marks(path):
    rows = [line.split() for line in path.read_text().splitlines() if line.strip()]
    return {row[0]: (float(row[1]), float(row[2])) for row in rows}


def _published(report: str, kind: str, photo: str) -> str:
    return re.search(rf"## {kind} Transformation \(dec_1_{photo}\)\n```(.*?)```", report, re.S).group(1)


def _same_digits(computed: float, printed: str) -> None:
    decimals = len(printed.split(".")[1])
    # -0.0000 and 0.0000 are the same printed number.
    assert f"{computed:.{decimals}f}".replace("-0." + "0" * decimals, "0." + "0" * decimals) == (
        printed.replace("-0." + "0" * decimals, "0." + "0" * decimals)
    ), (computed, printed)


@pytest.fixture(scope="module")
def lab1(data_folder):
    folder = data_folder / "houston_film/photo-lab1"
    marks = {p: _marks(folder / f"data/dec_1_{p}-observed.txt") for p in ("027", "028")}
    # Their rows are counted negative down: stored rows are positive.
    measured = {p: {n: (x, -y) for n, (x, y) in m.items()} for p, m in marks.items()}
    report = (folder / "report/report.md").read_text()
    return _marks(folder / "data/dec_1_027-known.txt"), measured, report


@pytest.mark.real
@pytest.mark.parametrize("photo", ["027", "028"])
@pytest.mark.parametrize("kind", ["Similarity", "Affine", "Projective"])
def test_published_fiducial_transforms_to_every_printed_digit(lab1, kind, photo):
    known, measured, report = lab1
    text = _published(report, kind, photo)
    result = interior_orientation(known, measured[photo], kind.lower())
    (a, b, tx), (c, d, ty) = (np.array(row) * [1, -1, 1] for row in result.photo_from_pixel.affine)
    printed = dict(re.findall(r"^([\w -]+?\d?) (?:\([^)]*\) )?= (-?[\d.]+)", text, re.M))
    if kind == "Projective":
        # Published is the one-step linear solution; the least squares of residuals differs by nanometres.
        names = sorted(known)
        source = np.array([measured[photo][n] for n in names]) * [1, -1]
        linear = algebraic_projective(source, np.array([known[n] for n in names]))
        for row, prefix, count in zip(linear.matrix, "abc", (3, 3, 2), strict=True):
            for i in range(count):
                _same_digits(row[i], printed[f"{prefix}{i + 1}"])
        np.testing.assert_allclose([tx, ty], np.array(linear.matrix)[:2, 2], rtol=0, atol=2e-6)
        g, h, _ = np.array(result.photo_from_pixel.matrix[2]) * [1, -1, 1]
        _same_digits(g, printed["c1"])
        _same_digits(h, printed["c2"])
    elif kind == "Affine":
        for value, name in ((a, "a"), (b, "b"), (c, "c"), (d, "d")):
            _same_digits(value, printed[name])
    else:
        for value, name in ((a, "a"), (c, "b"), (d, "a"), (-b, "b")):
            _same_digits(value, printed[name])
    scale_x, scale_y = np.hypot(a, c), np.hypot(b, d)
    rotation = np.arctan2(c, a)
    if kind == "Similarity":
        _same_digits(scale_x, printed["scale"])
    else:
        _same_digits(scale_x, printed["scale x"])
        _same_digits(scale_y, printed["scale y"])
        _same_digits(np.degrees(rotation - np.arctan2(-b, d)), printed["non-orthogonality"])
    _same_digits(np.degrees(rotation), printed["rotation"])
    if kind != "Projective":
        _same_digits(tx, printed["delta x"])
        _same_digits(ty, printed["delta y"])
    for i, name in enumerate("xy"):
        _same_digits(result.rms_mm[i], re.search(rf"RMSE {name} = ([\d.]+)", text).group(1))
    rows = re.findall(r"^ +(\d) +(-?[\d.]+) +(-?[\d.]+) +(-?[\d.]+) +(-?[\d.]+)$", text, re.M)
    assert len(rows) == 8
    for name, _, x, _, y in rows:
        residual = -result.residuals_mm[result.names.index(name)]  # theirs is computed minus observed
        _same_digits(residual[0], x)
        _same_digits(residual[1], y)
    assert (result.rotation, result.mirrored) == (0, False)


@pytest.mark.real
@pytest.mark.parametrize("photo", ["27", "28"])
def test_published_corrections_of_distortion_and_refraction(lab1, data_folder, photo):
    known, measured, _ = lab1
    inner = interior_orientation(known, measured[f"0{photo}"], "affine")
    # They went on with the affine as printed: ten decimals, four for the shift.
    printed = np.column_stack(
        [np.round(np.array(inner.photo_from_pixel.affine), d)[:, i] for i, d in _PRINTED]
    )
    affine = PlaneTransform.from_array("affine", printed).inverse().affine
    folder = data_folder / "houston_film/photo-lab3/data"
    observed, fiducial, corrected = (
        np.array(list(_marks(folder / f"image_{photo}_{kind}.txt").values()))
        for kind in ("obs", "fid", "corrected")
    )
    pixels = observed * [1, -1]
    camera = Camera(
        "houston", (20480, 20480), 153.358, (-0.006, 0.006), affine,
        BrownDistortion.from_certificate((0.8878e-4, -0.1528e-7, 0.5256e-12, 0.0), (0.1346e-6, 0.1224e-7)),
    )  # fmt: skip
    # Printed to 1e-5 mm.
    np.testing.assert_allclose(camera.photo_from_image(pixels), fiducial, rtol=0, atol=5.1e-6)
    constant = refraction_constant(1860.0, 1100.0)
    # and with the fiducial coordinates as printed.
    pixels = camera.image_from_photo(fiducial)
    rays = with_refraction(camera, constant).rays_from_image(pixels)
    np.testing.assert_allclose(rays[:, :2] * 153.358, corrected, rtol=0, atol=5.1e-6)
    # Without it, it would show.
    assert np.abs(camera.rays_from_image(pixels)[:, :2] * 153.358 - corrected).max() > 1e-3


def _align(points, target):
    a, b = points - points.mean(axis=0), target - target.mean(axis=0)
    u, _, vt = np.linalg.svd(b.T @ a)
    return a @ (u @ vt).T + target.mean(axis=0)


def test_certificate_of_distances_only_gives_the_certified_coordinates():
    # Not a synthetic case: the report states both, accurate to 0.005 mm.
    corners = certificate_from_distances({n: NOMINAL[n] for n in "1234"}, USGS_DISTANCES)
    assert corners.redundancy == 1
    assert corners.assumed == 0
    assert max(abs(v) for v in corners.residuals_mm.values()) < 0.005
    ours = np.array([corners.certificate_mm[n] for n in "1234"])
    certified = np.array([USGS_MARKS[n] for n in "1234"])
    np.testing.assert_allclose(_align(ours, certified), certified, rtol=0, atol=0.004)
    # placed on the nominal layout: same centroid, no turn
    np.testing.assert_allclose(ours.mean(axis=0), 0.0, atol=1e-12)
    nominal = np.array([NOMINAL[n] for n in "1234"], float)
    assert np.sum(nominal[:, 0] * ours[:, 1] - nominal[:, 1] * ours[:, 0]) == pytest.approx(0.0, abs=1e-9)


def test_two_distances_only_keep_the_right_angle_and_say_so():
    sides = certificate_from_distances({n: NOMINAL[n] for n in "5678"}, USGS_SIDES)
    assert sides.assumed == 3
    assert sides.redundancy == 0
    marks = {n: np.array(p) for n, p in sides.certificate_mm.items()}
    assert np.linalg.norm(marks["5"] - marks["6"]) == pytest.approx(224.002, abs=1e-9)
    assert np.linalg.norm(marks["7"] - marks["8"]) == pytest.approx(223.996, abs=1e-9)
    assert (marks["5"] - marks["6"]) @ (marks["7"] - marks["8"]) == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(marks["5"] + marks["6"], marks["7"] + marks["8"], atol=1e-9)


def test_wrong_distances_are_refused():
    layout = {n: NOMINAL[n] for n in "1234"}
    with pytest.raises(InputError, match="1-9"):
        certificate_from_distances(layout, {("1", "9"): 3.0})
    with pytest.raises(InputError, match="positive"):
        certificate_from_distances(layout, {("1", "2"): -3.0})
    with pytest.raises(InputError, match=r"distance each, got '3, 4'"):
        certificate_from_distances(layout, {("1", "2"): 311.0})


def _scan(rotation: int, mirrored: bool, noise: float = 0.0):
    """Pixels of the marks in a scan of 12 µm that is turned, mirrored, and skew by 0.3°."""
    camera = Camera.from_pixel_pitch("s", (19500, 19500), 152.3, 0.012, (0, 0), None, rotation, mirrored)
    skew = np.radians(0.3)
    turn = np.array([[np.cos(skew), -np.sin(skew)], [np.sin(skew), np.cos(skew)]])
    rng = np.random.default_rng(4)
    return {
        n: tuple(camera.image_from_photo(turn @ np.array(p)) + rng.normal(0, noise, 2) if noise else
                 camera.image_from_photo(turn @ np.array(p)))
        for n, p in USGS_MARKS.items()
    }  # fmt: skip


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("rotation", [0, 90, 180, 270])
@pytest.mark.parametrize("kind", ["similarity", "affine", "projective"])
def test_turned_and_mirrored_scans_are_found(kind, rotation, mirrored):
    result = interior_orientation(USGS_MARKS, _scan(rotation, mirrored), kind)
    assert (result.rotation, result.mirrored) == (rotation, mirrored)
    assert np.abs(result.residuals_mm).max() < 1e-9
    assert result.pitch_mm == pytest.approx(0.012, rel=1e-5)
    camera = Camera("film", (19500, 19500), 152.3, (0.0, 0.0), result.pixel_from_photo)
    camera = replace(camera, projective_per_mm=result.projective_per_mm)
    for name, pixel in _scan(rotation, mirrored).items():
        np.testing.assert_allclose(camera.photo_from_image(pixel), USGS_MARKS[name], atol=1e-9)
        np.testing.assert_allclose(camera.image_from_photo(USGS_MARKS[name]), pixel, atol=1e-6)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("rotation", [0, 90, 180, 270])
def test_picture_of_a_scan_is_what_the_frame_leaves(rotation, mirrored):
    found = interior_orientation(USGS_MARKS, _scan(rotation, mirrored), "affine")
    film = Camera("film", (19500, 19500), 152.3, (0.0, 0.0), found.pixel_from_photo, format_mm=(200.0, 180.0))
    first, last = film.picture_px([[0.0, 0.0], [1.0, 1.0]])
    assert (first < last).all()
    assert (first > 0.0).all()
    np.testing.assert_allclose(np.abs(film.photo_from_image([first, last])), [[100.0, 90.0]] * 2, atol=1e-9)
    inner = film.picture_px([[0.001, 0.5], [0.5, 0.999]])
    outer = film.picture_px([[-0.001, 0.5], [0.5, 1.001]])
    for pixels, seen in ((inner, True), (outer, False)):
        assert (film.in_picture(pixels) == seen).all()
        assert (film.image_from_camera(film.rays_from_image(pixels))[1] == seen).all()
    assert not film.in_picture(inner, margin_px=20.0).any()
    # A scan that cuts the picture off shows as much of it as it has pixels.
    cut = replace(film, size_px=(10000, 9000))
    assert (cut.picture_px([1.0, 1.0]) == (10000, 9000)).all()


def test_statistics_of_the_marks():
    noise = 0.4  # px of 12 µm: 4.8 µm
    result = interior_orientation(USGS_MARKS, _scan(0, False, noise), "affine", sigma_mm=0.0048)
    assert result.summary.redundancy == 10
    assert 0.5 < result.summary.sigma0 < 1.6
    np.testing.assert_allclose(np.square(result.rms_mm).sum() * 8, np.sum(result.residuals_mm**2))
    bad = _scan(0, False, noise)
    bad["7"] = (bad["7"][0] + 30.0, bad["7"][1])
    found = interior_orientation(USGS_MARKS, bad, "affine", 0.0048, AdjustmentOptions(loss="huber"))
    worst = np.nanargmax(np.abs(found.summary.standardized_residuals))
    assert found.names[worst // 2] == "7"


def test_a_mark_that_is_not_in_the_certificate_is_named():
    with pytest.raises(InputError, match="'X'"):
        interior_orientation(USGS_MARKS, {"1": (0.0, 0.0), "X": (1.0, 1.0)})
    with pytest.raises(NotDeterminedError, match="3 points"):
        interior_orientation(USGS_MARKS, {"1": (0.0, 0.0), "2": (1.0, 1.0)})


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("rotation", [0, 90, 180, 270])
def test_arrangements_of_unnamed_points_contain_the_true_one(rotation, mirrored):
    scan = _scan(rotation, mirrored)
    points = [scan[n] for n in "42715863"]
    found = possible_arrangements(USGS_MARKS, points)
    assert len(found) == 8  # the frame is symmetric to some hundredths of a millimetre
    best = found[0]
    assert (best.rotation, best.mirrored) == (rotation, mirrored)
    assert best.marks == tuple("42715863")
    assert best.rms_mm < 1e-6 < 0.003 < found[1].rms_mm


def test_an_asymmetric_set_of_marks_has_few_arrangements():
    scan = _scan(90, False)
    found = possible_arrangements({n: USGS_MARKS[n] for n in "12357"}, [scan[n] for n in "12357"])
    assert (found[0].rotation, found[0].mirrored) == (90, False)
    assert len(found) < 8
    with pytest.raises(NotDeterminedError):
        possible_arrangements(USGS_MARKS, [(0.0, 0.0), (1.0, 1.0)])


def test_distortion_table_of_the_certificate():
    # The same report: field angles in degrees, mean radial distortion in micrometres, c = 152.299 mm.
    angles = np.radians([7.5, 15, 22.7, 30, 35, 40])
    microns = np.array([3.0, 4.0, 1.0, -3.0, -4.0, 3.0])
    table = radial_from_table(microns / 1000, field_angles=angles, principal_distance_mm=152.299)
    assert np.abs(table.residuals_mm).max() < 0.0012  # the table is rounded to 1 µm
    radii = 152.299 * np.tan(angles) + microns / 1000
    camera = Camera.from_pixel_pitch(
        "lmk", (23000, 23000), 152.299, 0.01, (0.0, 0.0), table.distortion((0.006, -0.010))
    )
    # A measured point at the tabulated radius is that far outside of where its ray says.
    measured = np.array([0.006, -0.010]) + radii[:, None] * [0.6, 0.8]
    rays = camera.rays_from_image(camera.image_from_photo(measured))[:, :2] * 152.299 - [0.006, -0.010]
    np.testing.assert_allclose(radii - np.linalg.norm(rays, axis=1), microns / 1000, rtol=0, atol=0.0012)


def test_distortion_table_gives_known_coefficients_back():
    radii = np.linspace(5, 150, 12)
    truth = (8e-5, -1.5e-8, 5e-13, 2e-18)
    values = sum(k * radii ** (2 * i + 1) for i, k in enumerate(truth))
    table = radial_from_table(values, radii_mm=radii)
    np.testing.assert_allclose(table.coefficients, truth, rtol=1e-7)
    with pytest.raises(InputError, match="either"):
        radial_from_table(values)
    with pytest.raises(InputError, match="principal_distance"):
        radial_from_table(values, field_angles=radii / 200)
    with pytest.raises(InputError, match="terms"):
        radial_from_table(values, radii_mm=radii, terms=6)
    with pytest.raises(NotDeterminedError):
        radial_from_table(values[:3], radii_mm=radii[:3])


@pytest.mark.parametrize("convention", ["opencv", "agisoft", "usgs", "australis"])
@pytest.mark.parametrize("direction", ["ideal_to_measured", "measured_to_ideal"])
@pytest.mark.parametrize("units", ["normalised", "mm"])
def test_refraction_moves_images_outwards_whatever_the_convention(convention, direction, units):
    constant = refraction_constant(6000.0, 500.0)
    assert 5e-5 < constant < 8e-5
    model = BrownDistortion(convention=convention, direction=direction, units=units)
    plain = Camera.from_pixel_pitch("p", (23000, 23000), 152.0, 0.01, (0.1, 0.2), model)
    bent = with_refraction(plain, constant)
    points = np.random.default_rng(2).uniform(-0.7, 0.7, (20, 3)) * [1, 1, 0] - [0, 0, 1]
    before, after = (c.photo_from_image(c.image_from_camera(points)[0]) - [0.1, 0.2] for c in (plain, bent))
    r = np.linalg.norm(before, axis=1)
    expected = constant * (r + r**3 / 152.0**2)
    # The two directions differ by K² r.
    np.testing.assert_allclose(np.linalg.norm(after, axis=1) - r, expected, rtol=5e-4)


def test_refraction_refuses_what_it_cannot_do():
    with pytest.raises(InputError, match="flying_height_m"):
        refraction_constant(400.0, 500.0)
    with pytest.raises(InputError, match="flying_height_m"):
        refraction_constant(14000.0, 500.0)
    for model in (OpenCVDistortion(), FisheyeDistortion()):
        camera = Camera.from_pixel_pitch("p", (230, 230), 152.0, 1.0, (0, 0), model)
        with pytest.raises(InputError, match="refraction"):
            with_refraction(camera, 1e-5)
    pinhole = with_refraction(Camera.from_pixel_pitch("p", (230, 230), 152.0, 1.0), 1e-5)
    assert pinhole.distortion == BrownDistortion(k0=1e-5, k1=1e-5)
