"""How a status is made and kept, and how it recovers: the base of all causes.

A cause is reported as long as it lasts: from what holds now, or from what was counted in the last
`RECENT` seconds of the steady clock. Every complaint gives the number that led to it and what to
do. docs/reference/diagnostics.md lists all of them.
"""

from collections import Counter, deque
from collections.abc import Collection, Hashable, Iterable, Mapping
from dataclasses import dataclass, field
from math import inf
from typing import Any, Generic, TypeVar

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from insdvl.arrays import Array
from insdvl.messages.refusals import Refused
from ros_insdvl.status.reasons import OF_FRAMES, OF_TIME, remedy_of

OK = DiagnosticStatus.OK
WARN = DiagnosticStatus.WARN
ERROR = DiagnosticStatus.ERROR

#: How long an event is reported [s].
RECENT = 10.0
#: A topic without a message for longer than this is silent [s].
SILENT = 2.0
#: How long the driver of a topic may take to start, before its silence is an error [s]: serial
#: devices and flight controllers take 5 to 15 s, devices that boot with the vehicle up to 30 s.
START_TIME = 30.0

_Key = TypeVar("_Key", bound=Hashable)


@dataclass(frozen=True)
class Complaint:
    """One thing that is wrong.

    Attributes:
        level: `WARN` or `ERROR`.
        about: Its short name, which stays while the numbers in the text change.
        text: One sentence: the number that led to it, and what to do.
    """

    level: bytes
    about: str
    text: str


@dataclass
class Status:
    """One cause: what is wrong with it, and the numbers behind.

    Attributes:
        cause: Its name, the second half of the status' name.
        summary: The message while nothing is wrong.
        complaints: What is wrong.
        values: What is shown beside the message.
    """

    cause: str
    summary: str = "nothing to report"
    complaints: list[Complaint] = field(default_factory=list)
    values: dict[str, Any] = field(default_factory=dict)

    def complain(self, level: bytes, about: str, text: str) -> None:
        """Add a complaint; the status takes the worst level of all of them."""
        self.complaints.append(Complaint(level, about, text))

    @property
    def level(self) -> bytes:
        """The worst level of the complaints."""
        return max((complaint.level for complaint in self.complaints), default=OK)

    @property
    def message(self) -> str:
        """All complaints, the worst first, or the summary."""
        ordered = sorted(self.complaints, key=lambda c: c.level, reverse=True)
        return "; ".join(complaint.text for complaint in ordered) or self.summary

    def of_node(self, node: str) -> DiagnosticStatus:
        """The status as a message.

        It is named as diagnostic_updater names it. The namespace is kept, since two filters may be
        in one graph; there is no hardware behind a status of ours.

        Args:
            node: The full name of the node.
        """
        return DiagnosticStatus(
            level=self.level,
            name=f"{node.lstrip('/')}: {self.cause}",
            message=self.message,
            hardware_id="none",
            values=[KeyValue(key=key, value=str(value)) for key, value in self.values.items()],
        )


class Tally(Generic[_Key]):
    """Cumulative counts, and their growth over the last seconds.

    Attributes:
        total: The counts at the last look.
        step: Their growth since the look before.
        recent: Their growth over the last seconds.
    """

    def __init__(self, seconds: float = RECENT) -> None:
        self._seconds = seconds
        self._looks: deque[tuple[float, Counter[_Key]]] = deque()
        self.total: Counter[_Key] = Counter()
        self.step: Counter[_Key] = Counter()
        self.recent: Counter[_Key] = Counter()

    def look(self, now: float, counts: Mapping[_Key, int]) -> None:
        """Take the counts of a time [s]; one that was set back has not grown."""
        grown = ((key, count - self.total[key]) for key, count in counts.items())
        self.step = Counter({key: growth for key, growth in grown if growth > 0})
        self.total = Counter(counts)
        self._looks.append((now, self.step))
        while self._looks[0][0] <= now - self._seconds:
            self._looks.popleft()
        self.recent = Counter()
        for _, step in self._looks:
            self.recent.update(step)


