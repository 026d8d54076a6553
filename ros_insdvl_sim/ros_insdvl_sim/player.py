"""What simulator and replay share: a node that plays messages at the pace of their stamps.

A thread of its own sends the messages by the steady clock: in real time each when it is due, faster
than that in short bursts, since waking the subscribers for every message would cost more than the
messages. After a short delay a player catches up; one that is too slow for its pace falls behind.
It never skips a message.
"""

import math
import sys
import threading
import time
from abc import abstractmethod
from collections.abc import Iterator
from typing import Any, TypeVar

from rclpy.duration import Duration
from rosgraph_msgs.msg import Clock

from insdvl.messages.topics import IMU
from insdvl.navigation.events import NS
from ros_insdvl.conversions import time_of
from ros_insdvl.endpoints import Output
from ros_insdvl.node import InsdvlNode

_Group = TypeVar("_Group")

CLOCK_PERIOD = 0.02  # s of the steady clock between messages on /clock
BURST_PERIOD = 0.02  # s of the steady clock between bursts, where there is a rate_factor
SETTLE_TIME = 1.0  # s without a new subscriber after which all have been discovered
MAX_LAG = 0.1  # s behind the pace that are caught up
ACKNOWLEDGE_TIME = 30.0  # s to wait for the last messages to arrive


class Player(InsdvlNode[_Group]):
    """A node that plays its timeline once and then finishes."""

    def start_playing(
        self, *, rate_factor: float, min_subscribers: int, exclusive_wait: float = 0.0
    ) -> None:
        """Play in a thread as soon as the subscribers are there.

        Args:
            rate_factor: Speed relative to the stamps, with /clock; 0 is real time without /clock.
            min_subscribers: Number of subscribers of imu/data_raw to wait for.
            exclusive_wait: How long to look for another publisher of imu/data_raw [s]. If there is
                one, nothing is sent and the node finishes with exit code 1.
        """
        self._rate = rate_factor or 1.0
        self._burst_period = BURST_PERIOD if rate_factor else 0.0
        self._min_subscribers = min_subscribers
        self._exclusive_wait = exclusive_wait
        self._clock_output = self.create_publisher(Clock, "/clock", 10) if rate_factor else None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._play, name="player", daemon=True)
        self._thread.start()

    @abstractmethod
    def timeline(self) -> Iterator[tuple[int, str, Any]]:
        """Time [ns], topic and message of all that is to be sent; times do not decrease.

        It is called when the subscribers are there. The first time is that at which playing begins.
        """

    def destroy_node(self) -> None:
        """Stop playing and destroy the node."""
        if hasattr(self, "_thread"):
            self._stop.set()
            self._thread.join()
        super().destroy_node()

    def _play(self) -> None:
        try:
            if self._wait_for_graph() and self._send_all():
                self._finish_when_arrived()
        except Exception as error:  # an exception in a thread would end nothing
            if self.context.ok():  # else an interrupt has shut the middleware down
                print(f"{self.get_name()} failed: {error!r}", file=sys.stderr)
                self.finish(1)

    def _wait_for_graph(self) -> bool:
        """Wait for the subscribers; False if the node ends before they are there."""
        if self._min_subscribers:
            self.get_logger().info(f"waiting for {self._min_subscribers} subscribers of {IMU}")
        started = settled = time.monotonic()
        listeners: list[int] = []
        while not self._stop.wait(0.01):
            now = time.monotonic()
            if self._exclusive_wait and self.count_publishers(IMU) > 1:
                topic = self.resolve_topic_name(IMU)
                print(f"{topic} already has a publisher: not starting", file=sys.stderr)
                self.finish(1)
                return False
            found = [output.listeners for output in self.outputs.values()]
            if found != listeners:
                listeners, settled = found, now
            if (
                self.outputs[IMU].listeners >= self._min_subscribers
                and now - settled >= SETTLE_TIME
                and now - started >= self._exclusive_wait
            ):
                return True
        return False

    def _send_all(self) -> bool:
        """Send all messages; False if the node ends before."""
        start, start_ns, now_ns = time.monotonic(), -1, -1
        last_clock = -math.inf
        for time_ns, topic, message in self.timeline():
            if start_ns < 0:
                start, start_ns = time.monotonic(), time_ns
            if time_ns != now_ns:
                now_ns = time_ns
                due = start + (now_ns - start_ns) / NS / self._rate
                lag = time.monotonic() - due
                if lag > MAX_LAG:  # a burst to catch up would overrun the subscribers' queues
                    start += lag - MAX_LAG
                if lag < 0.0 and self._stop.wait(self._burst_period - lag):
                    return False
                if time.monotonic() - last_clock >= CLOCK_PERIOD:
                    last_clock = time.monotonic()
                    self._tell_time(now_ns)
            self.outputs[topic].send(message)
        self._tell_time(now_ns)
        return not self._stop.is_set()

    def _tell_time(self, now_ns: int) -> None:
        if self._clock_output is not None:
            self._clock_output.publish(Clock(clock=time_of(now_ns)))

    def _wait_until_arrived(self, output: Output) -> bool:
        """Whether all messages arrive in time; False also if the node ends before."""
        deadline = time.monotonic() + ACKNOWLEDGE_TIME
        while not self._stop.is_set() and time.monotonic() < deadline:
            if output.acknowledged(Duration(seconds=0.1)):
                return True
        return False

    def _finish_when_arrived(self) -> None:
        missing = [t for t, output in self.outputs.items() if not self._wait_until_arrived(output)]
        sent = ", ".join(f"{topic} {output.count}" for topic, output in self.outputs.items())
        print(f"sent: {sent}", flush=True)
        if missing:
            print(
                f"not all arrived within {ACKNOWLEDGE_TIME:g} s on {', '.join(missing)}",
                file=sys.stderr,
            )
        self.finish(1 if missing else 0)
