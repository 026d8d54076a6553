"""The noise of the sensors that the tuner node would have published on a recording."""

from collections.abc import Collection, Iterator

from insdvl.messages.convert import RejectedMessage, vector
from insdvl.messages.topics import (
    IMU,
    MEASUREMENT_NOISE,
    PROCESS_NOISE,
    TOPICS,
    measurement_of,
)
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.recordings.base import Raw, decode, encode
from insdvl.recordings.messages import imu_message, message_of
from insdvl.recordings.played import Recording
from insdvl.tuner.own import EstimatorError
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.republish import DvlMessages, set_learned, tune
from insdvl.tuner.tuner import Tuner


class Learned(Recording):
    """A recording with the process noise that the tuner learns from its IMU.

    Args:
        recording: The recording; process noise that it has is left out.
        parameters: Of the tuner.

    Raises:
        ModelError: The model cannot be used.
    """

    def __init__(self, recording: Recording, parameters: TunerParameters) -> None:
        self._recording, self._parameters = recording, parameters
        Tuner(parameters)

    @property
    def topics(self) -> frozenset[str]:
        """See `Recording`."""
        return self._recording.topics | {PROCESS_NOISE}

    def on(self, topics: Collection[str]) -> Iterator[Raw]:
        """See `Recording`."""
        if PROCESS_NOISE not in topics:
            yield from self._recording.on(topics)
            return
        tuner = Tuner(self._parameters)
        for raw in self._recording.on({*topics, IMU} - {PROCESS_NOISE}):
            if raw.topic in topics:
                yield raw
            if raw.topic == IMU and (learned := _learned(raw, tuner)) is not None:
                yield learned


def _learned(raw: Raw, tuner: Tuner) -> Raw | None:
    """What the tuner publishes on a sample, if anything.

    Raises:
        EstimatorError: An estimator of your own failed.
    """
    message = decode(raw).message
    try:
        tuned = tune(tuner, message)
    except RejectedMessage:  # counted where the recording is folded
        return None
    if tuner.failure:
        raise EstimatorError(tuner.failure)
    if tuned is None:
        return None
    f = vector(message.linear_acceleration, "linear_acceleration")
    w = vector(message.angular_velocity, "angular_velocity")
    copy = imu_message(tuned.stamp_ns, message.header.frame_id, f, w)
    set_learned(copy, tuned)
    return encode(PROCESS_NOISE, raw.time_ns, copy)


class LearnedOfDvl(Recording):
    """A recording with the noise of its DVL that the tuner learns.

    Args:
        recording: The recording; measurement noise that it has is left out.
        parameters: Of the tuner, with those of the vehicle.
    """

    def __init__(self, recording: Recording, parameters: TunerParameters) -> None:
        self._recording, self._parameters = recording, parameters

    @property
    def topics(self) -> frozenset[str]:
        """See `Recording`."""
        return self._recording.topics | {MEASUREMENT_NOISE}

    def on(self, topics: Collection[str]) -> Iterator[Raw]:
        """See `Recording`."""
        if MEASUREMENT_NOISE not in topics:
            yield from self._recording.on(topics)
            return
        messages = DvlMessages(self._parameters)
        sensors = {IMU, *(row.name for row in TOPICS if row.measurement == Dvl.name)}
        for raw in self._recording.on({*topics, *sensors} - {MEASUREMENT_NOISE}):
            if raw.topic in topics:
                yield raw
            if raw.topic not in sensors:
                continue
            hear = messages.hear_dvl if measurement_of(raw.topic) else messages.hear_imu
            try:
                tuned = hear(decode(raw).message)
            except RejectedMessage:  # counted where the recording is folded
                continue
            for one in tuned:
                message = message_of(MEASUREMENT_NOISE)
                messages.fill(message, one)
                yield encode(MEASUREMENT_NOISE, raw.time_ns, message)
