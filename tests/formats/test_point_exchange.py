"""Points, clouds and meshes from a tangent frame to the map grid: exactly, whatever file they are in."""

from __future__ import annotations

import numpy as np
import pytest

from stereomate.errors import CrsError, FormatError
from stereomate.formats import points_text
from stereomate.formats.orientation_set import GeocentricFrame
from stereomate.formats.point_exchange import convert_points
from stereomate.formats.point_move import PointMove
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_tangent

GRID = MapFrame("EPSG:32632", HeightSystem.ellipsoidal())
FRAME = TangentFrame.at_geodetic(GRID.geodetic, 11.5, 48.1, 500.0)
MOVE = PointMove(FRAME, GRID)
POINTS = np.random.default_rng(8).uniform((-5000, -5000, -50), (5000, 5000, 100), (7, 3))
EXPECTED = map_from_tangent(FRAME, GRID, POINTS)


def test_what_one_matrix_does_wrong():
    """A matrix fitted at the origin misses the height by 0.31 m at 2 km, 1.96 m at 5 km."""
    for distance, miss in ((2000.0, -0.31), (5000.0, -1.96)):
        height = MOVE.points(np.array([[distance, 0.0, 0.0]]))[0, 2]
        assert abs((500.0 - height) - miss) < 0.01


def text_of(rows, head=""):
    return head + "".join(f"{row}\n" for row in rows)


@pytest.mark.parametrize(
    ("head", "row", "columns", "places"),
    [
        ("name,x,y,z,colour\n", "p{k},{x!r},{y!r},{z!r},red", None, (1, 2, 3)),
        ("# made\nN;E;H\n", "{y!r};{x!r};{z!r}", None, (1, 0, 2)),
        ("", "{x!r} {y!r} {z!r} 7", None, (0, 1, 2)),
        ("", "{k}\t{z!r}\t{x!r}\t{y!r}", [3, 4, 2], (2, 3, 1)),
    ],
)
def test_text(tmp_path, monkeypatch, head, row, columns, places):
    monkeypatch.setattr(points_text, "_LINES", 3)
    path, out = tmp_path / "a.csv", tmp_path / "b.csv"
    rows = [row.format(k=k, x=x, y=y, z=z) for k, (x, y, z) in enumerate(POINTS.tolist())]
    path.write_text(text_of(rows, head))
    result = convert_points(path, out, MOVE, columns)
    assert result.count == 7
    lines = out.read_text().splitlines()
    body = lines[len(lines) - 7 :]
    separator = next((s for s in "\t;," if s in body[0]), None)
    cells = [line.split(separator) for line in body]
    found = np.array([[float(line[place]) for place in places] for line in cells])
    np.testing.assert_allclose(found, EXPECTED, rtol=0, atol=6e-6)
    others = [k for k in range(len(cells[0])) if k not in places]
    assert [[line[k] for k in others] for line in cells] == [
        [line.split(separator)[k] for k in others] for line in rows
    ]
    assert "".join(f"{line}\n" for line in lines[:-7]) == head


def test_text_offsets_and_back(tmp_path):
    path = tmp_path / "a.xyz"
    np.savetxt(path, POINTS, fmt="%.6f")
    offset = (690000.0, 5330000.0, 0.0)
    convert_points(path, tmp_path / "b.xyz", PointMove(FRAME, GRID, target_offset=offset))
    small = np.loadtxt(tmp_path / "b.xyz")
    np.testing.assert_allclose(small + offset, EXPECTED, rtol=0, atol=1e-5)
    convert_points(tmp_path / "b.xyz", tmp_path / "c.xyz", PointMove(GRID, FRAME, source_offset=offset))
    np.testing.assert_allclose(np.loadtxt(tmp_path / "c.xyz"), POINTS, rtol=0, atol=2e-5)


