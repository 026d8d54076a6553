"""What happens to the filter: IMU samples, measurements, process noise, initialisation.

All in NED and forward-right-down (see frames.py), stamps in integer nanoseconds. Events are ordered
by (stamp, kind, payload bytes), which does not depend on when they arrived.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from math import isfinite, pi

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NS = 1_000_000_000  # nanoseconds in a second

# No sensor measures and no vehicle does what lies beyond these. They keep the arithmetic finite.
MAX_ACCELERATION = 1e4  # m/s^2
MAX_RATE = 1e3  # rad/s
MAX_SPEED = 1e3  # m/s
MAX_DISTANCE = 1e7  # m
MAX_VARIANCE = 1e12  # of anything, SI
MIN_HEIGHT, MAX_HEIGHT = -12_000.0, 100_000.0  # m


class Kind(IntEnum):
    """Order of events with the same stamp: the state first reaches it, then is corrected."""

    IMU = 0
    ORIGIN = 1
    INITIAL = 2
    PROCESS_NOISE = 3
    DVL = 4


@dataclass(frozen=True, slots=True)
class Imu:
    """One sample: the mean over the interval that ends at its stamp, in IMU axes.

    Attributes:
        stamp_ns: End of the interval.
        f_b: (3,) specific force [m/s^2].
        w_ib_b: (3,) angular rate [rad/s].
    """

    stamp_ns: int
    f_b: Array
    w_ib_b: Array

    kind = Kind.IMU

    def payload(self) -> bytes:
        """What tells two events of one stamp apart."""
        return self.f_b.tobytes() + self.w_ib_b.tobytes()


@dataclass(frozen=True, slots=True)
class Origin:
    """Where on the Earth odom's origin is; the first one counts.

    Attributes:
        lat: Geodetic latitude [rad].
        lon: Longitude [rad].
        h: Height above the ellipsoid [m].
    """

    stamp_ns: int
    lat: float
    lon: float
    h: float

    kind = Kind.ORIGIN

    def payload(self) -> bytes:
        """What tells two events of one stamp apart."""
        return np.array([self.lat, self.lon, self.h]).tobytes()


@dataclass(frozen=True, slots=True)
class Initial:
    """The state of base_link at a stamp. A covariance that is None takes the parameters' sigmas.

    Attributes:
        C_n_b: (3, 3) attitude of base_link.
        p_n: (3,) position [m] from odom's origin.
        v: (3,) velocity [m/s], in body axes or in NED, see `velocity_frame`.
        velocity_frame: ``body`` or ``nav``: the axes of `v` and of `P_v`.
        P_v: (3, 3) covariance of `v` [(m/s)^2].
        P_psi: (3, 3) covariance of the rotation error about NED axes [rad^2].
        P_p: (3, 3) covariance of the position in NED [m^2].
        once: Applies only while the filter is not yet initialised.
    """

    stamp_ns: int
    C_n_b: Array
    p_n: Array
    v: Array
    velocity_frame: str
    P_v: Array | None = None
    P_psi: Array | None = None
    P_p: Array | None = None
    once: bool = False

    kind = Kind.INITIAL

    def payload(self) -> bytes:
        """What tells two events of one stamp apart."""
        covariances = (self.P_v, self.P_psi, self.P_p)
        return b"".join(
            [
                *(array.tobytes() for array in (self.C_n_b, self.p_n, self.v)),
                *(b"-" if P is None else P.tobytes() for P in covariances),
                self.velocity_frame.encode(),
                bytes([self.once]),
            ]
        )


@dataclass(frozen=True, slots=True)
class ProcessNoise:
    """Variance per sample of the IMU's noise, in IMU axes, from the stamp on; None is unknown.

    Attributes:
        Q_f: (3, 3) of the specific force [(m/s^2)^2].
        Q_w: (3, 3) of the angular rate [(rad/s)^2].
    """

    stamp_ns: int
    Q_f: Array | None
    Q_w: Array | None

    kind = Kind.PROCESS_NOISE

    def payload(self) -> bytes:
        """What tells two events of one stamp apart."""
        return b"".join(b"-" if Q is None else Q.tobytes() for Q in (self.Q_f, self.Q_w))


@dataclass(frozen=True, slots=True)
class Dvl:
    """Velocity over ground at the DVL, in DVL axes.

    Attributes:
        v_d: (3,) velocity [m/s].
        R: (3, 3) covariance [(m/s)^2]; None takes the parameter ``dvl.noise_std``.
    """

    stamp_ns: int
    v_d: Array
    R: Array | None = None

    kind = Kind.DVL

    def payload(self) -> bytes:
        """What tells two events of one stamp apart."""
        return self.v_d.tobytes() + (b"" if self.R is None else self.R.tobytes())


Event = Imu | Origin | Initial | ProcessNoise | Dvl


def refusal(event: Event) -> str | None:
    """Why the numbers of an event cannot be used: ``not_finite``, ``out_of_range``; else None."""
    parts: Sequence[tuple[Array | None, float]]
    if isinstance(event, Imu):
        parts = ((event.f_b, MAX_ACCELERATION), (event.w_ib_b, MAX_RATE))
    elif isinstance(event, Dvl):
        parts = ((event.v_d, MAX_SPEED), (event.R, MAX_VARIANCE))
    elif isinstance(event, ProcessNoise):
        parts = ((event.Q_f, MAX_VARIANCE), (event.Q_w, MAX_VARIANCE))
    elif isinstance(event, Initial):
        parts = (
            (event.C_n_b, 1.0 + 1e-9),
            (event.p_n, MAX_DISTANCE),
            (event.v, MAX_SPEED),
            (event.P_v, MAX_VARIANCE),
            (event.P_psi, MAX_VARIANCE),
            (event.P_p, MAX_VARIANCE),
        )
    else:
        middle = (MIN_HEIGHT + MAX_HEIGHT) / 2
        parts = (
            (np.array([event.lat]), pi / 2),
            (np.array([event.lon]), 2 * pi),
            (np.array([event.h - middle]), MAX_HEIGHT - middle),
        )
    # On so few numbers this is several times as fast as numpy's own comparison.
    numbers = [(x, limit) for part, limit in parts if part is not None for x in part.flat]
    if all(-limit <= x <= limit for x, limit in numbers):
        return None
    return "out_of_range" if all(isfinite(x) for x, _ in numbers) else "not_finite"
