"""What happens to the filter: IMU samples, measurements, their noise, initialisation.

All in NED and forward-right-down (see geometry/frames.py), stamps in integer nanoseconds. Events
are ordered by (stamp, kind, payload bytes), which does not depend on when they arrived.
Measurements are in files of their own, under measurements/.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from math import isfinite, pi
from typing import ClassVar

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.geometry.earth import MAX_LATITUDE
from insdvl.navigation.geometry.odom import MAX_FROM_ORIGIN

NS = 1_000_000_000  # nanoseconds in a second

# No sensor measures and no vehicle does what lies beyond these. They keep the arithmetic finite.
MAX_ACCELERATION = 1e4  # m/s^2
MAX_RATE = 1e3  # rad/s
MAX_SPEED = 1e3  # m/s
MAX_DISTANCE = 1e7  # m
MAX_VARIANCE = 1e12  # of anything, SI
MIN_HEIGHT, MAX_HEIGHT = -12_000.0, 100_000.0  # m

#: Numbers of an event, and the largest size that each may have.
Limits = Iterable[tuple[Array | None, float]]


@dataclass(frozen=True, slots=True)
class Event(ABC):
    """Something that happens to the filter at a stamp.

    Attributes:
        stamp_ns: When.
        kind: Order of events with the same stamp: first the IMU sample, then origin, initial
            state, settings, process noise, orientation and measurement noise, then the
            measurements.
        follows_samples: Whether it is made from the newest samples, some of which may still be on
            their way; it may then be ahead of them.
    """

    stamp_ns: int

    kind: ClassVar[int]
    follows_samples: ClassVar[bool] = False

    @property
    def starts_only(self) -> bool:
        """Whether it tells nothing to a filter that has started, and so never cuts a sample."""
        return False

    @abstractmethod
    def payload(self) -> bytes:
        """What tells two events of one stamp and kind apart."""

    @abstractmethod
    def limits(self) -> Limits:
        """Its numbers, and the largest size that each may have."""


@dataclass(frozen=True, slots=True)
class Imu(Event):
    """One sample: the mean over the interval that ends at its stamp, in IMU axes.

    Attributes:
        stamp_ns: End of the interval.
        f_b: (3,) specific force [m/s^2].
        w_ib_b: (3,) angular rate [rad/s].
    """

    f_b: Array
    w_ib_b: Array

    kind = 0

    def payload(self) -> bytes:
        """Both triads."""
        return self.f_b.tobytes() + self.w_ib_b.tobytes()

    def limits(self) -> Limits:
        """What no sensor measures."""
        return (self.f_b, MAX_ACCELERATION), (self.w_ib_b, MAX_RATE)


@dataclass(frozen=True, slots=True)
class Origin(Event):
    """Where on the Earth odom's origin is; the first one counts.

    Attributes:
        lat: Geodetic latitude [rad].
        lon: Longitude [rad].
        h: Height above the ellipsoid [m].
    """

    lat: float
    lon: float
    h: float

    kind = 1

    def payload(self) -> bytes:
        """All three numbers."""
        return np.array([self.lat, self.lon, self.h]).tobytes()

    def limits(self) -> Limits:
        """Where no vehicle is, and the poles."""
        middle = (MIN_HEIGHT + MAX_HEIGHT) / 2
        return (
            (np.array([self.lat]), MAX_LATITUDE),
            (np.array([self.lon]), 2 * pi),
            (np.array([self.h - middle]), MAX_HEIGHT - middle),
        )


@dataclass(frozen=True, slots=True)
class Initial(Event):
    """The state of base_link in odom at a stamp; odom as north, east, down (geometry/odom.py).

    A covariance that is None takes the parameters' sigmas.

    Attributes:
        C_o_b: (3, 3) attitude of base_link: tilt against the local level, yaw against odom.
        p_o: (3,) position [m] in odom.
        v: (3,) velocity [m/s], in body axes or in odom's, see `velocity_frame`.
        velocity_frame: ``body`` or ``nav``: the axes of `v` and of `P_v`.
        P_v: (3, 3) covariance of `v` [(m/s)^2].
        P_psi: (3, 3) covariance of the rotation error about odom's axes [rad^2].
        P_p: (3, 3) covariance of the position in odom [m^2].
        once: Applies only while the filter is not yet initialised.
    """

    C_o_b: Array
    p_o: Array
    v: Array
    velocity_frame: str
    P_v: Array | None = None
    P_psi: Array | None = None
    P_p: Array | None = None
    once: bool = False

    kind = 2

    @property
    def starts_only(self) -> bool:
        """Where it applies once."""
        return self.once

    def payload(self) -> bytes:
        """All numbers, and how they are to be taken."""
        covariances = (self.P_v, self.P_psi, self.P_p)
        return b"".join(
            [
                *(array.tobytes() for array in (self.C_o_b, self.p_o, self.v)),
                *(b"-" if P is None else P.tobytes() for P in covariances),
                self.velocity_frame.encode(),
                bytes([self.once]),
            ]
        )

    def limits(self) -> Limits:
        """What no vehicle does."""
        return (
            (self.C_o_b, 1.0 + 1e-9),
            (self.p_o, MAX_FROM_ORIGIN),
            (self.v, MAX_SPEED),
            (self.P_v, MAX_VARIANCE),
            (self.P_psi, MAX_VARIANCE),
            (self.P_p, MAX_VARIANCE),
        )


@dataclass(frozen=True, slots=True)
class ProcessNoise(Event):
    """Variance per sample of the IMU's noise, in IMU axes, from the stamp on; None is unknown.

    Attributes:
        Q_f: (3, 3) of the specific force [(m/s^2)^2].
        Q_w: (3, 3) of the angular rate [(rad/s)^2].
    """

    Q_f: Array | None
    Q_w: Array | None

    kind = 4
    follows_samples = True

    def payload(self) -> bytes:
        """Both covariances."""
        return b"".join(b"-" if Q is None else Q.tobytes() for Q in (self.Q_f, self.Q_w))

    def limits(self) -> Limits:
        """What no noise is."""
        return (self.Q_f, MAX_VARIANCE), (self.Q_w, MAX_VARIANCE)


@dataclass(frozen=True, slots=True)
class SensorNoise(Event):
    """Covariance of a sensor's white noise, from the stamp on.

    Attributes:
        of: Name of the sensor's measurements, such as ``dvl``.
        R: (3, 3) positive definite, in the axes of the sensor, squares of its unit.
    """

    of: str
    R: Array

    kind = 6
    follows_samples = True

    def payload(self) -> bytes:
        """The sensor and the covariance."""
        return self.of.encode() + self.R.tobytes()

    def limits(self) -> Limits:
        """What no noise is."""
        return ((self.R, MAX_VARIANCE),)


@dataclass(frozen=True, slots=True)
class Orientation(Event):
    """What an IMU says of its own attitude; it only tells the heading at the start.

    Attributes:
        C_n_i: (3, 3) attitude of the IMU's axes.
        heading_std: One sigma about the vertical [rad].
    """

    C_n_i: Array
    heading_std: float

    kind = 5

    @property
    def starts_only(self) -> bool:
        """Of a filter that has started it tells nothing."""
        return True

    def payload(self) -> bytes:
        """Attitude and sigma."""
        return self.C_n_i.tobytes() + np.float64(self.heading_std).tobytes()

    def limits(self) -> Limits:
        """A rotation, and what no heading is off."""
        return (self.C_n_i, 1.0 + 1e-9), (np.array([self.heading_std]), 2 * pi)


@dataclass(frozen=True, slots=True)
class Measurement(Event):
    """What a sensor says of the state at a stamp; each kind is a class of its own.

    Attributes:
        name: Of the kind; that of its gate, its parameters and its topics.
        kind: At least `FIRST`, in the order in which measurements of one stamp correct the state.
    """

    FIRST: ClassVar[int] = 16

    name: ClassVar[str]
    follows_samples = True


def refusal(event: Event) -> str | None:
    """Why the numbers of an event cannot be used: ``not_finite``, ``out_of_range``; else None."""
    # On so few numbers this is several times as fast as numpy's own comparison.
    numbers = [(x, limit) for part, limit in event.limits() if part is not None for x in part.flat]
    if all(-limit <= x <= limit for x, limit in numbers):
        return None
    return "out_of_range" if all(isfinite(x) for x, _ in numbers) else "not_finite"
