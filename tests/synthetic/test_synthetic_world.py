"""The world is what it says: rays meet the first surface, exactly, seen in two independent ways."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stereomate.errors import CrsError, InputError
from stereomate.frames.factors import grid_factors
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.synthetic.making import make_world
from stereomate.synthetic.options import SurveyOptions
from stereomate.terrain.model import HeightModel


def rays_of_photograph(survey, number, count, seed=0):
    """Random pixels of a photograph as origins and unit directions in the tangent frame."""
    photograph = survey.survey.photographs[number]
    rng = np.random.default_rng(seed)
    pixels = rng.uniform(0.0, 1.0, (count, 2)) * photograph.camera.size_px
    rays = photograph.camera.rays_from_image(pixels) @ photograph.orientation.object_from_camera.T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    return pixels, np.array(photograph.orientation.centre), rays


def inside_objects(world, points):
    """Whether map points (n, 3) lie in a building or crown, by their values; -1 or the object's number."""
    found = np.full(len(points), -1)
    for number, house in enumerate(world.buildings):
        dx, dy = points[:, 0] - house.centre[0], points[:, 1] - house.centre[1]
        u = np.cos(house.azimuth) * dx + np.sin(house.azimuth) * dy
        v = np.cos(house.azimuth) * dy - np.sin(house.azimuth) * dx
        roof = house.eaves + (house.ridge - house.eaves) * (1.0 - np.abs(v) / house.half_width)
        within = (np.abs(u) < house.half_length) & (np.abs(v) < house.half_width)
        found[within & (points[:, 2] < roof) & (points[:, 2] > house.base)] = number
    for number, tree in enumerate(world.trees):
        distance = np.hypot(points[:, 0] - tree.centre[0], points[:, 1] - tree.centre[1])
        share = (points[:, 2] - tree.crown_base) / (tree.top - tree.crown_base)
        if tree.conifer:
            radius = tree.radius * (1.0 - share)
        else:
            radius = tree.radius * np.sqrt(np.maximum(1.0 - (2.0 * share - 1.0) ** 2, 0.0))
        within = (distance < radius) & (share > 0.0) & (share < 1.0)
        found[within] = len(world.buildings) + number
    return found


def test_rays_end_on_the_terrain_to_a_micrometre(small_survey):
    world = small_survey.world
    for number in range(len(small_survey.survey.photographs)):
        _, origin, rays = rays_of_photograph(small_survey, number, 2000, number)
        hits = world.first_hit(origin, rays)
        assert np.isfinite(hits.distances).all()
        ground = hits.kind == "terrain"
        assert ground.mean() > 0.6
        rigorous = world.map_from_tangent(origin + rays * hits.distances[:, None])
        # map coordinates of 1e6 m carry 1e-9 m
        assert np.abs(rigorous - hits.points).max() < 2e-7
        assert np.abs(world.height(rigorous[ground, :2]) - rigorous[ground, 2]).max() < 1e-6


def test_polynomial_states_its_error(small_survey):
    world = small_survey.world
    rng = np.random.default_rng(3)
    rows, cols = world.heights.shape
    step = world.options.terrain_step_m
    share = rng.uniform(0.0, 1.0, (500, 3)) * [(cols - 1) * step, -(rows - 1) * step, 300.0]
    points = share + np.array([*world.origin, 280.0])
    error = np.abs(world.polynomial(world.tangent_from_map(points)) - (points - world.polynomial.origin))
    assert error.max() <= 1.5 * max(world.polynomial.error_m, 2e-9)
    assert world.polynomial.error_m < 1e-6


