"""The statuses of other nodes, as they arrive on /diagnostics."""

import time
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

#: Levels of `DiagnosticStatus`, as numbers.
OK, WARN, ERROR, STALE = range(4)

#: Changes of statuses that are kept.
CHANGES = 10_000


class HeardStatus(NamedTuple):
    """Level and message of a status."""

    level: int
    message: str


class Change(NamedTuple):
    """A status with a new level or message.

    Attributes:
        at: When it arrived, on the monotonic clock [s].
        node: Full name of the node.
        cause: Name of the status.
        status: The new level and message.
    """

    at: float
    node: str
    cause: str
    status: HeardStatus


@dataclass
class Report:
    """What a node said last.

    Attributes:
        at: When, on the monotonic clock [s].
        count: How often it has reported.
        statuses: Its statuses, by cause.
        of_cause: The values of each of them.
        values: The values of all of them.
    """

    at: float = 0.0
    count: int = 0
    statuses: dict[str, HeardStatus] = field(default_factory=dict)
    of_cause: dict[str, dict[str, str]] = field(default_factory=dict)
    values: dict[str, str] = field(default_factory=dict)


class HeardDiagnostics:
    """Keeps the last report of every node, and the changes of all statuses.

    Attributes:
        reports: The last report of every node, by its full name.
        changes: The last `CHANGES` changes.
    """

    def __init__(self) -> None:
        self.reports: dict[str, Report] = {}
        self.changes: deque[Change] = deque(maxlen=CHANGES)

    def add(self, message: DiagnosticArray) -> None:
        """Take a message of /diagnostics, whose names of nodes have no leading slash."""
        now = time.monotonic()
        by_node: dict[str, dict[str, DiagnosticStatus]] = {}
        for status in message.status:
            node, _, cause = status.name.partition(": ")
            by_node.setdefault(f"/{node.lstrip('/')}", {})[cause] = status
        for node, statuses in by_node.items():
            report = self.reports.setdefault(node, Report())
            heard = {
                cause: HeardStatus(int.from_bytes(status.level, "little"), status.message)
                for cause, status in statuses.items()
            }
            self.changes.extend(
                Change(now, node, cause, status)
                for cause, status in heard.items()
                if report.statuses.get(cause) != status
            )
            report.at, report.count, report.statuses = now, report.count + 1, heard
            report.of_cause = {
                cause: {v.key: v.value for v in status.values} for cause, status in statuses.items()
            }
            report.values = {k: v for values in report.of_cause.values() for k, v in values.items()}

    def count(self, node: str, key: str) -> int:
        """A count among the values of a node's last report, 0 without one."""
        return int(self.report(node).values.get(key, 0))

    def report(self, node: str) -> Report:
        """The last report of a node, an empty one before the first."""
        return self.reports.get(node, Report())
