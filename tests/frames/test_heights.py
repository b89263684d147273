"""Height systems: geoid grids, vertical CRS with and without their grid, undeclared heights."""

import subprocess
import sys

import numpy as np
import pytest
import rasterio
from geoid_files import bilinear_surface, write_geotiff, write_gtx
from rasterio.transform import Affine

from stereomate.errors import CrsError, HeightSystemError, MissingGridError
from stereomate.frames.crs import geodetic_of
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_map, map_from_tangent, tangent_from_map
from stereomate.raster.grids import read_geoid_grid


@pytest.mark.parametrize(("write", "name"), [(write_gtx, "g.gtx"), (write_geotiff, "g.tif")])
def test_grid_files_give_the_surface_they_hold(tmp_path, write, name):
    system = HeightSystem.grid_file(write(tmp_path / name))
    rng = np.random.default_rng(1)
    lon, lat = rng.uniform(-2.0, 4.0, 500), rng.uniform(43.0, 47.0, 500)
    lon[:4], lat[:4] = (-2.0, 4.0, -2.0, 4.0), (43.0, 43.0, 47.0, 47.0)
    h = system.ellipsoidal_from_system(lon, lat, np.full(500, 100.0))
    # float32 undulations of about 40 m are rounded to 2e-6 m
    np.testing.assert_allclose(h, 100.0 + bilinear_surface(lon, lat), rtol=0, atol=4e-6)
    np.testing.assert_allclose(system.system_from_ellipsoidal(lon, lat, h), 100.0, rtol=0, atol=1e-12)
    # The same point, written a turn further east or west.
    np.testing.assert_allclose(system.ellipsoidal_from_system(lon + 360.0, lat, 100.0), h, atol=1e-9)


@pytest.mark.parametrize(("lon", "lat"), [(-2.01, 45.0), (4.01, 45.0), (0.0, 42.99), (0.0, 47.01)])
def test_a_grid_that_does_not_cover_is_an_error_that_says_where(tmp_path, lon, lat):
    system = HeightSystem.grid_file(write_gtx(tmp_path / "g.gtx"))
    with pytest.raises(HeightSystemError, match=r"g\.gtx.*does not cover longitude.*-2\.0000 to 4\.0000"):
        system.ellipsoidal_from_system([0.0, lon], [45.0, lat], [0.0, 0.0])
    # NaN in, NaN out: no point was asked.
    assert np.isnan(system.ellipsoidal_from_system(np.nan, np.nan, np.nan))


def test_nodes_without_data_are_not_covered(tmp_path):
    path = write_geotiff(tmp_path / "g.tif", nodata=-9999.0)
    with rasterio.open(path, "r+") as out:
        values = out.read(1)
        values[8, 12] = -9999.0
        out.write(values, 1)
    system = HeightSystem.grid_file(path)
    with pytest.raises(HeightSystemError, match="does not cover"):
        system.ellipsoidal_from_system(1.1, 45.1, 0.0)
    assert np.isfinite(system.ellipsoidal_from_system(1.6, 45.1, 0.0))


def test_a_grid_around_the_earth_is_continuous_at_its_seam(tmp_path):
    lon = np.arange(0.0, 360.0, 15.0)
    values = np.broadcast_to(20.0 * np.cos(np.deg2rad(lon)), (13, 24)).astype(np.float32)
    path = tmp_path / "world.tif"
    profile = {"driver": "GTiff", "height": 13, "width": 24, "count": 1, "dtype": "float32"}
    profile |= {"crs": "EPSG:4326", "transform": Affine(15, 0, -7.5, 0, -15, 97.5)}
    with rasterio.open(path, "w", **profile) as out:
        out.write(values, 1)
    system = HeightSystem.grid_file(path)
    middle = 0.5 * (values[0, 0] + values[0, 23])
    for where in (352.5, -7.5):
        assert system.ellipsoidal_from_system(where, 10.0, 0.0) == pytest.approx(middle, abs=1e-6)


def test_files_that_are_no_geoid_are_refused(tmp_path):
    with pytest.raises(MissingGridError, match=r"absent\.tif.*not on this machine"):
        HeightSystem.grid_file(tmp_path / "absent.tif")
    with pytest.raises(FileNotFoundError):
        HeightSystem.from_text("absent.gtx", tmp_path)
    (tmp_path / "broken.tif").write_bytes(b"nothing")
    with pytest.raises(HeightSystemError, match="not a readable geoid grid"):
        HeightSystem.grid_file(tmp_path / "broken.tif")
    with pytest.raises(HeightSystemError, match="longitude and latitude"):
        HeightSystem.grid_file(write_geotiff(tmp_path / "utm.tif", crs="EPSG:25832"))
    path = write_geotiff(tmp_path / "dem.tif")
    with rasterio.open(path, "r+") as out:
        out.write(out.read(1) + 1000.0, 1)
    with pytest.raises(HeightSystemError, match="stay below"):
        HeightSystem.grid_file(path)


def test_a_vertical_crs_without_its_grid_names_the_grid():
    system = HeightSystem.vertical_crs("EPSG:5773")
    with pytest.raises(MissingGridError, match=r"us_nga_egm96_15\.tif.*not on this machine"):
        system.ellipsoidal_from_system(10.0, 50.0, 100.0)
    frame = MapFrame("EPSG:25832", HeightSystem.vertical_crs("EPSG:7837"))
    with pytest.raises(MissingGridError, match="de_bkg_gcg2016"):
        frame.geodetic_from_map((600_000.0, 5_600_000.0, 100.0))
    with pytest.raises(MissingGridError):
        frame.map_from_geodetic((9.0, 50.0, 100.0))


