"""The cause `measurement noise`: the R of the DVL in force, where it is from, and what was refused.

Only with a `dvl.noise_source` that is not nominal.
"""

import numpy as np

from insdvl.arrays import Array
from insdvl.messages.topics import MEASUREMENT_NOISE, TRUE_MEASUREMENT_NOISE
from insdvl.navigation.events import NS, Event
from insdvl.navigation.measurement_noise.source import NOMINAL, ORACLE, InForce
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.timeline.fold import Fold
from ros_insdvl.status.diagnostics import WARN, Status, View
from ros_insdvl.status.filter.base import Cause


class MeasurementNoise(Cause):
    """The noise of the DVL that the filter uses."""

    def __init__(self, parameters: FilterParameters, fold: Fold) -> None:
        self._source = parameters.dvl.noise_source
        self._timeout = parameters.q_timeout
        self._topic = TRUE_MEASUREMENT_NOISE if self._source == ORACLE else MEASUREMENT_NOISE
        self._fold = fold
        self._nominal: Array | None = None  # covariance of the last ping

    @staticmethod
    def of(parameters: FilterParameters, fold: Fold) -> "list[MeasurementNoise]":
        """The cause, where the noise is not nominal."""
        is_nominal = parameters.dvl.noise_source == NOMINAL
        return [] if is_nominal else [MeasurementNoise(parameters, fold)]

    def took(self, events: list[Event]) -> None:
        """Remember what the last whole ping among the events was told to have."""
        pings = [event for event in events if isinstance(event, Dvl) and all(event.measured)]
        if pings:
            self._nominal = self._fold.filter.models[Dvl.name].noise(pings[-1])

    def status(self, view: View) -> Status:
        """Refusals, the sigmas in force, their origin, and the age of what was received."""
        status = Status("measurement noise", self._source)
        view.report_refused(status, [self._topic])
        view.show(status, self._topic)
        state = self._fold.latest
        noise = None if state is None else self._fold.filter.noise_in_force(state, Dvl.name)
        if noise is None:
            return status
        status.summary = f"{self._source}, R is {noise.factor:.3g} times nominal: {noise.text}"
        status.values["R factor"] = f"{noise.factor:.3g}"
        status.values["R origin"] = noise.text
        if self._nominal is not None:
            self._show(status, "R sigma", noise.factor * self._nominal)
            self._show(status, "R nominal sigma", self._nominal)
        self._report_age(status, noise)
        return status

    @staticmethod
    def _show(status: Status, name: str, R: Array) -> None:
        """The sigmas of the axes, of which those of the stream differ by their signs alone."""
        for axis, sigma in zip("xyz", np.sqrt(np.diagonal(R)), strict=True):
            status.values[f"{name} {axis} [m/s]"] = f"{sigma:.3g}"

    def _report_age(self, status: Status, noise: InForce) -> None:
        """Of what is received, in whose place the filter has an estimate of its own."""
        if noise.age_ns is None:
            status.values["R age [s]"] = "none received"
            if self._source == ORACLE:
                status.complain(
                    WARN,
                    "none received",
                    f"no {self._topic} received yet, R is from: {noise.text}; check what "
                    f"publishes {self._topic}",
                )
            return
        status.values["R age [s]"] = f"{noise.age_ns / NS:.3f}"
        if noise.timed_out:
            status.complain(
                WARN,
                "timed out",
                f"the last {self._topic} is {noise.age_ns / NS:.1f} s old, more than the "
                f"{self._timeout:g} s of q_timeout; R is from: {noise.text}; check what publishes "
                f"{self._topic}",
            )
