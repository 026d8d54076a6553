"""The cause `dvl`: outages, rejections, and innovations that do not fit their covariance."""

from collections import Counter, deque

import numpy as np

from insdvl.navigation.events import NS
from insdvl.timeline.fold import Fold
from insdvl.timeline.output import AppliedUpdate
from insdvl.watch.state_summary import summary
from ros_insdvl.status.diagnostics import ERROR, RECENT, WARN, Status, View
from ros_insdvl.status.filter.base import DVL, Cause, Published

#: Stamps without an accepted measurement for longer than this are worth a warning; for longer than
#: the second, the DVL says nothing about the velocity any more.
OUTAGE_NS, LOST_NS = 5 * NS, 60 * NS
#: Rejections by the gate that are no longer chance.
GATE_REJECTIONS = 2
#: NIS of the last measurements that are kept.
KEPT_NIS = 100
#: Median of at least so many NIS above which a filter is overconfident: twice that of chi-square
#: with 3 degrees of freedom.
NIS_COUNT, NIS_MEDIAN = 50, 4.73
#: Name under which updates are counted that were not made.
UPDATES = "dvl"

#: Events of the gate's recovery, and what the filter did.
_RECOVERIES = {
    "inflations": "the velocity's covariance was inflated after rejections",
    "restarts": "the velocity was restarted from the DVL after rejections",
}


class Dvl(Cause):
    """The DVL as the filter takes it."""

    def __init__(self, fold: Fold, published: Published) -> None:
        self._fold = fold
        self._published = published
        self._updates: Counter[str] = Counter()
        self.reset()

    def reset(self) -> None:
        """A filter that restarts has innovations of its own."""
        self._nis: deque[float] = deque(maxlen=KEPT_NIS)

    def updated(self, update: AppliedUpdate) -> None:
        """Remember what became of a measurement."""
        report = update.report
        self._updates["accepted" if report.accepted else "rejected"] += 1
        if report.corrected:
            self._nis.append(report.nis)

    def status(self, view: View) -> Status:
        """Rejections, outage, recovery and NIS."""
        status = Status("dvl")
        reasons = [r.reason for r in view.rejected.total if r.topic == UPDATES]
        view.report_refused(status, [UPDATES], [r for r in reasons if r not in _ignored(view)])
        view.report_refused(status, [topic for topic in DVL if topic in view.silence])
        self._report_outage(status, view)
        for name, what in _RECOVERIES.items():
            if count := view.events.recent[name]:
                status.complain(
                    WARN,
                    name,
                    f"{what}, {count} times in the last {RECENT:.0f} s: find out what was wrong "
                    "before, the DVL or the IMU",
                )
        view.show(status, *DVL)
        for name in ("accepted", "rejected"):
            status.values[f"DVL updates {name}"] = self._updates[name]
        for refused, count in view.rejected.total.items():
            if refused.topic == UPDATES:
                status.values[f"rejected {refused}"] = count
        self._report_nis(status)
        view.show_events(status, *_RECOVERIES)
        return status

    def _report_outage(self, status: Status, view: View) -> None:
        """Complain of a long time of the stamps without a used measurement."""
        state, first_ns = self._fold.latest, self._published.first_ns
        if state is None or first_ns is None:
            return
        times = summary(state)
        accepted_ns = times.accepted_ns["dvl"]
        outage_ns = times.time_ns - (first_ns if accepted_ns is None else accepted_ns)
        if outage_ns <= OUTAGE_NS:
            return
        received = sum(view.received.recent[topic] for topic in DVL)
        why = (
            f"{received} were received in the last {RECENT:.0f} s, see which were refused"
            if received
            else "none is received, check the DVL's driver, its topic and the connections"
        )
        status.complain(
            ERROR if outage_ns > LOST_NS else WARN,
            "outage",
            f"no DVL measurement used for {outage_ns / NS:.0f} s: {why}; the velocity's sigma is "
            f"{self._published.velocity_sigma:.2f} m/s",
        )

    def _report_nis(self, status: Status) -> None:
        if not self._nis:
            return
        count, nis = len(self._nis), float(np.mean(self._nis))
        status.values[f"NIS, mean of {count}"] = f"{nis:.3f}"
        status.summary = f"mean NIS {nis:.2f} (3 is expected)"
        if count >= NIS_COUNT and float(np.median(self._nis)) > NIS_MEDIAN:
            status.complain(
                WARN,
                "overconfident",
                f"the mean NIS of {count} measurements is {nis:.1f}, 3 is expected: the filter is "
                "overconfident, its process noise or the DVL's noise_std is too small",
            )


def _ignored(view: View) -> tuple[str, ...]:
    """Reasons of updates that are not reported.

    One measurement in a thousand fails the gate by chance, and none is used before the start.
    """
    by_the_gate = sum(
        n
        for refused, n in view.rejected.recent.items()
        if refused.topic == UPDATES and refused.reason == "gate"
    )
    return ("not_initialised", "gate") if by_the_gate < GATE_REJECTIONS else ("not_initialised",)
