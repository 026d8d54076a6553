"""One pass over a recording that looks at everything; what is kept is small."""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

import numpy as np

from insdvl.messages import convert
from insdvl.messages.convert import RejectedMessage
from insdvl.messages.topics import BY_NAME, IMU, Topic, ZeroStamp
from insdvl.navigation.events import NS, Event, Imu
from insdvl.navigation.geometry.frames import CONVENTIONS
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build, flatten
from insdvl.recordings.bag_reader import BagReader, RecordedTopic
from insdvl.recordings.base import Raw, decode, stamp_ns
from insdvl.recordings.parameters import ReplayParameters
from insdvl.studies.check.bias import BiasLog, GyroscopeBias
from insdvl.studies.check.dvl import DvlFacts, DvlLog
from insdvl.studies.check.heading import OrientationFacts, OrientationLog
from insdvl.studies.check.imu import ImuFacts, ImuLog
from insdvl.studies.check.stamps import StampFacts, StampLog
from insdvl.studies.check.topics import READ, Sensors, begins_with_header, sensors_of
from insdvl.watch.alignment.check import AlignmentCheck
from insdvl.watch.alignment.gravity import ASIDE, GRAVITY, WRONG_SIZE, GravityCheck
from insdvl.watch.alignment.sentences import Remedy

FIRST = 60 * NS  # of the recording, from which gravity tells the axes
SHOWN = 5000  # messages between two reports of progress
GYROSCOPE_BIAS = "initial.gyroscope_bias_std"
NEAR = 0.02  # of a rate: nearer than this it is as declared


@dataclass(frozen=True)
class Inspection:
    """All that was seen.

    Attributes:
        topics: All topics, by name.
        remarks: What the reader of the recording says of it.
        sensors: Which of them are the sensors.
        stamps: What the stamps show, of the topics whose messages have them.
        span: From the first to the last message that was read [s].
        parameters: Of the filter, as the recording was judged: the defaults, or those that were
            given, and `found`.
        replay: Parameters that name the topics.
        found: Parameters of the filter that gravity, rate and the gyroscope's bias tell.
        imu: The samples; None without an IMU.
        gyroscope_bias: What they show of it together with the DVL; None where that is nothing.
        dvl: The measurements; None without a DVL.
        orientation: Of the IMU.
        place: Latitude and longitude of the first fix [deg]; None without one.
        gravity: What contradicts gravity.
        remedies: What the motion contradicts.
        windows: Windows of motion.
        ping_noise: See `AlignmentCheck.ping_noise`.
    """

    topics: dict[str, RecordedTopic]
    remarks: list[str]
    sensors: Sensors
    stamps: dict[str, StampFacts]
    span: float
    parameters: FilterParameters
    replay: ReplayParameters
    found: dict[str, Any]
    imu: ImuFacts | None
    gyroscope_bias: GyroscopeBias | None
    dvl: DvlFacts | None
    orientation: OrientationFacts | None
    place: tuple[float, float] | None
    gravity: list[str]
    remedies: list[Remedy]
    windows: int
    ping_noise: tuple[float, float] | None


def inspect(
    bag: BagReader,
    filter_: FilterParameters,
    replay: ReplayParameters,
    *,
    adapt: bool,
    show: Callable[[int], None] = lambda count: None,
) -> Inspection:
    """Look at a recording.

    Args:
        bag: The recording.
        filter_: Parameters by which it is judged.
        replay: Parameters that name the topics; topics of other names are found by type.
        adapt: Whether frame convention, mount, rate and a larger gyroscope bias of the IMU are
            taken from the recording, since nobody has told them.
        show: Called now and then with the number of messages that were read.

    Raises:
        BagError: The recording is damaged.
    """
    sensors = sensors_of(bag.topics, filter_, replay)
    found = _told_by_imu(bag, sensors, filter_) if adapt and sensors.imu else {}
    parameters = build(FilterParameters, flatten(filter_) | found)
    return _Pass(bag, sensors, parameters, adapt=adapt).inspection(replay, found, show)


def _told_by_imu(bag: BagReader, sensors: Sensors, told: FilterParameters) -> dict[str, Any]:
    """Frame convention, mount and rate of the IMU, where they differ from what is told."""
    found: dict[str, Any] = {}
    first = list(_first_samples(bag, sensors, told))
    if len(first) < 2:
        return {}
    steps = np.diff([sample.stamp_ns for sample in first]) / NS
    rate = 1.0 / float(np.median(steps)) if np.median(steps) > 0 else 0.0
    if rate and abs(rate / told.imu.rate - 1.0) > NEAR and 0.1 <= rate <= 1e4:
        found["imu.rate"] = float(f"{rate:.3g}")
        if told.imu.max_gap <= 2.0 / rate:
            found["imu.max_gap"] = float(f"{5.0 / rate:.2g}")
    mean = np.mean([sample.f_b for sample in first], axis=0)
    size = float(np.linalg.norm(mean))
    if abs(size / GRAVITY - 1.0) > WRONG_SIZE:  # which is said later
        return found
    if -mean[2] / size < -ASIDE:
        names = [name for name in CONVENTIONS if name != told.frame_convention]
        found["frame_convention"] = names[0]
    elif abs(mean[2]) / size < np.sqrt(1.0 - ASIDE**2):
        check = GravityCheck(told.frame_convention, np.eye(3))
        stamps_ns = np.array([sample.stamp_ns for sample in first])
        check.add(stamps_ns, np.array([sample.f_b for sample in first]))
        if check.mean is not None:
            found["imu.mount"] = check.upright_mount()
    return found


