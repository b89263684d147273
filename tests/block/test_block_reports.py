"""Adjustments that others published, from their observations: DBAT, a textbook resection, a film pair."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from pmexport import read_export

from stereomate.block.adjustment import adjust_block
from stereomate.block.network import BlockCamera, Control, ImagePoints, Network, Photographs, Points
from stereomate.camera.distortion import BrownDistortion
from stereomate.camera.model import Camera
from stereomate.geometry.collinearity import perturbation_from_opk
from stereomate.geometry.rotations import opk_from_rotation, rotation_from_opk, rotation_from_vector
from stereomate.relative.orientation import relative_orientation
from stereomate.relative.pair import correspondences_from_photo

CONTROL = {1001: (0.0, 1.0, 0.0), 1002: (1.0, 1.0, 0.0), 1003: (0.0, 0.0, 0.0), 1004: (1.0, 0.0, 0.0)}


def network_of(export, camera, free=None, sigma=0.0, xy=None, offset=0.0):
    """Network of an export; `sigma` of the control points, 0 holds them fixed, None leaves them out."""
    shift = offset * np.array([1.0, 1.0, 0.0])
    names = sorted(set(export.points) | {mark[1] for mark in export.marks})
    index = {name: k for k, name in enumerate(names)}
    points = np.array(
        [np.add(export.points.get(i, np.subtract(CONTROL.get(i, 0.0), shift)), shift) for i in names]
    )
    control = None
    if sigma is not None:
        known = [i for i in CONTROL if i in index]
        control = Control(np.array([index[i] for i in known]), np.array([CONTROL[i] for i in known]), sigma)
    rows = np.array([(photo, index[point]) for photo, point, _, _ in export.marks])
    pixels = np.array([mark[2:] for mark in export.marks]) if xy is None else xy
    n = len(export.centres)
    photographs = Photographs(
        tuple(f"photo {i + 1}" for i in range(n)), np.zeros(n, int), export.centres + shift, export.rotations
    )
    return Network(
        (BlockCamera(camera, free or {}),),
        photographs,
        Points(tuple(map(str, names)), points),
        ImagePoints(rows[:, 0], rows[:, 1], pixels, 0.1),
        control,
    )


class Report:
    """Numbers of a report of DBAT as printed: (value, half a unit of its last digit)."""

    def __init__(self, path):
        self.text = path.read_text(errors="replace")

    def number(self, label, start=0, what=""):
        at = self.text.index(label, start)
        if what:
            at = self.text.index(what, at)
        printed = re.search(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?", self.text[at + len(what or label) :]).group()
        mantissa, _, exponent = printed.partition("e")
        digits = len(mantissa.partition(".")[2])
        return float(printed), 0.5 * 10.0 ** (int(exponent or 0) - digits)

    def agrees(self, value, label, start=0, what="", slack=0.0):
        printed, half = self.number(label, start, what)
        # One more unit for its own last iteration.
        assert value == pytest.approx(printed, abs=1.5 * half + slack), label


def photo_figures(result, k):
    """Angles in degrees, centre and their standard deviations of a photograph."""
    opk = opk_from_rotation(result.rotations[k])
    turn = np.linalg.inv(perturbation_from_opk(opk))
    covariance = result.statistics.cofactors.photos[k] * result.sigma0**2
    angles = np.degrees(np.sqrt(np.diag(turn @ covariance[3:, 3:] @ turn.T)))
    return np.degrees(opk), angles, result.centres[k], np.sqrt(np.diag(covariance)[:3])


def check_photos(result, report, centre_shift=0.0, slack=0.0):
    """All photographs; `slack` in standard deviations, where DBAT stopped early (at 1e-6)."""
    for k in range(21):
        start = report.text.index(f"Photo {k + 1}: ")
        opk, angle_sigma, centre, sigma = photo_figures(result, k)
        for i, label in enumerate(("Omega:\n", "Phi:\n", "Kappa:\n")):
            printed, half = report.number(label, start, "Value:")
            assert (opk[i] - printed + 180.0) % 360.0 - 180.0 == pytest.approx(
                0.0, abs=3.0 * half + slack * angle_sigma[i]
            )
            report.agrees(angle_sigma[i], label, start, "Deviation:")
        for i, label in enumerate(("Xc:\n", "Yc:\n", "Zc:\n")):
            report.agrees(centre[i] - centre_shift * (i < 2), label, start, "Value:", slack * sigma[i])
            report.agrees(sigma[i], label, start, "Deviation:")


@pytest.mark.real
def test_dbat_self_calibration_to_the_printed_digits(data_folder):
    """Its forward model: corrections subtracted from the ideal point, residuals in pixels."""
    folder = data_folder / "dbat_camcal"
    export = read_export(folder / "pmexports/camcal-pmexport.txt")
    report = Report(folder / "dbatexports/camcal-dbatreport-model-1.txt")
    pitch = 5.43764 / 1704
    lens = BrownDistortion(convention="usgs", direction="ideal_to_measured", units="mm")
    camera = Camera.from_pixel_pitch("c4040z", export.size, 7.5, pitch, (0.0, 0.0), lens)
    names = ("principal_distance_mm", "principal_point_x_mm", "principal_point_y_mm")
    result = adjust_block(
        network_of(export, camera, dict.fromkeys((*names, "k1", "k2", "k3", "p1", "p2"), math.inf))
    )
    assert result.converged
    assert (result.observations, result.unknowns, result.redundancy) == (4148, 422, 3726)
    report.agrees(result.sigma0, "Sigma0:")
    values = list(zip(result.shared, result.statistics.shared_sigma, strict=True))
    # Its principal point counts from the upper left corner, downwards.
    values[1] = (values[1][0] + 1136 * pitch, values[1][1])
    values[2] = (-values[2][0] + 852 * pitch, values[2][1])
    labels = ("Camera Constant:", "px - principal", "py - principal", "K1 -", "K2 -", "K3 -", "P1 -", "P2 -")
    for (value, sigma), label in zip(values, labels, strict=True):
        report.agrees(value, label, 0, "Value:")
        report.agrees(sigma, label, 0, "Deviation:")
    check_photos(result, report)
    assert [(c.first, c.second, round(c.value, 3)) for c in result.correlations] == [
        ("c4040z: k2", "c4040z: k3", -0.980)
    ]


def corrected_residuals(network, camera, aspect, model, centres, rotations, points):
    """Residuals in pixels of corrected coordinates: what DBAT's backward models make small.

    `aspect` scales x about the principal point: in model 3 before the distortion is taken off, in 4 after.
    """
    photo, point = network.image.photo, network.image.point
    local = np.einsum("mji,mj->mi", rotations[photo], points[point] - centres[photo])
    measured = network.image.xy.copy()
    (across, _, middle), _ = camera.pixel_from_photo
    if model == 3:
        centre = middle + across * camera.parameters[1]
        measured[:, 0] = centre + (1.0 + aspect) * (measured[:, 0] - centre)
    rays = camera.rays_from_image(measured)[:, :2]
    if model == 4:
        rays = rays * (1.0 + aspect, 1.0)
    scale = camera.principal_distance_mm * abs(across)
    return (scale * (rays + local[:, :2] / local[:, 2:])).ravel()


@pytest.mark.real
@pytest.mark.parametrize(
    ("model", "names"),
    [
        (1, ("dbatreport-model1", "dbatreport-model2")),
        (3, ("dbatreport-model3", "dbatreport")),
        (4, ("dbatreport-model4",)),
    ],
    ids=["1 and 2", "3 and 5", "4"],
)
def test_dbat_backward_model_to_the_printed_digits(data_folder, model, names):
    """Its backward models make residuals of corrected coordinates small, errors are in the measured ones.

    So the rigorous adjustment is another one, near it. The same camera with its residuals, in steps of Gauss
    and Newton over differences from there, gives its report. Model 5 is 3 with x scaled about the corner.
    """
    folder = data_folder / "dbat_camcal"
    export = read_export(folder / "pmexports/camcal-pmexport.txt")
    report, *others = (Report(folder / f"dbatexports/camcal-{name}.txt") for name in names)
    pitch = 5.43764 / 1704
    lens = BrownDistortion(convention="australis", direction="measured_to_ideal", units="mm")
    camera = Camera.from_pixel_pitch("c4040z", export.size, 7.5, pitch, (0.0, 0.0), lens)
    first = ("principal_distance_mm", "principal_point_x_mm", "principal_point_y_mm")
    free = dict.fromkeys((*first, "k1", "k2", "k3", "p1", "p2"), math.inf)
    network = network_of(export, camera, {**free, **({} if model == 1 else {"pixel_aspect": math.inf})})
    result = adjust_block(network)
    assert result.converged
    assert result.redundancy == report.number("Redundancy")[0]
    labels = ["Camera Constant:", "px - principal", "py - principal", "K1 -", "K2 -", "K3 -", "P1 -", "P2 -"]
    labels += [] if model == 1 else ["as - off-unit"]

    def as_printed(values):
        return [values[0], values[1] + 1136 * pitch, 852 * pitch - values[2], *values[3:]]

    # Its aspect makes coordinates larger, ours makes pixels of them.
    rigorous = np.append(result.shared[:8], 1.0 / (1.0 + result.shared[8:]) - 1.0)
    for value, label in zip(as_printed(rigorous), labels, strict=True):
        # Where the distortion is taken off before the scale the aspect is another number.
        near = 0.5 if model == 4 else 0.3
        assert (
            abs(value - report.number(label, 0, "Value:")[0])
            < near * report.number(label, 0, "Deviation:")[0]
        ), label
    own = list(camera.parameter_names)
    at = [*(own.index(name) for name in free), *range(len(own), len(own) + len(labels) - 8)]
    tied = np.setdiff1d(np.flatnonzero(np.isfinite(result.points[:, 0])), network.control.point)
    values = np.append(np.array(result.cameras[0].parameters), rigorous[8:])
    state = result.centres, result.rotations, result.points, values

    def moved(step):
        centres, rotations, points, values = (part.copy() for part in state)
        photos = step[: 6 * len(centres)].reshape(-1, 6)
        points[tied] += step[6 * len(centres) : -len(at)].reshape(-1, 3)
        values[at] += step[-len(at) :]
        return centres + photos[:, :3], rotation_from_vector(photos[:, 3:]) @ rotations, points, values

    def residuals(centres, rotations, points, values):
        lens, aspect = camera.with_parameters(values[: len(own)]), float(values[len(own) :].sum())
        return corrected_residuals(network, lens, aspect, model, centres, rotations, points)

    size = 6 * len(state[0]) + 3 * len(tied) + len(at)
    assert size == report.number("Number of params:")[0]
    unit = np.full(size, 1e-5)
    unit[-len(at) :] = (1e-4, 1e-4, 1e-4, 1e-6, 1e-8, 1e-9, 1e-7, 1e-7, 1e-6)[: len(at)]
    for _ in range(3):
        design = np.empty((2 * len(network.image.photo), size))
        for i in range(size):
            step = np.zeros(size)
            step[i] = unit[i]
            design[:, i] = (residuals(*moved(step)) - residuals(*moved(-step))) / 2.0
        change = np.linalg.lstsq(design, -residuals(*state), rcond=None)[0] * unit
        state = moved(change)
    last = residuals(*state)
    sigma0 = math.sqrt(float(last @ last) / (len(last) - size))
    found = as_printed(state[3][at])
    reports = [(one, found) for one in (report, *others)]
    if model == 3:
        reports.append((Report(folder / "camcaldemo/result/report.txt"), found))
        fifth = Report(folder / "dbatexports/camcal-dbatreport-model5.txt")
        reports.append((fifth, [found[0], found[1] * (1.0 + found[8]), *found[2:]]))
    for printed, values in reports:
        printed.agrees(sigma0, "Sigma0 (pixels):")
        for value, label in zip(values, labels, strict=True):
            printed.agrees(value, label, 0, "Value:")


@pytest.mark.real
@pytest.mark.parametrize("start", ["no", "with"])
@pytest.mark.parametrize("kind", ["fixed", "weighted"])
def test_dbat_with_a_known_camera_to_the_printed_digits(data_folder, kind, start):
    """Its backward model with a known camera is a pinhole's adjustment of corrected coordinates.

    Its runs with and without an orientation of the model to start from end at the same place.
    """
    folder = data_folder / "dbat_camcal/prague2016_cam"
    export = read_export(folder / f"pmexports/{kind}-{start}-orient-pmexport.txt")
    report = Report(folder / f"dbatexports/{kind}-{start}-orient-dbatreport.txt")
    c, px, py, width, height, k1, k2, k3, p1, p2 = export.interior
    pitch = width / 2272
    lens = BrownDistortion(
        k1=k1, k2=k2, k3=k3, p1=p1, p2=p2, convention="australis", direction="measured_to_ideal", units="mm"
    )
    point = (px - width / 2, height / 2 - py)
    camera = Camera.from_pixel_pitch("c4040z", export.size, c, pitch, point, lens)
    pinhole = Camera.from_pixel_pitch("pinhole", export.size, c, pitch)
    measured = np.array([mark[2:] for mark in export.marks])
    corrected, _ = pinhole.image_from_camera(camera.rays_from_image(measured))
    sigma = 0.0 if kind == "fixed" else 1e-3
    result = adjust_block(network_of(export, pinhole, None, sigma, corrected, offset=0.5))
    assert result.redundancy == 3734
    assert result.unknowns == (414 if kind == "fixed" else 426)
    report.agrees(result.sigma0, "Sigma0:")
    check_photos(result, report, 0.5, 0.0 if kind == "fixed" else 2e-3)


@pytest.mark.real
def test_dbat_without_datum_misses_seven(data_folder):
    """DBAT reports rank 428 of 435; here the network is adjusted with inner constraints."""
    folder = data_folder / "dbat_camcal"
    export = read_export(folder / "pmexports/camcal-pmexport.txt")
    report = Report(folder / "dbatexports/camcal-dbatreport-no-datum.txt")
    pitch = 5.43764 / 1704
    lens = BrownDistortion(convention="usgs", direction="ideal_to_measured", units="mm")
    camera = Camera.from_pixel_pitch("c4040z", export.size, 7.5, pitch, (0.0, 0.0), lens)
    names = ("principal_distance_mm", "principal_point_x_mm", "principal_point_y_mm")
    free = dict.fromkeys((*names, "k1", "k2", "k3", "p1", "p2", "pixel_aspect"), math.inf)
    result = adjust_block(network_of(export, camera, free, sigma=None))
    assert result.solution.defect.size == report.number("deficiency:")[0] == 7
    assert result.unknowns + 7 == report.number("Number of params:")[0]
    assert result.converged
    # Control fixed at four exact places strains the net; without it sigma0 is smaller.
    assert 1.0 < result.sigma0 < 1.62


@pytest.mark.real
@pytest.mark.parametrize("kind", ["1ray", "missing-obs"])
def test_dbat_runs_that_failed_there_are_survived(data_folder, kind):
    """Points seen once and points without observations: DBAT's runs ended in NaN or did not converge."""
    folder = data_folder / "dbat_camcal"
    export = read_export(folder / f"pmexports/camcal-pmexport-{kind}.txt")
    pitch = 5.43764 / 1704
    lens = BrownDistortion(convention="usgs", direction="ideal_to_measured", units="mm")
    camera = Camera.from_pixel_pitch("c4040z", export.size, 7.5, pitch, (0.0, 0.0), lens)
    names = ("principal_distance_mm", "principal_point_x_mm", "principal_point_y_mm")
    free = dict.fromkeys((*names, "k1", "k2", "k3", "p1", "p2"), math.inf)
    result = adjust_block(network_of(export, camera, free))
    assert result.converged
    assert 1.55 < result.sigma0 < 1.70
    lonely = np.isnan(result.points).any(axis=1)
    rays = np.bincount(result.network.image.point, minlength=len(lonely))
    np.testing.assert_array_equal(lonely, rays < 2)
    assert lonely.any() or kind != "1ray"


