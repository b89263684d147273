"""Cross-sections of a project's height model: points, factors, the model before, images without texture."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
from pyproj import Transformer

from stereomate.cli import main
from stereomate.errors import FormatError, InputError
from stereomate.project import load
from stereomate.project.orientation_sections import ProjectSectionOptions, project_sections
from stereomate.relative.overcorrection import overcorrection_factor

NGI = """
[project]
crs = "+proj=tmerc +lat_0=0 +lon_0=25 +k=1 +x_0=0 +y_0=0 +ellps=WGS84 +units=m"
heights = "undeclared"
[[camera]]
name = "DMC"
principal_distance_mm = 120.0
size_px = [640, 1152]
sensor_mm = [92.16, 165.888]
[photos]
files = "{folder}/*_RGB.tif"
orientation = "{folder}/ngi_xyz_opk.csv"
angles = "grid"
adjusted_in = "grid"
[terrain]
file = "{folder}/dem.tif"
"""


def with_third(small):
    """A third photograph, so that two pairs of a strip share one."""
    random = np.random.default_rng(3)
    pixels = random.integers(0, 255, (40, 60, 3), dtype=np.uint8)
    tifffile.imwrite(small.folder / "photo_3.tif", pixels, photometric="rgb")
    lines = (small.folder / "orientation.csv").read_text().splitlines()
    _, x, *rest = lines[-1].split(",")
    lines.append(",".join(["photo_3.tif", str(float(x) + 24.0), *rest]))
    (small.folder / "orientation.csv").write_text("\n".join(lines) + "\n")
    return load(small.path)


def test_sections_of_a_small_project(small):
    project = load(small.path)
    (pair,) = project_sections(project, ProjectSectionOptions(texture_radius_px=2))
    assert pair.names == ("photo_1", "photo_2")
    assert pair.base_m == pytest.approx(24.0, rel=1e-3)
    assert pair.sections.under(0.0) is not None
    assert pair.sections.under(1.0) is not None
    assert pair.verdict == "near critical"  # photographs of ±4° across: n is about 112 on flat ground
    photos = project.survey.photographs
    for section, points, points_map in zip(pair.sections.sections, pair.points, pair.points_map, strict=True):
        three = section.strength.section
        assert section.strength.factor == overcorrection_factor(three)
        ground = project.require_heights().heights_at(points_map[:, :2])
        np.testing.assert_allclose(points_map[:, 2], ground, atol=1e-3)
        for photo in photos:
            _, inside = photo.camera.image_from_camera(photo.orientation.camera_from_tangent(points))
            assert inside.all()
        # Independent of the terrain code: y and z from the base line by vector algebra.
        a, b = (np.array(photo.orientation.centre) for photo in photos)
        along = (b - a) / np.linalg.norm(b - a)
        foot = a + section.place * (b - a)
        np.testing.assert_allclose((points - foot) @ along, 0.0, atol=1e-6)
        np.testing.assert_allclose(
            np.linalg.norm(points - foot, axis=1), np.linalg.norm(three, axis=1), rtol=1e-9
        )


def test_one_pair_on_request(small):
    project = with_third(small)
    options = ProjectSectionOptions(texture_radius_px=2, profiles=3)
    everything = project_sections(project, options)
    assert len(everything) == 3
    (pair,) = project_sections(project, options, ("photo_3", "photo_2"))
    assert pair.names == ("photo_2", "photo_3")
    with pytest.raises(InputError, match="pair"):
        project_sections(project, options, ("photo_3", "photo_9"))


def test_section_from_the_model_before(small):
    pairs = {
        pair.names: pair
        for pair in project_sections(with_third(small), ProjectSectionOptions(texture_radius_px=2))
    }
    pair = pairs["photo_2", "photo_3"]
    assert pair.previous == "photo_1"
    assert pair.from_previous is not None
    # Nearly the section that the height model gives there.
    assert pair.from_previous.strength.factor == pytest.approx(
        pair.sections.under(0.0).strength.factor, rel=0.3
    )
    assert pairs["photo_1", "photo_2"].previous is None


def test_water_is_avoided(small):
    """A photograph without contrast on one side: points are taken elsewhere."""
    pixels = tifffile.imread(small.folder / "photo_2.tif").copy()
    pixels[30:] = 90  # the lowest quarter of the photograph, the south side of the strip
    tifffile.imwrite(small.folder / "photo_2.tif", pixels, photometric="rgb")
    project = load(small.path)
    dry = ProjectSectionOptions(texture_radius_px=2)
    (pair,) = project_sections(project, dry)
    (blind,) = project_sections(project, ProjectSectionOptions(least_contrast=0.0))
    photo = project.survey.photographs[1]
    for geometry, allowed in ((pair, False), (blind, True)):
        rows = [
            photo.camera.image_from_camera(photo.orientation.camera_from_tangent(points))[0][:, 1]
            for points in geometry.points
        ]
        assert (np.concatenate(rows) > 32.5).any() == allowed


def test_no_point_on_water_polygons(small):
    """A lake in the north of the strip, in longitude and latitude: its shore is kept, and check agrees."""
    (dry,) = project_sections(load(small.path), ProjectSectionOptions(least_contrast=0.0))
    assert max(points[:, 1].max() for points in dry.points_map) > 5400012.0
    shore = Transformer.from_crs("EPSG:25832", "EPSG:4326", always_xy=True)
    corners = [(511900, 5400010), (512100, 5400010), (512100, 5400100), (511900, 5400100), (511900, 5400010)]
    ring = [list(shore.transform(*corner)) for corner in corners]
    geometry = {"type": "Polygon", "coordinates": [ring]}
    lake = {"type": "Feature", "properties": {}, "geometry": geometry}
    small.write("lakes.geojson", json.dumps({"type": "FeatureCollection", "features": [lake]}))
    small.replace("project.toml", "[terrain]", '[terrain]\nwater = "lakes.geojson"')
    project = load(small.path)
    assert [i.path.name for i in project.inputs if i.role == "water"] == ["lakes.geojson"]
    (wet,) = project_sections(project, ProjectSectionOptions(least_contrast=0.0))
    assert len(wet.points_map) == len(dry.points_map)
    for points in wet.points_map:
        assert points[:, 1].max() < 5400010.001
    assert wet.sections.strength < dry.sections.strength
    small.replace("project.toml", "lakes.geojson", "none.geojson")
    with pytest.raises(FormatError, match=r"none\.geojson"):
        load(small.path)


def test_no_ground_no_section(small):
    rows, cols = np.mgrid[0:40, 0:40]
    heights = 200.0 + 0.1 * cols
    heights[rows > 17] = np.nan
    small.write_heights(heights)
    project = load(small.path)
    pairs = project_sections(project, ProjectSectionOptions(texture_radius_px=2))
    for pair in pairs:
        for points in pair.points:
            assert np.isfinite(points).all()


def run(*arguments):
    with pytest.raises(SystemExit) as end:
        main.run(["overcorrection", "section", *arguments])
    return end.value.code


def test_command(small, tmp_path, capsys):
    assert run(str(small.path), "--map", str(tmp_path / "map.svg")) == 0
    out = capsys.readouterr().out
    assert out.startswith("photo_1 - photo_2: ")
    assert "1 pairs" in out
    assert (tmp_path / "map.svg").stat().st_size > 3000
    assert run(str(small.path), "--json", "--profiles", "3") == 0
    (value,) = json.loads(capsys.readouterr().out)
    assert value["pair"] == ["photo_1", "photo_2"]
    assert all(np.array(section["points_map"]).shape == (3, 3) for section in value["sections"])
    assert run(str(small.path), "--pair", "photo_1", "photo_7") == 2
    assert "photo_7" in capsys.readouterr().err
    assert run(str(Path("nowhere.toml"))) == 2


@pytest.mark.real
def test_ngi(data_folder, tmp_path):
    folder = data_folder / "ngi_strip05"
    (tmp_path / "project.toml").write_text(NGI.format(folder=folder))
    (pair,) = project_sections(load(tmp_path / "project.toml"))
    assert pair.verdict == "good"
    assert len(pair.sections.sections) == 9
    factors = [section.strength.factor for section in pair.sections.sections]
    # Relief of 150 to 780 m below 4.9 km: within the sums of heights of Table I's flat corner.
    assert 2.0 < min(factors) <= max(factors) < 6.0
    assert pair.sections.flat_factor == pytest.approx(2.3, abs=0.15)
    choices = [section.choice for section in pair.sections.sections]
    assert choices.count("standard") >= 6