@pytest.mark.parametrize("number", [0, 4])
def test_nothing_stands_before_the_first_hit(small_survey, number):
    """Walk along each ray in steps of 10 cm, by the rigorous transformation and the objects as values."""
    world = small_survey.world
    _, origin, rays = rays_of_photograph(small_survey, number, 150, 11)
    # half of the rays at the village and the wood
    targets = np.concatenate([small_survey.roof_corners(), small_survey.tree_tops()])
    aimed = world.tangent_from_map(targets + np.array([0.4, 0.3, -0.5])) - origin
    rays = np.concatenate([rays, aimed / np.linalg.norm(aimed, axis=-1, keepdims=True)])
    hits = world.first_hit(origin, rays)
    rays, distances = rays[np.isfinite(hits.distances)], hits.distances[np.isfinite(hits.distances)]
    kinds = hits.kind[np.isfinite(hits.distances)]
    assert {"terrain", "building", "tree"} <= set(kinds.tolist())
    back = np.arange(0.1, 60.0, 0.1)
    walked = world.map_from_tangent(origin + rays[:, None] * (distances[:, None] - back)[..., None])
    flat = walked.reshape(-1, 3)
    assert (flat[:, 2] > world.height(flat[:, :2])).all()
    assert (inside_objects(world, flat) == -1).all()


def test_hits_on_objects_lie_on_their_surfaces(small_survey):
    world = small_survey.world
    origin = np.array(small_survey.survey.photographs[1].orientation.centre)
    targets = np.concatenate([small_survey.roof_corners(), small_survey.tree_tops()]) + np.array(
        [0.3, -0.2, -0.6]
    )
    rays = world.tangent_from_map(targets) - origin
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    hits = world.first_hit(origin, rays)
    objects = np.isin(hits.kind, ["building", "tree"])
    assert objects.sum() > 50
    number = np.where(hits.kind == "tree", hits.number + len(world.buildings), hits.number)[objects]

    def at(offset):
        points = world.map_from_tangent(origin + rays[objects] * (hits.distances[objects, None] + offset))
        return inside_objects(world, points)

    # grazing rays cross a crown within a few centimetres: 0.1 mm decides for them as well
    assert (at(-1e-5) == -1).all()
    assert (at(1e-5) == number).mean() > 0.98


def test_the_mask_of_open_ground_misses_no_object(small_survey):
    """Photographs are rendered with the search for objects left out on open ground: never an object there."""
    world = small_survey.world
    for number in (0, 2, 5):
        _, origin, rays = rays_of_photograph(small_survey, number, 20000, 5)
        hits = world.first_hit(origin, rays)
        tangent = origin + rays * hits.distances[:, None]
        assert np.isfinite(tangent).all()
        objects = hits.kind != "terrain"
        # the ground behind each object hit
        without = world.scene.objects._replace(cell_items=np.empty(0, dtype=np.int32))
        bare = replace(world, scene=world.scene._replace(objects=without)).first_hit(origin, rays)
        assert (bare.kind == "terrain").all()
        assert not world.is_open(bare.points[objects, :2]).any()


def test_misses_are_said(small_survey):
    world = small_survey.world
    origin = np.array(small_survey.survey.photographs[0].orientation.centre)
    hits = world.first_hit(origin, [[0.0, 0.0, 1.0], [1.0, 0.0, 0.001], [5.0, 0.0, -0.1]])
    assert np.isnan(hits.distances).all()
    assert (hits.kind == "nothing").all()
    assert (hits.number == -1).all()


def test_visibility_is_symmetric_with_the_first_hit(small_survey):
    world = small_survey.world
    _, origin, rays = rays_of_photograph(small_survey, 3, 3000, 8)
    hits = world.first_hit(origin, rays)
    assert world.is_visible(origin, hits.points).all()
    objects = hits.kind != "terrain"
    below = np.concatenate(
        [hits.points[objects, :2], world.height(hits.points[objects, :2])[:, None]], axis=-1
    )
    # the ground plumb under a roof or crown that the ray hits at its top is hidden by it
    deep = hits.points[objects, 2] - below[:, 2] > 4.0
    assert deep.sum() > 20
    assert world.is_visible(origin, below[deep]).mean() < 0.2


def test_height_model_is_the_terrain_under_bilinear_interpolation(small_survey):
    world = small_survey.world
    model = HeightModel.from_array(
        world.heights.astype(np.float32).astype(np.float64),
        world.affine,
        MapFrame(world.options.crs, HeightSystem.ellipsoidal()),
    )
    rng = np.random.default_rng(2)
    xy = np.array(world.options.centre) + rng.uniform(-250.0, 250.0, (5000, 2))
    assert np.abs(model.heights_at(xy) - world.height(xy)).max() < 1e-9


