"""A real delivery adjusted in the grid (IGN, Lambert-93): the table of the theory page, section 9.

The table is that of the points seen in three photographs or more; with the 226 points of two rays the
residuals split another way (0.150/0.183 px, the same sum of squares).
"""

from collections import defaultdict

import numpy as np
import pytest

from stereomate.frames.adjusted import grid_height_excess_m, space_from_grid_centres
from stereomate.frames.attitude import AttitudeConvention, object_from_camera
from stereomate.frames.curvature import CurvatureOptions, curvature_corrected
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.prediction.intersection import image_coordinates, intersect
from stereomate.frames.remedies import GridBlock
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_map, map_from_tangent, tangent_from_map

pytestmark = pytest.mark.real

C_PX, PRINCIPAL_POINT = 30975.0, np.array([13210.0, 8502.0])
ELLIPSOIDAL = HeightSystem.ellipsoidal()


class Delivery:
    """Orientation, measurements and published ground coordinates, read with a few lines."""

    def __init__(self, folder):
        rows = [line.split() for line in (folder / "eo_lambert93_ign69.OPK").read_text().splitlines()[1:]]
        rows = [row for row in rows if row]
        self.index = {row[0]: k for k, row in enumerate(rows)}
        values = np.array([row[1:7] for row in rows], dtype=float)
        self.centres_ngf, self.opk = values[:, :3], values[:, 3:]
        ngf = MapFrame("EPSG:2154", HeightSystem.grid_file(folder / "fr_ign_RAF20.tif"))
        self.frame = MapFrame("EPSG:2154", ELLIPSOIDAL)
        self.centres = map_from_map(self.frame, ngf, self.centres_ngf)
        self.observations = self.read_measures(folder / "tie_points.mes")
        self.observations |= self.read_measures(folder / "gcp_image.mes")
        self.ground = {}
        for name in ("tie_points_world_ellipsoidal.mes", "gcp_ellipsoidal.app"):
            for row in map(str.split, (folder / name).read_text().splitlines()):
                if row:
                    self.ground[row[0]] = np.array(row[-3:], dtype=float)

    def read_measures(self, path):
        measures = defaultdict(list)
        for row in map(str.split, path.read_text().splitlines()):
            if row:
                col, line = float(row[2]), float(row[3])
                offset = np.array([col, line]) - PRINCIPAL_POINT
                measures[row[0]].append((self.index[row[1]], offset[0], -offset[1]))
        return dict(measures)

    def groups(self):
        """Points by their number of rays: names, photographs (n, k), image coordinates (n, k, 2)."""
        by_count = defaultdict(list)
        for name, rays in self.observations.items():
            if name in self.ground and len(rays) >= 3:
                by_count[len(rays)].append((name, np.array(rays)))
        for members in by_count.values():
            rays = np.stack([m[1] for m in members])
            yield [m[0] for m in members], rays[..., 0].astype(int), rays[..., 1:]


def intersect_all(delivery, centres, rotations, to_map, correct=None):
    """Differences to the published points, image residuals, and the control point's difference."""
    differences, residuals, control = [], [], None
    for names, photos, xy in delivery.groups():
        published = np.array([delivery.ground[name] for name in names])
        used = xy if correct is None else correct(xy, photos, published)
        c = np.full(photos.shape, C_PX)
        found = intersect(used, centres[photos], rotations[photos], c)
        residuals.append(
            (used - image_coordinates(found, centres[photos], rotations[photos], c)).reshape(-1, 2)
        )
        difference = to_map(found) - published
        for name, row in zip(names, difference, strict=True):
            if name == '"1003"':
                control = row
            else:
                differences.append(row)
    differences = np.array(differences)
    rms = np.sqrt(np.mean(np.concatenate(residuals) ** 2, axis=0))
    return differences.mean(axis=0), differences[:, 2].std(), rms, control


@pytest.fixture(scope="module")
def delivery(data_folder):
    return Delivery(data_folder / "ign_borea_A")


@pytest.fixture(scope="module")
def tangent(delivery):
    return TangentFrame.at_map(delivery.frame, delivery.centres.mean(axis=0) * (1, 1, 0))


def in_space(delivery, tangent, centres_map):
    centres = tangent_from_map(tangent, delivery.frame, centres_map)
    rotations = object_from_camera(
        delivery.opk, AttitudeConvention("opk", "grid", "deg"), tangent, centres, delivery.frame
    )
    return centres, rotations


def test_the_data_are_what_the_table_was_made_of(delivery):
    assert len(delivery.index) == 37
    assert len(delivery.observations) == 1783
    undulation = delivery.centres[:, 2] - delivery.centres_ngf[:, 2]
    assert undulation.mean() == pytest.approx(49.33, abs=0.02)