def _first_samples(bag: BagReader, sensors: Sensors, parameters: FilterParameters) -> Iterator[Imu]:
    raws = bag.raw([sensors.imu])
    start_ns = None
    for raw in raws:
        start_ns = raw.time_ns if start_ns is None else start_ns
        if raw.time_ns - start_ns > FIRST:
            return
        try:
            yield convert.imu(decode(raw).message, CONVENTIONS[parameters.frame_convention])
        except RejectedMessage:  # counted by the pass over all
            continue


class _Pass:
    """The pass over all messages with stamps."""

    def __init__(
        self, bag: BagReader, sensors: Sensors, parameters: FilterParameters, *, adapt: bool
    ) -> None:
        self._bag, self._sensors, self._parameters = bag, sensors, parameters
        self._adapt = adapt
        axes = CONVENTIONS[parameters.frame_convention]
        self._read = [n for n, t in bag.topics.items() if t.size and t.type in READ]
        self._headed = {n for n in self._read if begins_with_header(bag.topics[n].type)}
        self._logs = {name: StampLog() for name in self._read}
        self._newest_ns = 0  # of the IMU
        self._imu = ImuLog(parameters)
        self._dvl = DvlLog(parameters.dvl.max_speed, axes.body)
        self._orientation = OrientationLog(axes)
        self._bias = BiasLog(parameters.imu.max_gap)
        self._alignment = AlignmentCheck(parameters, thinks=False)
        self._place: tuple[float, float] | None = None

    def inspection(
        self, replay: ReplayParameters, found: dict[str, Any], show: Callable[[int], None]
    ) -> Inspection:
        """Look at all messages."""
        first_ns = last_ns = None
        for k, raw in enumerate(self._bag.raw(self._read)):
            if k % SHOWN == 0:
                show(k)
            first_ns = raw.time_ns if first_ns is None else first_ns
            last_ns = raw.time_ns
            if raw.topic in self._headed:
                self._logs[raw.topic].add(stamp_ns(raw), raw.time_ns)
            self._look(raw)
        sensors, has_imu, has_dvl = self._sensors, bool(self._sensors.imu), bool(self._sensors.dvl)
        dvl = self._dvl.facts() if has_dvl else None
        bias = self._gyroscope_bias(dvl) if has_imu and dvl is not None else None
        if bias is not None and bias.exceeds(self._bias_std):
            self._alignment.take_off(bias.mean, bias.size)
        if self._adapt and bias is not None and bias.is_usable and bias.exceeds(self._bias_std):
            found = {**found, GYROSCOPE_BIAS: bias.rounded}
            values = flatten(self._parameters) | {GYROSCOPE_BIAS: bias.rounded}
            self._parameters = build(FilterParameters, values)
        self._alignment.finish()
        longest = {sensors.imu: self._parameters.imu.max_gap}
        return Inspection(
            topics=dict(self._bag.topics),
            remarks=self._bag.remarks,
            sensors=sensors,
            stamps={n: log.facts(longest.get(n, 0.0)) for n, log in self._logs.items()},
            span=0.0 if first_ns is None or last_ns is None else (last_ns - first_ns) / NS,
            parameters=self._parameters,
            replay=replay,
            found=found,
            imu=self._imu.facts(self._bias_std) if has_imu else None,
            gyroscope_bias=bias,
            dvl=dvl,
            orientation=self._orientation.facts() if has_imu else None,
            place=self._place,
            gravity=self._alignment.gravity,
            remedies=self._alignment.remedies,
            windows=self._alignment.windows,
            ping_noise=self._alignment.ping_noise(),
        )

    @property
    def _bias_std(self) -> float:
        return self._parameters.initial.gyroscope_bias_std

    def _gyroscope_bias(self, dvl: DvlFacts) -> GyroscopeBias | None:
        sigma = self._parameters.dvl.noise_floor
        if dvl.scatter is not None:
            sigma = max(sigma, float(np.nanmax(dvl.scatter)))
        return self._bias.found(self._imu.variance(), sigma)

    def _look(self, raw: Raw) -> None:
        """Look at a message of a sensor."""
        sensors = self._sensors
        if raw.topic == sensors.imu:
            self._look_at_imu(raw)
        elif raw.topic == sensors.dvl:
            self._look_at_dvl(raw)
        elif raw.topic == sensors.fix and self._place is None:
            fix = decode(raw).message
            if fix.status.status >= 0 and np.isfinite([fix.latitude, fix.longitude]).all():
                self._place = float(fix.latitude), float(fix.longitude)

    def _look_at_imu(self, raw: Raw) -> None:
        message = decode(raw).message
        for event in self._events(message, BY_NAME[IMU], self._imu.refused):
            if isinstance(event, Imu):
                self._newest_ns = event.stamp_ns
                self._imu.add(event)
                self._bias.add(event)
                self._orientation.add(message, event.f_b)
                self._alignment.add(event)

    def _look_at_dvl(self, raw: Raw) -> None:
        row = self._sensors.dvl_row
        assert row is not None
        for event in self._events(decode(raw).message, row, self._dvl.refused):
            if isinstance(event, Dvl):
                self._dvl.add(event)
                self._bias.add_ping(event)
                self._alignment.add(event)
                if raw.topic not in self._headed:
                    self._logs[raw.topic].add(event.stamp_ns, raw.time_ns)

    def _events(self, message: Any, row: Topic, refused: Counter[str]) -> Iterator[Event]:
        """The events of a message at the time at which they were valid; a refusal is counted."""
        offset_ns = round(attrgetter(row.time_offset)(self._parameters) * NS)
        try:
            for event in row.convert(message, self._parameters):
                since_ns = offset_ns
                if event.stamp_ns <= 0 and row.zero_stamp is ZeroStamp.NOW:
                    since_ns += self._newest_ns
                yield replace(event, stamp_ns=event.stamp_ns + since_ns) if since_ns else event
        except RejectedMessage as rejection:
            refused[rejection.reason] += 1
