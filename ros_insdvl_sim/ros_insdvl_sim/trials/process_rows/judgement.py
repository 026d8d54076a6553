"""Errors and losses of a mission that was flown by processes."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message

from insdvl.arrays import Array
from insdvl.navigation.events import NS
from ros_insdvl_sim.trials.process_rows.flight import START_S, LiveFlight

GOOD = 0.5  # m/s: below it the velocity has recovered
SECOND = 100  # samples of a second


def velocity_of(data: bytes) -> tuple[Array, Array, bool]:
    """Body velocity (3,) and its covariance (6, 6), and whether the whole message is finite."""
    message = deserialize_message(data, Odometry)
    v, p, q = message.twist.twist.linear, message.pose.pose.position, message.pose.pose.orientation
    velocity = np.array([v.x, v.y, v.z])
    covariance = message.twist.covariance.reshape(6, 6)
    numbers = [velocity, [p.x, p.y, p.z, q.x, q.y, q.z, q.w], covariance.ravel()]
    finite = bool(np.isfinite(np.concatenate([*numbers, message.pose.covariance])).all())
    return velocity, covariance, finite


class Errors:
    """Errors of the body velocity against the truth.

    Attributes:
        t: (N,) time of the mission [s].
        error: (N,) length of the error [m/s].
        finite: Whether all output is finite, with positive variances of the velocity.
        rising: Whether the published stamps rise.
    """

    def __init__(self, flight: LiveFlight) -> None:
        rows = {stamp: data for stamp, data in flight.odometry if stamp in flight.truth}
        stamps = np.array(sorted(rows), dtype=np.int64)
        self.t = stamps / NS - START_S
        self.error = np.empty(stamps.size)
        self.finite = True
        for k, stamp in enumerate(stamps.tolist()):
            v, covariance, finite = velocity_of(rows[stamp])
            self.finite &= finite and bool((np.diag(covariance)[:3] > 0.0).all())
            self.error[k] = np.linalg.norm(v - velocity_of(flight.truth[stamp])[0])
        published = np.array([stamp for stamp, _ in flight.odometry], dtype=np.int64)
        self.rising = bool((np.diff(published) > 0).all())

    def rms(self, begin: float, end: float) -> float | None:
        """RMS within a time of the mission [m/s], None without output."""
        inside = (self.t >= begin) & (self.t < end)
        return float(np.sqrt(np.mean(self.error[inside] ** 2))) if inside.any() else None

    def largest_from(self, begin: float) -> float:
        """Largest from a time of the mission on [m/s], infinite without output."""
        behind = self.error[self.t >= begin]
        return float(behind.max()) if behind.size else np.inf

    def recovery(self, end: float) -> float | None:
        """Time from the end of a fault until the error stays below `GOOD` [s]."""
        behind = self.t >= end
        bad = np.flatnonzero(self.error[behind] >= GOOD)
        first = 0 if not bad.size else int(bad[-1]) + 1
        if first >= behind.sum():
            return None
        return max(float(self.t[behind][first] - end), 0.0)


@dataclass(frozen=True)
class Flown:
    """A row that was flown to its end.

    Attributes:
        flight: What was seen.
        fault: Begin and end of the fault [s of the mission], None if no errors are judged.
    """

    flight: LiveFlight
    fault: tuple[float, float] | None

    @cached_property
    def errors(self) -> Errors:
        """Errors of the whole mission."""
        return Errors(self.flight)


def samples_without_output(
    sent: Sequence[int], published: Sequence[int], lives: Sequence[float], output_delay: float
) -> int:
    """Samples without output, from the first output of each filter on.

    Of a filter that was ended, up to its last output; of the last one, up to the end of the
    mission.

    Args:
        sent: Stamps of the samples [ns].
        published: Stamps of the output [ns].
        lives: Where one filter ends and the next begins [s of the mission]; in between there is
            none to lose anything.
        output_delay: What the last filter holds back at the end [s].
    """
    samples, stamps = np.array(sorted(sent)), np.array(sorted(published), dtype=np.int64)
    *ended, last = np.split(stamps, np.searchsorted(stamps / NS - START_S, lives))
    until_ns = [int(own[-1]) for own in ended]
    until_ns.append(int(samples[-1]) - round(output_delay * NS))
    return sum(
        int(((samples >= own[0]) & (samples <= end_ns)).sum()) - own.size
        for own, end_ns in zip([*ended, last], until_ns, strict=True)
    )


def first_sigmas(flight: LiveFlight, index: int) -> float:
    """Largest ratio of velocity error to sigma, in the second of outputs from an index on."""
    ratios = []
    for stamp, data in flight.odometry[index : index + SECOND]:
        v, covariance, _ = velocity_of(data)
        error = v - velocity_of(flight.truth[stamp])[0]
        ratios.append(float((np.abs(error) / np.sqrt(np.diag(covariance)[:3])).max()))
    return max(ratios)
