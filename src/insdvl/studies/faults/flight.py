"""A stream of messages through the filter, as its node takes them, and what it publishes."""

import hashlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array, Stamps
from insdvl.messages.convert import stamp_ns as stamp_of
from insdvl.messages.feed import Feed
from insdvl.messages.refusals import Refused
from insdvl.messages.topics import DEPTH, HEADING, IMU, measurement_of
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.frames import (
    ENU,
    rotation_from_quaternion,
    rpy_from_rotation,
)
from insdvl.navigation.odometry import Odometry
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build, flatten
from insdvl.simulation.initial_errors import P_0, drawn_initial
from insdvl.simulation.mission import Mission
from insdvl.studies.faults.stream import Arrival, Sensors, Stream, learned_from
from insdvl.timeline.fold import Fold
from insdvl.timeline.jumps import TimeJump
from insdvl.timeline.output import AppliedUpdate
from insdvl.tuner.tuner import Tuner

_COVARIANCE_EVERY_NS = NS // 10  # of stamps, between two checks of the whole covariance


class FlownUpdate(NamedTuple):
    """A measurement, judged by the filter.

    Attributes:
        time_ns: Time of arrival of the message that led to it.
        stamp_ns: Stamp of the measurement.
        measurement: Its name.
        reason: Why it was not accepted; empty where it was.
    """

    time_ns: int
    stamp_ns: int
    measurement: str
    reason: str


@dataclass(frozen=True)
class Flight:
    """What the filter published of a stream, compared with the truth.

    Attributes:
        times_ns: (N,) time of arrival that corresponds to each published stamp.
        truth_ns: (N,) time of the mission that corresponds to it.
        v_b: (N, 3) published body velocity [m/s], stream axes.
        error: (N, 3) its error.
        sigma: (N, 3) its standard deviation.
        height_error: (N,) error of the published height [m], positive upwards.
        height_sigma: (N,) its standard deviation.
        heading_error: (N,) error of the published yaw within +-pi [rad].
        heading_sigma: (N,) its standard deviation.
        digest: Digest of all published odometry without its stamps.
        updates: The measurements that were judged.
        refused: Messages that were not used, by topic and reason.
        counts: Counters of the fold at the end.
        lost: Valid messages that are in no output.
        faulted: Messages that are not valid, by topic.
        finite: Whether every published number is finite.
        positive: Whether the covariance of the error state was symmetric and positive throughout.
        monotonic: Whether published stamps increase within each epoch.
    """

    times_ns: Stamps
    truth_ns: Stamps
    v_b: Array
    error: Array
    sigma: Array
    height_error: Array
    height_sigma: Array
    heading_error: Array
    heading_sigma: Array
    digest: str
    updates: list[FlownUpdate]
    refused: dict[Refused, int]
    counts: dict[str, int]
    lost: int
    faulted: dict[str, int]
    finite: bool
    positive: bool
    monotonic: bool

    def updates_of(self, measurement: str) -> list[FlownUpdate]:
        """The updates of one kind of measurement."""
        return [update for update in self.updates if update.measurement == measurement]

    def inside(self, begin_ns: int, end_ns: int) -> NDArray[np.bool_]:
        """Which outputs have times of arrival within [begin, end)."""
        return (self.times_ns >= begin_ns) & (self.times_ns < end_ns)


def parameters_of(
    mission: Mission, sensors: Sensors, seed: int, changes: Mapping[str, Any]
) -> FilterParameters:
    """Parameters that fit the mission; the initial state has an error drawn from P_0.

    Args:
        mission: The mission.
        sensors: What navigates.
        seed: Random seed of the error.
        changes: Further parameters, by name.
    """
    rng = np.random.default_rng([seed, 2])
    initial = drawn_initial(mission.truth, P_0, rng, with_position=False)
    force, turn = sensors.variances
    values = {
        **flatten(P_0, "initial."),
        "imu.rate": sensors.rate,
        "process_noise.accelerometer_variance": (force,) * 3,
        "process_noise.gyroscope_variance": (turn,) * 3,
        "initial.rpy": tuple(rpy_from_rotation(ENU.attitude(initial.C_o_b)).tolist()),
        "initial.velocity": tuple((ENU.body @ initial.v).tolist()),
        "origin.height": -5.0,
        "depth.topic": DEPTH if sensors.depth_rate else "",
        "depth.surface_std": 0.0,
        "heading.topic": HEADING if sensors.heading_rate else "",
        "heading.interval": 0.0,
    }
    return build(FilterParameters, values | dict(changes))


