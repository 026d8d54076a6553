"""The cause `initialisation`: what the filter waits for, and initial states that it cannot use."""

from insdvl.messages.inputs import Inputs
from insdvl.messages.topics import FIX, SET_ODOMETRY
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.earth import MAX_LATITUDE_DEG
from insdvl.navigation.geometry.odom import MAX_FROM_ORIGIN
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.start import automatic
from insdvl.navigation.state.fields import State
from insdvl.timeline.fold import Fold
from insdvl.watch.start import (
    DIVERGED,
    large_biases,
    report_of_start,
    unknown_heading,
    waits_for,
)
from ros_insdvl.status.diagnostics import ERROR, RECENT, WARN, Status, View
from ros_insdvl.status.filter.base import Cause, Published

_DIVERGED, _JUMPS = "diverged", "time_jumps"
#: Modes other than auto that take the yaw of initial.rpy.
_TOLD_BY_PARAMETERS = ("parameters", "levelling")
#: Events that are no error, and what each means.
_EVENTS = {
    "without_origin": "{count} initial states in the last {seconds:.0f} s arrived before the "
    "origin and were not used: send them again after the fix",
    "too_old": "{count} initial states in the last {seconds:.0f} s were much older than the first "
    "IMU sample and were not used: check the sender's clock",
    "off_the_map": "{count} initial states in the last {seconds:.0f} s were not used: their "
    f"position is more than {MAX_FROM_ORIGIN / 1e3:.0f} km from the origin, or beyond "
    f"{MAX_LATITUDE_DEG:g} deg of latitude",
    "not_level": "levelling restarted {count} times in the last {seconds:.0f} s: the specific "
    "force differs from gravity, or samples are missing; keep the vehicle still, check the IMU and "
    "its unit",
    "wrong_headings": "{count} times in the last {seconds:.0f} s the gyroscope bias moved further "
    "than its sigma allows and contradicted the heading, which is unknown again: tell the heading, "
    "or check initial.gyroscope_bias_std, dvl.noise_std and dvl.bias_model",
}


class Initialisation(Cause):
    """Whether the filter has its initial state."""

    def __init__(
        self, parameters: FilterParameters, inputs: Inputs, fold: Fold, published: Published
    ) -> None:
        self._parameters = parameters
        self._inputs = inputs
        self._fold = fold
        self._published = published

    def status(self, view: View) -> Status:
        """What is missing."""
        status = Status("initialisation", "initialised")
        first_ns, latest = self._published.first_ns, self._fold.latest
        if latest is None:
            status.complain(
                WARN, "waits", f"not initialised, waits for {waits_for(self._parameters)}"
            )
        elif first_ns is not None:
            status.summary = f"initialised, first output at stamp {first_ns / NS:.3f} s"
        if latest is not None:
            self._tell_start(latest, status)
            self._tell_restart(latest, status, view)
        if count := view.events.recent[_DIVERGED]:
            status.complain(
                ERROR,
                _DIVERGED,
                f"the filter diverged and gave up its state {count} times in the last "
                f"{RECENT:.0f} s, and starts again as initial.mode says: {DIVERGED}",
            )
        for name, text in _EVENTS.items():
            if count := view.events.recent[name]:
                status.complain(WARN, name, text.format(count=count, seconds=RECENT))
        topics = [SET_ODOMETRY]
        if self._inputs.initial_topic is not None:
            topics.append(self._inputs.initial_topic)
        if FIX in self._inputs.topics:
            topics.append(FIX)
        view.show(status, *topics)
        view.report_refused(status, topics)
        view.show_events(status, _DIVERGED, *_EVENTS)
        return status

    def _tell_start(self, latest: State, status: Status) -> None:
        """What was taken from where, what is not known, and biases that were told too small."""
        report = report_of_start(self._fold.filter, latest)
        if report.text:
            status.summary += f", {report.text}"
        if report.missing:
            status.complain(WARN, "heading", report.missing)
        if text := unknown_heading(latest):
            status.complain(WARN, "odom", text)
        for text in large_biases(self._fold.filter, latest):
            status.complain(WARN, "bias", text)

    def _tell_restart(self, latest: State, status: Status, view: View) -> None:
        """A heading of the parameters is that of the first start: the vehicle has turned since."""
        initial, times = self._parameters.initial, view.events.total
        is_told = initial.mode in _TOLD_BY_PARAMETERS and not view.received.total[SET_ODOMETRY]
        if not (is_told or latest["start"]["heading_from"] == automatic.PARAMETERS):
            return
        if self._parameters.heading.topic or not times[_JUMPS] + times[_DIVERGED]:
            return
        why = "a time jump" if times[_JUMPS] else "the filter diverged"
        status.complain(
            WARN,
            "restarted",
            f"started again after {why} with the heading of initial.rpy and the position of "
            "initial.position, which were those of the first start: publish set_odometry with "
            "heading and position",
        )
