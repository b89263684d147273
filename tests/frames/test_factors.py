"""Scale and convergence against closed forms, axes, units, and what is refused."""

import numpy as np
import pytest

from stereomate.errors import CrsError
from stereomate.frames.factors import (
    effective_scale,
    gauss_radius,
    grid_axes,
    grid_factors,
    grid_factors_geodetic,
    require_conformal,
)
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame

ELLIPSOIDAL = HeightSystem.ellipsoidal()


def conformal_tangent(tan_lat, e):
    """Tangent of the conformal latitude."""
    sigma = np.sinh(e * np.arctanh(e * tan_lat / np.sqrt(1 + tan_lat**2)))
    return tan_lat * np.sqrt(1 + sigma**2) - sigma * np.sqrt(1 + tan_lat**2)


def transverse_mercator_factors(lat_deg, dlon_deg, flattening, k0):
    """Krüger's series to the sixth order in n: point scale and convergence."""
    n = flattening / (2 - flattening)
    alpha = [
        n / 2 - 2 * n**2 / 3 + 5 * n**3 / 16 + 41 * n**4 / 180 - 127 * n**5 / 288 + 7891 * n**6 / 37800,
        13 * n**2 / 48 - 3 * n**3 / 5 + 557 * n**4 / 1440 + 281 * n**5 / 630 - 1983433 * n**6 / 1935360,
        61 * n**3 / 240 - 103 * n**4 / 140 + 15061 * n**5 / 26880 + 167603 * n**6 / 181440,
        49561 * n**4 / 161280 - 179 * n**5 / 168 + 6601661 * n**6 / 7257600,
        34729 * n**5 / 80640 - 3418889 * n**6 / 1995840,
        212378941 * n**6 / 319334400,
    ]
    rectifying = (1 + n**2 / 4 + n**4 / 64 + n**6 / 256) / (1 + n)
    e2 = flattening * (2 - flattening)
    phi, dlon = np.deg2rad(lat_deg), np.deg2rad(dlon_deg)
    t = conformal_tangent(np.tan(phi), np.sqrt(e2))
    xi = np.arctan2(t, np.cos(dlon))
    eta = np.arcsinh(np.sin(dlon) / np.hypot(t, np.cos(dlon)))
    p, q = 1.0, 0.0
    for j, a in enumerate(alpha, 1):
        p = p + 2 * j * a * np.cos(2 * j * xi) * np.cosh(2 * j * eta)
        q = q + 2 * j * a * np.sin(2 * j * xi) * np.sinh(2 * j * eta)
    gamma = np.arctan(t / np.sqrt(1 + t * t) * np.tan(dlon)) + np.arctan2(q, p)
    scale = k0 * rectifying * np.sqrt(1 - e2 * np.sin(phi) ** 2) * np.sqrt(1 + np.tan(phi) ** 2)
    return scale * np.hypot(p, q) / np.hypot(t, np.cos(dlon)), gamma


def lambert_factors(lat_deg, dlon_deg, flattening, lat1_deg, lat2_deg):
    """Lambert conformal conic with two standard parallels."""
    e2 = flattening * (2 - flattening)
    e = np.sqrt(e2)

    def m(phi):
        return np.cos(phi) / np.sqrt(1 - e2 * np.sin(phi) ** 2)

    def t(phi):
        return np.tan(np.pi / 4 - phi / 2) / ((1 - e * np.sin(phi)) / (1 + e * np.sin(phi))) ** (e / 2)

    phi, phi1, phi2 = (np.deg2rad(v) for v in (lat_deg, lat1_deg, lat2_deg))
    n = np.log(m(phi1) / m(phi2)) / np.log(t(phi1) / t(phi2))
    return m(phi1) / m(phi) * (t(phi) / t(phi1)) ** n, n * np.deg2rad(dlon_deg)