def test_grid_taken_as_cartesian(delivery):
    rotations = object_from_camera(  # the matrices themselves, in grid axes
        delivery.opk,
        AttitudeConvention("opk", "tangent"),
        TangentFrame(0, 0, 0, 6.4e6, 0.0),
        delivery.centres,
    )
    mean, std, rms, control = intersect_all(delivery, delivery.centres, rotations, lambda x: x)
    np.testing.assert_allclose(mean, (0.0, -0.002, -0.009), atol=0.0006)
    assert std == pytest.approx(0.022, abs=0.0006)
    np.testing.assert_allclose(rms, (0.145, 0.192), atol=0.0006)
    np.testing.assert_allclose(control, (0.01, -0.02, 0.0), atol=0.006)


def test_grid_with_curvature_correction(delivery):
    rotations = object_from_camera(
        delivery.opk,
        AttitudeConvention("opk", "tangent"),
        TangentFrame(0, 0, 0, 6.4e6, 0.0),
        delivery.centres,
    )

    def correct(xy, photos, published):
        return curvature_corrected(
            xy,
            C_PX,
            rotations[photos],
            delivery.centres[photos, 2],
            published[:, None, 2],
            CurvatureOptions(6.371e6, "classical"),
        )

    mean, std, rms, control = intersect_all(delivery, delivery.centres, rotations, lambda x: x, correct)
    np.testing.assert_allclose(mean, (0.0, -0.002, 0.018), atol=0.0006)
    assert std == pytest.approx(0.020, abs=0.0008)
    np.testing.assert_allclose(rms, (0.144, 0.188), atol=0.0006)
    np.testing.assert_allclose(control, (0.01, -0.02, 0.03), atol=0.0051)


def test_rigorous_with_the_centres_as_they_are_is_half_a_metre_too_high(delivery, tangent):
    centres, rotations = in_space(delivery, tangent, delivery.centres)
    mean, std, _, _ = intersect_all(
        delivery, centres, rotations, lambda x: map_from_tangent(tangent, delivery.frame, x)
    )
    np.testing.assert_allclose(mean, (0.0, -0.0015, 0.508), atol=0.0006)
    assert std < 0.025


def test_rigorous_after_dividing_by_the_effective_scale(delivery, tangent):
    reference = float(delivery.ground['"1003"'][2])  # the mean control height
    space = space_from_grid_centres(delivery.frame, delivery.centres, reference)
    assert space.shift_m.mean() == pytest.approx(-0.486, abs=0.0006)
    # 272 to 297 ppm of plane scale, less the height of the ground.
    assert 260e-6 < space.effective_scale.min() - 1 < space.effective_scale.max() - 1 < 297e-6
    excess = grid_height_excess_m(delivery.frame, delivery.centres, reference)
    np.testing.assert_allclose(excess, -space.shift_m, rtol=1e-9)
    # A reference wrong by 100 m would change the heights by 3 cm.
    assert space.uncertainty_m(100.0) == pytest.approx(0.0285, abs=0.002)

    centres, rotations = in_space(delivery, tangent, space.centres)
    mean, std, rms, control = intersect_all(
        delivery, centres, rotations, lambda x: map_from_tangent(tangent, delivery.frame, x)
    )
    np.testing.assert_allclose(mean, (0.0, -0.002, 0.020), atol=0.0006)
    assert std == pytest.approx(0.020, abs=0.0008)
    assert rms[0] <= 0.1455
    assert rms[1] <= 0.1875
    np.testing.assert_allclose(control, (0.01, -0.02, 0.03), atol=0.0051)


def test_m4_gives_the_grid_the_rigorous_points(delivery, tangent):
    """The whole block: images corrected by M4, intersected in the grid, against the intersection in space."""
    reference = float(delivery.ground['"1003"'][2])  # the mean control height
    true_map = space_from_grid_centres(delivery.frame, delivery.centres, reference).centres
    centres, rotations = in_space(delivery, tangent, true_map)
    block = GridBlock(tangent, delivery.frame, centres, rotations, np.full(37, C_PX))
    worst = 0.0
    for _, photos, xy in delivery.groups():
        c = np.full(photos.shape, C_PX)
        space = map_from_tangent(
            tangent, delivery.frame, intersect(xy, centres[photos], rotations[photos], c)
        )
        grid = intersect(xy, block.grid_centres[photos], block.grid_rotations[photos], c)
        point_of = np.repeat(np.arange(len(xy)), photos.shape[1])
        for _ in range(3):
            change = block.corrections(grid, point_of, photos.ravel()).reshape(xy.shape)
            grid = intersect(xy + change, block.grid_centres[photos], block.grid_rotations[photos], c)
        worst = max(worst, float(np.abs(grid - space).max()))
    # Noisy rays do not meet: the two least-squares problems weigh their misfits a little differently.
    assert worst < 1e-4
