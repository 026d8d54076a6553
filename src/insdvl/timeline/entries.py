"""All events but the samples, in the order in which they are applied."""

import bisect
from dataclasses import dataclass, field

from insdvl.navigation.events import Event, Initial, Measurement, Origin
from insdvl.navigation.measurements.report import UpdateReport
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.settings import Settings

#: Most events of each kind that are kept before the first sample.
MAX_WAITING = 1000


@dataclass(order=True, slots=True)
class Entry:
    """An event in the sorted list, and what was done with it. Only the key is compared."""

    key: tuple[int, int, bytes]
    event: Event = field(compare=False)
    report: UpdateReport | None = field(default=None, compare=False)


class Entries:
    """Events sorted by (stamp, kind, payload); of one stamp and kind there is one.

    Args:
        parameters: With the settings that are in force before all events.

    Attributes:
        ordered: All that are kept.
        unpublished: Measurements that `Fold.take` has not returned yet, in the order of arrival.
    """

    def __init__(self, parameters: FilterParameters) -> None:
        self.ordered: list[Entry] = []
        self.unpublished: list[Entry] = []
        self._first_settings = parameters
        self._settings: list[Entry] = []  # those of `ordered`

    def insert(self, event: Event) -> tuple[bool, bool]:
        """Insert an event; of one stamp and kind that with the smallest payload counts.

        Returns:
            Whether there is another with its stamp and kind, and whether the list has changed.
        """
        entry = Entry((event.stamp_ns, event.kind, event.payload()), event)
        at = len(self.ordered)
        if at and entry.key[:2] <= self.ordered[-1].key[:2]:  # most events are the newest
            at = bisect.bisect_left(self.ordered, (*entry.key[:2], b""), key=lambda e: e.key)
        if at < len(self.ordered) and self.ordered[at].key[:2] == entry.key[:2]:
            kept = self.ordered[at]
            if entry.key >= kept.key:
                return True, False
            kept.key, kept.event = entry.key, event
            return True, True
        self.ordered.insert(at, entry)
        if isinstance(event, Settings):
            bisect.insort(self._settings, entry)
        if isinstance(event, Measurement):
            self.unpublished.append(entry)
        return False, True

    def bound_waiting(self, kind: int) -> int:
        """Give up an event of a kind of which too many wait for the first sample.

        The oldest has the least to say, but of origins the first counts.

        Returns:
            How many were given up.
        """
        same = [entry for entry in self.ordered if entry.event.kind == kind]
        if len(same) <= MAX_WAITING:
            return 0
        given_up = same[-1] if kind == Origin.kind else same[0]
        self.ordered.remove(given_up)
        self.unpublished = [entry for entry in self.unpublished if entry is not given_up]
        return 1

    def first_after(self, stamp_ns: int) -> int:
        """Index of the first event after a stamp."""
        return bisect.bisect_right(self.ordered, stamp_ns, key=lambda entry: entry.event.stamp_ns)

    def begin_with(self, parameters: FilterParameters) -> None:
        """Settings that are in force before all events."""
        self._first_settings = parameters

    def settings_at(self, stamp_ns: int) -> FilterParameters:
        """The parameters with the settings in force after the events up to a stamp."""
        for entry in reversed(self._settings):
            if entry.event.stamp_ns <= stamp_ns and isinstance(entry.event, Settings):
                return entry.event.parameters
        return self._first_settings

    def forget(self, until_ns: int) -> None:
        """Drop the events up to a stamp, all of which have been applied."""
        self._first_settings = self.settings_at(until_ns)
        self._settings = [e for e in self._settings if e.event.stamp_ns > until_ns]
        self.ordered = [entry for entry in self.ordered if entry.event.stamp_ns > until_ns]
        # One that was left out has no report, and will have none.
        self.unpublished = [
            e for e in self.unpublished if e.report is not None or e.event.stamp_ns > until_ns
        ]

    def another_start(self, e: int, until_ns: int) -> bool:
        """Whether up to a stamp another initial state that applies once follows event e."""
        for entry in self.ordered[e + 1 :]:
            if entry.event.stamp_ns > until_ns:
                break
            if isinstance(entry.event, Initial) and entry.event.once:
                return True
        return False
