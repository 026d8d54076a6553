"""Earth model: WGS-84 radii, normal gravity, Earth rate and transport rate, all in NED.

The vehicle's position is kept in metres north, east and down of a geodetic origin, p' = v_n.
Latitude follows from the metres north, height from the metres down; longitude enters nothing.

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
def latitude(lat_0: float, h_0: float, p_north: float) -> float:
    """Latitude [rad] at a distance north [m] of an origin, with the origin's radius.

    The radius changes by 1e-5 of itself over 10 km, 0.1 m in position: nothing here feels it.
    """
    R_N, _ = radii(lat_0)
    return lat_0 + p_north / (R_N + h_0)


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
