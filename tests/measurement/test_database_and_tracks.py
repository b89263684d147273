"""The measurement database, read by COLMAP too, and tie points without contradictions."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from stereomate.errors import FormatError, InputError, StorageError
from stereomate.geometry.rotations import rotation_from_opk
from stereomate.measurement.database import CameraRow, ImageRow, MeasurementDatabase, PairRow
from stereomate.measurement.features import Features
from stereomate.measurement.matching import Matches
from stereomate.measurement.tracks import PairMatches, ThinningOptions, TiePoints, join_matches, thin

CAMERAS = {1: CameraRow(1, (4000, 2250), (2300.0, 2310.0, 2000.5, 1124.0))}
IMAGES = [ImageRow(1, "a.jpg", 1), ImageRow(2, "b.jpg", 1), ImageRow(3, "c.jpg", 1)]


def features(seed: int, count: int = 50) -> Features:
    rng = np.random.default_rng(seed)
    descriptors = np.sqrt(rng.dirichlet(np.ones(128), count)).astype(np.float32)
    pixels = rng.uniform([0, 0], [4000, 2250], (count, 2)).astype(np.float32).astype(np.float64)
    return Features(pixels, rng.uniform(3, 9, count), rng.uniform(0, 6, count), np.ones(count), descriptors)


def matches(rows: np.ndarray) -> Matches:
    return Matches(rows[:, 0], rows[:, 1], np.zeros(len(rows)), np.zeros(len(rows)))


def filled(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rows = np.array([[0, 3], [4, 2], [7, 7]])
    base = np.array([0.8, -0.6, 0.0])
    turn = rotation_from_opk([0.02, -0.03, 3.1])
    with MeasurementDatabase.open(path) as database:
        database.set_photographs(CAMERAS, IMAGES)
        database.set_positions({1: (46.8, -91.99, 198.0)})
        for image in IMAGES:
            database.put_features(image.image_id, features(image.image_id), "key", {"found": 50})
        database.put_pair(PairRow(1, 2, rows[:2], base, turn), matches(rows), "key", {"agree": 2})
        database.put_pair(PairRow(2, 3, rows[:0]), matches(rows), "key", {"reasons": ["few"]})
    return rows, base, turn


def test_what_is_kept_comes_back(tmp_path: Path) -> None:
    rows, base, turn = filled(tmp_path / "m.db")
    with MeasurementDatabase.open(tmp_path / "m.db") as database:
        assert database.images() == tuple(IMAGES)
        assert database.cameras() == CAMERAS
        back, given = database.features(2), features(2)
        np.testing.assert_allclose(back.pixels, given.pixels, atol=1e-3)
        np.testing.assert_allclose(back.size_px, given.size_px, rtol=1e-6)
        assert (back.descriptors * given.descriptors).sum(axis=1).min() > 0.9995
        first, second = database.pairs()
        assert (first.first, first.second) == (1, 2)
        np.testing.assert_array_equal(first.rows, rows[:2])
        np.testing.assert_allclose(first.base, base, atol=1e-12)
        np.testing.assert_allclose(first.first_from_second, turn, atol=1e-12)
        assert second.base is None
        assert len(second.rows) == 0
        assert database.done("pair")["2-3"] == ("key", {"reasons": ["few"]})


def test_new_features_and_other_photographs_take_what_hung_on_them(tmp_path: Path) -> None:
    filled(tmp_path / "m.db")
    with MeasurementDatabase.open(tmp_path / "m.db") as database:
        database.put_features(3, features(9), "other", {})
        assert [(p.first, p.second) for p in database.pairs()] == [(1, 2)]
        assert set(database.done("pair")) == {"1-2"}
        database.set_photographs(CAMERAS, [IMAGES[0], ImageRow(2, "other.jpg", 1)])
        assert database.pairs() == ()
        assert set(database.done("features")) == {"1"}
        assert [image.name for image in database.images()] == ["a.jpg", "other.jpg"]
        with pytest.raises(InputError, match="no keypoints"):
            database.features(2)


def test_a_transaction_that_breaks_leaves_nothing(tmp_path: Path) -> None:
    filled(tmp_path / "m.db")
    with MeasurementDatabase.open(tmp_path / "m.db") as database:
        before = database.features(1).pixels
        with pytest.raises(TypeError):
            database.put_features(1, features(5), "k", {"not json": object()})
        np.testing.assert_array_equal(database.features(1).pixels, before)
        assert len(database.pairs()) == 2


_COLMAP = """
import sys
import numpy
import pycolmap
database = pycolmap.Database.open(sys.argv[1])
two = database.read_two_view_geometry(1, 2)
pose = two.cam2_from_cam1
image = database.read_image_with_name("b.jpg")
out = [database.num_images(), database.num_keypoints(), image.camera_id,
       *database.read_camera(1).params, *database.read_keypoints(2)[3][:2],
       *numpy.array(two.inlier_matches).reshape(-1), *pose.rotation.matrix().reshape(-1), *pose.translation,
       *two.E.reshape(-1), database.num_matches(), *database.read_all_pose_priors()[0].position]
