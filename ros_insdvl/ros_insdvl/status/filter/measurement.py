"""One cause for each kind of measurement: outages, rejections, innovations that do not fit."""

from collections import Counter, deque
from collections.abc import Sequence
from math import inf

import numpy as np

from insdvl.messages.topics import IMU
from insdvl.navigation.events import NS
from insdvl.navigation.state.layout import gate_counter
from insdvl.timeline.fold import Fold
from insdvl.timeline.output import AppliedUpdate
from insdvl.watch.consistency import nis_median, nis_median_limit, scaled_nis
from insdvl.watch.outages import LOST, OUTAGE
from insdvl.watch.state_summary import summary
from ros_insdvl.status.diagnostics import (
    ERROR,
    RECENT,
    WARN,
    Status,
    View,
    age_key,
    nis_key,
    updates_key,
)
from ros_insdvl.status.filter.base import Cause, Published

#: Stamps without an accepted measurement for longer than this are worth a warning; for longer than
#: the second, the sensor says nothing about the state any more.
OUTAGE_NS, LOST_NS = round(OUTAGE * NS), round(LOST * NS)
#: Rejections by the gate that are no longer chance.
GATE_REJECTIONS = 2
#: NIS of the last measurements that are kept.
KEPT_NIS = 100
#: A filter is overconfident if the median of at least so many NIS is above so many times that of
#: chi-square; that of fewer must also be one that chance makes less often than NIS_CHANCE.
NIS_COUNT, NIS_RATIO, NIS_CHANCE = 50, 2.0, 1e-6

#: Events of the gate's recovery, and what the filter did.
_RECOVERIES = {
    "inflations": "the covariance was inflated after rejections",
    "restarts": "the state was restarted from a measurement after rejections",
}


class MeasurementCause(Cause):
    """A kind of measurement as the filter takes it.

    Args:
        name: Of the measurement, under which updates are counted that were not made.
        topics: That feed it.
        fold: Of the filter.
        published: What was published.
    """

    def __init__(self, name: str, topics: Sequence[str], fold: Fold, published: Published) -> None:
        self._name = name
        self._topics = tuple(topics)
        self._fold = fold
        self._published = published
        model = fold.filter.models[name]
        self._label, self._rows = model.label, model.rows
        self._tells_velocity, self._angles = model.tells_velocity, model.angles
        self._updates: Counter[str] = Counter()
        self._not_measured: Counter[str] = Counter()  # components
        self._used = self._received_by_then = 0  # when the last measurement was used
        self.reset()

    def reset(self) -> None:
        """A filter that restarts has innovations of its own."""
        self._nis: deque[float] = deque(maxlen=KEPT_NIS)

    def updated(self, update: AppliedUpdate) -> None:
        """Remember what became of a measurement."""
        report = update.report
        if report.measurement != self._name:
            return
        self._updates["accepted" if report.accepted else "rejected"] += 1
        missing = np.isinf(np.diagonal(report.S))
        self._not_measured.update(axis for axis, none in zip("xyz", missing, strict=False) if none)
        if report.corrected:
            self._nis.append(scaled_nis(report))

    def status(self, view: View) -> Status:
        """Rejections, outage, recovery and NIS."""
        status = Status(self._name)
        reasons = [r.reason for r in view.rejected.total if r.topic == self._name]
        told = [reason for reason in reasons if reason not in self._ignored(view)]
        view.report_refused(status, [self._name], told)
        topics = (topic for topic in self._topics if topic in view.silence and topic != IMU)
        view.report_refused(status, topics)  # on the topic of the IMU it is the samples
        self._report_outage(status, view)
        for name, what in _RECOVERIES.items():
            if count := view.events.recent[gate_counter(self._name, name)]:
                status.complain(
                    WARN,
                    name,
                    f"{what}, {count} times in the last {RECENT:.0f} s: find out what was wrong "
                    "before, a measurement or the IMU",
                )
        view.show(status, *self._topics)
        for name in ("accepted", "rejected"):
            status.values[updates_key(self._label, name)] = self._updates[name]
        for axis, count in sorted(self._not_measured.items()):
            status.values[f"{self._label} updates without {axis}"] = count
        for refused, count in view.rejected.total.items():
            if refused.topic == self._name:
                status.values[f"rejected {refused}"] = count
        self._report_nis(status)
        view.show_events(status, *(gate_counter(self._name, name) for name in _RECOVERIES))
        return status

    def _report_outage(self, status: Status, view: View) -> None:
        """Complain of a long time of the stamps without a used measurement."""
        received = self._received_since(view)
        state, first_ns = self._fold.latest, self._published.first_ns
        if state is None or first_ns is None:
            return
        times = summary(state)
        accepted_ns = times.accepted_ns[self._name]
        if accepted_ns is not None:
            status.values[age_key(self._label)] = f"{(times.time_ns - accepted_ns) / NS:.2f}"
        outage_ns = times.time_ns - (first_ns if accepted_ns is None else accepted_ns)
        if outage_ns <= OUTAGE_NS:
            return
        silence = min(view.silence[topic] for topic in self._topics)
        if received and silence <= OUTAGE_NS / NS:
            why = f"{received} came since the last one that was used, see which were refused"
        else:
            since = "none is received" if silence == inf else f"none came for {silence:.0f} s"
            why = f"{since}, check the {self._label}'s driver, its topic and the connections"
        sigma = f"the height's sigma is {self._published.height_sigma:.2f} m"
        if self._tells_velocity:
            sigma = f"the velocity's sigma is {self._published.velocity_sigma:.2f} m/s"
        elif self._angles:
            sigma = f"the heading's sigma is {self._published.heading_sigma_deg:.2g} deg"
        status.complain(
            ERROR if outage_ns > LOST_NS else WARN,
            "outage",
            f"no {self._label} measurement used for {outage_ns / NS:.0f} s: {why}; {sigma}",
        )

    def _received_since(self, view: View) -> int:
        """How many messages came since the last measurement that was used."""
        received = sum(view.received.total[topic] for topic in self._topics)
        if self._updates["accepted"] != self._used:
            self._used, self._received_by_then = self._updates["accepted"], received
        return received - self._received_by_then

    def _report_nis(self, status: Status) -> None:
        if not self._nis:
            return
        count, nis = len(self._nis), float(np.median(self._nis))
        status.values[f"{nis_key(self._name)}{count}"] = f"{np.mean(self._nis):.3f}"
        # Message and level are of the median: a few outliers carry the mean away.
        expected = nis_median(self._rows)
        status.summary = f"median NIS {nis:.2f} ({expected:.2f} is expected)"
        if nis <= NIS_RATIO * expected:
            return
        if count < NIS_COUNT and nis <= nis_median_limit(self._rows, count, NIS_CHANCE):
            status.summary = f"{count} measurements, too few to judge their NIS"
        else:
            status.complain(
                WARN,
                "overconfident",
                f"the median NIS of {count} measurements is {nis:.1f}, {expected:.2f} is expected: "
                "the filter is overconfident, its process noise or the "
                f"{self._label}'s noise_std is too small",
            )

    def _ignored(self, view: View) -> tuple[str, ...]:
        """Reasons of updates that are not reported.

        One measurement in a thousand fails the gate by chance, and none is used before the start.
        """
        by_the_gate = sum(
            n
            for refused, n in view.rejected.recent.items()
            if refused.topic == self._name and refused.reason == "gate"
        )
        few = by_the_gate < GATE_REJECTIONS
        return ("not_initialised", "gate") if few else ("not_initialised",)
