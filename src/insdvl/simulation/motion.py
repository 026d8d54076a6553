"""Truth as functions of time.

A trajectory is six scalar functions: speed u(t), sway and heave, heading psi(t), pitch theta(t) and
roll. Each is a sum of soft ramps and sine waves, which are analytic on the whole time axis. All
other quantities follow in closed form from the functions and their derivatives:

    v_b  = [u, sway - pivot psi', heave]  sideslip in a turn
    phi  = roll + bank psi'               bank in a turn
    v_n  = C_n_b v_b
    a_n  = C_n_b (v_b' + w_nb_b x v_b)
    f_b  = C_b_n (a_n + (2 w_ie_n + w_en_n) x v_n - g_n)
    w_ib_b = w_nb_b + C_b_n (w_ie_n + w_en_n)

Position is the only integral without a closed form:

    lat' = v_N / (R_N + h),  lon' = v_E / ((R_E + h) cos lat),  h' = -v_D

The rates are expanded in Legendre polynomials on segments of one second, at the Gauss nodes, and
the expansions are integrated. Height needs v_n alone, longitude the latitude; the latitude, on
which its own rate depends through R_N, is found by Picard's iteration. The error is that of the
rounding of an angle, 1e-9 m on the ground.

Sources: the Euler rates are Groves (2013), equation (2.58); f_b and w_ib_b are (5.53) and (5.44)
solved for the sensors. Frames are north-east-down and forward-right-down.
"""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import radians
from typing import Protocol

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike

from insdvl.arrays import Array
from insdvl.kernels import kernel
from insdvl.navigation.geometry import odom
from insdvl.navigation.geometry.earth import (
    MAX_LATITUDE,
    MAX_LATITUDE_DEG,
    earth_rate_n,
    gravity,
    radii,
    transport_rate_n,
    wrapped,
)

Tables = tuple[Array, Array, Array]
#: C_n_b (N, 3, 3), then v_n, a_n and w_nb_b (N, 3), as in `Truth`.
Motion = tuple[Array, Array, Array, Array]

_NODES = 20  # per segment; the truncation of v_n is then far below the rounding
_SEGMENT = 1.0  # s
_PICARD = 50  # steps; each gains two digits over 1000 km
_LATITUDE_STEP = 1e-15  # rad, 6e-9 m
_FAR = 40.0  # exp(-40) is below the rounding of 1


@dataclass(frozen=True)
class Ramp:
    """A change with a soft start and end, and a constant rate in between.

    Attributes:
        start: Time at which the rate has risen to half of its value [s].
        end: Time at which the rate has fallen to half of its value [s].
        change: Change over the whole ramp, in the unit of the function.
        softness: Time constant of the logistic function that the rate follows [s].
    """

    start: float
    end: float
    change: float
    softness: float = 1.0


@dataclass(frozen=True)
class Wave:
    """A sine wave, amplitude * sin(2 pi t / period + phase)."""

    amplitude: float
    period: float
    phase: float = 0.0


@dataclass(frozen=True)
class Channel:
    """A function of time: value + slope t + ramps + waves.

    Attributes:
        value: Value at t = 0 without waves: ramps add nothing there.
        slope: Constant rate [1/s].
    """

    value: float = 0.0
    slope: float = 0.0
    ramps: tuple[Ramp, ...] = ()
    waves: tuple[Wave, ...] = ()

    @cached_property
    def tables(self) -> Tables:
        """Tables for `channel_at`: (value, slope); knots (K, 3); waves (W, 3).

        A knot is (time, softness, change of rate): a ramp is a pair of them.
        """
        knots = []
        for ramp in self.ramps:
            rate = ramp.change / (ramp.end - ramp.start)
            knots += [(ramp.start, ramp.softness, rate), (ramp.end, ramp.softness, -rate)]
        waves = [(w.amplitude, 2.0 * math.pi / w.period, w.phase) for w in self.waves]
        knot_table, wave_table = np.array(knots).reshape(-1, 3), np.array(waves).reshape(-1, 3)
        ramps_at_zero = np.empty(3)
        channel_at(0.0, np.zeros(2), knot_table, np.empty((0, 3)), ramps_at_zero)
        return np.array([self.value - ramps_at_zero[0], self.slope]), knot_table, wave_table


