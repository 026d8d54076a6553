"""The tuner on messages: an IMU message in, the process_noise message that it leads to out."""

from typing import Any

import numpy as np

from insdvl.messages import convert
from insdvl.messages.make import NOT_MEASURED, fill_variances
from insdvl.navigation.geometry.frames import NED
from insdvl.tuner.tuner import TunedNoise, Tuner


def tune(tuner: Tuner, message: Any) -> TunedNoise | None:
    """Give a sensor_msgs/Imu to the tuner; the new estimate where it closes a window.

    Raises:
        RejectedMessage: The message cannot be used, see `convert.imu`.
    """
    # The variance of a channel does not depend on the sign of its axis: nothing is rotated.
    sample = convert.imu(message, NED)
    return tuner.add(sample.stamp_ns, np.concatenate([sample.f_b, sample.w_ib_b]))


def set_learned(message: Any, tuned: TunedNoise) -> None:
    """Turn the sample that closed the window, or a copy of it, into the process_noise message.

    Header, specific force and angular rate stay: it is a plain Imu that any consumer may use.
    """
    fill_variances(message, tuned.variances)
    message.orientation_covariance = NOT_MEASURED
