"""Odom on the Earth: horizontally the tangent plane at the origin, z the height from the origin.

x and y are the horizontal components of the straight line from the origin to the vehicle, in the
axes of the origin. z is the difference of the geodetic heights, not the distance from the plane:
what an autopilot takes for depth stays the depth. Roll and pitch are against the local level; yaw
is against odom's axes: local north appears in odom's plane at the angle gamma.

Everything is north, east, down here, and positions `p_o` are in odom. The derivation is in
docs/explanation/geodesy.md.
"""

import numpy as np

from insdvl.arrays import Array
from insdvl.kernels import kernel
from insdvl.navigation.geometry.earth import (
    ECCENTRICITY_SQUARED,
    MAX_LATITUDE,
    radii,
    wrapped,
)
from insdvl.navigation.geometry.rotation import about_down, copy_matrix

#: Farthest horizontal distance [m] from the origin at which a place is found from its position in
#: odom. The filter itself may go farther.
MAX_FROM_ORIGIN = 1e6

_STEPS = 20  # of Newton; five are enough at MAX_FROM_ORIGIN
_TOLERANCE = 1e-8  # m


@kernel
def position(p_o: Array, place: Array, origin: Array) -> None:
    """Position in odom [m] of a place into ``p_o`` (3,).

    Differences of coordinates in Earth-fixed axes, rearranged so that nothing of the size of the
    Earth cancels: with dlat, dlon from the origin and R = R_E + h,

        x = R sin dlat + 2 R cos lat sin lat_0 sin^2(dlon / 2)
            - e^2 cos lat_0 (R_E sin lat - R_E0 sin lat_0)
        y = R cos lat sin dlon
    """
    _, R_E = radii(place[0])
    _, R_E_0 = radii(origin[0])
    R, dlon = R_E + place[2], wrapped(place[1] - origin[1])
    sine, sine_0, cosine_0 = np.sin(place[0]), np.sin(origin[0]), np.cos(origin[0])
    to_axis = R * np.cos(place[0])
    p_o[0] = (
        R * np.sin(place[0] - origin[0])
        + 2.0 * to_axis * sine_0 * np.sin(0.5 * dlon) ** 2
        - ECCENTRICITY_SQUARED * cosine_0 * (R_E * sine - R_E_0 * sine_0)
    )
    p_o[1] = to_axis * np.sin(dlon)
    p_o[2] = origin[2] - place[2]


@kernel
def axes(C_o_n: Array, place: Array, origin: Array) -> None:
    """Rotation (3, 3) from north, east, down at a place to those at the origin."""
    dlon = wrapped(place[1] - origin[1])
    s, c, s_0, c_0 = np.sin(place[0]), np.cos(place[0]), np.sin(origin[0]), np.cos(origin[0])
    sine, cosine = np.sin(dlon), np.cos(dlon)
    C_o_n[0, 0], C_o_n[0, 1], C_o_n[0, 2] = (
        s_0 * s * cosine + c_0 * c,
        s_0 * sine,
        s_0 * c * cosine - c_0 * s,
    )
    C_o_n[1, 0], C_o_n[1, 1], C_o_n[1, 2] = -s * sine, cosine, -c * sine
    C_o_n[2, 0], C_o_n[2, 1], C_o_n[2, 2] = (
        c_0 * s * cosine - s_0 * c,
        c_0 * sine,
        c_0 * c * cosine + s_0 * s,
    )


@kernel
def convergence(C_o_n: Array) -> float:
    """Angle gamma [rad] of local north in odom's plane, from `axes`; yaw in odom is psi + gamma."""
    return float(np.arctan2(C_o_n[1, 0], C_o_n[0, 0]))


@kernel
def convergence_slope(slope: Array, place: Array, origin: Array) -> None:
    """Derivatives of gamma by metres north and east at the vehicle into ``slope`` [rad/m]."""
    dlon = wrapped(place[1] - origin[1])
    s, c, s_0, c_0 = np.sin(place[0]), np.cos(place[0]), np.sin(origin[0]), np.cos(origin[0])
    sine, cosine = np.sin(dlon), np.cos(dlon)
    # gamma = atan2(a, b)
    a, b = -s * sine, s_0 * s * cosine + c_0 * c
    by_lat = -b * c * sine - a * (s_0 * c * cosine - c_0 * s)
    by_lon = -b * s * cosine + a * s_0 * s * sine
    R_N, R_E = radii(place[0])
    size = a * a + b * b
    slope[0] = by_lat / (size * (R_N + place[2]))
    slope[1] = by_lon / (size * (R_E + place[2]) * c)


@kernel
def position_jacobian(J: Array, C_o_n: Array) -> None:
    """J (3, 3), p_o by metres north, east, down at the vehicle: rows x, y of `axes`, z alone."""
    copy_matrix(J, C_o_n)
    J[2, 0], J[2, 1], J[2, 2] = 0.0, 0.0, 1.0


@kernel
def _fill(p_o: Array, gamma: Array, places: Array, origin: Array) -> None:
    C = np.empty((3, 3))
    for k in range(places.shape[0]):
        position(p_o[k], places[k], origin)
        axes(C, places[k], origin)
        gamma[k] = convergence(C)


def in_odom(places: Array, origin: Array) -> tuple[Array, Array]:
    """Positions p_o (..., 3) [m] and angles gamma (...) [rad] of places (..., 3).

    Args:
        places: (..., 3) latitude, longitude [rad], height [m].
        origin: (3,) the same of the origin.
    """
    p_o, gamma = np.empty(places.shape), np.empty(places.shape[:-1])
    flat = np.ascontiguousarray(places).reshape(-1, 3)
    _fill(p_o.reshape(-1, 3), gamma.reshape(-1), flat, np.ascontiguousarray(origin))
    return p_o, gamma


def turned(C_n_b: Array, gamma: Array) -> Array:
    """Attitudes C_o_b = Rz(gamma) C_n_b (..., 3, 3) against odom's axes."""
    s, c = np.sin(gamma)[..., None], np.cos(gamma)[..., None]
    north, east = C_n_b[..., 0, :], C_n_b[..., 1, :]
    return np.stack([c * north - s * east, s * north + c * east, C_n_b[..., 2, :]], axis=-2)


def jacobian(place: Array, origin: Array) -> tuple[Array, Array]:
    """`position_jacobian` and Rz(gamma), (3, 3) each, at a place."""
    C, J, turn = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    axes(C, place, origin)
    position_jacobian(J, C)
    about_down(turn, convergence(C))
    return J, turn


def place_of(p_o: Array, origin: Array) -> Array | None:
    """The place (3,) at a position in odom, by Newton's method from the origin.

    Returns:
        None where there is none that the filter could navigate at: beyond `MAX_FROM_ORIGIN`, or
        beyond `MAX_LATITUDE`.
    """
    if not np.hypot(p_o[0], p_o[1]) <= MAX_FROM_ORIGIN:
        return None
    place, found, C = origin.copy(), np.empty(3), np.empty((3, 3))
    place[2] -= p_o[2]
    for _ in range(_STEPS):
        position(found, place, origin)
        step = p_o[:2] - found[:2]
        if np.hypot(*step) < _TOLERANCE:
            return place
        axes(C, place, origin)
        north, east = np.linalg.solve(C[:2, :2], step)
        R_N, R_E = radii(place[0])
        lat = place[0]
        place[0] = min(max(lat + north / (R_N + place[2]), -MAX_LATITUDE), MAX_LATITUDE)
        place[1] = wrapped(place[1] + east / ((R_E + place[2]) * np.cos(lat)))
    return None