@dataclass(frozen=True)
class Truth:
    """The state of the vehicle at N times, in NED and forward-right-down.

    Attributes:
        t: (N,) time from the start [s].
        llh: (N, 3) latitude, longitude [rad] and height [m].
        p_o: (N, 3) position in odom [m] (navigation/geometry/odom.py).
        gamma: (N,) angle of local north in odom [rad].
        v_n: (N, 3) velocity [m/s].
        a_n: (N, 3) v_n' [m/s^2].
        C_n_b: (N, 3, 3) body to navigation.
        f_b: (N, 3) specific force [m/s^2].
        w_ib_b: (N, 3) angular rate against inertial space [rad/s].
        w_nb_b: (N, 3) angular rate against the navigation frame [rad/s].
    """

    t: Array
    llh: Array
    p_o: Array
    gamma: Array
    v_n: Array
    a_n: Array
    C_n_b: Array
    f_b: Array
    w_ib_b: Array
    w_nb_b: Array

    @property
    def C_o_b(self) -> Array:  # noqa: N802
        """(N, 3, 3) attitude in odom: tilt against the local level, yaw against odom's axes."""
        return odom.turned(self.C_n_b, self.gamma)

    def in_odom_at(self, origin: ArrayLike) -> "Truth":
        """The same motion in an odom with another origin (3,): latitude, longitude, height."""
        p_o, gamma = odom.in_odom(self.llh, np.array(origin))
        return replace(self, p_o=p_o, gamma=gamma)


class Vibration(Protocol):
    """Fast motion on top of a trajectory."""

    def shake(self, t: Array, speed: Channel, heading: Channel, llh: Array, motion: Motion) -> None:
        """Add to place and motion at times t (N,)."""


@dataclass(frozen=True)
class Trajectory:
    """A motion from t = 0 to `duration`, and its place on the Earth.

    Attributes:
        duration: [s].
        speed: Forward velocity u [m/s].
        heading: psi [rad].
        pitch: theta [rad].
        roll: Part of phi without the bank in turns [rad].
        bank: Roll per rate of turn [s].
        pivot: Distance from the origin of the body frame forward to the point without sideslip [m].
        lat_0: Geodetic latitude of the start, which is the origin of odom [rad].
        lon_0: Its longitude [rad].
        h_0: Its height above the ellipsoid [m].
        sway: Velocity along the body's y axis without the sideslip [m/s].
        heave: Velocity along the body's z axis [m/s].
        vibration: On top of all of this (drawn/vibration.py).
    """

    duration: float
    speed: Channel
    heading: Channel = field(default_factory=Channel)
    pitch: Channel = field(default_factory=Channel)
    roll: Channel = field(default_factory=Channel)
    bank: float = 0.0
    pivot: float = 0.0
    lat_0: float = radians(32.0)
    lon_0: float = radians(34.0)
    h_0: float = -5.0
    sway: Channel = field(default_factory=Channel)
    heave: Channel = field(default_factory=Channel)
    vibration: Vibration | None = None

    @property
    def origin(self) -> Array:
        """(3,) latitude, longitude [rad] and height [m] of the start."""
        return np.array([self.lat_0, self.lon_0, self.h_0])

    def truth(self, t: ArrayLike, *, earth_rate: bool = True) -> Truth:
        """The truth at times t (N,) [s].

        Args:
            t: Times within [0, duration].
            earth_rate: False omits the rotation of the Earth and the transport rate (w_ie = w_en
                = 0).

        Raises:
            ValueError: A time is outside the trajectory.
        """
        t = np.array(t, dtype=float)
        outside = ~((t >= 0.0) & (t <= self.duration))
        if outside.any():
            raise ValueError(
                f"time must be within 0 to {self.duration:g} s, got {t[outside].flat[0]!r}"
            )
        n = t.size
        llh = np.empty((n, 3))
        _place(t, _SEGMENT, self._place_table, self.origin, llh)
        C_n_b = np.empty((n, 3, 3))
        v_n, a_n, w_nb_b = np.empty((3, n, 3))
        self._fill_motion(t, C_n_b, v_n, a_n, w_nb_b)
        if self.vibration is not None:
            self.vibration.shake(t, self.speed, self.heading, llh, (C_n_b, v_n, a_n, w_nb_b))
        p_o, gamma = odom.in_odom(llh, self.origin)
        truth = Truth(
            t=t,
            llh=llh,
            p_o=p_o,
            gamma=gamma,
            v_n=v_n,
            a_n=a_n,
            C_n_b=C_n_b,
            f_b=np.empty((n, 3)),
            w_ib_b=np.empty((n, 3)),
            w_nb_b=w_nb_b,
        )
        _sensors(
            earth_rate,
            truth.C_n_b,
            truth.llh,
            truth.v_n,
            truth.a_n,
            truth.w_nb_b,
            truth.f_b,
            truth.w_ib_b,
        )
        return truth

    def _fill_motion(self, t: Array, C_n_b: Array, v_n: Array, a_n: Array, w_nb_b: Array) -> None:
        _motion(
            t,
            self.speed.tables,
            self.sway.tables,
            self.heave.tables,
            self.heading.tables,
            self.pitch.tables,
            self.roll.tables,
            self.bank,
            self.pivot,
            C_n_b,
            v_n,
            a_n,
            w_nb_b,
        )

    @cached_property
    def _place_table(self) -> Array:
        """Legendre coefficients (K, _NODES + 1, 3) of llh less the origin's, on each segment."""
        segments = max(1, math.ceil(self.duration / _SEGMENT))
        x, w = legendre.leggauss(_NODES)
        t = (np.arange(segments)[:, None] + (x + 1.0) / 2.0) * _SEGMENT
        v_n = np.empty((t.size, 3))
        scratch = np.empty((t.size, 3))
        C_n_b = np.empty((t.size, 3, 3))
        self._fill_motion(t.ravel(), C_n_b, v_n, scratch, scratch)
        north, east, down = np.moveaxis(v_n.reshape(segments, _NODES, 3), 2, 0)
        values = legendre.legvander(x, _NODES).T  # of a table at the nodes

        height = _integral(-down, x, w)
        h, lat = self.h_0 + height @ values, np.full(t.shape, self.lat_0)
        for _ in range(_PICARD):
            R_N, R_E = radii(lat)  # type: ignore[arg-type]
            latitude = _integral(north / (R_N + h), x, w)
            before, lat = lat, self.lat_0 + latitude @ values
            if np.abs(lat - before).max() < _LATITUDE_STEP:
                break
        else:
            raise ValueError("the trajectory goes too far for its latitude to converge")
        if np.abs(lat).max() > MAX_LATITUDE:
            raise ValueError(f"the trajectory goes beyond {MAX_LATITUDE_DEG:g} deg of latitude")
        longitude = _integral(east / ((R_E + h) * np.cos(lat)), x, w)
        return np.ascontiguousarray(np.stack([latitude, longitude, height], axis=2))


