"""A real delivery that was adjusted in the grid (IGN, Lambert-93), adjusted here: ``ign_borea_A``."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from stereomate.block.adjustment import adjust_block
from stereomate.block.network import (
    BlockCamera,
    Control,
    ImagePoints,
    Network,
    Photographs,
    Points,
    Positions,
)
from stereomate.block.options import BlockOptions
from stereomate.block.systematic import find_systematic_shift
from stereomate.block.unknowns import vector_from_rotation
from stereomate.block.variance import estimate_variance_components
from stereomate.camera.distortion import BrownDistortion
from stereomate.camera.model import Camera
from stereomate.formats.ign import read_ground_points, read_mes
from stereomate.frames.adjusted import space_from_grid_centres
from stereomate.frames.attitude import AttitudeConvention, object_from_camera
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_map, map_from_tangent, tangent_from_map
from stereomate.geometry.rotations import rotation_from_vector
from stereomate.project.compare_report import comparison_sections
from stereomate.project.orient_compare import comparisons, findings_of

pytestmark = pytest.mark.real

CAMERA = Camera.from_focal_lengths("ucem3", (26460, 17004), (30975.0, 30975.0), (13210.0, 8502.0))
OPTIONS = BlockOptions(scale_by="prior")


class Delivery:
    """The orientation as delivered and as true positions, with its network, perturbed."""

    def __init__(self, folder):
        rows = [line.split() for line in (folder / "eo_lambert93_ign69.OPK").read_text().splitlines()[1:]]
        rows = [row for row in rows if row]
        values = np.array([row[1:7] for row in rows], dtype=float)
        self.names = tuple(row[0] for row in rows)
        ngf = MapFrame("EPSG:2154", HeightSystem.grid_file(folder / "fr_ign_RAF20.tif"))
        self.frame = MapFrame("EPSG:2154", HeightSystem.ellipsoidal())
        self.delivered = map_from_map(self.frame, ngf, values[:, :3])
        self.tangent = TangentFrame.at_map(self.frame, self.delivered.mean(axis=0) * (1, 1, 0))
        control = read_ground_points(folder / "gcp_ellipsoidal.app")
        self.ground_height = float(control.xyz[0, 2])
        true = space_from_grid_centres(self.frame, self.delivered, self.ground_height).centres
        self.centres = tangent_from_map(self.tangent, self.frame, true)
        self.as_delivered = tangent_from_map(self.tangent, self.frame, self.delivered)
        self.rotations = object_from_camera(
            values[:, 3:], AttitudeConvention("opk", "grid", "deg"), self.tangent, self.centres, self.frame
        )
        ties, marks = read_mes(folder / "tie_points.mes"), read_mes(folder / "gcp_image.mes")
        world = read_ground_points(folder / "tie_points_world_ellipsoidal.mes")
        names = (*world.names, *control.names)
        index = {name: k for k, name in enumerate(names)}
        photo_index = {name: k for k, name in enumerate(self.names)}
        known = [k for k, name in enumerate((*ties.points, *marks.points)) if name in index]
        points = (*ties.points, *marks.points)
        photos = (*ties.photographs, *marks.photographs)
        xyz = tangent_from_map(self.tangent, self.frame, np.vstack([world.xyz, control.xyz]))
        self.published = xyz
        self.image = ImagePoints(
            np.array([photo_index[photos[k]] for k in known]),
            np.array([index[points[k]] for k in known]),
            np.vstack([ties.pixels, marks.pixels])[known],
            0.2,
        )
        self.points = names
        self.control = Control(np.array([len(names) - 1]), xyz[-1:], 0.02)

    def network(self, positions=None, control=True, free=None, sigma=0.05):
        rng = np.random.default_rng(11)
        n = len(self.names)
        centres = self.centres + rng.normal(0.0, 5.0, (n, 3))
        turns = rotation_from_vector(np.radians(0.5) * rng.normal(size=(n, 3)))
        return Network(
            (BlockCamera(CAMERA, free or {}),),
            Photographs(self.names, np.zeros(n, int), centres, turns @ self.rotations),
            Points(self.points, self.published + rng.normal(0.0, 5.0, self.published.shape)),
            self.image,
            self.control if control else None,
            Positions(np.arange(n), self.centres if positions is None else positions, sigma),
        )

    def differences(self, result):
        """Centres and angles against the delivered orientation; points against the published ones, in map."""
        centres = result.centres - self.centres
        turns = vector_from_rotation(result.rotations @ np.swapaxes(self.rotations, 1, 2))
        known = np.isfinite(result.points[:, 0])
        found = map_from_tangent(self.tangent, self.frame, result.points[known])
        return centres, turns, found - map_from_tangent(self.tangent, self.frame, self.published[known])


@pytest.fixture(scope="module")
def delivery(data_folder):
    return Delivery(data_folder / "ign_borea_A")


@pytest.mark.parametrize(
    ("control", "free"),
    [(True, None), (False, None), (True, {"principal_distance_mm": math.inf})],
    ids=["control", "positions only", "principal distance free"],
)
def test_perturbed_orientation_comes_back(delivery, control, free):
    result = adjust_block(delivery.network(control=control, free=free), OPTIONS)
    assert result.converged
    assert max(result.rms_px) < 0.20
    # One photograph shows a single point: said, and left where it was.
    assert result.notes[0].startswith(
        "1 photographs are not determined, too few observations: 23FD1305x00026_01300"
    )
    here = result.determined_photos
    assert here.sum() == 36
    centres, turns, points = delivery.differences(result)
    sigma = result.statistics.photo_sigma[here]
    # The delivery has an accuracy of its own (5 cm, 0.003°): no strict chi-square.
    assert np.abs(centres[here] / np.hypot(sigma[:, :3], 0.05)).max() < 4.0
    assert np.abs(turns[here] / np.hypot(sigma[:, 3:], 5e-5)).max() < 4.0
    # Errors of the points go together (datum): their mean has about the standard deviation of one of them.
    stated = np.nanmedian(result.statistics.point_sigma, axis=0)
    assert (np.abs(points.mean(axis=0)) < 2.6 * stated).all(), (points.mean(axis=0), stated)
    assert stated.max() < 0.1
    if free:
        c, c_sigma = result.shared[0], result.statistics.shared_sigma[0]
        assert abs(c - CAMERA.principal_distance_mm) < 4.0 * c_sigma


def test_delivered_centres_taken_as_true_show_the_half_metre(delivery):
    network = delivery.network(positions=delivery.as_delivered)
    plain = adjust_block(network, OPTIONS)
    # The control contradicts the heights of the centres: its residual is standardized far over the limit.
    assert abs(plain.statistics.control.standardized[0, 2]) > 10.0
    found = find_systematic_shift(plain, delivery.tangent, delivery.frame)
    assert found.grid_excess_m == pytest.approx(0.486, abs=0.003)
    assert abs(found.shift[2] - 0.486) < 3.0 * found.sigma[2]
    np.testing.assert_array_equal(found.significant, [False, False, True])
    assert "Ressl" in found.cause
    # Divided by the effective scale the same centres show nothing of the kind; the difference is the effect.
    true = find_systematic_shift(adjust_block(delivery.network(), OPTIONS), delivery.tangent, delivery.frame)
    assert not true.significant.any()
    assert "Ressl" not in true.cause
    assert found.shift[2] - true.shift[2] == pytest.approx(0.488, abs=0.003)


def test_variance_components_see_the_heights_of_the_centres(delivery):
    # With control all over the block the heights of the centres are the ones that give way.
    rows = np.arange(0, len(delivery.points), 40)
    many = Control(rows, delivery.published[rows], 0.05)
    network = replace(delivery.network(positions=delivery.as_delivered), control=many)
    found = estimate_variance_components(network)
    factors = {c.group: c.factor for c in found.components}
    assert found.converged
    # The standard deviation of 5 cm becomes the half metre, and the mean residual is the effect.
    assert 0.05 * factors["positions height"] == pytest.approx(0.5, abs=0.05)
    assert factors["positions plan"] < 2.0
    assert factors["image"] == pytest.approx(0.94, abs=0.02)
    placed = found.adjustment.statistics.positions
    assert placed.residuals[1:, 2].mean() == pytest.approx(0.49, abs=0.03)
    shift = find_systematic_shift(adjust_block(network, OPTIONS), delivery.tangent, delivery.frame)
    assert abs(shift.shift[2] - shift.grid_excess_m) < 3.0 * shift.sigma[2]


def test_systematic_image_errors_explain_the_height_without_control(delivery):
    """Positions alone leave the points 0.11 m high, three times what random errors do to their mean.

    The residuals show why: a pattern over the image of some 0.05 px that no random model has. With radial
    distortion free the pattern, and the height, are gone, and sigma0 is smaller; what is stated grows.
    """
    plain = adjust_block(delivery.network(control=False), OPTIONS)
    lens = replace(CAMERA, distortion=BrownDistortion())
    free = dict.fromkeys(("k1", "k2", "p1", "p2"), math.inf)
    network = replace(delivery.network(control=False), cameras=(BlockCamera(lens, free),))
    calibrated = adjust_block(network, OPTIONS)
    heights = [delivery.differences(r)[2][:, 2].mean() for r in (plain, calibrated)]
    assert heights[0] == pytest.approx(0.114, abs=0.01)
    stated = np.nanmedian(calibrated.statistics.point_sigma[:, 2])
    assert abs(heights[1]) < stated < 0.1
    assert calibrated.sigma0 < 0.98 * plain.sigma0
    cofactor = calibrated.statistics.cofactors.shared
    assert calibrated.shared @ np.linalg.solve(cofactor, calibrated.shared) > chi2.ppf(1.0 - 1e-6, 4)


def test_comparisons_tabulate_the_indirect_case(delivery):
    """What `stereomate orient` writes of a block: P1 differs, M2 and M3 agree, with c held and free."""
    rows = np.arange(0, len(delivery.points), 40)
    many = Control(rows, delivery.published[rows], 0.05)
    network = replace(delivery.network(positions=delivery.as_delivered), control=many)
    result = adjust_block(network, replace(OPTIONS, robust="snooping"))
    found = comparisons(
        SimpleNamespace(tangent=delivery.tangent, frame=delivery.frame),
        SimpleNamespace(result=result, has_datum=True),
    )
    json.dumps(found, allow_nan=False)
    table = {(row["method"], row["principal_distance"]): row for row in found["in_grid"]}
    assert len(table) == 6
    assert all(row["converged"] for row in table.values())
    assert abs(table["P1", "held"]["points_mean_m"][2]) > 0.05
    for method in ("M2", "M3"):
        assert max(table[method, "held"]["points_rms_m"]) < 0.005
        assert abs(table[method, "held"]["centres_mean_m"][2]) < 0.002
    assert table["M3", "held"]["principal_distance_mm"] < table["M2", "held"]["principal_distance_mm"]
    assert "Ressl" in findings_of(found)[0]
    assert {c["group"] for c in found["variance_components"]} >= {"image", "positions height"}
    (section,) = comparison_sections({"comparison": found})
    assert len(section.tables[1].rows) == 6