def test_vertical_systems_that_cannot_be_reached_are_errors():
    with pytest.raises(HeightSystemError, match="must be a vertical CRS"):
        HeightSystem.vertical_crs("EPSG:25832")
    with pytest.raises(CrsError, match="known to PROJ"):
        HeightSystem.from_text("EPSG:999999")
    # A datum that is not named cannot carry a geoid.
    bare = MapFrame("+proj=utm +zone=32 +ellps=GRS80", HeightSystem.vertical_crs("EPSG:5773"))
    with pytest.raises(HeightSystemError, match="declared datum"):
        bare.geodetic_from_map((600_000.0, 5_600_000.0, 100.0))
    # Baltic heights have no transformation from RD New's datum.
    odd = MapFrame("EPSG:28992", HeightSystem.vertical_crs("EPSG:5774"))
    with pytest.raises(HeightSystemError, match="EPSG:5774"):
        odd.geodetic_from_map((155_000.0, 463_000.0, 100.0))


VERTICAL_CRS_SCRIPT = """
import sys
import numpy as np
import pyproj
folder, own = sys.argv[1:]
pyproj.datadir.append_data_dir(folder)
from stereomate.frames.crs import geodetic_of
from stereomate.frames.heights import HeightSystem
through_proj = HeightSystem.vertical_crs("EPSG:5773")
through_file = HeightSystem.grid_file(own)
rng = np.random.default_rng(1)
lon, lat = rng.uniform(-1.9, 3.9, 300), rng.uniform(43.1, 46.9, 300)
h = rng.uniform(0.0, 3000.0, 300)
a = through_proj.ellipsoidal_from_system(lon, lat, h)
b = through_file.ellipsoidal_from_system(lon, lat, h)
back = through_proj.system_from_ellipsoidal(lon, lat, a)
print(np.abs(a - b).max(), np.abs(back - h).max(), np.abs(a - h).min())
"""


def test_a_vertical_crs_with_its_grid_agrees_with_the_grid_read_directly(tmp_path):
    """Two ways: PROJ's pipeline for EPSG:5773 with a grid of the name it asks for, and our interpolation."""
    path = write_geotiff(tmp_path / "us_nga_egm96_15.tif")
    done = subprocess.run(
        [sys.executable, "-c", VERTICAL_CRS_SCRIPT, str(tmp_path), str(path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    difference, back, undulation = map(float, done.stdout.split())
    assert difference < 1e-8
    assert back < 1e-8
    assert undulation > 30.0


def test_units_of_height():
    feet = HeightSystem.ellipsoidal(0.3048)
    assert feet.ellipsoidal_from_system(0.0, 0.0, 1000.0) == pytest.approx(304.8, rel=1e-15)
    assert feet.system_from_ellipsoidal(0.0, 0.0, 304.8) == pytest.approx(1000.0, rel=1e-15)


def test_undeclared_heights_are_taken_as_they_are():
    """Also across datums: only the plan moves."""
    undeclared = HeightSystem.undeclared()
    old, new = MapFrame("EPSG:31467", undeclared), MapFrame("EPSG:25832", undeclared)
    xyz = np.array([3_500_000.0, 5_500_000.0, 123.456])
    moved = map_from_map(new, old, xyz)
    assert moved[2] == 123.456
    assert 50.0 < np.hypot(*(moved[:2] - (500_000.0, 5_498_000.0))) < 5000.0
    declared = map_from_map(
        MapFrame("EPSG:25832", HeightSystem.ellipsoidal()),
        MapFrame("EPSG:31467", HeightSystem.ellipsoidal()),
        xyz,
    )
    assert abs(declared[2] - 123.456) > 10.0  # the ellipsoids lie tens of metres apart
    np.testing.assert_allclose(declared[:2], moved[:2], atol=1e-3)


def test_from_text_and_descriptions(tmp_path):
    write_gtx(tmp_path / "g.gtx")
    assert HeightSystem.from_text("ellipsoidal") == HeightSystem.ellipsoidal()
    assert HeightSystem.from_text("undeclared").kind == "undeclared"
    assert HeightSystem.from_text("EPSG:5773").description == "EGM96 height (EPSG:5773)"
    grid = HeightSystem.from_text("g.gtx", tmp_path)
    assert grid == HeightSystem.grid_file(tmp_path / "g.gtx")
    assert "g.gtx" in grid.description
    assert "undeclared" in HeightSystem.undeclared().description


@pytest.mark.real
def test_raf20_against_proj(data_folder):
    """The French geoid grid: our reading against PROJ's vgridshift of the same file."""
    import pyproj

    path = data_folder / "ign_borea_A" / "fr_ign_RAF20.tif"
    grid = read_geoid_grid(path)
    assert grid.values.shape == (381, 421)
    assert "RAF20" in grid.description
    system = HeightSystem.grid_file(path)
    rng = np.random.default_rng(2)
    lon, lat = rng.uniform(-5.4, 8.4, 2000), rng.uniform(42.1, 51.4, 2000)
    pipeline = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
        f"+step +inv +proj=vgridshift +grids={path} +multiplier=1 "
        "+step +proj=unitconvert +xy_in=rad +xy_out=deg"
    )
    expected = pipeline.transform(lon, lat, np.full(2000, 700.0))[2]
    found = system.system_from_ellipsoidal(lon, lat, np.full(2000, 700.0))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7)

    frame = MapFrame("EPSG:2154", system)
    tangent = TangentFrame.at_map(frame, (815_000.0, 6_285_000.0, 0.0))
    points = rng.uniform(-8000.0, 8000.0, (1000, 3))
    there = map_from_tangent(tangent, frame, points)
    np.testing.assert_allclose(tangent_from_map(tangent, frame, there), points, rtol=0, atol=1e-8)
    assert geodetic_of("EPSG:2154").declared
