"""Random messages of an adversary: most are plausible, the others hold anything the type allows."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np

from insdvl.arrays import Array
from insdvl.messages import topics as names
from insdvl.messages.convert import FIX, IMU, ODOMETRY, TWIST, TWIST_WITH_COVARIANCE
from insdvl.messages.depth import PRESSURE
from insdvl.navigation.events import NS
from insdvl.recordings.base import new_message
from insdvl.recordings.drivers import DEFINITIONS, Told, dvl_message
from insdvl.recordings.messages import imu_message, odometry_message, twist_message

#: Numbers that break programs.
ODD = (np.nan, np.inf, -np.inf, 1e308, -1e300, 1e155, 1e30, 1e12, 1e-310, -0.0, 0.0)
_STEP_NS = NS // 100


class Adversary:
    """Draws messages, mostly with increasing stamps.

    Args:
        rng: Random numbers.
        start_ns: First stamp.
        odd: Probability that a field of a message is implausible.
        wire: Whether every message must be serialisable: no covariance of a wrong size.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        *,
        start_ns: int = 1000 * NS,
        odd: float = 0.05,
        wire: bool = False,
    ) -> None:
        self._rng = rng
        self._now_ns = start_ns
        self._odd = odd
        self._wire = wire
        self._makers: dict[str, Callable[[], Any]] = {
            IMU: self._imu,
            TWIST: self._twist,
            TWIST_WITH_COVARIANCE: self._twist_with_covariance,
            ODOMETRY: self._odometry,
            FIX: self._fix,
            PRESSURE: self._pressure,
        }

    def messages(self, types: Mapping[str, str], count: int) -> Iterator[tuple[str, Any]]:
        """Topics and messages; four of five are samples of imu/data_raw.

        Args:
            types: Message type of each topic.
            count: Number of messages.
        """
        topics = list(types)
        for _ in range(count):
            imu = self._rng.random() < 0.8 and names.IMU in types
            topic = names.IMU if imu else topics[self._rng.integers(len(topics))]
            if topic == names.IMU:
                self._now_ns += _STEP_NS
            kind = types[topic]
            if kind in DEFINITIONS:
                yield topic, self._driver(kind)
                continue
            maker = self._makers.get(kind)
            message = self._any(kind) if maker is None else maker()
            yield topic, replace(message, header=self._header(message.header))

    def _any(self, kind: str) -> Any:
        """A message of a type without a maker of its own, with random numbers in all its fields."""
        message = new_message(kind)
        for field in fields(message):
            value = getattr(message, field.name)
            if isinstance(value, float):
                setattr(message, field.name, float(self._numbers(1, 0.0, 1.0)[0]))
            elif isinstance(value, np.ndarray) and value.dtype == np.float64:
                setattr(message, field.name, self._numbers(value.size, 0.0, 1.0))
            elif hasattr(value, "__msgtype__") and field.name != "header":
                setattr(message, field.name, self._any(value.__msgtype__))
        return message

    def _is_odd(self) -> bool:
        return bool(self._rng.random() < self._odd)

    def _header(self, header: Any) -> Any:
        sec, nanosec = self._stamp()
        frame_id = ["imu_link", "", "camera", "x" * 300, "ü\n"][self._rng.integers(5)]
        return replace(
            header,
            stamp=replace(header.stamp, sec=sec, nanosec=nanosec),
            frame_id=frame_id if self._is_odd() else "imu_link",
        )

    def _stamp(self) -> tuple[int, int]:
        now_ns, rng = self._now_ns, self._rng
        if not self._is_odd():
            return divmod(now_ns, NS)
        if rng.random() < 0.02:  # the clock is set, and stays so
            self._now_ns = int(rng.integers(1, 2**31 - 10_000)) * NS
            return divmod(self._now_ns, NS)
        stamps = (
            (0, 0),
            (-int(rng.integers(1, 2**31)), 5),
            (now_ns // NS, int(rng.integers(NS, 2**32))),
            (2**31 - 1, 999_999_999),
            divmod(now_ns - int(rng.integers(0, 5 * NS)), NS),
            divmod(now_ns + int(rng.integers(0, 60 * NS)), NS),
            divmod(now_ns - _STEP_NS, NS),
        )
        return stamps[rng.integers(len(stamps))]

    def _numbers(self, size: int, mean: Array | float, sigma: float) -> Array:
        values = mean + sigma * self._rng.standard_normal(size)
        if self._is_odd():
            values[self._rng.integers(size)] = ODD[self._rng.integers(len(ODD))]
        return values

    def _covariance(self, size: int) -> Array:
        rng = self._rng
        if not self._is_odd():
            return np.diag(10.0 ** rng.uniform(-6.0, 0.0, size)).ravel()
        flat = (10.0 ** rng.uniform(-3.0, 3.0) * rng.standard_normal((size, size))).ravel()
        choices = [
            np.zeros(size * size),
            np.full(size * size, ODD[rng.integers(len(ODD))]),
            np.diag(np.full(size, ODD[rng.integers(len(ODD))])).ravel(),
            flat,
            (flat.reshape(size, size) @ flat.reshape(size, size).T).ravel(),
            np.concatenate([[-1.0], np.zeros(size * size - 1)]),
            -np.eye(size).ravel(),
        ]
        if not self._wire:
            choices += [np.zeros(0), np.ones(5), np.ones(size * size - 1), np.eye(size + 1).ravel()]
        return choices[rng.integers(len(choices))]

    def _imu(self) -> Any:
        f = self._numbers(3, np.array([0.0, 0.0, 9.8]), 0.1)
        message = imu_message(0, "", f, self._numbers(3, 0.0, 0.03))
        x, y, z, w = self._numbers(4, np.array([0.0, 0.0, 0.0, 1.0]), 1e-3).tolist()
        return replace(
            message,
            orientation=replace(message.orientation, x=x, y=y, z=z, w=w),
            orientation_covariance=self._covariance(3),
            linear_acceleration_covariance=self._covariance(3),
            angular_velocity_covariance=self._covariance(3),
        )

    def _twist(self) -> Any:
        return twist_message(0, "", self._numbers(3, 0.0, 0.1))

    def _twist_with_covariance(self) -> Any:
        message = twist_message(0, "", self._numbers(3, 0.0, 0.1), np.eye(3))
        return replace(message, twist=replace(message.twist, covariance=self._covariance(6)))

    def _odometry(self) -> Any:
        q = self._rng.standard_normal(4)
        q /= np.linalg.norm(q)
        if self._is_odd():
            q[self._rng.integers(4)] = ODD[self._rng.integers(len(ODD))]
        message = odometry_message(
            0,
            ("odom", "base_link"),
            self._numbers(3, 0.0, 10.0),
            q,
            self._numbers(3, 0.0, 1.0),
            self._numbers(3, 0.0, 0.1),
        )
        pose = replace(message.pose, covariance=self._covariance(6))
        twist = replace(message.twist, covariance=self._covariance(6))
        return replace(message, pose=pose, twist=twist)

    def _driver(self, kind: str) -> Any:
        """A ping of a driver's own type; where it is odd, any of its numbers may be anything."""
        rng = self._rng
        told = Told()
        if self._is_odd():
            told = Told(
                valid=bool(rng.integers(2)),
                sigma=float(rng.choice([0.0, 0.1, 10.0, 1e100])),
                altitude=float(rng.choice([-1.0, 20.0, np.nan])),
                good_beams=int(rng.integers(4)),
                beams=bool(rng.integers(2)),
                water=bool(rng.integers(2)),
                latency_ns=int(rng.integers(-(10**9), 2 * 10**10)),
            )
        message = dvl_message(kind, self._now_ns, self._numbers(3, 0.0, 0.1), told)
        if self._is_odd():
            message = self._spoilt(message)
        if hasattr(message, "header"):
            return replace(message, header=self._header(message.header))
        if self._is_odd():
            message.posix_time = bool(rng.integers(2))
            message.timestamp, message.microseconds = (int(rng.integers(2**32)) for _ in range(2))
        return message

    def _spoilt(self, message: Any) -> Any:
        """A message one of whose numbers, at any depth, is anything."""
        name = [field.name for field in fields(message)][self._rng.integers(len(fields(message)))]
        value = getattr(message, name)
        odd = float(ODD[self._rng.integers(len(ODD))])
        if isinstance(value, float):
            return replace(message, **{name: odd})
        if isinstance(value, np.ndarray) and value.size and value.dtype.kind == "f":
            spoilt = value.copy()
            with np.errstate(over="ignore"):
                spoilt[self._rng.integers(value.size)] = odd
            return replace(message, **{name: spoilt})
        if hasattr(value, "__msgtype__") and name != "header":
            return replace(message, **{name: self._spoilt(value)})
        return message

    def _pressure(self) -> Any:
        message = new_message(PRESSURE)
        message.fluid_pressure = float(self._numbers(1, 2e5, 1e4)[0])
        message.variance = float(np.abs(self._numbers(1, 1e4, 1e3))[0])
        return message

    def _fix(self) -> Any:
        message = new_message(FIX)
        message.status.status = int(self._rng.integers(-2, 3))
        message.status.service = 1
        numbers = self._numbers(3, np.array([32.0, 34.0, 0.0]), 1.0)
        message.latitude, message.longitude, message.altitude = numbers.tolist()
        message.position_covariance = self._covariance(3)
        return message
