"""The node `insdvl_tuner`: IMU in, the process noise learned from its last samples out.

Data driven: the schedule follows from the stamps (see `insdvl.tuner.tuner`). The node publishes the
sample that closes the window with its learned covariances: a plain Imu that any consumer may use in
place of the driver's.
"""

import sys
from collections import Counter
from typing import Any

from sensor_msgs.msg import Imu
from std_srvs.srv import SetBool

from insdvl.messages.cdr.imu_bytes import ImuMessage, decode_imu
from insdvl.messages.convert import vector
from insdvl.messages.make import fill_imu
from insdvl.messages.topics import IMU, PROCESS_NOISE
from insdvl.parameters.declaration import ParameterError
from insdvl.tuner.models import ModelError
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.republish import set_learned, tune
from insdvl.tuner.tuner import TunedNoise, Tuner
from ros_insdvl.node import InsdvlNode
from ros_insdvl.process.arguments import Help
from ros_insdvl.process.execution import run_node
from ros_insdvl.qos import HIGH_RATE, latched_qos, sensor_qos
from ros_insdvl.status.diagnostics import Status, View
from ros_insdvl.status.tuner.imu import imu_status
from ros_insdvl.status.tuner.process_noise import Learned

HELP = Help(
    package="ros_insdvl",
    executable="tuner",
    node="/insdvl_tuner",
    about="""
The tuner learns the process noise of the filter from the last samples of the IMU.

subscribes  imu/data_raw
publishes   process_noise, which a filter with process_noise.source 'external' takes; /diagnostics
services    ~/enable (std_srvs/SetBool): publish process_noise, or not
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
        except (ModelError, ParameterError) as error:
            self.get_logger().fatal(str(error))
            self.destroy_node()
            raise
        self._latest: TunedNoise | None = None
        self._learned = Learned(self._tuner, self.parameters.rate, self.parameters.max_gap)
        self._process_noise = self.advertise(Imu, PROCESS_NOISE, latched_qos())
        self.create_service(SetBool, "~/enable", self._enable)
        self.listen(Imu, IMU, self._on_imu, sensor_qos(HIGH_RATE), decode=decode_imu)
        self.start_diagnostics()

    def _on_imu(self, message: Imu | ImuMessage) -> None:
        tuned = tune(self._tuner, message)
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
        self._tuner.enabled = request.data
        response.success = True
        response.message = "enabled" if request.data else "disabled"
        self.get_logger().info(response.message)
        return response

    # Diagnostics

    def counts(self) -> Counter[str]:
        """Those of every node, and what became of the samples."""
        counts = super().counts()
        counts.update(self._tuner.counts)
        return counts

    def causes(self, view: View) -> list[Status]:
        """The IMU and its stamps, and what is learned from it."""
        return [
            imu_status(view, self.parameters.max_gap),
            self._learned.status(view, self._latest),
        ]


def main() -> int:
    """Run the node until it is interrupted."""
    try:
        return run_node(TunerNode, HELP)
    except ModelError:  # the node has logged it
        return 1


if __name__ == "__main__":
    sys.exit(main())
