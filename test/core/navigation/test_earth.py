"""Earth model against python-ins, published numbers and the geometry that it stands for."""

import numpy as np
import pytest
from pyins import earth as pyins_earth
from pyins import transform
from scipy.integrate import quad

from insdvl.navigation.geometry import earth

LATITUDES_DEG = [-80.0, -45.0, -1.0, 0.0, 32.0, 60.0, 79.0]


@pytest.mark.parametrize("lat_deg", LATITUDES_DEG)
def test_radii(lat_deg):
    R_N, R_E, _ = pyins_earth.principal_radii(lat_deg, 0.0)
    np.testing.assert_allclose(earth.radii(np.radians(lat_deg)), (R_N, R_E), rtol=1e-12)


@pytest.mark.parametrize("lat_deg", LATITUDES_DEG)
def test_gravity_at_the_ellipsoid(lat_deg):
    ours = earth.gravity(np.radians(lat_deg), 0.0)
    assert ours == pytest.approx(pyins_earth.gravity(lat_deg, 0.0), abs=1e-8)


@pytest.mark.parametrize(("lat_deg", "expected"), [(0.0, 9.7803253359), (90.0, 9.8321849378)])
def test_gravity_of_wgs84_at_equator_and_pole(lat_deg, expected):
    assert earth.gravity(np.radians(lat_deg), 0.0) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("lat_deg", LATITUDES_DEG)
@pytest.mark.parametrize("h", [-5000.0, -5.0, 8000.0])
def test_gravity_grows_with_depth(lat_deg, h):
    """The gradient of python-ins, -2 g / a, leaves out the flattening: less than one per cent."""
    lat = np.radians(lat_deg)
    ours = earth.gravity(lat, h) - earth.gravity(lat, 0.0)
    theirs = pyins_earth.gravity(lat_deg, h) - pyins_earth.gravity(lat_deg, 0.0)
    assert ours == pytest.approx(theirs, rel=0.01)


def test_gravity_gradient_of_geodesy():
    """-0.30877 (1 - 0.00142 sin^2) mGal/m is the normal free-air gradient (Heiskanen, Moritz)."""
    for lat_deg in LATITUDES_DEG:
        lat = np.radians(lat_deg)
        gradient = (earth.gravity(lat, 10.0) - earth.gravity(lat, -10.0)) / 20.0
        assert gradient == pytest.approx(-3.0877e-6 * (1 - 0.00142 * np.sin(lat) ** 2), rel=5e-4)


@pytest.mark.parametrize("lat_deg", LATITUDES_DEG)
def test_earth_rate(lat_deg):
    w_ie_n = np.full(3, np.nan)
    earth.earth_rate_n(np.radians(lat_deg), w_ie_n)
    np.testing.assert_allclose(w_ie_n, pyins_earth.rate_n(lat_deg), atol=1e-18)


@pytest.mark.parametrize("lat_deg", LATITUDES_DEG)
def test_transport_rate(lat_deg):
    v_n, w_en_n = np.array([3.0, -7.0, 2.0]), np.full(3, np.nan)
    earth.transport_rate_n(np.radians(lat_deg), -40.0, v_n, w_en_n)
    expected = pyins_earth.curvature_matrix(lat_deg, -40.0) @ v_n
    np.testing.assert_allclose(w_en_n, expected, atol=1e-18)


def test_transport_rate_is_the_turn_of_the_north_east_down_axes():
    """Directions of the axes after a small step over the ellipsoid, from their definition."""
    lat_deg, h, v_n, dt = 32.0, -5.0, np.array([3.0, -7.0, 2.0]), 1.0
    lla = np.array([lat_deg, 34.0, h])
    after = transform.perturb_lla(lla, v_n * dt / 2)
    before = transform.perturb_lla(lla, -v_n * dt / 2)
    turn = transform.mat_en_from_ll(*before[:2]).T @ transform.mat_en_from_ll(*after[:2])
    w_en_n = np.empty(3)
    earth.transport_rate_n(np.radians(lat_deg), h, v_n, w_en_n)
    measured = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    np.testing.assert_allclose(measured / 2 / dt, w_en_n, rtol=1e-6)


@pytest.mark.parametrize("p_north", [-10_000.0, 10_000.0])
def test_a_way_north_is_the_arc_of_the_meridian(p_north):
    start = np.array([np.radians(32.0), 1.0, -5.0])
    place = start.copy()
    assert earth.move(place, np.array([p_north, 0.0, 0.0]))
    arc, _ = quad(lambda x: earth.radii(x)[0] - 5.0, start[0], place[0], epsrel=1e-12)
    assert arc == pytest.approx(p_north, abs=1e-4)


@pytest.mark.parametrize("lat_deg", LATITUDES_DEG)
@pytest.mark.parametrize("size", [1.0, 1e3, 1e5])
def test_a_way_and_back(lat_deg, size):
    """A displacement is what a place was moved by, across the date line as well."""
    start = np.array([np.radians(lat_deg), np.radians(-179.99), -50.0])
    for d_n in size * np.array([[1.0, 2.0, 0.01], [-0.7, -1.9, -0.03], [0.0, 0.0, 0.0]]):
        place, found = start.copy(), np.empty(3)
        assert earth.move(place, d_n)
        assert abs(place[1]) <= np.pi
        earth.displacement(found, start, place)
        np.testing.assert_allclose(found, d_n, atol=1e-8)


def test_no_place_lies_beyond_the_largest_latitude():
    place = np.array([np.radians(89.4), 1.0, 0.0])
    assert not earth.move(place, np.array([1e6, 1e6, 0.0]))
    assert np.degrees(place[0]) == pytest.approx(earth.MAX_LATITUDE_DEG)
    assert np.isfinite(place).all()