def polar_stereographic_factors(lat_deg, lon_deg, flattening, lat_ts_deg):
    """South polar stereographic, true at a latitude."""
    e2 = flattening * (2 - flattening)
    e = np.sqrt(e2)

    def m(phi):
        return np.cos(phi) / np.sqrt(1 - e2 * np.sin(phi) ** 2)

    def t(phi):
        return np.tan(np.pi / 4 - phi / 2) / ((1 - e * np.sin(phi)) / (1 + e * np.sin(phi))) ** (e / 2)

    phi, phi_ts = -np.deg2rad(lat_deg), -np.deg2rad(lat_ts_deg)
    return m(phi_ts) / m(phi) * t(phi) / t(phi_ts), -np.deg2rad(lon_deg)


rng = np.random.default_rng(11)


@pytest.mark.parametrize(
    ("crs", "lon0", "flattening", "k0", "south", "north"),
    [
        ("EPSG:31467", 9.0, 1 / 299.1528128, 1.0, 40.0, 70.0),
        ("EPSG:25832", 9.0, 1 / 298.257222101, 0.9996, 20.0, 80.0),
        ("EPSG:32733", 15.0, 1 / 298.257223563, 0.9996, -80.0, -1.0),
        ("EPSG:2193", 173.0, 1 / 298.257222101, 0.9996, -48.0, -33.0),
    ],
)
def test_transverse_mercator(crs, lon0, flattening, k0, south, north):
    lat, dlon = rng.uniform(south, north, 300), rng.uniform(-4.0, 4.0, 300)
    xyz = MapFrame(crs, ELLIPSOIDAL).map_from_geodetic(np.column_stack([lon0 + dlon, lat, np.zeros(300)]))
    tau, gamma = grid_factors(crs, xyz[:, 0], xyz[:, 1])
    expected = transverse_mercator_factors(lat, dlon, flattening, k0)
    np.testing.assert_allclose(tau, expected[0], rtol=0, atol=1e-11)
    np.testing.assert_allclose(gamma, expected[1], rtol=0, atol=1e-11)


def test_lambert():
    lat, lon = rng.uniform(41.0, 52.0, 300), rng.uniform(-5.0, 10.0, 300)
    tau, gamma = grid_factors_geodetic("EPSG:2154", lon, lat)
    expected = lambert_factors(lat, lon - 3.0, 1 / 298.257222101, 44.0, 49.0)
    np.testing.assert_allclose(tau, expected[0], rtol=0, atol=1e-11)
    np.testing.assert_allclose(gamma, expected[1], rtol=0, atol=1e-11)


def test_polar_stereographic_up_to_the_pole():
    lat, lon = rng.uniform(-89.0, -60.0, 300), rng.uniform(-180.0, 180.0, 300)
    lat[:3] = (-89.95, -89.99, -89.96)  # the stencil passes over the pole
    tau, gamma = grid_factors_geodetic("EPSG:3031", lon, lat)
    expected = polar_stereographic_factors(lat, lon, 1 / 298.257223563, -71.0)
    np.testing.assert_allclose(tau, expected[0], rtol=0, atol=1e-10)
    # Grid north lies along the meridian of Greenwich: gamma is minus the longitude.
    np.testing.assert_allclose(np.exp(1j * gamma), np.exp(1j * expected[1]), rtol=0, atol=1e-10)


def test_against_pyproj_with_its_own_accuracy():
    import pyproj

    lat, lon = rng.uniform(46.0, 47.5, 50), rng.uniform(6.0, 10.4, 50)
    tau, gamma = grid_factors_geodetic("EPSG:21781", lon, lat)
    theirs = pyproj.Proj("EPSG:21781").get_factors(lon, lat)
    np.testing.assert_allclose(tau, theirs.meridional_scale, rtol=0, atol=1e-9)
    np.testing.assert_allclose(gamma, np.deg2rad(theirs.meridian_convergence), rtol=0, atol=1e-9)


