"""Topics of several possible types: which one they have, their publishers tell."""

from collections.abc import Callable
from typing import Any

from rclpy.clock import Clock, ClockType

from insdvl.messages.topics import Topic
from insdvl.parameters.declaration import ParameterError
from ros_insdvl.node import InsdvlNode

DISCOVERY_PERIOD = 0.1  # s of the steady clock between two looks for the type of a topic


def chosen_type(name: str, topic: Topic, found: set[str]) -> str:
    """The type of a topic, of those that its publishers have; empty where there is none yet.

    Raises:
        ParameterError: None of them is accepted, or several are.
    """
    accepted = [kind for kind in topic.types if kind in found]
    if len(accepted) > 1:
        remedy = f", or set {topic.type_parameter}" if topic.type_parameter else ""
        raise ParameterError(
            f"{name} is not received: its publishers have the types {' and '.join(accepted)}; stop "
            f"all but one{remedy}"
        )
    if found and not accepted:
        raise ParameterError(
            f"{name} is not received: it has type {', '.join(sorted(found))}, expected one of "
            f"{', '.join(topic.types)}"
        )
    return accepted[0] if accepted else ""


class Discovery:
    """Looks for publishers of topics, until the type of each is known.

    Args:
        node: That subscribes to the topics; what keeps it from one is in its ``unheard``.
        subscribe: Takes the name of a topic, its row and its type; raises `ParameterError` where
            the type is not installed.
    """

    def __init__(self, node: InsdvlNode[Any], subscribe: Callable[[str, Topic, str], None]) -> None:
        self._node, self._subscribe = node, subscribe
        self._sought: dict[str, Topic] = {}
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(DISCOVERY_PERIOD, self.look, clock=steady)

    def seek(self, name: str, topic: Topic) -> None:
        """Look for the type of a topic from now on."""
        self._sought[name] = topic
        self._timer.reset()

    def look(self) -> None:
        """Subscribe to the topics whose publishers show by now which type they have."""
        self._node.unheard = {}
        for name, topic in list(self._sought.items()):
            found = {info.topic_type for info in self._node.get_publishers_info_by_topic(name)}
            try:
                if kind := chosen_type(name, topic, found):
                    self._subscribe(name, topic, kind)
                    del self._sought[name]
            except ParameterError as error:
                self._node.unheard[name] = str(error)
        if not self._sought:
            self._timer.cancel()
