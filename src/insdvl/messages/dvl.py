"""Velocity of a DVL from the messages of its driver: which pings are used, and which are not.

``invalid``, ``through_water`` and ``no_bottom`` are what a ping says of itself. What the table in
drivers.py leaves open (no flag, no altitude, no beams) refuses nothing.
"""

from typing import Any, NamedTuple

import numpy as np

from insdvl.arrays import Array
from insdvl.messages.convert import (
    RejectedMessage,
    sensor_stamp_ns,
    vector,
    velocity_covariance,
)
from insdvl.messages.drivers import DRIVERS, Axes, Driver, Ping, field_of, ping, type_of
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.frames import ENU, NED, Convention
from insdvl.navigation.measurements.dvl import Dvl

#: Beams without which there is no velocity.
MIN_BEAMS = 3
#: What stands in place of a velocity that an instrument does not have [m/s]; see `FILL_SIGMA` too.
FILL_VELOCITY = -32.768
_FILL_ROUNDING = 1e-3  # m/s: the resolution of the number that it fills
#: The longest latency that is believed.
MAX_LATENCY_NS = 10 * NS
_US = 1000  # ns


def dvl(message: Any, convention: Convention, *, by_arrival: bool = False) -> Dvl:
    """The measurement of a message of one of the `TYPES`.

    Args:
        message: The message.
        convention: Axes of ROS's own types; the other types have axes of their own.
        by_arrival: Whether the stamp is not read: it is then zero less the latency, if there is
            one, and means so long before the message arrived.

    Raises:
        RejectedMessage: One of `REFUSALS`.
    """
    try:
        return _measurement(message, convention, by_arrival)
    except RejectedMessage:
        raise
    except (AttributeError, IndexError, TypeError, ValueError) as error:
        # The message's definition is not that which its type has in the table.
        raise RejectedMessage("no_data", f"the message cannot be understood: {error}") from error


def body_axes(axes: Axes, convention: Convention) -> Array:
    """Rotation (3, 3) from the axes of a type to forward-right-down; its own inverse."""
    # Body axes of NED are forward-right-down, those of ENU forward-left-up.
    return {Axes.STREAM: convention, Axes.FRD: NED, Axes.FLU: ENU}[axes].body


def _measurement(message: Any, convention: Convention, by_arrival: bool) -> Dvl:
    driver, told = DRIVERS[type_of(message)], ping(message)
    stamp = 0 if by_arrival else _stamp_ns(message, driver)
    latency_ns = _latency_ns(message, driver)
    if not by_arrival and stamp < latency_ns:
        raise RejectedMessage("bad_stamp", f"stamp is {stamp} ns, the latency {latency_ns} ns")
    axes = body_axes(driver.axes, convention)
    v, R, measured = _velocity(told, driver)
    return Dvl(
        stamp_ns=stamp - latency_ns,
        v_d=axes @ v,
        R=None if R is None else axes @ R @ axes.T,
        measured=measured,  # the axes differ in signs only
    )


def _velocity(told: Ping, driver: Driver) -> tuple[Array, Array | None, tuple[bool, bool, bool]]:
    """Velocity (3,), its covariance (3, 3), and what was measured, in the axes of the type.

    Raises:
        RejectedMessage: The ping has no velocity over ground, or not all of its numbers are right.
    """
    _check_bottom(told)
    R, measured = None, told.measured
    if told.covariance is not None:
        R, finite = velocity_covariance(told.covariance, driver.covariance, driver.rows)
        measured = _both(measured, finite)
    if R is None and told.sigma.any():
        sigma = np.where(measured, told.sigma, np.inf)
        sigma[sigma < 0.0] = 0.0  # not known either
        R, sure = velocity_covariance(np.diag(sigma**2).ravel(), driver.sigma, 3)
        measured = _both(measured, sure)
    if not any(measured):
        raise RejectedMessage("invalid", "each component is marked as invalid, or its sigma is")
    v = vector(Vector(*told.velocity.tolist()), driver.velocity, measured)
    if R is not None:
        known = np.array(measured)
        R = np.where(known[:, None] & known, R, 0.0)
    filled = driver.axes is not Axes.STREAM and np.abs(v - FILL_VELOCITY) < _FILL_ROUNDING
    if np.any(filled):
        raise RejectedMessage("invalid", f"velocity is {v.tolist()}, {FILL_VELOCITY} is none")
    return v, R, measured


class Vector(NamedTuple):
    """Three numbers as the fields of a Vector3."""

    x: float
    y: float
    z: float


def _both(a: tuple[bool, ...], b: tuple[bool, ...]) -> tuple[bool, bool, bool]:
    x, y, z = (p and q for p, q in zip(a, b, strict=True))
    return x, y, z


def _check_bottom(told: Ping) -> None:
    """Refuse a ping that is marked as invalid, is of the water, or has no bottom."""
    if not any(told.measured):
        raise RejectedMessage("invalid", "the driver marks the velocity as invalid")
    if told.water:
        raise RejectedMessage("through_water", "the velocity is that through the water")
    if told.altitude < 0.0:
        raise RejectedMessage("no_bottom", f"altitude is {told.altitude:g} m")
    if told.good_beams is not None and told.good_beams < MIN_BEAMS:
        raise RejectedMessage(
            "no_bottom", f"{told.good_beams} beams have the bottom, {MIN_BEAMS} are needed"
        )


def _stamp_ns(message: Any, driver: Driver) -> int:
    """Stamp of a message, before the latency [ns].

    Raises:
        RejectedMessage: ``bad_stamp`` or ``no_stamp``.
    """
    if driver.header:
        return sensor_stamp_ns(message.header)
    seconds, microseconds = int(message.timestamp), int(message.microseconds)
    if not message.posix_time or seconds == 0:
        raise RejectedMessage(
            "no_stamp",
            "the device's clock is not set: set it, or take the time of arrival (dvl.stamp)",
        )
    if not 0 <= microseconds < NS // _US:
        raise RejectedMessage("bad_stamp", f"stamp is {seconds} s and {microseconds} us")
    return seconds * NS + microseconds * _US


def _latency_ns(message: Any, driver: Driver) -> int:
    """Time from validity to transmission [ns]; 0 where the message does not tell both.

    Raises:
        RejectedMessage: ``bad_stamp``.
    """
    if driver.times is None:
        return 0
    valid_us, sent_us = (int(field_of(message, name, 0)) for name in driver.times)
    if valid_us <= 0 or sent_us <= 0:
        return 0
    latency_ns = (sent_us - valid_us) * _US
    if not 0 <= latency_ns <= MAX_LATENCY_NS:
        raise RejectedMessage(
            "bad_stamp",
            f"{driver.times[1]} is {latency_ns / NS:g} s after {driver.times[0]}, 0 to "
            f"{MAX_LATENCY_NS / NS:g} s are possible",
        )
    return latency_ns
