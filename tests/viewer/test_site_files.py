"""Served and published files: the same bytes, nothing from outside, whole or not at all, many clients."""

from __future__ import annotations

import concurrent.futures
import contextlib
import dataclasses
import http.client
import io
import json
import re
import shutil
import threading
import urllib.error
import urllib.request
import zlib

import imagecodecs
import numpy as np
import pytest
from browsing import serving
from PIL import Image
from written_surface import write_surface_file

from stereomate.errors import FormatError, InputError
from stereomate.frames.transform import map_from_map, tangent_from_map
from stereomate.raster import open_photo
from stereomate.raster.pyramid import open_pyramid
from stereomate.stereo.product import StereoProduct
from stereomate.stereo.surface_bands import ABOVE, BANDS, JUMP, SIGMA
from stereomate.viewer import server
from stereomate.viewer.binary import decode_floats, encode_floats
from stereomate.viewer.imagery import Stretch, TileReader, stretch_of
from stereomate.viewer.kept import Kept
from stereomate.viewer.lattice import measuring_lattice
from stereomate.viewer.objects import object_heights
from stereomate.viewer.page_files import joined_modules
from stereomate.viewer.points import read_points
from stereomate.viewer.publish import is_site, publish
from stereomate.viewer.server import PublishedFolder
from stereomate.viewer.site import Site, SiteOptions


@pytest.fixture(scope="module")
def published(site, tmp_path_factory):
    out = tmp_path_factory.mktemp("sites") / "a site – ünï"
    made = publish(site, out)
    assert made.files == sum(path.is_file() for path in out.rglob("*"))
    return out


def test_static_site_equals_the_served_one(published, site, address):
    names = list(site.names())
    assert len(set(names)) == len(names)
    assert {path.relative_to(published).as_posix() for path in published.rglob("*") if path.is_file()} == set(
        names
    )
    with serving(PublishedFolder(published)) as static:
        for name in names:
            served, given = raw_get(address, "/" + name), raw_get(static, "/" + name)
            assert served[0] == 200
            assert served == given, name


