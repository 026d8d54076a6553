"""The tuner's cause `process noise`: what is learned, and why nothing is."""

import numpy as np

from insdvl.messages.topics import IMU, PROCESS_NOISE
from insdvl.tuner.tuner import TunedNoise, Tuner
from ros_insdvl.status.diagnostics import RECENT, WARN, Status, View, show_sigmas


class Learned:
    """The learned process noise.

    Args:
        tuner: The tuner.
        rate: Its parameter [Hz].
        max_gap: Its parameter [s].
    """

    def __init__(self, tuner: Tuner, rate: float, max_gap: float) -> None:
        self._tuner = tuner
        self._rate = rate
        self._max_gap = max_gap

    def status(self, view: View, latest: TunedNoise | None) -> Status:
        """What learns, switch, and the six sigmas of the latest Q."""
        status = Status("process noise", f"learned by {self._tuner.name}")
        status.values["model"] = self._tuner.name
        status.values["enabled"] = self._tuner.enabled
        if not self._tuner.enabled:
            status.complain(
                WARN,
                "disabled",
                "disabled, process_noise is not published: set enabled, or call ~/enable",
            )
        elif self._learns_nothing(view):
            status.complain(
                WARN,
                "nothing",
                f"no window was usable in the last {RECENT:.0f} s: it takes "
                f"{self._tuner.window} samples in a row without a gap" + self._what_emptied(view),
            )
        if count := view.events.recent["too_large"]:
            status.complain(
                WARN,
                "too large",
                f"{count} windows in the last {RECENT:.0f} s had values too large to learn from: "
                "check the IMU",
            )
        if count := view.events.recent["failed"]:
            status.complain(
                WARN, "failed", f"{count} times in the last {RECENT:.0f} s: {self._tuner.failure}"
            )
        self._report_time(status, view)
        if latest is not None:
            sigmas = np.sqrt(latest.variances)
            show_sigmas(status, sigmas[:3], sigmas[3:])
        view.show_events(status, "samples", "windows", "too_large", "failed")
        view.show(status, PROCESS_NOISE)
        return status

    def _report_time(self, status: Status, view: View) -> None:
        """How long an estimate takes: longer than until the next one, and the node gets behind."""
        seconds, between = self._tuner.seconds_per_call, 1.0 / self._rate
        if seconds is None:
            return
        status.values["time per estimate [s]"] = f"{seconds:.3g}"
        recent = view.events.recent
        if seconds > between and any(recent[name] for name in ("windows", "too_large", "failed")):
            status.complain(
                WARN,
                "slow",
                f"{self._tuner.kind} {self._tuner.name} takes {seconds:.2g} s per call, more than "
                f"the {between:.3g} s between calls: the tuner falls behind, and in the navigator "
                "the odometry with it; make it faster, or lower the tuner's rate",
            )

    def _learns_nothing(self, view: View) -> bool:
        """Whether samples came all the time, for long enough, and no window was full.

        One of which nothing came was full: what came of it is told beside.
        """
        samples, events = view.received.recent[IMU], view.events.recent
        return (
            0 < samples < view.received.total[IMU]
            and not events["failed"] + events["too_large"]
            and not view.sent.recent[PROCESS_NOISE]
            and RECENT * self._rate >= 2.0
        )

    def _what_emptied(self, view: View) -> str:
        """What kept the window from filling, and what to do; empty if nothing did."""
        gaps, restarts = view.events.recent["gaps"], view.events.recent["restarts"]
        if not gaps + restarts:
            return ""
        return (
            f", and {gaps} gaps and {restarts} restarts emptied it: repair the network, run the "
            "tuner beside the IMU's driver, or raise max_gap "
            f"({self._max_gap:g} s) above the delays"
        )
