"""The node `insdvl_replay`: plays a rosbag2 recording onto the topics of the graph."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from insdvl.messages.topics import PROCESS_NOISE
from insdvl.messages.transforms import TF_MESSAGE, TF_STATIC
from insdvl.parameters.declaration import ParameterError
from insdvl.recordings.bag_reader import BagReader
from insdvl.recordings.base import BagError, stamp_ns
from insdvl.recordings.parameters import ReplayParameters
from insdvl.recordings.played import played
from ros_insdvl.conversions import message_class
from ros_insdvl.process.arguments import Help
from ros_insdvl.process.execution import run_node
from ros_insdvl.qos import latched_command_qos, latched_qos
from ros_insdvl.status.diagnostics import Status, View
from ros_insdvl_sim.player import Player

HELP = Help(
    package="ros_insdvl_sim",
    executable="replay",
    node="/insdvl_replay",
    about="""
The replay plays a rosbag2 recording onto the topics of the filter, at the pace of the IMU's stamps.

publishes   imu/data_raw, dvl/velocity, dvl/velocity_cov, process_noise, measurement_noise,
            gps/fix, set_odometry, ground_truth/odometry, ground_truth/process_noise,
            ground_truth/measurement_noise: those that the recording has, and further_topics;
            /tf_static where tf2_msgs is installed; /diagnostics, and /clock with rate_factor

It starts when imu/data_raw has min_subscribers subscribers, and ends with the recording.
`insdvl replay` runs the filter over a recording without ROS.
""",
    examples=("-p bag:=FOLDER", "-p bag:=FOLDER -p imu_topic:=/xsens/imu"),
)


#: Topics of which late subscribers get the last messages.
_LATCHED = {PROCESS_NOISE: latched_qos, TF_STATIC: latched_command_qos}


class Replay(Player[ReplayParameters]):
    """Plays a recording once, in the recorded order, at the pace of the IMU's stamps.

    Messages are published as the recorded bytes, unchanged.
    """

    def __init__(self, **options: Any) -> None:
        """Open the recording and read it through, before anything is published.

        Raises:
            ParameterError: A parameter is wrong, or the recording cannot be played.
        """
        super().__init__("insdvl_replay", ReplayParameters, **options)
        try:
            self._open()
        except BagError as error:
            self.destroy_node()
            raise ParameterError(f"parameter 'bag': {error}") from error
        for recorded, topic in self._topics.items():
            qos = _LATCHED[topic]() if topic in _LATCHED else None
            self.advertise(message_class(self._bag.topics[recorded].type), topic, qos)
        self.start_diagnostics()
        self.start_playing(
            rate_factor=self.parameters.rate_factor,
            min_subscribers=self.parameters.min_subscribers,
        )

    def _open(self) -> None:
        if not self.parameters.bag:
            raise BagError("it is empty, but must name a recording")
        self._bag = BagReader(Path(self.parameters.bag))
        for remark in self._bag.remarks:
            self.get_logger().warning(remark)
        self._topics = played(self._bag, self.parameters)
        self._play_transforms()
        for raw in self._bag.raw(self._topics):
            if raw.topic != TF_STATIC:  # which has a list in place of a header
                stamp_ns(raw)

    def _play_transforms(self) -> None:
        """Play /tf_static as well, where its type is installed: extrinsics may come from it."""
        if TF_STATIC not in self._bag.topics or self._bag.topics[TF_STATIC].type != TF_MESSAGE:
            return
        try:
            message_class(TF_MESSAGE)
        except ParameterError as error:
            self._topics.pop(TF_STATIC, None)
            self.get_logger().info(f"{TF_STATIC} is not played: {error}")
        else:
            self._topics[TF_STATIC] = TF_STATIC  # in no namespace

    def causes(self, view: View) -> list[Status]:
        """The recording, and how many of its messages were sent."""
        status = Status("recording", f"plays {self.parameters.bag}")
        view.show(status, *self.outputs)
        return [status]

    def timeline(self) -> Iterator[tuple[int, str, bytes]]:
        """All messages in the recorded order; the time is that of the newest IMU stamp so far."""
        now_ns = min(stamp_ns(raw) for raw in self._bag.raw([self.parameters.imu_topic]))
        for raw in self._bag.raw(self._topics):
            if raw.topic == self.parameters.imu_topic:
                now_ns = max(now_ns, stamp_ns(raw))
            yield now_ns, self._topics[raw.topic], raw.data


def main() -> None:
    """Run the node until the recording is played and all of it has arrived."""
    sys.exit(run_node(Replay, HELP))


if __name__ == "__main__":
    main()