@pytest.mark.real
def test_textbook_resection_as_a_block_of_one(data_folder):
    lines = (data_folder / "mikhail_resection/resect.inp").read_text().split("\n")
    rows = [line.split() for line in lines if len(line.split()) == 6]
    mm = np.array([[float(v) for v in row[1:3]] for row in rows])
    xyz = np.array([[float(v) for v in row[3:]] for row in rows])
    origin = np.array([914250.0, 575400.0, 0.0])
    camera = Camera.from_pixel_pitch("film", (230, 230), 152.222, 1.0)
    start = np.array([[0.0, 0.0, 800.0]])
    network = Network(
        (BlockCamera(camera),),
        Photographs(("photo",), np.zeros(1, int), start, rotation_from_opk([[0.0, 0.0, -1.57]])),
        Points(tuple(row[0] for row in rows), xyz - origin),
        ImagePoints(np.zeros(5, int), np.arange(5), camera.image_from_photo(mm), 0.01),
        Control(np.arange(5), xyz - origin, 0.0),
    )
    result = adjust_block(network)
    np.testing.assert_allclose(result.centres[0] + origin, [914260.422, 575441.836, 839.130], atol=6e-4)
    np.testing.assert_allclose(
        opk_from_rotation(result.rotations[0]), [-0.0065075, -0.0085218, -1.5753221], atol=6e-8
    )
    assert result.redundancy == 4