def normals():
    """Directions along which a point is moved by a metre, at each point."""
    vectors = np.random.default_rng(1).normal(size=POINTS.shape)
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def turned_by_differences():
    """The same after the move, by differences of moved points: another way than rotations."""
    vectors = normals()
    step = 0.5 * vectors
    moved = map_from_tangent(FRAME, GRID, POINTS + step) - map_from_tangent(FRAME, GRID, POINTS - step)
    return moved / np.linalg.norm(moved, axis=1, keepdims=True)


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply(tmp_path, kind):
    header = (
        f"ply\nformat {kind} 1.0\ncomment made\nelement vertex 7\nproperty float x\nproperty float y\n"
        "property float z\nproperty float nx\nproperty float ny\nproperty float nz\nproperty uchar red\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    vectors = normals()
    if kind == "ascii":
        rows = [
            " ".join(f"{v:.9g}" for v in (*p, *n)) + f" {k}"
            for k, (p, n) in enumerate(zip(POINTS, vectors, strict=True))
        ]
        data = ("\n".join(rows) + "\n3 0 1 2\n").encode()
        tail = b"3 0 1 2\n"
    else:
        order = "<" if "little" in kind else ">"
        record = np.zeros(7, dtype=[("p", order + "f4", 6), ("c", "u1")])
        record["p"], record["c"] = np.hstack([POINTS, vectors]), np.arange(7)
        tail = b"\x03" + np.array([0, 1, 2], dtype=order + "i4").tobytes()
        data = record.tobytes() + tail
    path, out = tmp_path / "a.ply", tmp_path / "b.ply"
    path.write_bytes(header.encode() + data)
    assert convert_points(path, out, MOVE).count == 7
    head, body = out.read_bytes().split(b"end_header\n", 1)
    assert head.decode() == header.replace("float x", "double x").replace("float y", "double y").replace(
        "float z", "double z"
    ).removesuffix("end_header\n")
    assert body.endswith(tail)
    if kind == "ascii":
        values = np.array([line.split() for line in body.decode().splitlines()[:7]], dtype=float)
        xyz, turned, colour = values[:, :3], values[:, 3:6], values[:, 6]
    else:
        record = np.frombuffer(
            body, dtype=[("p", order + "f8", 3), ("n", order + "f4", 3), ("c", "u1")], count=7
        )
        xyz, turned, colour = record["p"], record["n"], record["c"]
    exact = POINTS if kind == "ascii" else POINTS.astype(np.float32).astype(float)
    np.testing.assert_allclose(xyz, map_from_tangent(FRAME, GRID, exact), rtol=0, atol=2e-5)
    # The grid is conformal in plan but scales heights otherwise: 5e-4 here.
    np.testing.assert_allclose(turned, turned_by_differences(), atol=6e-4)
    np.testing.assert_array_equal(colour, np.arange(7))


def test_obj(tmp_path):
    vectors = normals()
    lines = ["# made", "mtllib a.mtl"]
    lines += [
        "v " + " ".join(f"{v:.6f}" for v in p) + (" 0.5 0.5 0.5" if k == 0 else "")
        for k, p in enumerate(POINTS)
    ]
    lines += [
        "vt 0.1 0.2",
        "vn " + " ".join(f"{v:.9f}" for v in vectors[0]),
        "f 1/1/1 2/1/1 3/1/1",
        "v 0 0 0",
    ]
    path, out = tmp_path / "a.obj", tmp_path / "b.obj"
    path.write_text("\n".join(lines) + "\n")
    result = convert_points(path, out, MOVE)
    assert result.count == 8
    after = out.read_text().splitlines()
    assert [line for line in after if line[:2] not in ("v ", "vn")] == [
        line for line in lines if line[:2] not in ("v ", "vn")
    ]
    xyz = np.array([line.split()[1:4] for line in after if line.startswith("v ")], dtype=float)
    np.testing.assert_allclose(xyz[:7], EXPECTED, rtol=0, atol=1e-5)
    assert after[2].endswith(" 0.5 0.5 0.5")
    turned = np.array(next(line for line in after if line.startswith("vn ")).split()[1:], dtype=float)
    np.testing.assert_allclose(turned, turned_by_differences()[0], atol=6e-4)


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_las(tmp_path, suffix):
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(point_format=7, version="1.4")
    header.scales, header.offsets = [0.001] * 3, [0.0] * 3
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = POINTS.T
    cloud.red = np.arange(7)
    cloud.gps_time = np.arange(7) / 3.0
    path, out = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    cloud.write(path)
    assert convert_points(path, out, MOVE).count == 7
    back = laspy.read(out)
    rounded = np.stack([cloud.x, cloud.y, cloud.z], axis=-1)
    found = np.stack([back.x, back.y, back.z], axis=-1)
    np.testing.assert_allclose(found, map_from_tangent(FRAME, GRID, rounded), rtol=0, atol=5.1e-4)
    np.testing.assert_array_equal(back.red, np.arange(7))
    np.testing.assert_array_equal(back.gps_time, np.arange(7) / 3.0)
    assert back.header.parse_crs().to_epsg() == 32632
    np.testing.assert_allclose(back.header.maxs, found.max(axis=0), atol=1e-3)


@pytest.mark.real
def test_a_real_cloud_to_geocentric_and_back(tmp_path, data_folder):
    laspy = pytest.importorskip("laspy")
    grid = MapFrame("EPSG:32615", HeightSystem.ellipsoidal())
    source, there, back = data_folder / "brighton_beach" / "model.laz", tmp_path / "g.laz", tmp_path / "b.laz"
    first = convert_points(source, there, PointMove(grid, GeocentricFrame("EPSG:4978")))
    second = convert_points(there, back, PointMove(GeocentricFrame("EPSG:4978"), grid))
    before, after = laspy.read(source), laspy.read(back)
    assert first.count == second.count == len(before.points)
    for axis in "xyz":
        # Two roundings to the resolution of the file.
        np.testing.assert_allclose(getattr(after, axis), getattr(before, axis), rtol=0, atol=2.1e-3)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.csv", "name,a,b\n1,2,3\n", "where x, y, z are"),
        ("a.csv", "x,y,z\n1,2,3\n4,five,6\n", "line 3"),
        ("a.csv", "", "does not say|holds no point"),
        ("a.obj", "v 1 2\n", "line 1"),
        ("a.obj", "f 1 2 3\n", "no vertex"),
        ("a.ply", "obj\n", "header of a PLY"),
        ("a.ply", "ply\nformat ascii 1.0\nelement face 1\nend_header\n", "vertices as its first"),
        (
            "a.ply",
            "ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty int x\n"  # noqa: ISC004
            "property float y\nproperty float z\nend_header\n12345",
            "cut off",
        ),
        ("a.las", "LASF", "no LAS or LAZ"),
        ("a.shp", "", "suffixes"),
    ],
)
def test_malformed_points(tmp_path, name, text, message):
    path = tmp_path / name
    path.write_text(text)
    out = path.with_stem("b")
    with pytest.raises(FormatError, match=message):
        convert_points(path, out, MOVE)
    assert list(tmp_path.iterdir()) == [path]


def test_points_that_lie_nowhere_in_the_map(tmp_path):
    """Local coordinates declared as a map's, and the transformation of datums that was used."""
    (tmp_path / "a.csv").write_text("x,y,z\n1,2,3\n")
    ellipsoidal = HeightSystem.ellipsoidal()
    swiss, etrs = MapFrame("EPSG:2056", ellipsoidal), MapFrame("EPSG:25832", ellipsoidal)
    with pytest.raises(CrsError, match="1 of 1 points lie outside the area of CH1903"):
        convert_points(tmp_path / "a.csv", tmp_path / "b.csv", PointMove(swiss, etrs))
    assert not (tmp_path / "b.csv").exists()
    (tmp_path / "a.csv").write_text("x,y,z\n2600000,1200000,500\n")
    moved = convert_points(tmp_path / "a.csv", tmp_path / "b.csv", PointMove(swiss, etrs))
    assert any("CH1903+ to ETRS89" in note and "0.1 m" in note for note in moved.notes)
