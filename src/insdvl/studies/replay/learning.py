"""The process noise that the tuner node would have published on a recording."""

from collections.abc import Sequence

from insdvl.messages.convert import RejectedMessage, vector
from insdvl.messages.topics import IMU, PROCESS_NOISE
from insdvl.recordings.base import Raw, decode, encode
from insdvl.recordings.messages import imu_message
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.republish import set_learned, tune
from insdvl.tuner.tuner import Tuner


def with_learned(recording: Sequence[Raw], parameters: TunerParameters) -> list[Raw]:
    """A recording with the process noise that the tuner learns from its IMU.

    Raises:
        BagError: A message is damaged.
        ModelError: The model cannot be used.
    """
    tuner = Tuner(parameters)
    learned: list[Raw] = []
    for raw in recording:
        learned.append(raw)
        if raw.topic != IMU:
            continue
        message = decode(raw).message
        try:
            tuned = tune(tuner, message)
        except RejectedMessage:  # counted where the recording is folded
            continue
        if tuned is not None:
            f = vector(message.linear_acceleration, "linear_acceleration")
            w = vector(message.angular_velocity, "angular_velocity")
            copy = imu_message(tuned.stamp_ns, message.header.frame_id, f, w)
            set_learned(copy, tuned)
            learned.append(encode(PROCESS_NOISE, raw.time_ns, copy))
    return learned
