"""The form of the project file: what it takes, what it refuses and how it says so, and its versions."""

from __future__ import annotations

import copy
import re
import tomllib
from pathlib import Path

import pytest

from stereomate.errors import FormatError, ProjectError
from stereomate.frames.heights import HeightSystem
from stereomate.project.orientations import Reading, read_orientations
from stereomate.project.reading import parse_project
from stereomate.project.schema import (
    CameraSection,
    ControlSection,
    DistortionSection,
    OrientationSection,
    PhotosSection,
    ProductsSection,
    ProjectSection,
    TerrainSection,
)
from stereomate.rectify.options import RectifyOptions

PAGE = Path(__file__).parents[2] / "docs" / "project_file.md"
NAME = Path("p.toml")

# The form of version 1 as it was first written. It must work for ever; do not edit it.
FROZEN_1 = """
[project]
format = 1                    # version of this form; absent means 1
name = "ngi"
crs = "+proj=tmerc +lat_0=0 +lon_0=25 +k=1 +x_0=0 +y_0=0 +ellps=WGS84 +units=m"   # anything pyproj takes
heights = "undeclared"

[[camera]]
name = "DMC"
principal_distance_mm = 120.0
size_px = [640, 1152]
sensor_mm = [92.16, 165.888]            # or pixel_pitch_mm
principal_point_mm = [0.0, 0.0]         # or principal_point_px
# rotation = 0
# distortion = { model = "brown", k1 = 0.0, ... }

[photos]
files = "*_RGB.tif"
orientation = "ngi_xyz_opk.csv"         # filename, x, y, z, omega, phi, kappa in degrees
angles = "grid"
adjusted_in = "grid"

[terrain]
file = "dem.tif"

[products]
gsd = 5.0
law = "logarithmic"                      # or "linear", "natural"
"""


@pytest.fixture
def document():
    return tomllib.loads(FROZEN_1)


def changed(document, path: str, value: object):
    result = copy.deepcopy(document)
    *parents, last = path.split(".")
    place = result
    for part in parents:
        place = place[int(part) if part.isdigit() else part]
    place[last] = value
    return result


def test_frozen_form_1(document):
    file = parse_project(document, NAME)
    assert file.project.format == 1
    assert file.camera[0].sensor_mm == (92.16, 165.888)
    assert (file.photos.angles, file.photos.adjusted_in) == ("grid", "grid")
    assert (file.products.gsd, file.products.law) == (5.0, "logarithmic")


def test_absent_format_means_1(document):
    del document["project"]["format"]
    assert parse_project(document, NAME).project.format == 1


@pytest.mark.parametrize("version", [2, 99])
def test_newer_form_names_both(document, version):
    with pytest.raises(FormatError, match=rf"form {version}.*form 1"):
        parse_project(changed(document, "project.format", version), NAME)