def test_surface_model_holds_roofs_and_crowns(small_survey):
    world = small_survey.world
    surface = world.surface_model()
    assert (surface >= world.heights - 1e-9).all()
    rows, cols = world.heights.shape
    step = world.options.terrain_step_m
    col, row = np.meshgrid(np.arange(cols), np.arange(rows))
    nodes = np.stack([col * step + world.origin[0], world.origin[1] - row * step], axis=-1)
    above = np.concatenate([nodes.reshape(-1, 2), surface.reshape(-1, 1)], axis=-1)
    # at each node the surface is where things end: inside just below, nothing just above
    raised = (surface > world.heights + 0.01).ravel()
    assert raised.sum() > 50
    assert (inside_objects(world, above[raised] - [0.0, 0.0, 1e-6]) >= 0).all()
    assert (inside_objects(world, above + np.array([0.0, 0.0, 1e-6])) == -1).all()


def test_houses_stand_on_the_ground(small_survey):
    world = small_survey.world
    assert len(world.buildings) >= 10
    for house in world.buildings:
        ground = world.height(house.corners()[:, :2])
        assert house.base < ground.min()
        assert house.eaves > ground.max() + 2.5
        assert house.corners().shape == ((6, 3) if house.ridge > house.eaves else (4, 3))


def test_the_map_is_far_from_cartesian(small_survey):
    tau, gamma = grid_factors(small_survey.options.crs, *small_survey.options.centre)
    assert abs(np.degrees(gamma)) > 4.0
    assert abs(tau - 1.0) > 1e-3


def test_relief_is_as_ordered():
    for seed in range(3):
        world = make_world(SurveyOptions(seed=seed, relief_m=80.0, size_px=(400, 300), buildings=4, trees=5))
        assert np.ptp(world.heights) == pytest.approx(80.0, abs=1e-3)
        assert world.heights.mean() == pytest.approx(300.0, abs=0.01)
        slopes = np.hypot(*np.gradient(world.heights, 2.0))
        assert np.percentile(slopes, 90) > 0.1
    flat = make_world(SurveyOptions(relief_m=0.0, size_px=(400, 300), buildings=0, trees=0))
    assert np.ptp(flat.heights) == 0.0
    assert (flat.is_open(np.array([flat.options.centre]))).all()


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"strips": 0}, "strips"),
        ({"gsd_m": float("nan")}, "gsd_m"),
        ({"forward_overlap": 1.0}, "forward_overlap"),
        ({"relief_m": 600.0}, "relief_m"),
        ({"size_px": (8, 100)}, "size_px"),
        ({"noise_dn": -1.0}, "noise_dn"),
    ],
)
def test_options_that_cannot_be(change, field):
    with pytest.raises(InputError, match=field):
        SurveyOptions(**change)


@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:3035", "EPSG:2048", "EPSG:5513"])
def test_a_map_that_cannot_carry_a_world(crs):
    with pytest.raises(CrsError):
        make_world(SurveyOptions(crs=crs, centre=(10.0, 47.0)))


def test_a_block_too_large_for_one_polynomial():
    with pytest.raises(CrsError, match="too large"):
        make_world(
            SurveyOptions(
                gsd_m=20.0,
                flying_height_m=30000.0,
                relief_m=100.0,
                terrain_step_m=500.0,
                buildings=0,
                trees=0,
            )
        )


def test_clear_ground_is_seen_from_every_photograph_that_covers_it(small_survey):
    """Nothing stands before clear ground; close to objects something does."""
    world = small_survey.world
    rng = np.random.default_rng(6)
    points = world.on_ground(np.array(world.options.centre) + rng.uniform(-150.0, 150.0, (3000, 2)))
    clear = world.is_clear(points[:, :2])
    assert 0.1 < clear.mean() < 0.9
    assert (world.is_open(points[:, :2]) <= clear).all()
    hidden = 0
    for number, photograph in enumerate(small_survey.survey.photographs):
        _, inside = small_survey.project(number, points)
        seen = world.is_visible(photograph.orientation.centre, points)
        assert seen[clear & inside].all()
        hidden += int((~seen & inside).sum())
    assert hidden > 20