class View:
    """What a node has counted, as it looks at itself.

    Attributes:
        received: Messages per input.
        sent: Messages per output.
        rejected: Messages that were not used, by topic and reason.
        events: What the node counts beside its messages.
        silence: Time since the last message of each input [s], infinite before the first.
    """

    def __init__(self, now: float) -> None:
        """Begin at a time of the steady clock [s]."""
        self.received: Tally[str] = Tally()
        self.sent: Tally[str] = Tally()
        self.rejected: Tally[Refused] = Tally()
        self.events: Tally[str] = Tally()
        self.silence: dict[str, float] = {}
        self._began = self._looked = now
        self._elapsed = inf

    def look(
        self,
        now: float,
        *,
        received: Mapping[str, int],
        sent: Mapping[str, int],
        rejected: Mapping[Refused, int],
        events: Mapping[str, int],
        heard: Mapping[str, float],
    ) -> None:
        """Take what has been counted up to a time.

        Args:
            now: The time, of the steady clock [s].
            received: Messages per input.
            sent: Messages per output.
            rejected: Messages that were not used.
            events: What the node counts beside its messages.
            heard: When the last message of each input came [s]; inputs without one are absent.
        """
        self.received.look(now, received)
        self.sent.look(now, sent)
        self.rejected.look(now, rejected)
        self.events.look(now, events)
        self.silence = {topic: now - heard.get(topic, -inf) for topic in received}
        self._elapsed, self._looked = max(now - self._looked, 1e-3), now

    def rate(self, topic: str) -> float:
        """Messages of an input or output per second since the look before."""
        return (self.received.step[topic] or self.sent.step[topic]) / self._elapsed

    def rejected_recently(self, topic: str) -> int:
        """Messages of a topic that were not used in the last `RECENT` seconds."""
        return sum(n for refused, n in self.rejected.recent.items() if refused.topic == topic)

    def report_silence(self, status: Status, topic: str, level: bytes, remedy: str) -> None:
        """Complain of an input that never had a message, or has none any more.

        In the first `START_TIME` seconds of the node it is waited for.
        """
        silence = self.silence[topic]
        if silence == inf and self._looked - self._began < START_TIME:
            status.complain(min(level, WARN), "silent", f"waits for {topic}: {remedy}")
        elif silence == inf:
            status.complain(level, "silent", f"no {topic} received: {remedy}")
        elif silence > SILENT:
            status.complain(level, "silent", f"no {topic} for {silence:.0f} s: {remedy}")

    def show(self, status: Status, *topics: str) -> None:
        """Show the counts and rates of topics."""
        for topic in topics:
            for verb, tally in (("received", self.received), ("sent", self.sent)):
                if topic in tally.total:
                    status.values[f"{verb} {topic}"] = tally.total[topic]
                    status.values[f"rate {topic} [Hz]"] = f"{self.rate(topic):.1f}"

    def show_events(self, status: Status, *names: str) -> None:
        """Show counts of the node."""
        for name in names:
            status.values[name] = self.events.total[name]

    def report_refused(
        self, status: Status, topics: Iterable[str], reasons: Collection[str] | None = None
    ) -> None:
        """Complain of messages refused in the last seconds, and show the number of all.

        Args:
            status: Whose cause it is.
            topics: Of the messages.
            reasons: Which reasons; by default all but those of `OF_TIME` and `OF_FRAMES`.
        """
        for topic in topics:
            told = []
            for refused, count in self.rejected.total.items():
                if refused.topic != topic:
                    continue
                if reasons is None and refused.reason in (*OF_TIME, *OF_FRAMES):
                    continue
                if reasons is not None and refused.reason not in reasons:
                    continue
                status.values[f"rejected {refused}"] = count
                if recent := self.rejected.recent[refused]:
                    remedy = remedy_of(topic, refused.reason)
                    told.append(f"{recent} {refused.reason}" + (f" ({remedy})" if remedy else ""))
            if told:
                status.complain(
                    WARN,
                    f"refused {topic}",
                    f"refused on {topic} in the last {RECENT:.0f} s: {', '.join(told)}",
                )


#: Names of the sigmas of a process noise: of that in use, and of the nominal one.
Q_IN_USE, NOMINAL_Q = "Q sigma", "Q nominal sigma"


def sigma_keys(name: str) -> list[str]:
    """The keys of the six sigmas of a process noise: of the specific force, of the angular rate."""
    triads = (("f", "m/s^2"), ("w", "rad/s"))
    return [f"{name} {triad}_{axis} [{unit}]" for triad, unit in triads for axis in "xyz"]


def show_sigmas(status: Status, sigma_f: Array, sigma_w: Array, name: str = Q_IN_USE) -> None:
    """Show the per-sample noise of specific force (3,) [m/s^2] and angular rate (3,) [rad/s]."""
    for key, sigma in zip(sigma_keys(name), (*sigma_f, *sigma_w), strict=True):
        status.values[key] = f"{sigma:.6g}"


def nis_key(measurement: str) -> str:
    """How the key of a measurement's mean NIS begins; the number of measurements follows."""
    return f"NIS {measurement}, mean of "


def updates_key(label: str, outcome: str) -> str:
    """The key of how many measurements of a sensor were ``accepted`` or ``rejected``."""
    return f"{label} updates {outcome}"


def age_key(label: str) -> str:
    """The key of the time since a sensor's last measurement that was used, by the stamps."""
    return f"{label} age [s]"