@pytest.mark.real
def test_film_pair_as_a_block_of_two(data_folder):
    """Dependent relative orientation: the first photograph held, the base held in x."""
    folder = data_folder / "houston_film/photo-lab3/data"
    marks = [np.loadtxt(folder / f"image_{k}_given.txt") for k in (27, 28)]
    camera = Camera.from_pixel_pitch("film", (230, 230), 153.358, 1.0)
    fixed = np.zeros((2, 6), bool)
    fixed[0] = True
    fixed[1, 0] = True
    points = np.column_stack([marks[0][:, 1:], np.full(6, -150.0)])
    network = Network(
        (BlockCamera(camera),),
        Photographs(
            ("27", "28"),
            np.zeros(2, int),
            np.array([[0.0, 0, 0], [92.0, 0, 0]]),
            np.stack([np.eye(3)] * 2),
            fixed,
        ),
        Points(tuple(str(int(v)) for v in marks[0][:, 0]), points),
        ImagePoints(
            np.repeat([0, 1], 6),
            np.tile(np.arange(6), 2),
            np.concatenate([camera.image_from_photo(m[:, 1:]) for m in marks]),
            0.005,
        ),
    )
    result = adjust_block(network)
    assert result.redundancy == 1
    np.testing.assert_allclose(result.centres[1], [92.0, -1.422, -1.287], atol=6e-4)
    # The publication weights its conditions equally; rigorous weights, by coplanarity, give the same as here.
    rigorous = relative_orientation(
        correspondences_from_photo(marks[0][:, 1:], marks[1][:, 1:], 153.358, 0.005)
    ).dependent(92.0)
    opk = opk_from_rotation(result.rotations[1])
    np.testing.assert_allclose([*result.centres[1, 1:], *opk], rigorous.values, atol=2e-7)
    np.testing.assert_allclose(np.degrees(opk), [-0.97723, 0.27326, -1.72863], rtol=2e-4)
    published = [
        [-9.448, 96.274, -153.421], [84.642, 103.258, -152.654], [-2.292, -5.937, -151.638],
        [101.196, -0.396, -146.476], [18.370, -79.446, -148.905], [87.389, -88.122, -148.432],
    ]  # fmt: skip
    np.testing.assert_allclose(result.points, published, atol=4e-3)
