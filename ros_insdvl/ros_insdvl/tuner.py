"""The node `insdvl_tuner`: IMU in, the process noise learned from its last samples out.

Data driven: the schedule follows from the stamps (see `insdvl.tuner.tuner`). The node publishes the
sample that closes the window with its learned covariances: a plain Imu that any consumer may use in
place of the driver's. With ``measurement_noise`` it also listens to the DVL, and publishes the
noise of its pings.
"""

import sys
from collections import Counter
from dataclasses import replace
from typing import Any

from geometry_msgs.msg import TwistWithCovarianceStamped
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu
from std_srvs.srv import SetBool

from insdvl.messages.cdr.imu_bytes import ImuMessage, decode_imu
from insdvl.messages.convert import vector
from insdvl.messages.make import fill_imu
from insdvl.messages.topics import (
    BY_NAME,
    DVL,
    DVL_WITH_COVARIANCE,
    IMU,
    MEASUREMENT_NOISE,
    PROCESS_NOISE,
    Topic,
)
from insdvl.parameters.declaration import ParameterError
from insdvl.tuner.measurement_noise import TunedSensorNoise
from insdvl.tuner.models import ModelError
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.republish import DvlMessages, set_learned, tune
from insdvl.tuner.tuner import TunedNoise, Tuner
from ros_insdvl.conversions import message_class
from ros_insdvl.discovery import Discovery
from ros_insdvl.node import InsdvlNode
from ros_insdvl.process.arguments import Help
from ros_insdvl.process.execution import run_node
from ros_insdvl.qos import HIGH_RATE, latched_qos, sensor_qos
from ros_insdvl.status.diagnostics import Status, View
from ros_insdvl.status.tuner.imu import imu_status
from ros_insdvl.status.tuner.measurement_noise import measurement_noise_status
from ros_insdvl.status.tuner.process_noise import Learned

HELP = Help(
    package="ros_insdvl",
    executable="tuner",
    node="/insdvl_tuner",
    about="""
The tuner learns the process noise of the filter from the last samples of the IMU, and with
measurement_noise the noise of the DVL from its pings and the IMU between them.

subscribes  imu/data_raw; with measurement_noise dvl/velocity and dvl/velocity_cov
publishes   process_noise, which a filter with process_noise.source 'external' takes;
            measurement_noise, which one with dvl.noise_source 'adaptive' or 'learned' takes;
            /diagnostics
services    ~/enable (std_srvs/SetBool): publish both, or neither
""",
    examples=("--params-file vehicle.yaml", "-p model:=paper -p rate:=2.0"),
)


class TunerNode(InsdvlNode[TunerParameters]):
    """The tuner as a node."""

    single_inputs = (IMU,)

    def __init__(self, **options: Any) -> None:
        """Load the model and compile the kernels, then listen.

        Raises:
            ModelError: The model cannot be used; it has been logged.
            ParameterError: A parameter is wrong, or does not go with the model.
        """
        super().__init__("insdvl_tuner", TunerParameters, **options)
        try:
            with self.compiling():
                self._tuner = Tuner(self.parameters)
                self._dvl = None
                if self.parameters.measurement_noise:
                    self._dvl = DvlMessages(self.parameters)
        except (ModelError, ParameterError) as error:
            self.get_logger().fatal(str(error))
            self.destroy_node()
            raise
        self._latest: TunedNoise | None = None
        self._learned = Learned(self._tuner, self.parameters.rate, self.parameters.max_gap)
        self._process_noise = self.advertise(Imu, PROCESS_NOISE, latched_qos())
        self.create_service(SetBool, "~/enable", self._enable)
        self.listen(Imu, IMU, self._on_imu, sensor_qos(HIGH_RATE), decode=decode_imu)
        self._latest_of_dvl: TunedSensorNoise | None = None
        if self._dvl is not None:
            self._listen_to_dvl(self._dvl)
        self.start_diagnostics()

    def _listen_to_dvl(self, dvl: DvlMessages) -> None:
        """Subscribe to the DVL, of whatever type it is."""
        self._measurement_noise = self.advertise(
            TwistWithCovarianceStamped, MEASUREMENT_NOISE, latched_qos()
        )

        def hear(message: Any) -> None:
            self._send_of_dvl(dvl, dvl.hear_dvl(message))

        def subscribe(name: str, topic: Topic, kind: str) -> None:
            self.listen(message_class(kind), name, hear)

        self._discovery = Discovery(self, subscribe)
        kind, row = self.parameters.dvl.type, BY_NAME[DVL]
        self.received.setdefault(DVL, 0)
        self._discovery.seek(DVL, row if kind == "auto" else replace(row, types=(kind,)))
        self.listen(TwistWithCovarianceStamped, DVL_WITH_COVARIANCE, hear)

    def _send_of_dvl(self, dvl: DvlMessages, tuned: list[TunedSensorNoise]) -> None:
        for one in tuned if self._tuner.enabled else ():
            self._latest_of_dvl = one
            message = TwistWithCovarianceStamped()
            dvl.fill(message, one)
            self._measurement_noise.send(message)

    def _on_imu(self, message: Imu | ImuMessage) -> None:
        tuned = tune(self._tuner, message)
        if self._dvl is not None:
            self._send_of_dvl(self._dvl, self._dvl.hear_imu(message))
        if tuned is None:
            return
        self._latest = tuned
        learned = Imu()
        learned.header.frame_id = message.header.frame_id
        f = vector(message.linear_acceleration, "linear_acceleration")
        w = vector(message.angular_velocity, "angular_velocity")
        fill_imu(learned, tuned.stamp_ns, f, w)
        set_learned(learned, tuned)
        self._process_noise.send(learned)

    def _enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        """Set the parameter, so that service and parameter say the same."""
        result = self.set_parameters_atomically([Parameter("enabled", value=request.data)])
        response.success = result.successful
        response.message = result.reason or ("enabled" if request.data else "disabled")
        return response

    def settings_changed(self, before: TunerParameters) -> None:
        """Publish what is learned, or no longer."""
        super().settings_changed(before)
        self._tuner.enabled = self.parameters.enabled
        self.get_logger().info("enabled" if self.parameters.enabled else "disabled")

    # Diagnostics

    def counts(self) -> Counter[str]:
        """Those of every node, and what became of the samples."""
        counts = super().counts()
        counts.update(self._tuner.counts)
        if self._dvl is not None:
            counts.update(self._dvl.tuner.counts)
        return counts

    def causes(self, view: View) -> list[Status]:
        """The IMU and its stamps, and what is learned from it and from the DVL."""
        found = [
            imu_status(view, self.parameters.max_gap),
            self._learned.status(view, self._latest),
        ]
        if self._dvl is not None:
            counts = self._dvl.tuner.counts
            found.append(measurement_noise_status(view, self._latest_of_dvl, counts))
        return found


def main() -> int:
    """Run the node until it is interrupted."""
    try:
        return run_node(TunerNode, HELP)
    except ModelError:  # the node has logged it
        return 1


if __name__ == "__main__":
    sys.exit(main())
