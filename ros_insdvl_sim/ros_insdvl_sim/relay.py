"""The node `insdvl_relay`: a bad network between sensors and filter.

It receives topics under a prefix and relays their messages, as the received bytes. It loses,
delays, reorders and doubles them as its parameters say.
"""

import heapq
import sys
import threading
import time
from collections import Counter
from functools import partial
from typing import Any

from insdvl.messages.topics import BY_NAME, PROCESS_NOISE
from insdvl.parameters.declaration import ParameterError
from insdvl.studies.faults.link import RelayParameters, links
from ros_insdvl.conversions import message_class
from ros_insdvl.node import InsdvlNode
from ros_insdvl.process.arguments import Help
from ros_insdvl.process.execution import run_node
from ros_insdvl.qos import latched_qos
from ros_insdvl.status.diagnostics import Status, View

HELP = Help(
    package="ros_insdvl_sim",
    executable="relay",
    node="/insdvl_relay",
    about="""
The relay is a bad network: it loses, delays, reorders and doubles messages between sensors and
filter.

subscribes  the topics of parameter 'topics', each under the prefix of parameter 'prefix'
publishes   the same topics without the prefix, /diagnostics
""",
    examples=("--params-file network.yaml",),
)


class Relay(InsdvlNode[RelayParameters]):
    """Relays messages from a thread of its own, each when its delay is over.

    Attributes:
        lost: Messages that were lost, by topic.
        doubled: Messages that were sent twice, by topic.
    """

    def __init__(self, **options: Any) -> None:
        """Start to relay.

        Raises:
            ParameterError: A parameter is wrong.
        """
        super().__init__("insdvl_relay", RelayParameters, **options)
        parameters = self.parameters
        try:
            _check(parameters.topics)
            self._check_prefix()
        except ParameterError:
            self.destroy_node()
            raise
        self.lost: Counter[str] = Counter()
        self.doubled: Counter[str] = Counter()
        self._links = links(parameters)
        #: Due time, number of the copy, topic and bytes of the messages under way, as a heap.
        self._under_way: list[tuple[float, int, str, bytes]] = []
        self._copies = 0
        self._stopped = False
        self._changed = threading.Condition()
        for topic in parameters.topics:
            kind = message_class(BY_NAME[topic].types[0])
            self.advertise(kind, topic, latched_qos() if topic == PROCESS_NOISE else None)
            self.listen(kind, parameters.prefix + topic, partial(self._receive, topic), raw=True)
        self.start_diagnostics()
        self._thread = threading.Thread(target=self._send_all, name="relay", daemon=True)
        self._thread.start()

    def _check_prefix(self) -> None:
        """Refuse a prefix with which a received topic is also a sent one."""
        topics, prefix = self.parameters.topics, self.parameters.prefix
        sent = {self.resolve_topic_name(topic) for topic in topics}
        both = sorted(sent & {self.resolve_topic_name(prefix + topic) for topic in topics})
        if both:
            raise ParameterError(
                f"parameter 'prefix' must lead to topics that are not sent, got {prefix!r}: the "
                f"relay would receive its own messages on {', '.join(both)}"
            )

    def _receive(self, topic: str, data: bytes) -> None:
        delays = self._links[topic].delays()
        self.lost[topic] += not delays
        self.doubled[topic] += len(delays) > 1
        now = time.monotonic()
        with self._changed:
            for delay in delays:
                heapq.heappush(self._under_way, (now + delay, self._copies, topic, data))
                self._copies += 1
            self._changed.notify()

    def _send_all(self) -> None:
        try:
            while (due := self._next()) is not None:
                topic, data = due
                self.outputs[topic].send(data)
        except Exception as error:  # an exception in a thread would end nothing
            if self.context.ok():  # else an interrupt has taken the middleware away
                print(f"{self.get_name()} failed: {error!r}", file=sys.stderr)
                self.finish(1)

    def _next(self) -> tuple[str, bytes] | None:
        """Topic and bytes of the next message when it is due; None when the node ends."""
        with self._changed:
            while not self._stopped:
                wait = self._under_way[0][0] - time.monotonic() if self._under_way else None
                if wait is not None and wait <= 0.0:
                    return heapq.heappop(self._under_way)[2:]
                self._changed.wait(wait)
        return None

    def causes(self, view: View) -> list[Status]:
        """How many messages were lost and doubled, and how many are under way."""
        lost, doubled = self.lost.total(), self.doubled.total()
        status = Status("relay", f"{lost} messages lost, {doubled} doubled")
        for topic in self.parameters.topics:
            status.values[f"lost {topic}"] = self.lost[topic]
            status.values[f"doubled {topic}"] = self.doubled[topic]
            view.show(status, self.parameters.prefix + topic, topic)
        status.values["under way"] = len(self._under_way)
        return [status]

    def destroy_node(self) -> None:
        """Stop sending and destroy the node; messages under way are lost."""
        if hasattr(self, "_thread"):
            with self._changed:
                self._stopped = True
                self._changed.notify()
            self._thread.join()
        super().destroy_node()


def _check(topics: tuple[str, ...]) -> None:
    unknown = [topic for topic in topics if topic not in BY_NAME]
    if unknown:
        raise ParameterError(
            f"parameter 'topics' must be of {', '.join(BY_NAME)}, got {', '.join(unknown)}"
        )
    if len(set(topics)) < len(topics):
        raise ParameterError(f"parameter 'topics' must name a topic once, got {list(topics)!r}")


def main() -> None:
    """Run the node until it is interrupted."""
    sys.exit(run_node(Relay, HELP))


if __name__ == "__main__":
    main()
