"""The node `insdvl_simulator`: the sensors of a simulated vehicle, and the truth."""

import sys
import time
from collections.abc import Iterator
from typing import Any

from insdvl.messages.topics import BY_NAME
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.frames import CONVENTIONS
from insdvl.parameters.declaration import ParameterError
from insdvl.simulation.messages import StreamFormat, mission_messages, topics_of
from insdvl.simulation.mission import mission_of
from insdvl.simulation.parameters import SimulatorParameters
from ros_insdvl.conversions import message_class
from ros_insdvl.process.arguments import Help
from ros_insdvl.process.execution import run_node
from ros_insdvl.status.diagnostics import Status, View
from ros_insdvl_sim.player import Player

HELP = Help(
    package="ros_insdvl_sim",
    executable="simulator",
    node="/insdvl_simulator",
    about="""
The simulator publishes the sensors of a simulated vehicle on a mission, and the truth.

publishes   imu/data_raw, dvl/velocity, depth/pressure where it is on, ground_truth/odometry,
            ground_truth/process_noise, ground_truth/measurement_noise, /diagnostics, and
            /clock with rate_factor

It starts when imu/data_raw has min_subscribers subscribers, and ends with the mission.
""",
    examples=("-p seed:=3 -p duration:=60.0", "-p rate_factor:=5.0"),
)


class Simulator(Player[SimulatorParameters]):
    """Simulates the whole mission, then plays it.

    The stamps are start + k dt in integer nanoseconds. Messages of one stamp are sent in the order
    IMU, odometry, process noise, measurement noise, DVL, depth, heading.
    """

    def __init__(self, **options: Any) -> None:
        """Simulate the mission, before anything is published.

        Raises:
            ParameterError: A parameter is wrong.
        """
        super().__init__("insdvl_simulator", SimulatorParameters, **options)
        parameters = self.parameters
        try:
            with self.compiling():
                self._mission = mission_of(parameters)
        except ParameterError:
            self.destroy_node()
            raise
        self._start_ns = 0
        self._now_ns = 0
        # A message is serialised when it is sent, so one for each topic is enough.
        self._messages = {
            topic: message_class(BY_NAME[topic].types[0])() for topic in topics_of(self._mission)
        }
        for topic, message in self._messages.items():
            self.advertise(type(message), topic)
        self.start_diagnostics()
        self.start_playing(
            rate_factor=parameters.rate_factor,
            min_subscribers=parameters.min_subscribers,
            exclusive_wait=parameters.exclusive_wait,
        )

    def causes(self, view: View) -> list[Status]:
        """Progress of the mission."""
        elapsed, duration = (self._now_ns - self._start_ns) / NS, self._mission.stamps_ns[-1] / NS
        status = Status("mission", f"{elapsed:.0f} of {duration:.0f} s")
        status.values["mission time [s]"] = f"{elapsed:.1f}"
        status.values["mission duration [s]"] = f"{duration:.1f}"
        view.show(status, *self.outputs)
        return [status]

    def timeline(self) -> Iterator[tuple[int, str, Any]]:
        """All messages of the mission, by their stamps."""
        parameters = self.parameters
        self._start_ns = self._now_ns = self._start()
        form = StreamFormat(
            CONVENTIONS[parameters.frame_convention],
            imu=parameters.base_frame,
            dvl=parameters.dvl_frame,
            depth=parameters.depth_frame,
            odom=parameters.odom_frame,
            base=parameters.base_frame,
            start_ns=self._start_ns,
            with_variances=parameters.publish_covariance,
        )
        for timed in mission_messages(self._mission, self._messages.__getitem__, form):
            self._now_ns = timed.time_ns
            yield timed

    def _start(self) -> int:
        if self.parameters.start_stamp or self.parameters.rate_factor:
            return round(self.parameters.start_stamp * NS)
        return time.time_ns()


def main() -> None:
    """Run the node until the mission is over and all of it has arrived."""
    sys.exit(run_node(Simulator, HELP))


if __name__ == "__main__":
    main()
