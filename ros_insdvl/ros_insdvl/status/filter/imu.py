"""The cause `imu`: samples that are absent, refused, lost or not believed, and their rate."""

from collections import deque
from math import inf

import numpy as np

from insdvl.messages.topics import IMU, ODOMETRY
from insdvl.navigation.events import NS, Event
from insdvl.navigation.events import Imu as ImuSample
from insdvl.navigation.parameters import FilterParameters
from insdvl.watch.sample_count import ExpectedSamples
from ros_insdvl.status.diagnostics import ERROR, RECENT, WARN, Status, View
from ros_insdvl.status.filter.base import Cause

#: Largest relative difference between imu.rate and the rate of the stamps.
RATE_TOLERANCE = 0.05
#: Share of missing IMU samples from which on it is reported. Jitter of the stamps looks like less
#: than that.
MISSING_SHARE = 0.005
#: Stamps from which the rate is taken.
STAMPS, FEWEST_STAMPS = 200, 10

#: Samples that are not used, and what to check.
_NOT_USED = {
    "saturated": "had a saturated channel: check the IMU, or imu.acceleration_range and "
    "imu.rate_range",
    "frozen": "had a frozen channel: check the IMU, or imu.frozen_samples",
    "glitches": "left their neighbours in a channel and were not believed: check the IMU and its "
    "cable",
    "no_data": "had a specific force of exactly zero, which gravity never is: check the driver",
}

#: Events of `Imu.counts`.
EXPECTED, ARRIVED = "samples expected", "samples arrived"


class Imu(Cause):
    """The IMU as the filter takes it."""

    def __init__(self, parameters: FilterParameters) -> None:
        self._parameters = parameters.imu
        self._samples = ExpectedSamples(parameters)
        self.reset()

    def reset(self) -> None:
        """Another time has other stamps."""
        self._samples.restart()
        self._stamps: deque[int] = deque(maxlen=STAMPS)

    def took(self, events: list[Event]) -> None:
        """Remember the stamps of the samples among what the fold took."""
        for event in events:
            if isinstance(event, ImuSample):
                self._stamps.append(event.stamp_ns)
                self._samples.add(event.stamp_ns)

    @property
    def counts(self) -> dict[str, int]:
        """Samples that were expected by the stamps, and those that arrived."""
        return {EXPECTED: self._samples.expected, ARRIVED: self._samples.arrived}

    def status(self, view: View) -> Status:
        """Absence, refusals, gaps, channels, rate and losses."""
        status = Status("imu")
        view.report_silence(
            status, IMU, ERROR, "check the IMU's driver, its topic and the connections"
        )
        view.report_refused(status, [IMU])
        self._report_all_refused(status, view)
        if count := view.events.recent["gaps"]:
            status.complain(
                WARN,
                "gaps",
                f"{count} gaps of more than {self._parameters.max_gap:g} s in the last "
                f"{RECENT:.0f} s: samples are lost, check the driver and the network; sigma grows "
                "by the unseen motion",
            )
        for name, what in _NOT_USED.items():
            if count := view.events.recent[name]:
                status.complain(
                    WARN,
                    name,
                    f"{count} samples in the last {RECENT:.0f} s {what}; sigma grows by the unseen "
                    "motion",
                )
        view.show(status, IMU)
        self._report_rate(status, view)
        view.show_events(status, "gaps", *_NOT_USED)
        return status

    def _report_all_refused(self, status: Status, view: View) -> None:
        received, refused = view.received.recent[IMU], view.rejected_recently(IMU)
        if 0 < received <= refused and not view.sent.recent[ODOMETRY]:
            status.complain(
                ERROR,
                "all refused",
                f"all {refused} messages of the last {RECENT:.0f} s were refused: there is no "
                "navigation until this is corrected",
            )

    def _report_rate(self, status: Status, view: View) -> None:
        """Compare the rate of the stamps with the declared one."""
        if len(self._stamps) < FEWEST_STAMPS:
            return
        step_ns = float(np.median(np.diff(np.sort(np.array(self._stamps)))))
        rate, declared = NS / step_ns if step_ns > 0.0 else inf, self._parameters.rate
        status.summary = f"{rate:.1f} Hz"
        status.values["IMU rate of the stamps [Hz]"] = f"{rate:.2f}"
        if abs(rate / declared - 1.0) > RATE_TOLERANCE:
            status.complain(
                WARN,
                "rate",
                f"imu.rate is {declared:g} Hz, the stamps have {rate:.1f} Hz: set imu.rate, which "
                "scales the process noise",
            )
        else:
            self._report_missing(status, view)

    def _report_missing(self, status: Status, view: View) -> None:
        """Complain of lost samples; the rate of the stamps must be the declared one."""
        expected = view.events.recent[EXPECTED]
        missing = expected - view.events.recent[ARRIVED]
        status.values["samples missing"] = max(self._samples.expected - self._samples.arrived, 0)
        share = missing / expected if expected else 0.0
        status.values["samples missing lately [%]"] = f"{100.0 * max(share, 0.0):.2f}"
        if share >= MISSING_SHARE:
            status.complain(
                WARN,
                "missing",
                f"{100.0 * share:.1f} % of the samples are missing by their stamps, {missing} of "
                f"{expected} in the last {RECENT:.0f} s: check the driver, the network and the "
                "machine's load, or set reliable delivery on both sides (qos_overrides.*)",
            )
