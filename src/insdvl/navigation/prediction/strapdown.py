"""Strapdown mechanisation in NED: attitude, velocity, position from specific force and turn rate.

    C_n_b' = C_n_b [w_ib_b x] - [w_in_n x] C_n_b
    v_n'   = C_n_b f_b + g_n - (2 w_ie_n + w_en_n) x v_n
    lat'   = v_N / (R_N + h),  lon' = v_E / ((R_E + h) cos lat),  h' = -v_D

(Groves 2013, section 5.4.) A sample is the mean over its interval. Under constant f_b and w_ib_b
the attitude and the rotated specific force are integrated exactly; the rest is of second order in
the step. An axis of turn that moves from sample to sample (coning) has a term of its own.
"""

import numpy as np

from insdvl.kernels import kernel
from insdvl.navigation.error_state import POSITION
from insdvl.navigation.geometry import earth
from insdvl.navigation.geometry.rotation import (
    cross,
    exponential,
    orthonormalise,
    product,
    rotate,
    rotate_back,
)
from insdvl.navigation.state.fields import State
from insdvl.navigation.state.scratch import Constants, Workspace

#: Farthest [m] below or above the origin that gravity follows. Without a depth sensor the height
#: drifts, and gravity, which falls with it, makes it drift faster and faster.
MAX_DEPTH = 12_000.0

_NORTH = POSITION.start


@kernel
def earth_terms(s: State, w: Workspace, c: Constants, ahead: float) -> None:
    """Earth rate, transport rate matrix, gravity and radii into the workspace.

    Args:
        ahead: Time [s] from the state to the place that they are of, at the state's velocity: half
            a step. Of the first order only, the Earth rate of a way north would turn the attitude
            by w_ie v dt / 2 R, which is 3.5 mm after 20 km in 2000 s.
    """
    lat = s.nav.llh[0] + ahead * s.nav.v_n[0] / earth.SEMI_MAJOR_AXIS
    h = s.nav.llh[2] - ahead * s.nav.v_n[2]
    h = min(max(h, s.nav.h_0 - MAX_DEPTH), s.nav.h_0 + MAX_DEPTH)
    R_N, R_E = earth.radii(lat)
    w.R_N, w.R_E, w.cosine_lat = R_N + h, R_E + h, np.cos(lat)
    w.g_n[0] = 0.0
    w.g_n[1] = 0.0
    w.g_n[2] = earth.gravity(lat, h)
    if c.earth_rate:
        earth.earth_rate_n(lat, w.w_ie_n)
        w.W_v[0, 1], w.W_v[1, 0], w.W_v[2, 1] = earth.transport_rate_coefficients(lat, h)


@kernel
def navigation_rate(w: Workspace, v_n: np.ndarray) -> None:
    """w_en = W_v v and w_in = w_ie + w_en at a velocity, into the workspace."""
    rotate(w.w_en_n, w.W_v, v_n)
    for i in range(3):
        w.w_in_n[i] = w.w_ie_n[i] + w.w_en_n[i]


@kernel
def turn_rate(w_nb_b: np.ndarray, s: State, w: Workspace, c: Constants, w_ib_b: np.ndarray) -> None:
    """w_nb_b = w_ib_b - C_b_n w_in_n at the state, whose w_in_n stays in the workspace.

    Args:
        w_nb_b: (3,) result [rad/s].
        w_ib_b: (3,) angular rate [rad/s], bias removed, base_link axes.
    """
    earth_terms(s, w, c, 0.0)
    navigation_rate(w, s.nav.v_n)
    rotate_back(w_nb_b, s.nav.C_n_b, w.w_in_n)
    for i in range(3):
        w_nb_b[i] = w_ib_b[i] - w_nb_b[i]


@kernel
def acceleration(w: Workspace, v_n: np.ndarray, a_n: np.ndarray) -> None:
    """a_n = f_n + g_n - (2 w_ie_n + w_en_n) x v_n, with what is in the workspace."""
    for i in range(3):
        w.coriolis[i] = 2.0 * w.w_ie_n[i] + w.w_en_n[i]
    cross(a_n, w.coriolis, v_n)
    for i in range(3):
        a_n[i] = w.f_n[i] + w.g_n[i] - a_n[i]