def test_heights_of_objects_are_a_layer(run_folder, product, tmp_path):
    """Those of this product's own surface only; the version of the files follows it."""
    folder = tmp_path / "out"
    shutil.copytree(run_folder, folder)
    copied = dataclasses.replace(product, folder=folder)
    before = Site([copied])
    assert "data/0/objects.bin" not in set(before.names())
    cols, rows = product.job.grid.size
    step = 3
    size = (-(-cols // step), -(-rows // step))
    row, col = np.mgrid[0 : size[1], 0 : size[0]]
    values = np.full((size[1], size[0], len(BANDS)), np.nan, np.float32)
    values[..., ABOVE] = np.where((row + col) % 7 == 0, 0.01 * row + 0.1 * col, np.nan)
    values[..., SIGMA], values[..., JUMP] = 0.25, (col > 5) * 1.0
    path = folder / "surface.tif"
    write_surface_file(product, path, values, step)
    site = Site([copied])
    assert "data/0/objects.bin" in set(site.names())
    versions = [json.loads(s.read("data/0/product.json"))["version"] for s in (before, site)]
    assert versions[0] != versions[1]
    above, sigma = decode_floats(site.read("data/0/objects.bin")).reshape(2, rows, cols)
    # a product this small has layers of its own pixels: each cell of the surface covers step x step of them
    for c, r in ((0, 7), (7, 0), (4, 10), (20, 15)):
        assert above[r * step + 1, c * step + 1] == pytest.approx(values[r, c, ABOVE], abs=1e-4)
        assert np.isnan(sigma[r * step + 1, c * step + 1]) == (c > 5)
    assert np.isnan(above[1, step + 1])
    for made in (before, site):
        made.close()
    # the surface of other products is passed over where it lies, and refused where it is named
    write_surface_file(product, path, values, step, ortho="0" * 64)
    stale = Site([copied])
    assert "data/0/objects.bin" not in set(stale.names())
    with pytest.raises(FormatError, match="made anew since"):
        Site([copied], SiteOptions(surface=path))


def test_the_highest_object_of_a_cell_counts(product, tmp_path, monkeypatch):
    monkeypatch.setattr("stereomate.viewer.layers.LONGEST", 40)
    cols, rows = product.job.grid.size
    rng = np.random.default_rng(1)
    values = np.full((rows, cols, len(BANDS)), 0.0, np.float32)
    values[..., ABOVE] = np.where(rng.random((rows, cols)) < 0.5, rng.uniform(-3, 30, (rows, cols)), np.nan)
    values[..., SIGMA] = values[..., ABOVE] + 100.0
    path = tmp_path / "surface.tif"
    write_surface_file(product, path, values, 1)
    above, sigma = object_heights(product, path)
    step = -(-max(cols, rows) // 40)
    assert above.shape == (-(-rows // step), -(-cols // step))
    for r, c in ((0, 0), (3, 5), (above.shape[0] - 1, above.shape[1] - 1)):
        block = values[r * step : (r + 1) * step, c * step : (c + 1) * step, ABOVE]
        assert above[r, c] == np.nanmax(block)
        assert sigma[r, c] == pytest.approx(above[r, c] + 100.0)


def test_published_twice_and_never_over_other_things(published, site, tmp_path):
    assert is_site(published)
    before = {p: p.stat().st_size for p in published.rglob("*") if p.is_file()}
    publish(site, published)
    assert {p: p.stat().st_size for p in published.rglob("*") if p.is_file()} == before
    (tmp_path / "mine.txt").write_text("x")
    with pytest.raises(InputError, match="new, empty, or a site"):
        publish(site, tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]


def test_publishing_that_fails_leaves_nothing(site, tmp_path):
    class Failing:
        def names(self):
            return site.names()

        def read(self, name):
            if name.startswith("data/0/"):
                raise FormatError("damaged", file=name)
            return site.read(name)

    with pytest.raises(FormatError):
        publish(Failing(), tmp_path / "out")  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []


def raw_get(address: str, path: str, host: str | None = None) -> tuple[int, bytes]:
    """A request as it is written: clients that tidy up paths would hide what is tested."""
    _, _, place = address.rstrip("/").partition("//")
    with contextlib.closing(http.client.HTTPConnection(place, timeout=60)) as connection:
        connection.putrequest("GET", path, skip_host=host is not None)
        if host is not None:
            connection.putheader("Host", host)
        connection.endheaders()
        answer = connection.getresponse()
        return answer.status, answer.read()


OUTSIDE = (
    "/../stereo.json", "/data/../../stereo.json", "/%2e%2e/stereo.json", "/..%2fstereo.json", "/stereo.json",
    "/data/0/../../../x", "//etc/passwd", "/%2fetc/passwd", "/data/0/ortho.tif", "/data/0/ortho/0/-1_0.jpg",
    "/data/1/product.json", "/data//x", "/.hidden", "/data/0/ortho/99/0_0.jpg", "/data/0/ortho/0/999_0.jpg",
    "/..\\..\\x", "/data/0/heights/999_999.bin", "/page/main.js", "/data/0/lineage/900_0.bin",
    "/data/0/homogeneity_7.bin", "/data/%C2%B2/product.json",
)  # fmt: skip


def test_nothing_from_outside(address, published):
    with serving(PublishedFolder(published)) as static:
        (published.parent / "stereo.json").write_text("secret")
        for place in (address, static):
            for path in OUTSIDE:
                status, content = raw_get(place, path)
                assert status == 404, (place, path)
                assert b"secret" not in content


def test_files_are_made_once_for_all_who_ask():
    """Of twenty that ask at once one makes; errors are kept by nobody; what is old goes."""
    made, gate = [], threading.Event()

    def make(name):
        made.append(name)
        gate.wait(5.0)
        if name == "bad":
            raise KeyError(name)
        return name.encode() * 10

    kept = Kept(len, capacity=800)
    with concurrent.futures.ThreadPoolExecutor(20) as pool:
        answers = [pool.submit(kept.get, "a", make) for _ in range(20)]
        gate.set()
        assert {answer.result() for answer in answers} == {b"a" * 10}
    assert made == ["a"]
    for _ in range(2):
        with pytest.raises(KeyError):
            kept.get("bad", make)
    assert made == ["a", "bad", "bad"]
    for k in range(100):
        kept.get(f"{k:02d}", make)
    made.clear()
    kept.get("99", make)
    kept.get("a", make)
    assert made == ["a"]


def test_links_out_of_the_folder_are_refused(published, run_folder, tmp_path):
    copy = tmp_path / "site"
    shutil.copytree(published, copy)
    secret = tmp_path / "secret.txt"
    secret.write_text("secret")
    (copy / "link.txt").symlink_to(secret)
    (copy / "folder").symlink_to(tmp_path)
    with serving(PublishedFolder(copy)) as static:
        assert raw_get(static, "/index.html")[0] == 200
        assert raw_get(static, "/link.txt")[0] == 404
        assert raw_get(static, "/folder/secret.txt")[0] == 404
    # nor does a stereo.json lead out of its folder
    run = tmp_path / "run"
    shutil.copytree(run_folder, run)
    (tmp_path / "ortho.tif").symlink_to(run_folder / "ortho.tif")
    (run / "ortho.tif").unlink()
    (run / "ortho.tif").symlink_to(run_folder / "ortho.tif")
    text = (run / "stereo.json").read_text()
    product = StereoProduct.open(run, verify=False)
    with pytest.raises(FormatError, match="must lie in the folder"):
        Site([product])
    (run / "stereo.json").write_text(text.replace('"ortho.tif"', '"../ortho.tif"'))
    with pytest.raises(FormatError, match="must lie in the folder"):
        Site([StereoProduct.open(run, verify=False)])


def test_headers_and_other_hosts(address):
    with urllib.request.urlopen(address) as answer:
        headers = answer.headers
    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert headers["x-content-type-options"] == "nosniff"
    assert raw_get(address, "/", "127.0.0.1")[0] == 200
    # another name for this machine: a foreign page that reads through the browser
    assert raw_get(address, "/", "evil.example")[0] == 400
    with pytest.raises(urllib.error.HTTPError, match="405") as refused:
        urllib.request.urlopen(address, data=b"x")
    refused.value.close()


@pytest.mark.slow
def test_files_that_were_changed_end_the_server(tmp_path, monkeypatch):
    """They are compared while one looks: the page is there first, and the command says what is wrong."""
    monkeypatch.setattr(server, "CHECK_AFTER_S", 0.3)
    (tmp_path / "index.html").write_text("page")
    answers = []

    def check():
        answers.append(urllib.request.urlopen(address[0]).read())
        raise FormatError("was edited", file="ortho.tif")

    address: list[str] = []
    with concurrent.futures.ThreadPoolExecutor(1) as pool:
        served = pool.submit(server.serve, PublishedFolder(tmp_path), 0, address.append, check)
        with pytest.raises(FormatError, match="was edited"):
            served.result(timeout=30)
    assert answers == [b"page"]


def test_fifty_clients_at_once_and_some_that_drop(address, site):
    folders = ("ortho/", "mate/", "lineage/")
    names = [name for name in site.names() if name[len("data/0/") :].startswith(folders)][:9]
    expected = {name: site.read(name) for name in names}

    def load(number: int) -> list[bool]:
        good = []
        for k, name in enumerate(names[number % 9 :] + names[: number % 9]):
            if number % 5 == 4 and k % 3 == 0:
                # a client that asks and goes away
                connection = http.client.HTTPConnection(address.split("//")[1].rstrip("/"), timeout=60)
                connection.request("GET", "/" + name)
                connection.close()
            else:
                good.append(raw_get(address, "/" + name) == (200, expected[name]))
        return good

    with concurrent.futures.ThreadPoolExecutor(50) as pool:
        answers = list(pool.map(load, range(50)))
    assert len(names) > 6
    assert min(map(len, answers)) > 4
    assert all(all(good) for good in answers)
    assert raw_get(address, "/")[0] == 200


def test_tiles_are_the_pixels_of_the_raster(product):
    source = Site([product], SiteOptions(format="png"))
    with open_photo(product.folder / "ortho.tif") as image:
        pixels, _ = image.read_window(0, 0, *image.size)
        valid, _ = image.read_mask(0, 0, *image.size)
    pixels[~valid] = 0
    tile = np.asarray(Image.open(io.BytesIO(source.read("data/0/ortho/0/0_0.png"))))
    height, width = min(512, pixels.shape[0]), min(512, pixels.shape[1])
    np.testing.assert_array_equal(tile[1 : 1 + height, 1 : 1 + width], pixels[:height, :width])
    if pixels.shape[1] > 512:
        # the apron holds the neighbours
        np.testing.assert_array_equal(tile[1 : 1 + height, 1 + width], pixels[:height, width])
    with pytest.raises(KeyError):
        source.read("data/0/ortho/0/0_0.jpg")
    source.close()


def test_tiles_have_their_neighbours_around_them(tmp_path):
    """At both levels, in every corner; what has no neighbour repeats its edge."""
    import rasterio

    pixels = np.random.default_rng(2).integers(0, 255, (700, 1100, 3), np.uint8)
    size = {"width": 1100, "height": 700, "count": 3, "dtype": "uint8", "tiled": True}
    with rasterio.open(tmp_path / "o.tif", "w", driver="GTiff", **size) as file:
        file.write(np.moveaxis(pixels, -1, 0))
    with open_pyramid(tmp_path / "o.tif") as image:
        tiles = TileReader(image, Stretch((0, 1, 2), (0.0,) * 3, (255.0,) * 3))
        for level in (0, 1):
            whole, _, _ = image.read(level, 0, 0, *image.size(level))
            padded = np.pad(whole, ((1, 1), (1, 1), (0, 0)), mode="edge")
            rows, cols = whole.shape[:2]
            for row in range(-(-rows // 512)):
                for col in range(-(-cols // 512)):
                    place = padded[512 * row : 512 * row + 514, 512 * col : 512 * col + 514]
                    np.testing.assert_array_equal(tiles.read(level, col, row), place)
        for place in ((0, 3, 0), (0, 0, 2), (0, -1, 0)):
            with pytest.raises(KeyError):
                tiles.read(*place)


def test_jpeg_keeps_all_colours(site):
    data = site.read("data/0/ortho/0/0_0.jpg")
    # sampling factors of the frame header: 1 x 1 for each component
    at = data.index(b"\xff\xc0")
    factors = [data[at + 11 + 3 * k] for k in range(3)]
    assert factors == [0x11] * 3
    assert imagecodecs.jpeg_decode(data).shape[2] == 3


def test_sixteen_bits_are_stretched_alike(tmp_path):
    import rasterio

    rng = np.random.default_rng(1)
    values = rng.integers(200, 3000, (3, 40, 50)).astype(np.uint16)
    with rasterio.open(
        tmp_path / "o.tif",
        "w",
        driver="GTiff",
        width=50,
        height=40,
        count=3,
        dtype="uint16",
        photometric="RGB",
    ) as file:
        file.write(values)
    stretch = stretch_of(tmp_path / "o.tif")
    low, high = np.percentile(values.reshape(3, -1), (0.5, 99.5), axis=1)
    np.testing.assert_allclose(stretch.low, low)
    np.testing.assert_allclose(stretch.high, high)
    shown = stretch.apply(np.moveaxis(values, 0, -1))
    expected = np.clip(np.rint(255 * (np.moveaxis(values, 0, -1) - low) / (high - low)), 0, 255)
    np.testing.assert_allclose(shown, expected, atol=1)
    assert Stretch((0,), (0.0,), (1.0,)).apply(np.full((1, 1, 1), np.nan, np.float32)).item() == 0


def test_numbers_as_files():
    values = np.array([2741.123456, np.nan, 2741.2, 3105.987654])
    np.testing.assert_allclose(decode_floats(encode_floats(values)), values, atol=2e-5)
    data = bytearray(encode_floats(values))
    data[-1] ^= 1
    with pytest.raises(zlib.error):
        decode_floats(bytes(data))
    assert np.isnan(decode_floats(encode_floats([np.nan]))).all()


def test_lattice_loses_nothing(product):
    """At places of its own: tangent frame and degrees by the rigorous way, to a hundredth of a millimetre."""
    job = product.job
    lattice = measuring_lattice(job)
    rng = np.random.default_rng(2)
    pixel = rng.uniform((0, 0), job.grid.size, (200, 2))
    height = rng.uniform(*job.height_range, 200)
    found = lattice.at(pixel[:, 0], pixel[:, 1])
    xyh = np.column_stack([job.grid.map_from_pixel(pixel), height])
    exact = tangent_from_map(job.tangent, job.frame, xyh)
    np.testing.assert_allclose(found[:, :3] + height[:, None] * found[:, 3:6], exact, atol=1e-5)
    assert lattice.error_m < 1e-5
    from stereomate.frames.heights import HeightSystem
    from stereomate.frames.mapframe import MapFrame

    world = MapFrame("EPSG:4326", HeightSystem.ellipsoidal())
    flat = MapFrame(job.frame.crs, HeightSystem.ellipsoidal())
    degrees = map_from_map(world, flat, np.column_stack([xyh[:, :2], np.zeros(200)]))
    np.testing.assert_allclose(found[:, 9:], degrees[:, :2], atol=1e-10)


def test_points_are_read_and_refused(product, tmp_path):
    path = tmp_path / "points.csv"
    x, y = product.job.grid.map_from_pixel([10.0, 20.0])
    path.write_text(f"name,x,y,z,type\nA,{x},{y},12.5,check\n")
    site = Site([product], SiteOptions(points=path))
    (point,) = json.loads(site.read("data/0/product.json"))["points"]
    assert point["pixel"] == pytest.approx([10.0, 20.0])
    assert point["type"] == "check"
    assert "residual" not in point
    site.close()
    # residuals of its own, or those that the report of the run states for points of these names
    path.write_text(f"name,x,y,z,vx,vy,vz\nA,{x},{y},12.5,0.01,-0.02,0.03\n")
    assert read_points(path, product.job, tmp_path)[0]["residual"] == [0.01, -0.02, 0.03]
    path.write_text(f"name,x,y,z\nA,{x},{y},12.5\n")
    known = [{"name": "A", "difference_m": [0.1, 0.2, 0.3]}, {"name": "B", "difference_m": [None, None, 0.3]}]
    record = {"format": 1, "kind": "stereomate report", "accuracy": {"check_points": {"points": known}}}
    (tmp_path / "report.json").write_text(json.dumps(record))
    assert read_points(path, product.job, tmp_path)[0]["residual"] == [0.1, 0.2, 0.3]
    path.write_text("name,x,y,z\nA,1,2,high\n")
    with pytest.raises(FormatError, match="row 1: z"):
        Site([product], SiteOptions(points=path)).read("data/0/product.json")


def test_options_are_checked():
    for bad in ({"format": "gif"}, {"quality": 0}, {"object_heights_m": (0.0,)}):
        with pytest.raises(InputError):
            SiteOptions(**bad)


def test_first_picture_is_named_at_once(site):
    """Modules that a browser finds one inside the other are waited for in turn: they are one, and records
    and coarsest tiles are asked for beside it."""
    text = site.read("index.html").decode()
    assert re.findall(r'<script type="module" src="([^"]+)" blocking="render"', text) == ["page.js"]
    assert [name for name in site.names() if name.endswith(".js")] == ["page.js"]
    wanted = re.findall(r'<link rel="preload" as="fetch" href="([^"]+)" crossorigin', text)
    assert wanted[:2] == ["data/products.json", "data/0/product.json"]
    record = json.loads(site.read(wanted[1]))
    top = record["tiles"]["levels"] - 1
    assert wanted[2:] == [
        f"data/0/{eye}/{top}/0_0.jpg?v={record['version']}" for eye in record["tiles"]["eyes"]
    ]
    assert {name.partition("?")[0] for name in wanted} <= set(site.names())


def test_modules_are_joined_or_refused():
    modules = {
        "main.js": "import { a, b as c } from './x/one.js';\nc(a);\n",
        "x/one.js": "import { d } from '../two.js';\n// note\nexport const a = d;\nexport function b() {}\n",
        "two.js": "export class d {}\n",
    }
    text = joined_modules(modules, "main.js")
    assert re.findall(r"^(?:import|export|//).*", text, re.MULTILINE) == []
    assert re.findall(r"^const (module_\w+) =", text, re.MULTILINE) == ["module_two", "module_x_one"]
    assert "const { a, b: c } = module_x_one;\nc(a);" in text
    for name, change, message in (
        (
            "two.js",
            "import { a } from './x/one.js';\nexport class d {}\n",
            "imports itself: main.js > x/one.js > ",
        ),
        ("two.js", "export class e {}\n", "imports d, which two.js does not export"),
        ("two.js", "export class d {}\nexport default d;\n", "not joined"),
        ("main.js", "import { a } from './three.js';\n", "does not exist"),
    ):
        with pytest.raises(FormatError, match=message):
            joined_modules(modules | {name: change}, "main.js")
