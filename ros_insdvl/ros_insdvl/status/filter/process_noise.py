"""The cause `process noise`: the Q in use, its age, and limits that were applied to it."""

import numpy as np

from insdvl.messages.topics import IMU, Q_TOPICS
from insdvl.navigation.events import NS
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.process_noise.bank import LEVELS
from insdvl.timeline.fold import Fold
from insdvl.watch.state_summary import StateSummary, summary
from ros_insdvl.status.diagnostics import NOMINAL_Q, RECENT, WARN, Status, View, show_sigmas
from ros_insdvl.status.filter.base import Cause


class ProcessNoise(Cause):
    """The process noise in use."""

    def __init__(self, parameters: FilterParameters, fold: Fold) -> None:
        self._source = parameters.process_noise.source
        self._has_factor = parameters.process_noise.adaptive_factor
        self._timeout = parameters.q_timeout
        self._topic = Q_TOPICS.get(self._source)
        self._fold = fold
        noise = parameters.process_noise
        self._nominal = (
            np.sqrt(noise.accelerometer_variance),
            np.sqrt(noise.gyroscope_variance),
        )

    def status(self, view: View) -> Status:
        """Values, age, refusals and limits."""
        status = Status("process noise", self._source)
        state = self._fold.latest
        if state is not None:
            noise = summary(state)
            show_sigmas(status, noise.sigma_f, noise.sigma_w)
            show_sigmas(status, *self._nominal, NOMINAL_Q)
            if self._topic is not None or self._source == "message":
                self._report_age(status, noise)
            if self._has_factor:
                self._report_factor(status, noise.factor)
        if self._topic is not None:
            view.report_refused(status, [self._topic])
            view.show(status, self._topic)
        for name, limit, parameter, sensor in (
            ("floors", "below the floor", "floor", "good"),
            ("ceilings", "above the ceiling", "ceiling", "poor"),
        ):
            if count := view.events.recent[name]:
                status.complain(
                    WARN,
                    name,
                    f"a received Q was {limit} {count} times in the last {RECENT:.0f} s, and the "
                    f"{parameter} was used: check its sender, or set process_noise.*_{parameter} "
                    f"if the sensor is that {sensor}",
                )
        view.show_events(status, "q_timeouts", "floors", "ceilings")
        return status

    @staticmethod
    def _report_factor(status: Status, factor: float) -> None:
        """Of the factor that the innovations tell."""
        status.values["Q factor"] = f"{factor:.3g}"
        status.summary += f", times {factor:.3g} by the innovations"
        low, high = LEVELS[0], LEVELS[-1]
        if factor in (low, high):
            status.complain(
                WARN,
                "factor",
                f"the factor on Q is {factor:.3g}, the {'least' if factor == low else 'largest'} "
                "that is possible: correct the process noise that is told, or dvl.noise_std",
            )

    def _report_age(self, status: Status, noise: StateSummary) -> None:
        """Of a Q that is received."""
        if noise.process_noise_ns is None:
            status.values["Q age [s]"] = "nominal"
            sender = ", the tuner" if self._source == "external" else ""
            status.complain(
                WARN,
                "nominal",
                f"no process noise received yet, or none for more than {self._timeout:g} s; Q is "
                f"nominal: check what publishes {self._topic or IMU}{sender}",
            )
        else:
            age = (noise.time_ns - noise.process_noise_ns) / NS
            status.values["Q age [s]"] = f"{age:.3f}"
            status.summary = f"{self._source}, {age:.1f} s old"
