"""The node `insdvl_tuner`: IMU in, the process noise learned from its last samples out.

Data driven: the schedule follows from the stamps (see `insdvl.tuner.tuner`). What is published is
the sample that closes the window, with its learned covariances: a plain Imu that any consumer may
use in place of the driver's.
"""

import sys
from typing import Any

import numpy as np
from sensor_msgs.msg import Imu
from std_srvs.srv import SetBool

from insdvl import messages
from insdvl.frames import NED
from insdvl.parameters import ParameterError, TunerParameters
from insdvl.tuner.models import ModelError
from insdvl.tuner.tuner import TunedNoise, Tuner
from ros_insdvl.conversions import NOT_MEASURED, flat_covariance
from ros_insdvl.node import ERROR, WARN, Health, InsdvlNode, latched_qos, run


class TunerNode(InsdvlNode[TunerParameters]):
    """The tuner as a node."""

    def __init__(self, **options: Any) -> None:
        """Load the model and compile the kernels, then listen.

        Raises:
            ModelError: The model cannot be used; it has been logged.
            ParameterError: A parameter is wrong, or does not go with the model.
        """
        super().__init__("insdvl_tuner", TunerParameters, **options)
        try:
            self._tuner = Tuner(self.parameters)
        except (ModelError, ParameterError) as error:
            self.get_logger().fatal(str(error))
            self.destroy_node()
            raise
        self._latest: TunedNoise | None = None
        self._process_noise = self.advertise(Imu, "process_noise", latched_qos())
        self.create_service(SetBool, "~/enable", self._enable)
        self.listen(Imu, "imu/data_raw", self._on_imu)
        self.start_diagnostics()

    def _on_imu(self, message: Imu) -> None:
        # A channel's variance is the same whichever way the axes point: none is turned.
        sample = messages.imu(message, NED)
        tuned = self._tuner.add(sample.stamp_ns, np.concatenate([sample.f_b, sample.w_ib_b]))
        if tuned is None:
            return
        self._latest = tuned
        message.linear_acceleration_covariance = flat_covariance(np.diag(tuned.variances[:3]), 3)
        message.angular_velocity_covariance = flat_covariance(np.diag(tuned.variances[3:]), 3)
        message.orientation_covariance = NOT_MEASURED
        self._process_noise.send(message)

    def _enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._tuner.enabled = request.data
        response.success = True
        response.message = "enabled" if request.data else "disabled"
        self.get_logger().info(response.message)
        return response

    def health(self) -> Health:
        """Model, switch, the six sigmas of Q, and what became of the samples."""
        health = Health()
        health.values["model"] = self._tuner.model.card["name"]
        health.values["enabled"] = self._tuner.enabled
        if not self._tuner.enabled:
            health.complain(WARN, "disabled: process_noise is not published")
        if self.received["imu/data_raw"] == 0:
            health.complain(ERROR, "no imu/data_raw received")
        if self._latest is not None:
            sigmas = np.sqrt(self._latest.variances)
            for axis, f, w in zip("xyz", sigmas[:3], sigmas[3:], strict=True):
                health.values[f"Q sigma f_{axis} [m/s^2]"] = f"{f:.6g}"
                health.values[f"Q sigma w_{axis} [rad/s]"] = f"{w:.6g}"
        for name, count in self._tuner.counts.items():
            health.values[name] = count
        return health


def main() -> int:
    """Run the node until it is interrupted."""
    try:
        return run(TunerNode)
    except ModelError:  # the node has logged it
        return 1


if __name__ == "__main__":
    sys.exit(main())