def _integral(rate: Array, x: Array, w: Array) -> Array:
    """Legendre coefficients (K, _NODES + 1) of the integral of a rate at nodes (K, _NODES), from 0.

    Args:
        rate: Of K segments that follow each other.
        x: Gauss nodes within +-1.
        w: Their weights.
    """
    # Gauss quadrature of the rate times P_k is exact up to the resolution of the nodes.
    projection = legendre.legvander(x, _NODES - 1) * w[:, None] * (np.arange(_NODES) + 0.5)
    table = legendre.legint(rate @ projection, lbnd=-1.0, scl=_SEGMENT / 2.0, axis=1)
    lengths = table.sum(axis=1)  # P_k(1) = 1: the change over each segment
    table[1:, 0] += np.cumsum(lengths[:-1])
    return np.asarray(table, dtype=np.float64)


@kernel
def channel_at(t: float, line: Array, knots: Array, waves: Array, out: Array) -> None:
    """Value, first and second derivative of a `Channel` at t into ``out`` (3,).

    A knot adds softness * rate * log(1 + exp(x)), x = (t - time) / softness.
    """
    value, first, second = line[0] + line[1] * t, line[1], 0.0
    for k in range(knots.shape[0]):
        softness, rate = knots[k, 1], knots[k, 2]
        x = (t - knots[k, 0]) / softness
        if x > _FAR:
            value += softness * rate * x
            first += rate
        elif x > -_FAR:
            e = math.exp(-abs(x))
            s = 1.0 / (1.0 + e)
            value += softness * rate * (max(x, 0.0) + math.log1p(e))
            first += rate * (s if x > 0.0 else e * s)
            second += rate / softness * e * s * s
    for k in range(waves.shape[0]):
        amplitude, omega = waves[k, 0], waves[k, 1]
        angle = omega * t + waves[k, 2]
        sine = amplitude * math.sin(angle)
        value += sine
        first += omega * amplitude * math.cos(angle)
        second -= omega * omega * sine
    out[0], out[1], out[2] = value, first, second


