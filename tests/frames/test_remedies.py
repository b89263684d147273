"""M1 to M4 on the golden scenes: two photographs, exact image coordinates, every way to work in the grid."""

import numpy as np
import pytest
from geoid_files import write_gtx

from stereomate.errors import InputError, OrientationError
from stereomate.frames.curvature import CurvatureOptions, curvature_corrected
from stereomate.frames.factors import effective_scale, gauss_radius, grid_factors
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.prediction.intersection import intersect
from stereomate.frames.remedies import (
    GridBlock,
    cartesian_from_map,
    grid_principal_distance,
    levelled_scale,
    map_from_cartesian,
    scaled_heights,
    unscaled_heights,
)
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_tangent

ELLIPSOIDAL = HeightSystem.ellipsoidal()


class Scene:
    """A golden case as a block in a tangent frame at its middle."""

    def __init__(self, case):
        self.case = case
        self.frame = MapFrame(case["proj"], ELLIPSOIDAL)
        self.tangent = TangentFrame.at_geodetic(self.frame.geodetic, case["lon"], case["lat"], 0.0)
        geocentric = np.array([camera["ecef"] for camera in case["cameras"]])
        to_tangent = self.tangent.rotation_geocentric_from_tangent.T
        rotations = to_tangent @ np.array([camera["R_ecef"] for camera in case["cameras"]])
        self.c = case["c"]
        self.block = GridBlock(
            self.tangent,
            self.frame,
            self.tangent.tangent_from_geocentric(geocentric),
            rotations,
            np.full(2, self.c),
        )
        self.xy = np.swapaxes(np.array(case["image_xy"]), 0, 1)  # (points, photographs, 2)
        self.truth = np.array(case["points_grid_true"])
        self.h_camera = self.block.grid_centres[:, 2]

    def corrected(self, method, level):
        options = CurvatureOptions(self.case["R_earth"], method, level)
        return curvature_corrected(
            self.xy, self.c, self.block.grid_rotations, self.h_camera, self.case["ground_h"], options
        )

    def in_grid(self, xy, centres=None, c=None):
        c = np.full(2, self.c) if c is None else c
        centres = self.block.grid_centres if centres is None else centres
        return intersect(xy, centres, self.block.grid_rotations, c)

    def scale(self, effective):
        return self.case["tau_eff"] if effective else self.case["tau_centre"]

    def m2(self, xy, effective):
        scale = self.scale(effective)
        found = self.in_grid(xy, scaled_heights(self.block.grid_centres, scale))
        return unscaled_heights(found, scale)

    def m3(self, xy, effective):
        tau = np.array([camera["tau"] for camera in self.case["cameras"]])
        if effective:
            tau = effective_scale(tau, self.case["ground_h"], self.case["R_earth"])
        # One c per photograph means image coordinates scaled to a common c.
        return self.in_grid(xy, c=grid_principal_distance(self.c, tau))

    def m1(self):
        found = intersect(self.xy, self.block.centres, self.block.rotations, np.full(2, self.c))
        return map_from_tangent(self.tangent, self.frame, found)

    def m4(self, passes=6):
        count = len(self.truth)
        point_of, photo_of = np.repeat(np.arange(count), 2), np.tile([0, 1], count)
        found, history = self.in_grid(self.xy), []
        for _ in range(passes):
            change = self.block.corrections(map_from_cartesian(self.frame, found), point_of, photo_of)
            found = self.in_grid(self.xy + change.reshape(count, 2, 2))
            history.append(np.abs(found - self.truth).max())
        return found, history


@pytest.fixture(scope="module")
def scenes(golden):
    data = golden("georef_direct.json")
    assert data["tolerance"] == {"image_m": 1e-12, "point_m": 1e-5, "error_m": 1e-4}
    return [Scene(case) for case in data["cases"]]


def summary(found, truth):
    error = found - truth
    dz = error[:, 2]
    return {
        "dz_mean": dz.mean(),
        "dz_c": dz[4],
        "dz_max": np.abs(dz).max(),
        "dxy_max": np.hypot(error[:, 0], error[:, 1]).max(),
        "dz_sd": dz.std(),
    }


def test_the_block_in_the_grid_is_the_golden_one(scenes):
    for scene in scenes:
        for camera, centre, rotation in zip(
            scene.case["cameras"], scene.block.grid_centres, scene.block.grid_rotations, strict=True
        ):
            np.testing.assert_allclose(centre, camera["grid"], rtol=0, atol=1e-8)
            np.testing.assert_allclose(rotation, camera["R_grid"], rtol=0, atol=1e-9)
            tau, _ = grid_factors(scene.frame.crs, *centre[:2])
            assert abs(tau - camera["tau"]) < 1e-10
        datum = scene.frame.geodetic
        radius = gauss_radius(datum.semi_major_m, datum.flattening, scene.case["lat"])
        assert radius == pytest.approx(scene.case["R_earth"], abs=1e-3)


def test_naive_and_corrected_points(scenes):
    for scene in scenes:
        np.testing.assert_allclose(
            scene.in_grid(scene.xy), scene.case["points_grid_naive"], rtol=0, atol=1e-5
        )
        np.testing.assert_allclose(
            scene.in_grid(scene.corrected("classical", "ground")),
            scene.case["points_grid_P1_classic"],
            rtol=0,
            atol=1e-5,
        )


