"""Which measurements are used: a chi-square gate that neither locks out nor gives in at once.

One `Gate` for each kind of measurement, with one memory in the state record (state.py). It knows m
rows; what the measurement tells of is the model's business. The rules are derived in
docs/explanation/filter.md.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import expit, gammainccinv, gammaincinv

from insdvl.arrays import Array
from insdvl.navigation import kalman
from insdvl.navigation.channels import in_doubt
from insdvl.navigation.events import NS
from insdvl.navigation.kalman import Innovated
from insdvl.navigation.measurements.base import SensorModel
from insdvl.navigation.state import NEVER, Constants, State
from insdvl.parameters.declaration import parameter

#: A measurement whose NIS is so many times the gate's limit is surely a fault of the sensor.
FAULT = 1.5
#: A trusted filter may reject for so long [ns] what need not be a fault of the sensor; a longer
#: interval between measurements bears nothing out; two steps farther apart are no drift.
LEAST_PATIENCE_NS = 5 * NS
#: Memory of the running mean of the NIS [measurements], and the probability that a filter of honest
#: covariance has it above the limit.
NIS_MEMORY, NIS_TAIL = 5.0, 1e-4


@dataclass(frozen=True)
class GateParameters:
    """Which measurements are used."""

    enabled: bool = parameter(True, "Reject measurements that fail the chi-square gate.")
    probability: float = parameter(
        0.999,
        "Probability that a good measurement passes the gate.",
        above=0.5,
        high=1.0 - 1e-12,
    )
    max_rejection_time: float = parameter(
        60.0,
        "If a sensor is rejected without a break for this time (in stamps), or for as long as it "
        "has agreed with the filter before if that is shorter (at most 5 s if the filter itself "
        "may be wrong), the covariance is inflated: of velocity and tilt for the DVL, of the "
        "height for a depth sensor. After twice the time the state is restarted from the "
        "measurement.",
        unit="s",
        above=0.0,
        high=3600.0,
    )


class Gate:
    """The gate of one kind of measurement.

    Args:
        parameters: Of the gate.
        name: Of the measurement.
        model: Of its sensor.
        constants: Of the filter.
    """

    def __init__(
        self,
        parameters: GateParameters,
        name: str,
        model: SensorModel[Any],
        constants: Constants,
    ) -> None:
        self._name = name
        self._model = model
        self._constants = constants
        #: By the number of rows that were measured.
        self._limits = [
            2.0 * float(gammaincinv(m / 2.0, parameters.probability))
            if parameters.enabled
            else np.inf
            for m in range(model.rows + 1)
        ]
        self._nis_limit = _nis_limit(model.rows)
        self._patience_ns = round(parameters.max_rejection_time * NS)

    def start(self, s: State) -> None:
        """Nothing has borne the filter out yet."""
        g = self._memory(s)
        g["trusted_for"], g["nis"], g["doubt_until_ns"] = 0, float(self._model.rows), NEVER
        _trust_sensor(g)

    def _memory(self, s: State) -> State:
        return s["gate"][self._name]

    def doubted(self, s: State, stamp_ns: int, R: Array) -> Array:
        """Covariance (m, m) of the noise, with the error that the sensor may have at a stamp."""
        g = self._memory(s)
        if stamp_ns < g["doubt_until_ns"]:
            doubt = g["doubt"][: self._model.rows]
            R = R + np.outer(doubt, doubt)
        return R

    def judge(self, s: State, stamp_ns: int, now: Innovated) -> tuple[Innovated, bool, str]:
        """Decide on a measurement; a rejection may inflate the covariance, or restart the state.

        Args:
            s: State at the measurement.
            stamp_ns: Of the measurement.
            now: The measurement against its prediction; its NIS is finite.

        Returns:
            The same, with the error that it may have in R; whether it is used; and the reason:
            empty, ``gate``, or ``restarted`` where the state was set from it.
        """
        g, m, limit = self._memory(s), self._model.rows, self._limits[now.rows]
        goes_on = False
        probability = self._fault_probability(s, stamp_ns, now)
        if probability > 0.0:
            # With an error smaller than the filter's own sigma it still knows more than the filter.
            error = np.sqrt(probability) * g["first"][:m]
            goes_on = probability > 0.5 and bool(error @ error > np.trace(now.S - now.R))
            if not goes_on:
                R = now.R + np.outer(error, error)
                now = kalman.innovate(s["nav"]["P"], now.innovation, now.H, R)
                if probability > 0.5:
                    g["doubt"][:m] = error
                    g["doubt_until_ns"] = g["rejected_from_ns"] + g["patient_for"]
        if not goes_on and not now.nis > limit:
            return now, True, ""
        if goes_on or now.nis > FAULT * limit:
            g["fault"][:m], g["fault_ns"] = now.innovation, stamp_ns
        return now, *self._recover(s, stamp_ns, now)

    def accept(self, s: State, stamp_ns: int, nis: float, left: Array) -> None:
        """A measurement has corrected the state.

        Args:
            s: State, corrected.
            stamp_ns: Of the measurement.
            nis: Its normalised innovation squared, scaled to all rows where some were not measured.
            left: (m,) innovation that the correction left.
        """
        g = self._memory(s)
        g["nis"] += (nis - g["nis"]) / NIS_MEMORY
        g["left"][: len(left)] = left
        self._bear_out(s, stamp_ns)

    def _bear_out(self, s: State, stamp_ns: int) -> None:
        g = self._memory(s)
        if g["accepted_ns"] != NEVER:
            since_ns = stamp_ns - int(g["accepted_ns"])
            steady = since_ns <= LEAST_PATIENCE_NS and not g["rejections"]
            # What was contradicted, or not looked at, counts double against the filter.
            trust_ns = int(g["trusted_for"]) + (since_ns if steady else -2 * since_ns)
            honest = g["nis"] <= self._nis_limit and not in_doubt(s)
            g["trusted_for"] = min(max(trust_ns, 0), self._patience_ns) if honest else 0
        g["accepted_ns"] = stamp_ns
        if self._model.tells_velocity:
            s["channels"]["told_ns"] = stamp_ns
        _trust_sensor(g)

    def _fault_probability(self, s: State, stamp_ns: int, now: Innovated) -> float:
        """Probability that this measurement repeats the previous error rather than being good.

        The uncertainty grows while the sensor is rejected, until what was an error fits as well.
        But a lasting error repeats the last innovation, to within the noise of the sensor and what
        the IMU may have drifted in between. The likelihoods of the two explanations are compared.
        """
        g = self._memory(s)
        known = g["fault_ns"] != NEVER and not in_doubt(s)
        if not known or stamp_ns - g["rejected_from_ns"] >= g["patient_for"]:
            return 0.0
        S_step = self._step_covariance(s, stamp_ns - int(g["fault_ns"]), now.R)
        step = now.innovation - g["fault"][: self._model.rows]
        of_fault = step @ np.linalg.solve(S_step, step) + np.linalg.slogdet(S_step)[1]
        of_good = now.nis + np.linalg.slogdet(now.S)[1]
        return float(expit((of_good - of_fault) / 2.0))

    def _step_covariance(self, s: State, interval_ns: int, R: Array) -> Array:
        """Covariance (m, m) of the step between two innovations, nothing corrected in between.

        That of the noise of two measurements, and of the IMU's drift over the interval [ns].
        """
        drift = self._model.drift(s, interval_ns / NS)
        # The last term, far below all noise, gives an R that is singular an inverse.
        return 2.0 * R + drift + 1e-9 * np.trace(R) * np.eye(len(R))

    def _step_nis(self, s: State, step: Array, interval_ns: int, R: Array) -> float:
        """Of the step between two innovations: beyond the gate it is one that the IMU missed."""
        return float(step @ np.linalg.solve(self._step_covariance(s, interval_ns, R), step))

    def _patience(self, s: State, stamp_ns: int, now: Innovated) -> int:
        """How long [ns] the filter may reject from this measurement on.

        A step that the IMU did not see is the sensor's, and then as long as the sensor has borne
        the filter out before. Else the filter has drifted, or its own covariance is wrong.
        """
        g = self._memory(s)
        if g["accepted_ns"] == NEVER:
            return 0
        interval_ns = stamp_ns - int(g["accepted_ns"])
        # Whether there was a step during an outage or a gap is unknown.
        seen = interval_ns <= LEAST_PATIENCE_NS and not self._has_gap(s)
        step = now.innovation - g["left"][: self._model.rows]
        if seen and self._step_nis(s, step, interval_ns, now.R) > self._limits[now.rows]:
            return int(g["trusted_for"])
        return min(LEAST_PATIENCE_NS, int(g["trusted_for"]))

    def _has_gap(self, s: State) -> bool:
        """Whether samples are missing since the last accepted measurement."""
        channels = s["channels"]
        open_ns = s["nav"]["time_ns"] - channels["imu_ns"]
        closed = channels["gap_ns"] > self._memory(s)["accepted_ns"]
        return bool(closed or open_ns > self._constants["gap_ns"])

    def _wanders(self, s: State, stamp_ns: int, now: Innovated) -> bool:
        """Whether the innovations wander: then it is the filter that does.

        A lasting error of the sensor would repeat itself, and outliers would be as far from each
        other as from the truth. Innovations wander by steps that the IMU missed, or by a drift
        since the first of them that is too unlikely beside a fault of the sensor: one error of the
        filter, as unlikely as the first innovation, explains both.
        """
        g, m, innovation = self._memory(s), self._model.rows, now.innovation
        step = innovation - g["rejected"][:m]
        small = np.hypot.reduce(step) < np.hypot.reduce(innovation) / 2.0  # cannot overflow
        if not small:
            return False
        drift = innovation - g["first"][:m]
        since_ns = stamp_ns - int(g["rejected_from_ns"])
        surprise = self._step_nis(s, drift, since_ns, now.R) - len(drift)
        limit = self._limits[now.rows]
        drifts = g["first_nis"] < limit + surprise
        step_ns = stamp_ns - int(g["rejected_ns"])
        if not drifts and self._step_nis(s, step, step_ns, now.R) < limit:
            return False
        again = g["wandered_ns"] != NEVER and stamp_ns - g["wandered_ns"] <= LEAST_PATIENCE_NS
        g["wandered_ns"] = stamp_ns
        return bool(again)

    def _recover(self, s: State, stamp_ns: int, now: Innovated) -> tuple[bool, str]:
        """Reject, but not for ever: inflate the covariance, then restart from the measurement.

        A filter that nothing has borne out yet, or whose NIS say that it is too sure of itself, has
        no patience: it rejects once.
        """
        g, m = self._memory(s), self._model.rows
        if g["rejections"] == 0:
            g["rejected_from_ns"] = g["rejected_ns"] = stamp_ns
            g["patient_for"] = self._patience(s, stamp_ns, now)
            g["first"][:m], g["first_nis"] = now.innovation, now.nis
        since_ns = stamp_ns - int(g["rejected_from_ns"])
        if g["rejections"] and self._wanders(s, stamp_ns, now):
            g["patient_for"] = min(int(g["patient_for"]), since_ns)
        before_ns = int(g["rejected_ns"]) - int(g["rejected_from_ns"])
        inflated = g["rejections"] > 0 and before_ns >= g["patient_for"]
        g["rejections"] += 1
        g["rejected"][:m], g["rejected_ns"] = now.innovation, stamp_ns
        # An IMU that is in doubt itself has no patience to ask for.
        doubted = in_doubt(s)
        if doubted or (not inflated and since_ns >= g["patient_for"]):
            # A channel that is in doubt has its own explanation.
            known = g["accepted_ns"] != NEVER and stamp_ns > g["accepted_ns"] and not doubted
            seconds = (stamp_ns - int(g["accepted_ns"])) / NS if known else None
            self._model.inflate(s, now.innovation, seconds)
            g["trusted_for"] = 0
            s["counters"]["inflations"] += 1
        if doubted or not inflated or since_ns < 2 * g["patient_for"]:
            return False, "gate"
        self._model.restart(s, now.innovation, now.R)
        g["left"] = 0.0
        self._bear_out(s, stamp_ns)
        s["counters"]["restarts"] += 1
        return True, "restarted"


def _nis_limit(m: int) -> float:
    """Limit of the running mean of the NIS of m rows; 7.0 for three.

    An exponential mean of memory N has the variance of chi-square over 2 N - 1, so it is as a
    chi-square of (2 N - 1) m degrees of freedom, scaled to the mean m.
    """
    count = 2.0 * NIS_MEMORY - 1.0
    return 2.0 * float(gammainccinv(count * m / 2.0, NIS_TAIL)) / count


def _trust_sensor(g: State) -> None:
    g["rejections"] = 0
    g["rejected_from_ns"] = g["rejected_ns"] = g["wandered_ns"] = g["fault_ns"] = NEVER