@pytest.mark.parametrize("version", ["1", 0, 1.5, True])
def test_form_that_is_no_version(document, version):
    with pytest.raises(FormatError, match=r"project\.format"):
        parse_project(changed(document, "project.format", version), NAME)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("photos.angels", "grid", r"p\.toml: photos\.angels: is not a key.*did you mean angles\?"),
        ("camera.0.focal", 1.0, r"camera\[1\]\.focal: is not a key"),
        ("surprise", {}, r"surprise: is not a key.*known keys: project, camera"),
        (
            "photos.angles",
            "gird",
            r'photos\.angles: must be "grid", "local", "tangent" or "rph", got \'gird\'',
        ),
        ("products.gsd", "5", r"products\.gsd: must be a number, got '5'"),
        ("products.gsd", True, r"products\.gsd: must be a number"),
        ("products.rotation", "up", r'products\.rotation: must be "auto", "north-up" or degrees'),
        ("products.bounds", [1, 2, 3], r"products\.bounds: has too few values"),
        ("products.bounds", [1, 2, 3, 4, 5], r"products\.bounds: has too many values"),
        ("camera.0.size_px", [640.5, 2], r"camera\[1\]\.size_px\[1\]: must be a whole number, got 640\.5"),
        ("camera.0.size_px", [0, 2], r"camera\[1\]\.size_px\[1\]: must be greater than 0, got 0"),
        ("camera.0.pixel_pitch_mm", 0.1, r"camera\[1\]: only one of sensor_mm and pixel_pitch_mm"),
        ("camera.0.rotation", 45, r"camera\[1\]\.rotation: must be 0, 90, 180 or 270, got 45"),
        ("camera.0.distortion", {"model": "brown", "s1": 1.0}, r"s1 is no coefficient of the brown model"),
        (
            "camera.0.distortion",
            {"model": "fisheye", "units": "mm"},
            r"units has a meaning only with the brown",
        ),
        ("camera", {"name": "x"}, r"camera: must be written as \[\[camera\]\]"),
        ("photos", 3, r"photos: must be a table, got 3"),
        ("photos.files", 3, r"photos\.files: must be a pattern or a list of patterns"),
        ("photos.angles", "tangent", r"photos: origin = \[lon, lat, h\] must be given"),
        ("photos.mount", "gimbal", r'mount has a meaning only with angles = "rph"'),
        (
            "photos.compare",
            {"orientation": "o", "anglse": "grid"},
            r"photos\.compare\.anglse.*did you mean angles",
        ),
        ("terrain.heights", "ellipsoidal", r"terrain\.heights cannot declare a system"),
        ("photos.heights", "EPSG:5773", r"photos\.heights cannot declare a system"),
        ("terrain.level", 3.0, r"terrain: only one of file and level"),
        ("project.tangent_origin", [1.0, 2.0], r"project\.tangent_origin: has too few values"),
    ],
)
def test_wrong_keys(document, path, value, message):
    with pytest.raises(ProjectError, match=message):
        parse_project(changed(document, path, value), NAME)


@pytest.mark.parametrize("key", ["project.crs", "project.heights"])
def test_required_keys(document, key):
    section, name = key.split(".")
    del document[section][name]
    with pytest.raises(ProjectError, match=rf"{section}\.{name}: must be given"):
        parse_project(document, NAME)


def test_without_orientation_a_project_can_be_oriented_but_not_run(document, tmp_path):
    del document["photos"]["orientation"]
    file = parse_project(document, NAME)
    assert file.photos.orientation == ""
    reading = Reading(NAME, "photos", tmp_path, file.project.crs, HeightSystem.undeclared())
    with pytest.raises(ProjectError, match=r"photos\.orientation: must be given.*stereomate orient"):
        read_orientations(file.photos, reading)
    with pytest.raises(ProjectError, match=r"photos\.compare\.orientation must be given"):
        parse_project(changed(document, "photos.compare", {"crs": "EPSG:4326"}), NAME)


def test_all_that_is_wrong_is_named(document):
    wrong = changed(changed(document, "photos.angles", 1), "products.law", "cubic")
    with pytest.raises(ProjectError, match=r"photos\.angles.*also wrong: products\.law"):
        parse_project(wrong, NAME)


def test_products_section_is_the_options_of_the_engine():
    """The schema has the types, RectifyOptions the rules: same keys, same defaults."""
    files = {"area", "sheets", "breaklines", "seam_file", "law_table", "pairs"}
    keys = set(ProductsSection.model_fields) - files
    # The law's table is a file here, its two columns there.
    assert keys == set(RectifyOptions.__dataclass_fields__) - {"law_heights_m", "law_parallaxes_m"}
    section, options = ProductsSection(), RectifyOptions()
    assert {key: getattr(section, key) for key in keys} == {key: getattr(options, key) for key in keys}


def test_documented_examples_parse():
    blocks = re.findall(r"```toml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    whole, compare = (tomllib.loads(block) for block in blocks)
    assert parse_project(whole, PAGE).project.name == "ngi"
    whole["project"]["heights"] = "ellipsoidal"
    whole["photos"]["compare"] = compare["photos"]["compare"]
    assert parse_project(whole, PAGE).photos.compare is not None


@pytest.mark.parametrize(
    "section",
    [
        ProjectSection,
        CameraSection,
        DistortionSection,
        PhotosSection,
        OrientationSection,
        TerrainSection,
        ControlSection,
        ProductsSection,
    ],
)
def test_every_key_is_documented(section):
    page = PAGE.read_text(encoding="utf-8")
    coefficient = re.compile(r"[kpbs]\d|tau[xy]")
    missing = [key for key in section.model_fields if f"`{key}`" not in page and f"photos.{key}" not in page]
    assert [key for key in missing if not coefficient.fullmatch(key)] == []