def test_axes_and_units_do_not_change_the_factors():
    base = "+proj=tmerc +lat_0=0 +lon_0=9 +k=0.9997 +x_0=0 +y_0=0 +ellps=GRS80"
    expected = grid_factors_geodetic(base, 11.0, 48.0)
    for extra in (
        "+units=us-ft",
        "+units=ft",
        "+axis=wsu",
        "+axis=swu",
        "+axis=neu",
        "+axis=nwu",
        "+axis=esu",
    ):
        found = grid_factors_geodetic(f"{base} {extra}", 11.0, 48.0)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
        frame = MapFrame(f"{base} {extra}", ELLIPSOIDAL)
        x, y, _ = frame.map_from_geodetic((11.0, 48.0, 0.0))
        np.testing.assert_allclose(grid_factors(frame.crs, x, y), expected, rtol=0, atol=1e-12)


def test_sign_of_the_convergence():
    """Positive where grid north lies east of true north: in the northern hemisphere east of the meridian."""
    _, gamma = grid_factors_geodetic("EPSG:25832", np.array([6.5, 9.0, 11.5]), 50.0)
    assert gamma[0] < 0 < gamma[2]
    assert abs(gamma[1]) < 1e-12
    # A step along grid north, seen on the ellipsoid, goes east of north there.
    frame = MapFrame("EPSG:25832", ELLIPSOIDAL)
    a = frame.map_from_geodetic((11.5, 50.0, 0.0))
    b = frame.geodetic_from_map(a + np.array([0.0, 1000.0, 0.0]))
    assert b[0] > 11.5


def test_left_handed_axes():
    assert grid_axes("EPSG:5513").left_handed
    assert not grid_axes("EPSG:2053").left_handed
    assert not grid_axes("EPSG:31467").left_handed  # PROJ has exchanged (north, east)
    np.testing.assert_array_equal(grid_axes("EPSG:2053").working_from_east_north, -np.eye(2))
    # 5513 counts x south and y west; the working frame is (west, south): east-north turned by 180 degrees.
    np.testing.assert_array_equal(grid_axes("EPSG:5513").working_from_east_north, -np.eye(2))


@pytest.mark.parametrize(
    ("crs", "reason"),
    [
        ("EPSG:4326", "not projected"),
        ("EPSG:3857", "not conformal"),
        ("EPSG:3035", "not conformal"),
        ("+proj=cass +lat_0=0 +lon_0=25 +ellps=WGS84", "not conformal.*676 ppm"),
        ("+proj=eqc +lat_ts=48 +lon_0=9 +ellps=GRS80", "not conformal"),
    ],
)
def test_refused_with_a_reason(crs, reason):
    with pytest.raises(CrsError, match=reason):
        grid_factors(crs, 0.0, 0.0)
    with pytest.raises(CrsError, match=reason):
        MapFrame(crs, ELLIPSOIDAL).require_conformal()


@pytest.mark.parametrize(
    "crs",
    [
        "EPSG:28992",
        "EPSG:27700",
        "EPSG:5514",
        "EPSG:2056",
        "EPSG:3395",
        "EPSG:29873",
        "EPSG:27200",
        "EPSG:5041",
    ],
)
def test_conformal_maps_of_many_kinds(crs):
    require_conformal(crs)


def test_points_outside_are_refused_and_shapes_kept():
    with pytest.raises(CrsError, match="outside the domain"):
        grid_factors("EPSG:2154", 1e30, 1e30)
    tau, gamma = grid_factors("EPSG:2154", np.full((2, 3), 7e5), np.full((2, 3), 6.6e6))
    assert tau.shape == gamma.shape == (2, 3)
    tau, gamma = grid_factors("EPSG:2154", [7e5, np.nan], [6.6e6, np.nan])
    assert np.isnan(tau[1])
    assert np.isnan(gamma[1])


def test_effective_scale():
    radius = float(gauss_radius(6378137.0, 1 / 298.257222101, 48.0))
    assert effective_scale(1.0, 1000.0, radius) == pytest.approx(1 - 1.567e-4, abs=1e-7)
    a, f = 6378137.0, 1 / 298.257222101
    e2 = f * (2 - f)
    s = np.sin(np.deg2rad(48.0))
    meridian, prime = a * (1 - e2) / (1 - e2 * s * s) ** 1.5, a / np.sqrt(1 - e2 * s * s)
    assert radius == pytest.approx(np.sqrt(meridian * prime), rel=1e-14)
