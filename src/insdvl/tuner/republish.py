"""The tuner on messages: those of the sensors in, those of their noise that they lead to out."""

from typing import Any

import numpy as np

from insdvl.messages import convert, dvl
from insdvl.messages.inputs import frame_id_of
from insdvl.messages.make import NOT_MEASURED, fill_twist, fill_variances
from insdvl.navigation.geometry.frames import CONVENTIONS, NED
from insdvl.tuner.measurement_noise import DvlTuner, TunedSensorNoise
from insdvl.tuner.parameters import TunerParameters
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


class DvlMessages:
    """The tuner of the DVL's noise on messages.

    Attributes:
        tuner: The tuner.
    """

    def __init__(self, parameters: TunerParameters) -> None:
        self.tuner = DvlTuner(parameters)
        self._convention = CONVENTIONS[parameters.frame_convention]
        self._frame_id = ""

    def hear_imu(self, message: Any) -> list[TunedSensorNoise]:
        """Give a sensor_msgs/Imu to the tuner; the new estimates.

        Raises:
            RejectedMessage: The message cannot be used, see `convert.imu`.
        """
        return self.tuner.add_sample(convert.imu(message, self._convention))

    def hear_dvl(self, message: Any) -> list[TunedSensorNoise]:
        """Give a DVL's message of any type to the tuner; the new estimate, if there is one.

        Raises:
            RejectedMessage: The message cannot be used, see `dvl.dvl`.
        """
        ping = dvl.dvl(message, self._convention)
        self._frame_id = frame_id_of(message)
        return self.tuner.add_ping(ping)

    def fill(self, message: Any, tuned: TunedSensorNoise) -> None:
        """Fill a geometry_msgs/TwistWithCovarianceStamped: its twist is zero, and tells nothing."""
        message.header.frame_id = self._frame_id
        body = self._convention.body
        fill_twist(message, tuned.stamp_ns, np.zeros(3), body @ tuned.R @ body.T)