def fly(stream: Stream, parameters: FilterParameters, tuner: Tuner | None = None) -> Flight:
    """Give every message to the filter when it arrives, and take what it publishes.

    Args:
        stream: The messages.
        parameters: Parameters of the filter.
        tuner: Publishes the process noise that it learns from the same IMU messages.
    """
    feed = Feed(parameters)
    out = _Outputs(stream)
    arrivals = stream.arrivals if tuner is None else _with_learned(stream.arrivals, tuner)
    for time_ns, topic, message, _ in arrivals:
        if topic not in feed.inputs.topics:
            continue
        feed.give(topic, message)
        for output in feed.fold.take():
            if isinstance(output, AppliedUpdate):
                report = output.report
                reason = "" if report.accepted else report.reason
                update = FlownUpdate(time_ns, output.stamp_ns, report.measurement, reason)
                out.updates.append(update)
            elif not isinstance(output, TimeJump):
                out.add(output, time_ns, feed.fold)
    return out.flight(parameters, dict(feed.refused), feed.fold.counts)


def _with_learned(arrivals: Iterable[Arrival], tuner: Tuner) -> Iterator[Arrival]:
    """Messages, and the process noise that a tuner learns from the IMU messages."""
    for arrival in arrivals:
        yield arrival
        if arrival.topic == IMU and (learned := learned_from(arrival, tuner)):
            yield learned


