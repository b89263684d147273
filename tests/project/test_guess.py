"""`convert orientation --guess`: what a file leaves open, decided by points, or refused with the reason."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from stereomate.cli import main
from stereomate.errors import CrsError, FormatError, ProjectError
from stereomate.formats.declared import Declared
from stereomate.formats.exchange import FORMATS, convert_orientation
from stereomate.formats.orientation_set import converted
from stereomate.frames.adjusted import grid_from_space_centres
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.prediction.plan import FlightPlan
from stereomate.project.guess import guess_declared
from stereomate.synthetic.deliveries import write_delivery

CRS = "EPSG:25832"


def plan_at(easting, tilt_deg, height=1500.0):
    at = (easting, 5_400_000.0)
    return FlightPlan(CRS, *at, height, 300.0, 0.06 * height, heading_deg=70.0, tilt_deg=tilt_deg)


@pytest.fixture(scope="module")
def east(tmp_path_factory):
    """Tilted photographs 100 km east of the central meridian: every convention makes a difference."""
    folder, plan = tmp_path_factory.mktemp("east"), plan_at(600_000.0, 3.0)
    return folder, plan, write_delivery(folder, plan).true


def write(east, name, format_, orientations=None, axes="grid", **wanted):
    folder, _, true = east
    orientations = orientations or true
    place = orientations.place
    FORMATS[format_].write(folder / name, converted(orientations, place, axes), Declared(crs=CRS, **wanted))
    return folder / name


def test_axes_unit_heights_and_adjustment(east, capsys):
    """Angles in gon about true north, centres as a grid adjustment leaves them: found, said, made right."""
    folder, plan, true = east
    adjusted = replace(true, positions=grid_from_space_centres(plan.frame, true.positions, 330.0))
    source = write(east, "open.csv", "table", adjusted, "local", unit="gon")
    text = "\n".join(line for line in source.read_text().splitlines() if not line.startswith("#"))
    source.write_text(text + "\n")
    arguments = [source, folder / "out.csv", "--from", "table", "--to", "table", "--to-axes", "grid"]
    with pytest.raises(SystemExit) as end:
        main.run(["convert", "orientation", *map(str, arguments), "--from-crs", CRS])
    assert end.value.code == 2
    assert "about which axes its angles turn (declare one of: grid" in capsys.readouterr().err
    with pytest.raises(SystemExit) as end:
        main.run(["convert", "orientation", *map(str, arguments), "--guess"])
    assert end.value.code == 2
    assert "--evidence: must be given" in capsys.readouterr().err
    with pytest.raises(SystemExit) as end:
        main.run(
            [
                "convert",
                "orientation",
                *map(str, arguments),
                "--evidence",
                str(folder / "project.toml"),
                "--json",
            ]
        )
    assert end.value.code == 0
    notes = json.loads(capsys.readouterr().out)["notes"]
    assert any("guessed axes local, unit gon" in note and "practically certain" in note for note in notes)
    assert any("guessed heights: the orientation's heights are ellipsoidal" in note for note in notes)
    assert any("guessed centres: the centres come from an adjustment in the grid" in note for note in notes)
    back = FORMATS["table"].read(
        folder / "out.csv", Declared(crs=CRS, heights=HeightSystem.ellipsoidal(), axes="grid", unit="deg")
    )
    np.testing.assert_allclose(back.rotations, true.rotations, atol=1e-9)
    # The control lies at 300 to 400 m: its mean is what the scale is taken to act about.
    np.testing.assert_allclose(back.positions, true.positions, atol=0.02)


def test_direction_of_matrices(east):
    folder, _, _ = east
    for direction in ("camera_from_object", "object_from_camera"):
        source = write(east, "open.ori", "patb", matrix=direction)
        declared = Declared(crs=CRS, heights=HeightSystem.ellipsoidal())
        found = guess_declared(source, "patb", declared, folder / "project.toml")
        assert (found.declared.axes, found.declared.matrix) == ("grid", direction)
        assert found.grid_reference_height is None
        assert any("centres are read as true positions" in note for note in found.notes)


def test_phi_first_is_found_behind_usual_columns(east):
    folder, _, _ = east
    source = write(east, "open.csv", "table", order="pok")
    found = guess_declared(source, "table", Declared(crs=CRS), folder / "project.toml")
    assert (found.declared.order, found.declared.axes, found.declared.unit) == ("pok", "grid", "deg")


@pytest.mark.slow
def test_what_no_declaration_can_say_is_named(east):
    folder, _, true = east
    flipped = replace(true, rotations=true.rotations @ np.diag([1.0, -1.0, -1.0]))
    source = write(east, "open.csv", "table", flipped)
    with pytest.raises(
        FormatError, match=r"do not meet \(they would meet to 0.* px with .*camera axes x right, y down"
    ):
        guess_declared(source, "table", Declared(crs=CRS), folder / "project.toml")


def test_undecidable_is_refused_with_the_readings_that_fit(tmp_path):
    """A low flight on the central meridian, where grid north is true north: nothing tells the two."""
    made = write_delivery(tmp_path, plan_at(500_000.0, 0.0, 20.0))
    source = tmp_path / "orientation.csv"
    assert made.written.names == made.true.names
    match = r"cannot be guessed: .*axes (grid|local), unit deg \(.* px\); axes (grid|local).*differ by"
    with pytest.raises(FormatError, match=match):
        guess_declared(source, "table", Declared(crs=CRS), tmp_path / "project.toml")


def test_evidence_without_observations(east, tmp_path):
    source = write(east, "open.csv", "table")
    project = (source.parent / "project.toml").read_text()
    (tmp_path / "bare.toml").write_text(project[: project.index("[observations]")])
    with pytest.raises(ProjectError, match=r"observations: must be given.*tie or control points"):
        guess_declared(source, "table", Declared(crs=CRS), tmp_path / "bare.toml")


def test_a_frame_that_is_elsewhere(east):
    folder, _, true = east
    moved = replace(true, place=MapFrame(CRS, true.place.heights), positions=true.positions[:, [1, 0, 2]])
    source = write(east, "open.csv", "table", moved)
    with pytest.raises(CrsError, match="x and y exchanged"):
        guess_declared(source, "table", Declared(crs=CRS), folder / "project.toml")


@pytest.mark.real
def test_a_real_delivery_with_three_errors(data_folder, tmp_path):
    """Gon for degrees, feet for metres, heights above a geoid nobody named, and an adjustment in the grid."""
    for file in (data_folder / "ign_borea_A").iterdir():
        shutil.copyfile(file, tmp_path / file.name)
    (tmp_path / "project.toml").write_text(
        '[project]\ncrs = "EPSG:2154"\nheights = "ellipsoidal"\n[[camera]]\nname = "UCE-M3-f120-s06"\n'
        "size_px = [26460, 17004]\nprincipal_distance_px = 30975.0\nprincipal_point_px = [13210.0, 8502.0]\n"
        '[photos]\nfiles = "*.jp2"\norientation = "not_looked_at.OPK"\n'
        '[control]\nfile = "gcp_ellipsoidal.app"\n[observations]\n'
        'files = ["tie_points.mes", "gcp_image.mes"]\npoints = "tie_points_world_ellipsoidal.mes"\n'
    )
    head, *rows = (tmp_path / "eo_lambert93_ign69.OPK").read_text().splitlines()
    spoilt = [head]
    for row in rows:
        name, x, y, z, *angles, camera = row.split()
        angles = [f"{float(angle) / 0.9:.12f}" for angle in angles]
        spoilt.append("\t".join([name, x, y, f"{float(z) / 0.3048:.4f}", *angles, camera]))
    (tmp_path / "spoilt.OPK").write_text("\n".join(spoilt) + "\n")
    declared = Declared(crs="EPSG:2154")
    found = guess_declared(tmp_path / "spoilt.OPK", "ign-opk", declared, tmp_path / "project.toml")
    assert (found.declared.axes, found.declared.unit) == ("grid", "gon")
    assert found.declared.heights == HeightSystem.grid_file(tmp_path / "fr_ign_RAF20.tif", 0.3048)
    made = convert_orientation(
        tmp_path / "spoilt.OPK",
        tmp_path / "out.csv",
        "ign-opk",
        "table",
        found.declared,
        Declared(crs="EPSG:2154", heights=HeightSystem.ellipsoidal()),
        (found.grid_reference_height, None),
    ).written
    # What the delivery means: its heights over RAF20, freed of (tau_e - 1) H = 0.486 m.
    first = made.positions[made.names.index("23FD1305x00026_01300")]
    np.testing.assert_allclose(first[:2], (814963.604, 6285490.639), atol=1e-6)
    assert first[2] == pytest.approx(1821.445, abs=0.01)
