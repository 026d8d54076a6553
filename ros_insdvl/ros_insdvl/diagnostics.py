"""What a node says of itself in /diagnostics: one status per cause, each recovering by itself.

A cause is told as long as it lasts: from what holds now, or from what was counted in the last
`RECENT` seconds of the steady clock. Every complaint names the number that led to it and what to
do. docs/reference/diagnostics.md has all of them.
"""

from collections import Counter, deque
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from math import inf
from types import MappingProxyType
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

OK = DiagnosticStatus.OK
WARN = DiagnosticStatus.WARN
ERROR = DiagnosticStatus.ERROR

#: How long an event is told [s].
RECENT = 10.0
#: A topic that was quiet for longer than this is silent [s].
SILENT = 2.0

#: Reasons that are of the stamp and not of what is in the message.
OF_TIME = ("no_stamp", "bad_stamp", "too_late", "far_ahead")
#: Reasons that are of the frame of the message.
OF_FRAMES = ("wrong_frame",)

#: What to do about messages that are refused, by the reason.
REMEDIES: Mapping[str, str] = MappingProxyType(
    {
        "bad_covariance": "the sender's covariance is none: not finite, not symmetric, or negative",
        "bad_quaternion": "the sender's attitude is no unit quaternion",
        "bad_stamp": "the sender's stamps are negative, or have too many nanoseconds",
        "duplicate": "two senders on one topic, or a network that doubles",
        "far_ahead": "the sender's clock is ahead of the IMU's",
        "gate": "the measurements do not fit: look at the DVL, its mount and its noise, and at the "
        "IMU",
        "no_data": "the sender marks its data as not measured",
        "no_lock": "the DVL sends exact zeros: it has no bottom lock",
        "no_stamp": "the driver does not stamp its messages",
        "not_finite": "the sender sends NaN or infinities",
        "out_of_range": "the numbers are beyond all that is physical: another unit at the sender",
        "repeated": "the DVL repeats its last measurement: no bottom lock, or two publishers",
        "too_late": "they come more than max_delay behind the IMU: shorten the delay or raise it",
        "wrong_frame": "another sensor, or set the frame_id that is expected",
    }
)


@dataclass(frozen=True)
class Complaint:
    """One thing that is wrong.

    Attributes:
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
        values: What is shown beside the message.
    """

    cause: str
    summary: str = "nothing to tell"
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

        Args:
            node: The full name of the node.
        """
        return DiagnosticStatus(
            level=self.level,
            name=f"{node}: {self.cause}",
            message=self.message,
            hardware_id="insdvl",
            values=[KeyValue(key=key, value=str(value)) for key, value in self.values.items()],
        )


class Recent:
    """By how much cumulative counts grew over the last seconds, from looks at them now and then."""

    def __init__(self, seconds: float = RECENT) -> None:
        self._seconds = seconds
        self._looks: deque[tuple[float, Counter[str]]] = deque()
        self._last: Mapping[str, int] = {}
        #: Growth since the look before.
        self.step: Counter[str] = Counter()
        #: Growth over the last seconds.
        self.growth: Counter[str] = Counter()

    def look(self, now: float, counts: Mapping[str, int]) -> None:
        """Take the counts of a time [s]; one that was set back has not grown."""
        grown = ((name, count - self._last.get(name, 0)) for name, count in counts.items())
        self.step = Counter({name: growth for name, growth in grown if growth > 0})
        self._last = dict(counts)
        self._looks.append((now, self.step))
        while self._looks[0][0] <= now - self._seconds:
            self._looks.popleft()
        self.growth = Counter()
        for _, step in self._looks:
            self.growth.update(step)


@dataclass(frozen=True)
class View:
    """What a node has counted when it looks at itself.

    Counts are named ``received TOPIC``, ``sent TOPIC`` and ``rejected TOPIC: REASON``; a node adds
    its own.

    Attributes:
        total: Since the node started.
        recent: In the last `RECENT` seconds.
        rates: Messages per second since the last look, by topic.
        silence: Time since the last message of each input [s], infinite before the first.
    """

    total: Mapping[str, int]
    recent: Counter[str]
    rates: Mapping[str, float]
    silence: Mapping[str, float]

    def quiet(self, status: Status, topic: str, level: bytes, remedy: str) -> None:
        """Complain of an input that was never there, or is there no more."""
        silence = self.silence[topic]
        if silence == inf:
            status.complain(level, "silent", f"no {topic} received: {remedy}")
        elif silence > SILENT:
            status.complain(level, "silent", f"no {topic} for {silence:.0f} s: {remedy}")

    def show(self, status: Status, *topics: str) -> None:
        """Show the counts and rates of topics."""
        for topic in topics:
            for verb in ("received", "sent"):
                if (key := f"{verb} {topic}") in self.total:
                    status.values[key] = self.total[key]
                    status.values[f"rate {topic} [Hz]"] = f"{self.rates[topic]:.1f}"

    def refused(
        self, status: Status, topics: Iterable[str], reasons: Collection[str] | None = None
    ) -> None:
        """Complain of messages that were lately refused, and show how many were in all.

        Args:
            status: Whose cause it is.
            topics: Of the messages.
            reasons: Which reasons; by default all but those of `OF_TIME` and `OF_FRAMES`.
        """
        for topic in topics:
            prefix = f"rejected {topic}: "
            told = []
            for key, count in self.total.items():
                reason = key.removeprefix(prefix)
                if reason == key:  # of another topic
                    continue
                if reasons is None and reason in (*OF_TIME, *OF_FRAMES):
                    continue
                if reasons is not None and reason not in reasons:
                    continue
                status.values[key] = count
                if self.recent[key]:
                    remedy = REMEDIES.get(reason)
                    told.append(f"{self.recent[key]} {reason}" + (f" ({remedy})" if remedy else ""))
            if told:
                status.complain(
                    WARN,
                    f"refused {topic}",
                    f"refused of {topic} in the last {RECENT:.0f} s: {', '.join(told)}",
                )
