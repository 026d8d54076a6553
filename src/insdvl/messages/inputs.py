"""The filter's inputs: the topics that it takes, and the events that their messages are.

The filter node and `insdvl replay` both read their messages through this, so both fold the same.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, TypeVar

from insdvl.messages import convert as messages
from insdvl.messages.convert import RejectedMessage
from insdvl.navigation.events import NS, Event, Initial
from insdvl.navigation.geometry.frames import CONVENTIONS
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.state import NEVER
from insdvl.timeline.fold import Fold

IMU = "sensor_msgs/msg/Imu"
FIX = "sensor_msgs/msg/NavSatFix"
TWIST = "geometry_msgs/msg/TwistStamped"
TWIST_WITH_COVARIANCE = "geometry_msgs/msg/TwistWithCovarianceStamped"
ODOMETRY = "nav_msgs/msg/Odometry"

_AnyEvent = TypeVar("_AnyEvent", bound=Event)

#: Topic of each source of Q that listens to one.
Q_TOPICS = {"external": "process_noise", "oracle": "ground_truth/process_noise"}


class Inputs:
    """Messages to events, as the filter's parameters ask.

    Attributes:
        topics: Type of the messages of each topic that is taken.
        required: Topics without which there is no result, and why.
        initial_topic: Topic of the initial state in the mode ``topic``, else None.
        frame_ids: The last frame_id of each topic.
        frame_changes: How often the frame_id of a topic has changed under way.
    """

    def __init__(self, parameters: FilterParameters) -> None:
        self._parameters = parameters
        self._convention = CONVENTIONS[parameters.frame_convention]
        self._max_delay_ns = round(parameters.max_delay * NS)
        self._jump_limit_ns = round(parameters.jump_limit * NS)
        self.frame_ids: dict[str, str] = {}
        self.frame_changes: Counter[str] = Counter()
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
        """Messages of the initial topic are taken again."""
        #: Whether no further message of the initial topic can be the one that starts the filter.
        self.initial_done = False
        self._initial_until_ns: int | None = None
        self._unstamped: Initial | None = None  # a set_odometry that waits for a sample's stamp

    def events(self, topic: str, message: Any, fold: Fold) -> Iterator[Event]:
        """The events of a message.

        Args:
            topic: One of `topics`.
            message: Of the topic's type.
            fold: That takes the events, each before the next one is asked for. A set_odometry
                without a stamp is of its newest sample.

        Raises:
            RejectedMessage: The message cannot be used.
        """
        convention, newest_ns = self._convention, fold.newest_ns
        self._check_frame(topic, message)
        if topic == "imu/data_raw":
            sample = messages.imu(message, convention)
            yield sample
            if self._unstamped is not None:
                yield replace(self._unstamped, stamp_ns=sample.stamp_ns)
                self._unstamped = None
            if self._parameters.process_noise.source == "message":
                yield messages.process_noise(message, convention)
        elif topic in ("dvl/velocity", "dvl/velocity_cov"):
            ping = messages.dvl(message, convention)
            yield replace(ping, R=messages.completed(ping.R, self._parameters.dvl.noise_std))
        elif topic in Q_TOPICS.values():
            yield self._stamped(messages.process_noise(message, convention), newest_ns)
        elif topic == "gps/fix":
            origin = messages.origin(message, self._parameters.origin.height)
            yield self._stamped(origin, newest_ns)
        elif topic == "set_odometry":
            event = self._initial(message, once=False)
            if event.stamp_ns != 0:
                yield event
            elif newest_ns == NEVER:
                self._unstamped = event
            else:
                yield replace(event, stamp_ns=newest_ns)
        if topic == self.initial_topic and not self._is_initial_done(fold):
            yield self._stamped(self._initial(message, once=True), newest_ns)

    def _initial(self, message: Any, *, once: bool) -> Initial:
        """The state of a message; what its covariances leave open the parameters say."""
        event = messages.initial(message, self._convention, once=once)
        sigma = self._parameters.initial
        return replace(
            event,
            P_v=messages.completed(event.P_v, [sigma.velocity_std] * 3),
            P_psi=messages.completed(event.P_psi, sigma.attitude_std),
            P_p=messages.completed(event.P_p, [sigma.position_std] * 3),
        )

    def _is_initial_done(self, fold: Fold) -> bool:
        """Decide `initial_done`: the fold has started, and max_delay has passed since.

        Until then one with an earlier stamp may still come, and is the first.
        """
        if not self.initial_done and fold.latest is not None:
            if self._initial_until_ns is None:
                self._initial_until_ns = fold.newest_ns + self._max_delay_ns
            self.initial_done = fold.newest_ns > self._initial_until_ns
        return self.initial_done

    def _stamped(self, event: _AnyEvent, newest_ns: int) -> _AnyEvent:
        """The event, unless its stamp is zero while the samples are far from zero.

        Time may start at 0, as it does in a simulation; then zero is a stamp as any other.

        Raises:
            RejectedMessage: ``no_stamp``.
        """
        if event.stamp_ns == 0 and newest_ns > self._jump_limit_ns:
            raise RejectedMessage("no_stamp", "stamp is 0")
        return event

    def _check_frame(self, topic: str, message: Any) -> None:
        """Refuse a frame_id that is not the declared one; count those that change.

        Raises:
            RejectedMessage: ``wrong_frame``.
        """
        parameters, frame_id = self._parameters, str(message.header.frame_id)
        pairs = [("frame_id", frame_id, "")]
        if topic == "imu/data_raw":
            pairs = [("frame_id", frame_id, parameters.imu.frame_id)]
        elif topic in ("dvl/velocity", "dvl/velocity_cov"):
            pairs = [("frame_id", frame_id, parameters.dvl.frame_id)]
        elif topic == "set_odometry":
            child = str(message.child_frame_id)
            pairs = [
                ("frame_id", frame_id, frame_id and parameters.odom_frame),
                ("child_frame_id", child, child and parameters.base_frame),
            ]
        for name, found, wanted in pairs:
            if wanted and found != wanted:
                raise RejectedMessage("wrong_frame", f"{name} is {found!r}, not {wanted!r}")
        if self.frame_ids.setdefault(topic, frame_id) != frame_id:
            self.frame_ids[topic] = frame_id
            self.frame_changes[topic] += 1
