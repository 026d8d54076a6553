"""How the statuses of a node reach the graph and its log."""

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ros_insdvl.qos import publisher_qos
from ros_insdvl.status.diagnostics import ERROR, OK, Status

PERIOD = 1.0  # s of the steady clock


class Reporter:
    """Publishes the statuses of a node on /diagnostics once a second, and logs what changes.

    Args:
        node: The node.
        statuses: Gives its statuses as of now.
        last_resort: Gives those that are published where that fails: the node is not silent then.
    """

    def __init__(
        self,
        node: Node,
        statuses: Callable[[], list[Status]],
        last_resort: Callable[[], list[Status]],
    ) -> None:
        self._node = node
        self._statuses = statuses
        self._last_resort = last_resort
        self._logged: dict[str, dict[str, bytes]] = {}  # level of each complaint, by cause
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", publisher_qos())
        node.create_timer(PERIOD, self._report, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _report(self) -> None:
        try:
            statuses = self._statuses()
        except Exception:
            self._publish(self._last_resort())
            raise
        self._log_changes(statuses)
        self._publish(statuses)

    def _publish(self, statuses: list[Status]) -> None:
        name = self._node.get_fully_qualified_name()
        message = DiagnosticArray(status=[status.of_node(name) for status in statuses])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)

    def _log_changes(self, statuses: list[Status]) -> None:
        """One line for each complaint that is new or worse, and for each status that recovered."""
        log = self._node.get_logger()
        for status in statuses:
            before = self._logged.get(status.cause, {})
            for complaint in status.complaints:
                if complaint.level <= before.get(complaint.about, OK):
                    continue
                # One line each: rclpy keeps the level of a line of code.
                if complaint.level == ERROR:
                    log.error(f"{status.cause}: {complaint.text}")
                else:
                    log.warning(f"{status.cause}: {complaint.text}")
            if before and status.level == OK:
                log.info(f"{status.cause}: ok again, {status.summary}")
            self._logged[status.cause] = {c.about: c.level for c in status.complaints}
