"""The filter's inputs: the topics that it takes, and the events that their messages are.

The filter node and `insdvl replay` both read their messages through this, so both fold the same.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from insdvl import messages
from insdvl.events import NS, Event
from insdvl.frames import CONVENTIONS
from insdvl.parameters import FilterParameters

IMU = "sensor_msgs/msg/Imu"
FIX = "sensor_msgs/msg/NavSatFix"
TWIST = "geometry_msgs/msg/TwistStamped"
TWIST_WITH_COVARIANCE = "geometry_msgs/msg/TwistWithCovarianceStamped"
ODOMETRY = "nav_msgs/msg/Odometry"

#: Topic of each source of Q that listens to one.
Q_TOPICS = {"external": "process_noise", "oracle": "ground_truth/process_noise"}


class Inputs:
    """Messages to events, as the filter's parameters ask.

    Attributes:
        topics: Type of the messages of each topic that is taken.
        required: Topics without which there is no result, and why.
        initial_topic: Topic of the initial state in the mode ``topic``, else None.
    """

    def __init__(self, parameters: FilterParameters) -> None:
        self._parameters = parameters
        self._convention = CONVENTIONS[parameters.frame_convention]
        self.topics = {
            "imu/data_raw": IMU,
            "dvl/velocity": TWIST,
            "dvl/velocity_cov": TWIST_WITH_COVARIANCE,
            "set_odometry": ODOMETRY,
        }
        self.required: dict[str, str] = {}
        self.initial_topic: str | None = None
        initial, source = parameters.initial, parameters.process_noise.source
        if initial.mode == "topic":
            self.initial_topic = initial.topic
            self.topics[initial.topic] = ODOMETRY
            self.required[initial.topic] = "initial.mode is 'topic'"
        elif initial.mode == "set_odometry":
            self.required["set_odometry"] = "initial.mode is 'set_odometry'"
        if source in Q_TOPICS:
            self.topics[Q_TOPICS[source]] = IMU
            self.required[Q_TOPICS[source]] = f"process_noise.source is '{source}'"
        if parameters.origin.source == "topic":
            self.topics["gps/fix"] = FIX
            self.required["gps/fix"] = "origin.source is 'topic'"
        self.reset()

    def reset(self) -> None:
        """The next message of the initial topic is the first again."""
        self._initial_until_ns: int | None = None
        #: Whether no further message of the initial topic can be the one with the first stamp.
        self.initial_done = False

    def events(self, topic: str, message: Any, newest_ns: int) -> Iterator[Event]:
        """The events of a message.

        Args:
            topic: One of `topics`.
            message: Of the topic's type.
            newest_ns: Stamp of the newest IMU sample; a set_odometry without a stamp is of then.

        Raises:
            RejectedMessage: The message cannot be used.
        """
        convention = self._convention
        if topic == "imu/data_raw":
            yield messages.imu(message, convention)
            if self._parameters.process_noise.source == "message":
                yield messages.process_noise(message, convention)
        elif topic in ("dvl/velocity", "dvl/velocity_cov"):
            yield messages.dvl(message, convention)
        elif topic in Q_TOPICS.values():
            yield messages.process_noise(message, convention)
        elif topic == "gps/fix":
            yield messages.origin(message)
        elif topic == "set_odometry":
            event = messages.initial(message, convention, once=False)
            if event.stamp_ns == 0:
                event = replace(event, stamp_ns=max(newest_ns, 0))
            yield event
        if topic == self.initial_topic:
            event = messages.initial(message, convention, once=True)
            # One with an earlier stamp may still come and then is the first; after max_delay none.
            if self._initial_until_ns is None:
                self._initial_until_ns = event.stamp_ns + round(self._parameters.max_delay * NS)
            self.initial_done = event.stamp_ns > self._initial_until_ns
            if not self.initial_done:
                yield event
