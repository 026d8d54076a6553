"""Earth model: WGS-84 radii, normal gravity, Earth rate and transport rate, all in NED.

A place is (latitude, longitude, height): geodetic, radians and metres above the ellipsoid.

Source: P. D. Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems,
2nd ed., 2013, equations (2.105), (2.106), (2.123), (2.134) and (5.44), and WGS 84 (NIMA TR8350.2).
"""

import numpy as np

from insdvl.arrays import Array
from insdvl.kernels import kernel

SEMI_MAJOR_AXIS = 6378137.0  # m
FLATTENING = 1.0 / 298.257223563
ECCENTRICITY_SQUARED = FLATTENING * (2.0 - FLATTENING)
EARTH_RATE = 7.292115e-5  # rad/s
GRAVITATIONAL_CONSTANT = 3.986004418e14  # m^3/s^2
EQUATOR_GRAVITY = 9.7803253359  # m/s^2
SOMIGLIANA = 0.00193185265241  # (b g_pole - a g_equator) / (a g_equator)
_M = (
    EARTH_RATE**2 * SEMI_MAJOR_AXIS**2 * SEMI_MAJOR_AXIS * (1.0 - FLATTENING)
) / GRAVITATIONAL_CONSTANT


#: Largest latitude, north or south, at which the filter navigates: beyond it north and east turn
#: too fast under the vehicle, and are not defined at the pole (docs/explanation/geodesy.md).
MAX_LATITUDE_DEG = 89.5
MAX_LATITUDE = np.radians(MAX_LATITUDE_DEG)


@kernel
def radii(lat: float) -> tuple[float, float]:
    """Radii of curvature [m] in the meridian (R_N) and the prime vertical (R_E) at a latitude."""
    s = 1.0 - ECCENTRICITY_SQUARED * np.sin(lat) ** 2
    R_E = SEMI_MAJOR_AXIS / np.sqrt(s)
    return R_E * (1.0 - ECCENTRICITY_SQUARED) / s, R_E


@kernel
def gravity(lat: float, h: float) -> float:
    """Normal gravity [m/s^2] at latitude [rad] and height [m]: Somigliana, and Taylor in h."""
    s2 = np.sin(lat) ** 2
    g_0 = EQUATOR_GRAVITY * (1.0 + SOMIGLIANA * s2) / np.sqrt(1.0 - ECCENTRICITY_SQUARED * s2)
    a = SEMI_MAJOR_AXIS
    return g_0 * (
        1.0 - 2.0 / a * (1.0 + FLATTENING * (1.0 - 2.0 * s2) + _M) * h + 3.0 * h**2 / a**2
    )


@kernel
def wrapped(angle: float) -> float:
    """An angle [rad] within +-pi; one that is within already stays as it is."""
    return angle - 2.0 * np.pi * np.round(angle / (2.0 * np.pi))


@kernel
def displacement(d_n: Array, place: Array, to: Array) -> None:
    """Metres north, east and down from a place to another into ``d_n`` (3,).

    Differences of the coordinates times the radii halfway (mid-latitude): for 1 km within 0.01 mm
    of the way over the ellipsoid at 60 deg, for 20 km within 0.1 m.
    """
    lat, h = 0.5 * (place[0] + to[0]), 0.5 * (place[2] + to[2])
    R_N, R_E = radii(lat)
    d_n[0] = (R_N + h) * (to[0] - place[0])
    d_n[1] = (R_E + h) * np.cos(lat) * wrapped(to[1] - place[1])
    d_n[2] = place[2] - to[2]


@kernel
def move(place: Array, d_n: Array) -> bool:
    """Move a place (3,) by metres north, east and down: the inverse of `displacement`.

    Returns:
        Whether it came as far as told: no place lies beyond `MAX_LATITUDE`.
    """
    h, lat_0 = place[2] - 0.5 * d_n[2], place[0]
    lat = lat_0
    for _ in range(4):  # the radius halfway hardly depends on how far it is
        R_N, R_E = radii(0.5 * (lat_0 + lat))
        lat = min(max(lat_0 + d_n[0] / (R_N + h), -MAX_LATITUDE), MAX_LATITUDE)
    place[0] = lat
    place[1] = wrapped(place[1] + d_n[1] / ((R_E + h) * np.cos(0.5 * (lat_0 + lat))))
    place[2] -= d_n[2]
    return abs(lat) < MAX_LATITUDE


@kernel
def _displacements(d_n: Array, places: Array, to: Array) -> None:
    for k in range(d_n.shape[0]):
        displacement(d_n[k], places[k], to[k])


def displacements(places: Array, to: Array) -> Array:
    """Metres (..., 3) north, east and down from places (..., 3) to others, see `displacement`."""
    if places.ndim == to.ndim == 1:
        d_n = np.empty(3)
        displacement(d_n, np.ascontiguousarray(places), np.ascontiguousarray(to))
        return d_n
    places, to = (np.ascontiguousarray(x) for x in np.broadcast_arrays(places, to))
    d_n = np.empty(places.shape)
    _displacements(d_n.reshape(-1, 3), places.reshape(-1, 3), to.reshape(-1, 3))
    return d_n


@kernel
def earth_rate_n(lat: float, w_ie_n: Array) -> None:
    """Earth rate w_ie [rad/s] in NED into ``w_ie_n`` (3,)."""
    w_ie_n[0] = EARTH_RATE * np.cos(lat)
    w_ie_n[1] = 0.0
    w_ie_n[2] = -EARTH_RATE * np.sin(lat)


@kernel
def transport_rate_coefficients(lat: float, h: float) -> tuple[float, float, float]:
    """(a, b, c) of the transport rate w_en = (a v_E, b v_N, c v_E) in NED [1/m]."""
    R_N, R_E = radii(lat)
    return 1.0 / (R_E + h), -1.0 / (R_N + h), -np.tan(lat) / (R_E + h)


@kernel
def transport_rate_n(lat: float, h: float, v_n: Array, w_en_n: Array) -> None:
    """Transport rate w_en [rad/s] in NED at velocity ``v_n`` [m/s] into ``w_en_n`` (3,)."""
    a, b, c = transport_rate_coefficients(lat, h)
    w_en_n[0] = a * v_n[1]
    w_en_n[1] = b * v_n[0]
    w_en_n[2] = c * v_n[1]