print(" ".join(repr(float(v)) for v in out))
"""


def test_colmap_reads_it(tmp_path: Path) -> None:
    """Another program reads the same numbers; its epipolar geometry is that of the kept orientation."""
    pytest.importorskip("pycolmap")
    _, base, turn = filled(tmp_path / "m.db")
    run = subprocess.run(
        [sys.executable, "-c", _COLMAP, str(tmp_path / "m.db")], capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    values = [float(v) for v in run.stdout.split()]
    assert values[:7] == [3.0, 150.0, 1.0, 2300.0, 2310.0, 2000.5, 1124.0]
    np.testing.assert_allclose(values[7:9], features(2).pixels[3], atol=1e-3)
    assert values[9:13] == [0, 3, 4, 2]
    rotation, shift = np.array(values[13:22]).reshape(3, 3), np.array(values[22:25])
    essential = np.array(values[25:34]).reshape(3, 3)
    assert values[34] == 6
    assert values[35:38] == [46.8, -91.99, 198.0]
    # A point before both cameras: COLMAP's second coordinates from its first are ours.
    flip = np.diag([1.0, -1.0, -1.0])
    point = np.array([0.3, 0.2, -2.0])
    np.testing.assert_allclose(
        rotation @ (flip @ point) + shift, flip @ (turn.T @ (point - base)), atol=1e-12
    )
    one, other = flip @ point, flip @ (turn.T @ (point - base))
    assert abs((other / other[2]) @ essential @ (one / one[2])) < 1e-12


def test_what_is_no_database_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.db").write_text("no database, but long enough to be looked into" * 100)
    with pytest.raises(FormatError, match="SQLite"):
        MeasurementDatabase.open(tmp_path / "text.db")
    with pytest.raises(FormatError, match="does not exist"):
        MeasurementDatabase.open(tmp_path / "none.db", read_only=True)
    sqlite3.connect(tmp_path / "empty.db").execute("CREATE TABLE t (a)").connection.commit()
    with pytest.raises(FormatError, match="images"):
        MeasurementDatabase.open(tmp_path / "empty.db", read_only=True)
    with pytest.raises(StorageError, match="cannot"):
        MeasurementDatabase.open(tmp_path / "no" / "folder.db")


def test_tie_points_come_back(tmp_path: Path) -> None:
    filled(tmp_path / "m.db")
    rng = np.random.default_rng(0)
    points = TiePoints(
        ("a.jpg", "b.jpg", "c.jpg"),
        np.array([0, 0, 1, 1, 1]),
        np.array([0, 1, 0, 1, 2]),
        rng.uniform(0, 2000, (5, 2)),
        rng.uniform(0.1, 1.0, 5),
        np.array([3, 4, 5, -1, 6]),
    )
    with MeasurementDatabase.open(tmp_path / "m.db") as database:
        database.put_tie_points(points, "key", {})
        back = database.tie_points()
    assert back.photographs == points.photographs
    for name in ("point", "photo", "pixels", "sigma_px", "feature"):
        np.testing.assert_array_equal(getattr(back, name), getattr(points, name))


def test_contradicting_matches_do_not_join() -> None:
    """The better match wins, the one that closes onto another point of the same photograph is refused."""
    pairs = [
        PairMatches(0, 1, np.array([[0, 0], [1, 1]]), np.array([0.3, 0.3])),
        PairMatches(1, 2, np.array([[0, 0], [1, 1]]), np.array([0.3, 0.3])),
        # Point 0 of photograph 2 is said to be point 1 of photograph 0: it is point 0 by way of 1.
        PairMatches(0, 2, np.array([[1, 0]]), np.array([0.9])),
    ]
    tracks = join_matches(pairs)
    assert tracks.contradictions == 1
    assert tracks.point.tolist() == [0, 0, 0, 1, 1, 1]
    assert tracks.photo.tolist() == [0, 1, 2, 0, 1, 2]
    assert tracks.feature.tolist() == [0, 0, 0, 1, 1, 1]
    better = [*pairs[:2], PairMatches(0, 2, np.array([[1, 0]]), np.array([0.1]))]
    tracks = join_matches(better)
    for number in np.unique(tracks.point):
        photos = tracks.photo[tracks.point == number]
        assert len(set(photos.tolist())) == len(photos)
    joined = tracks.point[(tracks.photo == 0) & (tracks.feature == 1)]
    assert joined == tracks.point[(tracks.photo == 2) & (tracks.feature == 0)]


def test_random_matches_never_contradict_and_order_does_not_matter() -> None:
    rng = np.random.default_rng(3)
    pairs = []
    for a in range(5):
        for b in range(a + 1, 5):
            rows = np.column_stack([rng.permutation(40)[:25], rng.permutation(40)[:25]])
            pairs.append(PairMatches(a, b, rows, rng.uniform(size=25)))
    one, other = join_matches(pairs), join_matches(pairs[::-1])
    for name in ("point", "photo", "feature"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert one.contradictions == other.contradictions > 0
    assert len(np.unique(one.point * 10 + one.photo)) == len(one.point)
    assert len(np.unique(one.photo * 100 + one.feature)) == len(one.feature)


def test_thinning_serves_the_standard_positions_and_the_empty_corner() -> None:
    """A crowd in one corner does not crowd out the rest; every standard position keeps some points."""
    rng = np.random.default_rng(1)
    crowd = rng.uniform(0, 400, (3000, 2))
    spread = rng.uniform(0, 4000, (300, 2))
    pixels = np.concatenate([crowd, spread])
    count = len(pixels)
    points = TiePoints(
        ("a", "b"),
        np.repeat(np.arange(count), 2),
        np.tile([0, 1], count),
        np.repeat(pixels, 2, axis=0),
        np.full(2 * count, 0.5),
        np.arange(2 * count),
    )
    kept = thin(points, {0: (4000, 4000), 1: (4000, 4000)}, ThinningOptions(per_photo=120, per_place=4))
    first = kept.pixels[kept.photo == 0]
    assert 100 <= len(first) <= 120
    assert np.count_nonzero((first < 400).all(axis=1)) < 20
    for x in (0.12, 0.5, 0.88):
        for y in (0.12, 0.5, 0.88):
            near = np.abs(first / 4000 - [x, y]).max(axis=1) <= 0.14
            assert np.count_nonzero(near) >= 4, (x, y)
    assert kept.point.tolist() == np.repeat(np.arange(len(first)), 2).tolist()


def test_many_rays_go_before_few() -> None:
    photographs = tuple("abcd")
    rows = [(0, 0), (0, 1), (1, 0), (1, 1), (1, 2), (1, 3)]
    points = TiePoints(
        photographs,
        np.array([p for p, _ in rows]),
        np.array([k for _, k in rows]),
        np.full((6, 2), 50.0),
        np.ones(6),
        np.arange(6),
    )
    kept = thin(points, dict.fromkeys(range(4), (100, 100)), ThinningOptions(1, 1, 1))
    assert len(kept) == 4
    assert kept.rays().tolist() == [4] * 4