def test_every_method_has_the_golden_errors(scenes):
    for scene in scenes:
        classical = scene.corrected("classical", "ground")
        exact = scene.corrected("sphere", "ellipsoid")
        found = {
            "naive": scene.in_grid(scene.xy),
            "P1": scene.in_grid(classical),
            "P1M2": scene.m2(classical, effective=False),
            "P1M2e": scene.m2(classical, effective=True),
            "P1M3": scene.m3(classical, effective=False),
            "P1M3e": scene.m3(classical, effective=True),
            "PX": scene.in_grid(exact),
            "PXM3": scene.m3(exact, effective=False),
            "M1": scene.m1(),
            "generic": scene.m4()[0],
        }
        assert set(found) == set(scene.case["error_summary"])
        for method, expected in scene.case["error_summary"].items():
            for name, value in summary(found[method], scene.truth).items():
                assert value == pytest.approx(expected[name], abs=1e-4), (scene.case["name"], method, name)
        # The rigorous ways are right to rounding, not merely to the golden tolerance.
        assert np.abs(found["M1"] - scene.truth).max() < 2e-8
        assert np.abs(found["generic"] - scene.truth).max() < 2e-8


def test_equation_4_with_the_effective_scale(scenes):
    for scene in scenes:
        height = scene.case["H"]
        predicted = -(scene.case["tau_eff"] - 1.0) * height
        assert predicted == pytest.approx(scene.case["eq4_tau_eff"], abs=1e-9)
        centre = summary(scene.in_grid(scene.corrected("classical", "ground")), scene.truth)["dz_c"]
        assert centre == pytest.approx(predicted, abs=1e-3)


def test_m4_contracts(scenes):
    for scene in scenes:
        _, history = scene.m4()
        assert history[0] < 5e-3
        assert history[1] < history[0] / 50
        assert history[-1] < 2e-8


def test_m4_in_feet_with_south_axes_and_with_a_geoid(tmp_path):
    """The grid that other software sees may have any axes, unit and height system."""
    geoid = HeightSystem.grid_file(write_gtx(tmp_path / "g.gtx"))
    base = "+proj=tmerc +lat_0=0 +lon_0=1 +k=0.9996 +x_0=500000 +y_0=0 +ellps=GRS80"
    rng = np.random.default_rng(2)
    for crs, heights in (
        (f"{base} +units=us-ft", HeightSystem.ellipsoidal(1200 / 3937)),
        (f"{base} +axis=swu", ELLIPSOIDAL),
        (base, geoid),
    ):
        frame = MapFrame(crs, heights)
        tangent = TangentFrame.at_geodetic(frame.geodetic, 3.0, 45.0, 0.0)
        centres = np.array([[-500.0, 0.0, 2000.0], [500.0, 100.0, 2050.0]])
        rotations = np.stack([np.eye(3), np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])])
        block = GridBlock(tangent, frame, centres, rotations, np.array([0.1, 0.12]))
        truth = rng.uniform(-800, 800, (20, 3)) * (1, 1, 0.4)
        local = np.einsum("kji,nkj->nki", rotations, truth[:, None] - centres)
        xy = -block.principal_distances[:, None] * local[..., :2] / local[..., 2:]
        point_of, photo_of = np.repeat(np.arange(20), 2), np.tile([0, 1], 20)
        found = intersect(xy, block.grid_centres, block.grid_rotations, block.principal_distances)
        expected = cartesian_from_map(frame, map_from_tangent(tangent, frame, truth))
        assert np.abs(found - expected).max() > 0.05
        for _ in range(6):
            change = block.corrections(map_from_cartesian(frame, found), point_of, photo_of)
            found = intersect(
                xy + change.reshape(xy.shape),
                block.grid_centres,
                block.grid_rotations,
                block.principal_distances,
            )
        np.testing.assert_allclose(found, expected, rtol=0, atol=5e-8)


def test_levelled_scale_is_m2_for_tilted_photographs(scenes):
    """Exact M3: the corrected images give in the grid what M2 gives, for any tilt."""
    scene = next(s for s in scenes if "tilted" in s.case["name"])
    xy = scene.corrected("classical", "ground")
    scale = scene.case["tau_eff"]
    changed = levelled_scale(xy, scene.c, scene.block.grid_rotations, scale)
    difference = scene.in_grid(changed) - scene.m2(xy, effective=True)
    # The rays are the same; only the weights of the small misfits that are left (P3) differ.
    assert np.abs(difference).max() < 1e-5
    plain = scene.m3(xy, effective=True) - scene.m2(xy, effective=True)
    assert np.abs(plain).max() > 1e-2


def test_direction_of_m3():
    """A grid that stretches makes c smaller."""
    assert grid_principal_distance(150.0, 1.000273596885) == pytest.approx(149.95897, abs=1e-5)
    assert grid_principal_distance(150.0, 0.9996) == pytest.approx(150.06002, abs=1e-5)
    with pytest.raises(InputError, match="within 20 %"):
        grid_principal_distance(150.0, 150.0)


def test_wrong_shapes_are_refused(scenes):
    block = scenes[0].block
    with pytest.raises(OrientationError, match="one per photograph"):
        GridBlock(block.tangent, block.frame, block.centres, block.rotations[:1], block.principal_distances)
    with pytest.raises(InputError, match="photo_of"):
        block.corrections(scenes[0].truth, [0], [2])