@kernel
def _motion(
    t: Array,
    speed: Tables,
    sway: Tables,
    heave: Tables,
    heading: Tables,
    pitch: Tables,
    roll: Tables,
    bank: float,
    pivot: float,
    C_n_b: Array,
    v_n: Array,
    a_n: Array,
    w_nb_b: Array,
) -> None:
    """Attitude, velocity, acceleration and turn rate from the channels at times t (N,)."""
    u, y, z = np.empty(3), np.empty(3), np.empty(3)
    psi, theta, phi = np.empty(3), np.empty(3), np.empty(3)
    b = np.empty(3)
    for i in range(t.size):
        channel_at(t[i], speed[0], speed[1], speed[2], u)
        channel_at(t[i], sway[0], sway[1], sway[2], y)
        channel_at(t[i], heave[0], heave[1], heave[2], z)
        channel_at(t[i], heading[0], heading[1], heading[2], psi)
        channel_at(t[i], pitch[0], pitch[1], pitch[2], theta)
        channel_at(t[i], roll[0], roll[1], roll[2], phi)
        phi[0] += bank * psi[1]
        phi[1] += bank * psi[2]

        cr, sr = math.cos(phi[0]), math.sin(phi[0])
        cp, sp = math.cos(theta[0]), math.sin(theta[0])
        cy, sy = math.cos(psi[0]), math.sin(psi[0])
        C = C_n_b[i]
        C[0, 0], C[0, 1], C[0, 2] = cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy
        C[1, 0], C[1, 1], C[1, 2] = cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy
        C[2, 0], C[2, 1], C[2, 2] = -sp, sr * cp, cr * cp

        w = w_nb_b[i]
        w_x = phi[1] - psi[1] * sp
        w_y = theta[1] * cr + psi[1] * cp * sr
        w_z = -theta[1] * sr + psi[1] * cp * cr

        v_x, v_y, v_z = u[0], y[0] - pivot * psi[1], z[0]
        b[0] = u[1] - w_z * v_y + w_y * v_z
        b[1] = y[1] - pivot * psi[2] + w_z * v_x - w_x * v_z
        b[2] = z[1] + w_x * v_y - w_y * v_x
        for j in range(3):
            v_n[i, j] = C[j, 0] * v_x + C[j, 1] * v_y + C[j, 2] * v_z
            a_n[i, j] = C[j, 0] * b[0] + C[j, 1] * b[1] + C[j, 2] * b[2]
        w[0], w[1], w[2] = w_x, w_y, w_z


@kernel
def _place(t: Array, segment: float, table: Array, origin: Array, llh: Array) -> None:
    """The origin and the Legendre series of the segment of each time (N,) into ``llh`` (N, 3)."""
    segments, terms = table.shape[0], table.shape[1]
    for i in range(t.size):
        k = min(int(t[i] / segment), segments - 1)
        x = 2.0 * (t[i] / segment - k) - 1.0
        p_before, p = 1.0, x
        for j in range(3):
            llh[i, j] = table[k, 0, j] + table[k, 1, j] * x
        for n in range(2, terms):  # n P_n = (2 n - 1) x P_(n-1) - (n - 1) P_(n-2)
            p_before, p = p, ((2 * n - 1) * x * p - (n - 1) * p_before) / n
            for j in range(3):
                llh[i, j] += table[k, n, j] * p
        for j in range(3):
            llh[i, j] += origin[j]
        llh[i, 1] = wrapped(llh[i, 1])


@kernel
def _sensors(
    earth_rate: bool,
    C_n_b: Array,
    llh: Array,
    v_n: Array,
    a_n: Array,
    w_nb_b: Array,
    f_b: Array,
    w_ib_b: Array,
) -> None:
    """Specific force and angular rate of N states into ``f_b`` and ``w_ib_b`` (N, 3)."""
    w_ie, w_en = np.zeros(3), np.zeros(3)
    for i in range(llh.shape[0]):
        lat, h = llh[i, 0], llh[i, 2]
        if earth_rate:
            earth_rate_n(lat, w_ie)
            transport_rate_n(lat, h, v_n[i], w_en)
        x, y, z = 2.0 * w_ie[0] + w_en[0], 2.0 * w_ie[1] + w_en[1], 2.0 * w_ie[2] + w_en[2]
        v = v_n[i]
        f_north = a_n[i, 0] + y * v[2] - z * v[1]
        f_east = a_n[i, 1] + z * v[0] - x * v[2]
        f_down = a_n[i, 2] + x * v[1] - y * v[0] - gravity(lat, h)
        for j in range(3):
            C = C_n_b[i, :, j]
            f_b[i, j] = C[0] * f_north + C[1] * f_east + C[2] * f_down
            w_in = C[0] * (w_ie[0] + w_en[0]) + C[1] * (w_ie[1] + w_en[1])
            w_ib_b[i, j] = w_nb_b[i, j] + w_in + C[2] * (w_ie[2] + w_en[2])
