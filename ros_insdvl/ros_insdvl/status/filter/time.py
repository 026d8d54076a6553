"""The cause `time`: stamps that cannot be used, and clocks that jump."""

from insdvl.navigation.events import NS
from insdvl.navigation.state.fields import NEVER
from insdvl.timeline.fold import Fold
from insdvl.timeline.jumps import TimeJump
from ros_insdvl.status.diagnostics import ERROR, RECENT, WARN, Status, View
from ros_insdvl.status.filter.base import Cause
from ros_insdvl.status.reasons import KEPT, OF_TIME


class Time(Cause):
    """The stamps of all inputs."""

    def __init__(self, fold: Fold) -> None:
        self._fold = fold
        self._jump: TimeJump | None = None  # the last one

    def jumped(self, jump: TimeJump) -> None:
        """Remember a jump, which outlives the time that it began."""
        self._jump = jump

    def status(self, view: View) -> Status:
        """Refusals, jumps, and messages that waited in vain."""
        status = Status("time", "stamps are in order")
        recovered = view.events.recent["recovered"]
        kept = sum(n for refused, n in view.rejected.recent.items() if refused.reason in KEPT)
        # Refused at first, they were the beginning of another time, or the end of a gap.
        are_used = 0 < kept <= recovered
        told = [reason for reason in OF_TIME if not (are_used and reason in KEPT)]
        view.report_refused(status, view.silence, told)
        for refused, count in view.rejected.total.items():
            if refused.reason in OF_TIME:
                status.values[f"rejected {refused}"] = count
        held = self._fold.held
        if held is not None:
            status.complain(
                ERROR,
                "held",
                f"the IMU's stamps went from {_seconds(held)} and jump_action is 'hold': correct "
                "the clock, or call ~/reset to continue there",
            )
        if view.events.recent["time_jumps"] and self._jump is not None:
            used = (
                f"; {recovered} messages that were refused at first are used" if recovered else ""
            )
            status.complain(
                WARN,
                "jump",
                f"the IMU's stamps went from {_seconds(self._jump)} and the filter restarted: "
                f"check the clocks, and send the filter its position if it cannot know it{used}",
            )
        if count := view.events.recent["given_up"]:
            status.complain(
                WARN,
                "given up",
                f"{count} messages in the last {RECENT:.0f} s were dropped: they waited for IMU "
                "samples of their time until too many waited; check the IMU and the senders' "
                "clocks",
            )
        newest_ns = self._fold.newest_ns
        status.values["newest IMU stamp [s]"] = (
            "none" if newest_ns == NEVER else f"{newest_ns / NS:.3f}"
        )
        view.show_events(status, "time_jumps", "recovered", "given_up")
        return status


def _seconds(jump: TimeJump) -> str:
    return f"{jump.from_ns / NS:.3f} to {jump.to_ns / NS:.3f} s,"
