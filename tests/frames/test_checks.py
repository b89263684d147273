"""Coordinates at the gate."""

import numpy as np
import pytest

from stereomate.errors import CrsError, HeightSystemError
from stereomate.frames.checks import check_coordinates, check_height_units
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame

ELLIPSOIDAL = HeightSystem.ellipsoidal()


@pytest.mark.parametrize(
    ("crs", "good"),
    [
        ("EPSG:2154", (815_000.0, 6_285_000.0)),
        ("EPSG:25832", (600_000.0, 5_600_000.0)),
        ("EPSG:2053", (94_952.0, 2_899_340.0)),
        ("EPSG:2263", (985_000.0, 200_000.0)),
        ("EPSG:4326", (151.2, -33.9)),
        ("EPSG:3832", (7_000_000.0, 5_000_000.0)),
        ("EPSG:3031", (900_000.0, -1_500_000.0)),
        ("+proj=tmerc +lat_0=0 +lon_0=25 +k=1 +x_0=0 +y_0=0 +ellps=WGS84", (-55_094.0, -3_727_407.0)),
    ],
)
def test_coordinates_in_the_area_pass(crs, good):
    check_coordinates(MapFrame(crs, ELLIPSOIDAL), [good, (np.nan, np.nan)], "points")


@pytest.mark.parametrize(
    ("crs", "bad", "reason"),
    [
        ("EPSG:2154", (6_285_000.0, 815_000.0), "x and y exchanged"),
        ("EPSG:2053", (-94_952.0, -2_899_340.0), "both signs changed"),
        ("EPSG:5513", (-1_043_000.0, -743_000.0), "both signs changed"),
        ("EPSG:2263", (985_000.0 * 0.3048, 200_000.0 * 0.3048), "coordinates in metres"),
        ("EPSG:2154", (815_000.0 / 0.3048, 6_285_000.0 / 0.3048), "coordinates in feet"),
        ("EPSG:4326", (-33.9, 151.2), "x and y exchanged"),
    ],
)
def test_mistakes_are_found_and_named(crs, bad, reason):
    frame = MapFrame(crs, ELLIPSOIDAL)
    with pytest.raises(CrsError, match=f"1 of 1 projection centres lie outside .* inside with {reason}"):
        check_coordinates(frame, [(*bad, 100.0)], "projection centres", "eo.csv")


def test_somewhere_else_is_said_with_the_area():
    frame = MapFrame("EPSG:2154", ELLIPSOIDAL)
    with pytest.raises(
        CrsError, match=r"eo\.csv: crs: 1 of 2 points lie outside the area of RGF93.*latitude 41"
    ):
        check_coordinates(frame, [(815_000.0, 6_285_000.0), (3.0e6, 9.9e6)], "points", "eo.csv")


def test_heights_in_feet():
    ground = np.array([100.0, 250.0, 400.0])
    check_height_units(ground + 1.0, ground, "control points")
    check_height_units([5.0], [1.5], "control points")  # too low to tell
    with pytest.raises(HeightSystemError, match="look like feet"):
        check_height_units(ground / 0.3048, ground, "control points", "gcp.csv")
    with pytest.raises(HeightSystemError, match="others are in feet"):
        check_height_units(ground, ground / 0.3048, "control points")