class _Outputs:
    """Collects what is published, and compares it with the truth."""

    def __init__(self, stream: Stream) -> None:
        self.stream = stream
        self.updates: list[FlownUpdate] = []
        self.rows: list[tuple[int, int, Array, Array]] = []
        self.heights: list[tuple[float, float]] = []  # published, and sigma
        self.yaws: list[tuple[float, float]] = []
        self.digest = hashlib.sha256()
        self.finite = self.positive = self.monotonic = True
        self.epochs: list[int] = []
        self.stamps: Counter[int] = Counter()
        self.newest_ns: int | None = None
        self.checked_ns = -NS

    def add(self, output: Odometry, now_ns: int, fold: Fold) -> None:
        numbers = np.concatenate(
            [
                output.position,
                output.quaternion_xyzw,
                output.twist_linear,
                output.twist_angular,
                output.pose_covariance.ravel(),
                output.twist_covariance.ravel(),
            ]
        )
        self.digest.update(numbers.tobytes())
        self.finite &= bool(np.isfinite(numbers).all())
        if abs(output.stamp_ns - self.checked_ns) >= _COVARIANCE_EVERY_NS:
            self.checked_ns = output.stamp_ns
            self.positive &= _positive(fold.filter.covariance(fold.latest))  # type: ignore[arg-type]
        self.stamps[output.stamp_ns] += 1
        k = self.stream.epoch_of(output.stamp_ns, now_ns)
        if k is None:  # a stamp of no epoch
            self.monotonic = False
            return
        same = bool(self.epochs) and self.epochs[-1] == k
        if same and self.newest_ns is not None and output.stamp_ns <= self.newest_ns:
            self.monotonic = False
        self.newest_ns = output.stamp_ns
        self.epochs.append(k)
        epoch = self.stream.epochs[k]
        time_ns = output.stamp_ns - epoch.stamp_ns
        sigma = np.sqrt(np.diag(output.twist_covariance)[:3])
        self.rows.append((time_ns, time_ns + epoch.truth_ns, output.twist_linear, sigma))
        self.heights.append((output.position[2], np.sqrt(output.pose_covariance[2, 2])))
        C = rotation_from_quaternion(output.quaternion_xyzw)
        self.yaws.append((rpy_from_rotation(C)[2], np.sqrt(output.pose_covariance[5, 5])))

    def flight(
        self, parameters: FilterParameters, refused: dict[Refused, int], counts: dict[str, int]
    ) -> Flight:
        """All that was published, compared with the truth."""
        times, truths, velocities, sigmas = zip(*self.rows, strict=True)
        truth_ns, v_b = np.array(truths, dtype=np.int64), np.array(velocities)
        mission = self.stream.mission
        k = np.searchsorted(mission.stamps_ns, truth_ns)
        if not np.array_equal(mission.stamps_ns[k], truth_ns):
            raise ValueError("an output has a stamp that the mission does not have")
        true_v_b = np.einsum("kji,kj->ki", mission.truth.C_n_b[k], mission.truth.v_n[k]) @ ENU.body
        height, height_sigma = np.array(self.heights).T
        yaw, yaw_sigma = np.array(self.yaws).T
        true_yaw = rpy_from_rotation(ENU.attitude(mission.truth.C_o_b[k]))[:, 2]
        faulted = Counter(a.topic for a in self.stream.arrivals if not a.valid)
        return Flight(
            times_ns=np.array(times, dtype=np.int64),
            truth_ns=truth_ns,
            v_b=v_b,
            error=v_b - true_v_b,
            sigma=np.array(sigmas),
            height_error=height + mission.truth.p_o[k, 2],
            height_sigma=height_sigma,
            heading_error=(yaw - true_yaw + np.pi) % (2.0 * np.pi) - np.pi,
            heading_sigma=yaw_sigma,
            digest=self.digest.hexdigest(),
            updates=self.updates,
            refused=refused,
            counts=counts,
            lost=self._lost(parameters),
            faulted=dict(faulted),
            finite=self.finite,
            positive=self.positive,
            monotonic=self.monotonic,
        )

    def _lost(self, parameters: FilterParameters) -> int:
        """Valid messages without an output of their stamp.

        Those before the end of an initialisation, and those that `output_delay` still holds back,
        are not lost.
        """
        stream = self.stream
        valid = [
            (stamp_ns, stream.epoch_of(stamp_ns, arrival.time_ns), arrival.topic)
            for arrival in stream.arrivals
            if arrival.valid and (arrival.topic == IMU or measurement_of(arrival.topic))
            for stamp_ns in (stamp_of(arrival.message.header),)
        ]
        wait = parameters.initial.levelling_time if parameters.initial.mode == "levelling" else 0.0
        first: dict[int | None, int] = {}
        for stamp_ns, epoch, topic in valid:
            if topic == IMU:
                first.setdefault(epoch, stamp_ns + round(wait * NS))
        last = len(stream.epochs) - 1
        until_ns = max((stamp_ns for stamp_ns, epoch, _ in valid if epoch == last), default=0)
        until_ns -= round(parameters.output_delay * NS)
        samples, measurements = Counter[int](), Counter[tuple[str, int]]()
        for stamp_ns, epoch, topic in valid:
            early = epoch in first and stamp_ns < first[epoch]
            if not early and not (epoch == last and stamp_ns > until_ns):
                if topic == IMU:
                    samples[stamp_ns] += 1
                else:
                    measurements[measurement_of(topic), stamp_ns] += 1
        updated = Counter((update.measurement, update.stamp_ns) for update in self.updates)
        return (samples - self.stamps).total() + (measurements - updated).total()


def _positive(P: Array) -> bool:
    """Whether a covariance is exactly symmetric and positive definite."""
    if not np.array_equal(P, P.T):
        return False
    try:
        np.linalg.cholesky(P)
    except np.linalg.LinAlgError:
        return False
    return True
