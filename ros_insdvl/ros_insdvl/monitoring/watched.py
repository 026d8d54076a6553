"""A filter that is watched: what its topics say of it."""

import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from sensor_msgs.msg import Imu

from insdvl.arrays import Array
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.frames import (
    CONVENTIONS,
    Convention,
    rotation_from_quaternion,
    rpy_from_rotation,
)
from insdvl.navigation.state.layout import gate_counter
from insdvl.watch.table.numbers import Finding, Measured, Pose, Shown, Triads, VelocityError
from ros_insdvl.monitoring.polled import Last
from ros_insdvl.odometry_series import OdometrySeries
from ros_insdvl.status.diagnostics import (
    NOMINAL_Q,
    Q_IN_USE,
    age_key,
    nis_key,
    sigma_keys,
    updates_key,
)
from ros_insdvl.status.filter.frames import CONVENTION
from ros_insdvl.status.heard import OK, HeardDiagnostics, Report

_NOISE = "process noise"  # the cause
_ACCEPTED = updates_key("", "accepted")


@dataclass
class Watched:
    """A filter, and what is known of it.

    Attributes:
        label: Its namespace.
        node: Its full name.
        series: Its odometry.
        heard: The diagnostics of all nodes.
        biases: Its estimated biases.
    """

    label: str
    node: str
    series: OdometrySeries
    heard: HeardDiagnostics
    biases: Last = field(default_factory=lambda: Last(Imu))
    _odometry_at: float | None = None  # when the last odometry came, on the monotonic clock [s]

    def add_odometry(self, data: bytes) -> None:
        """Take a message of its odometry.

        Raises:
            RejectedMessage: It cannot be read.
        """
        self.series.add(data)
        self._odometry_at = time.monotonic()

    @property
    def report(self) -> Report:
        """Its last diagnostics."""
        return self.heard.report(self.node)

    @property
    def rejected(self) -> int:
        """Number of messages and updates that it did not use."""
        counts = (v for key, v in self.report.values.items() if key.startswith("rejected "))
        return sum(map(_count, counts))

    def shown(self, error: VelocityError | None, true_noise: Triads | None) -> Shown:
        """What the table shows of it.

        Args:
            error: Against the truth.
            true_noise: Of the IMU, where a simulator tells it.
        """
        report, now = self.report, time.monotonic()
        values = report.values
        convention = CONVENTIONS.get(values.get(CONVENTION, ""), CONVENTIONS["enu"])
        nis, nis_count = self._nis(values)
        bias, bias_sigma = self._biases(convention)
        return Shown(
            label=self.label,
            node=self.node,
            silent=now - report.at if report.count else None,
            still=None if self._odometry_at is None else now - self._odometry_at,
            pose=self._pose(convention),
            measured=tuple(_measured(report)),
            nis=nis,
            nis_count=nis_count,
            bias=bias,
            bias_sigma=bias_sigma,
            noise=_sigmas(values, Q_IN_USE),
            nominal=_sigmas(values, NOMINAL_Q),
            true_noise=true_noise,
            noise_source=report.statuses[_NOISE].message if _NOISE in report.statuses else "",
            inflations=_count(values.get(gate_counter("dvl", "inflations"), "0")),
            restarts=_count(values.get(gate_counter("dvl", "restarts"), "0")),
            imu_rate=_number(values.get("rate imu/data_raw [Hz]", "")),
            output_rate=_number(values.get("rate odometry/filtered [Hz]", "")),
            error=error,
            findings=tuple(_findings(report)),
        )

    def _pose(self, convention: Convention) -> Pose | None:
        """The last odometry, in the core's axes."""
        if not len(self.series):
            return None
        stamps, rows = self.series.arrays(count=1)
        row = rows[0]
        try:
            C_o_b = rotation_from_quaternion(row[OdometrySeries.QUATERNION])
        except ValueError:  # not a rotation: another node publishes there
            return None
        variance = row[OdometrySeries.POSE_VARIANCE]
        rpy_deg = np.degrees(rpy_from_rotation(convention.attitude(C_o_b)))
        rpy_deg[2] %= 360.0
        tilt, heading = variance[3:5].max(), variance[5]
        return Pose(
            stamp_s=int(stamps[0]) / NS,
            position=convention.nav @ row[OdometrySeries.POSITION],
            rpy_deg=rpy_deg,
            velocity=convention.body @ row[OdometrySeries.VELOCITY],
            position_sigma=_sigma(np.abs(convention.nav) @ variance[:3]),
            rpy_sigma_deg=np.degrees(_sigma(np.array([tilt, tilt, heading]))),
            velocity_sigma=_sigma(row[OdometrySeries.VELOCITY_VARIANCE]),
        )

    def _nis(self, values: Mapping[str, str]) -> tuple[float | None, int]:
        begin = nis_key("dvl")
        for key, value in values.items():
            if key.startswith(begin):
                return _number(value), _count(key.removeprefix(begin))
        return None, 0

    def _biases(self, convention: Convention) -> tuple[Triads | None, Triads | None]:
        message = self.biases.message
        if message is None:
            return None, None
        f, w = (
            convention.body @ np.array([v.x, v.y, v.z])
            for v in (message.linear_acceleration, message.angular_velocity)
        )
        return Triads(f, w), triads_of_covariances(message)


def triads_of_covariances(message: Imu) -> Triads:
    """The sigmas in the covariances of an Imu message; NaN where one is unknown (REP-145)."""
    f, w = (
        np.where(variance > 0.0, _sigma(variance), np.nan)
        for variance in (
            message.linear_acceleration_covariance[::4],
            message.angular_velocity_covariance[::4],
        )
    )
    return Triads(f, w)


def _measured(report: Report) -> Iterator[Measured]:
    """Of each sensor, the DVL first."""
    causes = sorted(report.of_cause, key=lambda cause: cause != "dvl")
    for cause in causes:
        values = report.of_cause[cause]
        labels = [key.removesuffix(_ACCEPTED) for key in values if key.endswith(_ACCEPTED)]
        for label in labels:
            refused = {
                key.rpartition(": ")[2]: _count(value)
                for key, value in values.items()
                if key.startswith("rejected ")
            }
            yield Measured(
                label,
                used=_count(values[updates_key(label, "accepted")]),
                refused={reason: count for reason, count in refused.items() if count},
                age=_number(values.get(age_key(label), "")),
            )


def _findings(report: Report) -> list[Finding]:
    """The worst first."""
    found = [
        Finding(status.level, f"{cause}: {status.message}")
        for cause, status in report.statuses.items()
        if status.level != OK
    ]
    return sorted(found, key=lambda finding: -finding.level)


def _sigmas(values: Mapping[str, str], name: str) -> Triads | None:
    numbers = [_number(values.get(key, "")) for key in sigma_keys(name)]
    if any(number is None for number in numbers):
        return None
    return Triads(np.array(numbers[:3]), np.array(numbers[3:]))


def _sigma(variance: Array) -> Array:
    return np.sqrt(np.maximum(variance, 0.0))


def _number(text: str) -> float | None:
    """A finite number; None for what is none, for another node may report anything."""
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def _count(text: str) -> int:
    return int(text) if text.isdecimal() else 0