@kernel
def coning(rate: np.ndarray, before: np.ndarray, w_ib_b: np.ndarray, dt: float) -> None:
    """Rate by which the axis of turn moves the attitude: (w_(k-1) x w_k) dt / 12.

    With a rate that changes linearly over two samples the rotation vector of the second is
    w_k dt + (w_(k-1) x w_k) dt^2 / 12 (Savage, Journal of Guidance, Control, and Dynamics 21(1),
    1998). As a constant rate over the sample it is shared by its parts, wherever a measurement
    cuts it.

    Args:
        rate: (3,) result [rad/s].
        before: (3,) angular rate of the sample before [rad/s], bias removed.
        w_ib_b: (3,) of this one.
        dt: Length of the whole sample [s].
    """
    cross(rate, before, w_ib_b)
    for i in range(3):
        rate[i] *= dt / 12.0


@kernel
def travel(s: State, w: Workspace) -> None:
    """Move the place by the way ``w.d_n`` of a step, with radii and latitude at its middle.

    Beyond `earth.MAX_LATITUDE` the latitude is held, counted, and its uncertainty grows by what was
    not followed.
    """
    nav, d_n = s.nav, w.d_n
    lat = nav.llh[0] + d_n[0] / w.R_N
    if abs(lat) > earth.MAX_LATITUDE:
        lat = min(max(lat, -earth.MAX_LATITUDE), earth.MAX_LATITUDE)
        s.counters.beyond_latitude += 1
        sigma = np.sqrt(nav.P[_NORTH, _NORTH]) + abs(d_n[0])
        nav.P[_NORTH, _NORTH] = sigma * sigma
    nav.llh[0] = lat
    nav.llh[1] = earth.wrapped(nav.llh[1] + d_n[1] / (w.R_E * w.cosine_lat))
    nav.llh[2] -= d_n[2]


@kernel
def mechanise(
    s: State, w: Workspace, c: Constants, f_b: np.ndarray, w_ib_b: np.ndarray, dt: float
) -> None:
    """Advance C_n_b, v_n and the place of a state over a step.

    The workspace has the rate of `coning` in the sample, and keeps the middle of the step for the
    error dynamics: C_mean, f_n, v_n, x_n, g_n, the rates. ``s.nav.w_nb_b`` becomes the turn rate
    over the step.

    Args:
        f_b: (3,) specific force [m/s^2], bias removed, base_link axes.
        w_ib_b: (3,) angular rate [rad/s], bias removed, base_link axes.
        dt: Step [s].
    """
    earth_terms(s, w, c, 0.5 * dt)
    navigation_rate(w, s.nav.v_n)

    # Body turn over the step and its mean; the frame's turn to the middle and to the end.
    turn, mean_turn, frame, frame_mean = w.turn, w.mean_turn, w.frame, w.frame_mean
    exponential(
        turn,
        mean_turn,
        (w_ib_b[0] + w.coning[0]) * dt,
        (w_ib_b[1] + w.coning[1]) * dt,
        (w_ib_b[2] + w.coning[2]) * dt,
    )
    half = -0.5 * dt
    exponential(frame, frame_mean, w.w_in_n[0] * half, w.w_in_n[1] * half, w.w_in_n[2] * half)
    product(w.rotated, s.nav.C_n_b, mean_turn)
    product(w.C_mean, frame, w.rotated)
    rotate(w.f_n, w.C_mean, f_b)

    # Velocity at the middle, then the rates there, then the whole step.
    acceleration(w, s.nav.v_n, w.a_n)
    for i in range(3):
        w.v_n[i] = s.nav.v_n[i] + 0.5 * dt * w.a_n[i]
    navigation_rate(w, w.v_n)
    acceleration(w, w.v_n, w.a_n)
    earth.displacement(w.x_n, s.nav.llh_r, s.nav.llh)
    for i in range(3):
        w.x_n[i] += 0.5 * dt * s.nav.v_n[i]
        w.d_n[i] = dt * (s.nav.v_n[i] + 0.5 * dt * w.a_n[i])
        s.nav.v_n[i] += dt * w.a_n[i]
    travel(s, w)

    product(w.rotated, s.nav.C_n_b, turn)
    exponential(frame, frame_mean, -w.w_in_n[0] * dt, -w.w_in_n[1] * dt, -w.w_in_n[2] * dt)
    product(s.nav.C_n_b, frame, w.rotated)
    orthonormalise(s.nav.C_n_b, w.rotated)

    rotate_back(w.w_in_b, s.nav.C_n_b, w.w_in_n)
    for i in range(3):
        s.nav.w_nb_b[i] = w_ib_b[i] - w.w_in_b[i]
