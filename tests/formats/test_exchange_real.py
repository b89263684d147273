"""Orientations of other people through the exchange."""

from __future__ import annotations

import json

import numpy as np
import pytest

from stereomate.formats.declared import Declared
from stereomate.formats.exchange import FORMATS, convert_orientation
from stereomate.formats.orientation_set import GeocentricFrame, converted
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame

pytestmark = pytest.mark.real

ELLIPSOIDAL = HeightSystem.ellipsoidal()


def test_orthority_csv_and_geojson_are_one_orientation(data_folder):
    folder = data_folder / "ngi_strip05"
    table = FORMATS["orthority-csv"].read(folder / "ngi_xyz_opk.csv", Declared())
    document = FORMATS["orthority-geojson"].read(folder / "ngi_ext_param.geojson", Declared())
    assert table.names == document.names
    # The CSV is rounded to millimetres and to 0.001 degrees.
    np.testing.assert_allclose(table.positions, document.positions, atol=6e-4)
    np.testing.assert_allclose(table.rotations, document.rotations, atol=np.deg2rad(1.1e-3))
    # Orthority put longitude and latitude beside them, with its own PROJ.
    features = json.loads((folder / "ngi_ext_param.geojson").read_text())["features"]
    lon_lat = np.array([feature["geometry"]["coordinates"][:2] for feature in features])
    for source, metres in ((document, 1e-5), (table, 1e-3)):
        plain = MapFrame(source.place.crs, ELLIPSOIDAL)
        found = plain.geodetic_from_map(source.positions)[:, :2]
        np.testing.assert_allclose(found, lon_lat, rtol=0, atol=metres / 1.1e5)


def test_orthority_written_again(data_folder, tmp_path):
    folder = data_folder / "ngi_strip05"
    declared = Declared(heights=ELLIPSOIDAL)
    source = FORMATS["orthority-geojson"].read(folder / "ngi_ext_param.geojson", declared)
    for name in ("orthority-csv", "orthority-geojson"):
        result = convert_orientation(
            folder / "ngi_ext_param.geojson", tmp_path / name, "orthority-geojson", name, declared, declared
        )
        assert result.written.names == source.names
        back = FORMATS[name].read(tmp_path / name, declared)
        np.testing.assert_allclose(back.positions, source.positions, atol=1e-6)
        np.testing.assert_allclose(back.rotations, source.rotations, atol=1e-12)


def test_reconstruction_of_odm_is_its_table(data_folder):
    """The frame is told from the measured positions, and the result is what ODM's table says."""
    folder = data_folder / "odm_tuniu"
    declared = Declared(crs="EPSG:32651", heights=ELLIPSOIDAL)
    model = FORMATS["opensfm"].read(folder / "odm" / "opensfm" / "reconstruction.json", declared)
    assert any("projected coordinates minus those of reference_lla" in note for note in model.notes)
    table = FORMATS["orthority-csv"].read(folder / "odm_xyz_opk.csv", declared)
    order = [model.names.index(name) for name in table.names]
    np.testing.assert_allclose(model.positions[order], table.positions, atol=2e-3)
    np.testing.assert_allclose(model.rotations[order], table.rotations, atol=np.deg2rad(1.1e-3))


def test_ign_block_through_every_frame(data_folder, tmp_path):
    """37 orientations in Lambert-93 to geocentric and back, and through files, within their rounding."""
    path = data_folder / "ign_borea_A" / "eo_lambert93_ign69.OPK"
    geoid = HeightSystem.grid_file(data_folder / "ign_borea_A" / "fr_ign_RAF20.tif")
    declared = Declared(crs="EPSG:2154", heights=geoid, axes="grid", unit="deg")
    source = FORMATS["ign-opk"].read(path, declared)
    assert len(source.names) == 37
    assert source.cameras[0] == "UCE-M3-f120-s06"
    there = converted(source, GeocentricFrame(source.place.geodetic.crs))
    np.testing.assert_allclose(np.linalg.norm(there.positions, axis=1), 6.37e6, rtol=2e-3)
    back = converted(there, source.place, "grid")
    np.testing.assert_allclose(back.positions, source.positions, rtol=0, atol=1e-7)
    np.testing.assert_allclose(back.rotations, source.rotations, rtol=0, atol=1e-12)

    wanted = Declared(crs="EPSG:2154", heights=ELLIPSOIDAL, unit="deg")
    result = convert_orientation(path, tmp_path / "out.OPK", "ign-opk", "ign-opk", declared, wanted)
    # The quasigeoid lies 49.33 m above the ellipsoid here (README of the data).
    shift = result.written.positions[:, 2] - source.positions[:, 2]
    assert abs(shift.mean() - 49.33) < 0.1
    # Convergence and axes do not change with the height system.
    again = FORMATS["ign-opk"].read(tmp_path / "out.OPK", wanted_axes(wanted))
    np.testing.assert_allclose(again.rotations, source.rotations, rtol=0, atol=1e-9)


def wanted_axes(declared: Declared) -> Declared:
    return Declared(crs=declared.crs, heights=declared.heights, unit=declared.unit, axes="grid")


def test_exif_of_a_drone_is_close_to_a_nadir_block(data_folder):
    source = FORMATS["exif"].read(data_folder / "brighton_beach" / "images", Declared(heights=ELLIPSOIDAL))
    assert len(source.names) == 18
    np.testing.assert_allclose(source.rotations[:, 2, 2], 1.0, atol=0.01)
    grid = converted(source, Declared(crs="EPSG:32615", heights=ELLIPSOIDAL).place())
    size = np.ptp(grid.positions, axis=0)
    assert 30.0 < size[0] < 300.0
    assert 30.0 < size[1] < 300.0
