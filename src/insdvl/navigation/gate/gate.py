"""A chi-square gate that neither locks out nor gives in at once.

One `Gate` for each kind of measurement, with one memory in the state record (state/). It knows m
rows; what the measurement tells of is the model's business. A measurement that nothing speaks
against is judged in ordinary.py; of all others a misfit is put down, in this order, to

1. noise that the filter is not told, where the IMU itself shows it (process_noise/shown.py);
2. a bad sample of the IMU (imu_step.py);
3. a drift of the filter, if the sensor has not jumped: used, softly or with a larger covariance;
4. the sensor: rejected, and for longer the longer it has agreed before. Then the filter gives in,
   and the sensor stays in doubt until it has kept to its claim, or takes it back.

The rules are derived in docs/explanation/filter.md.
"""

from typing import Any

import numpy as np

from insdvl.arrays import Array, Records
from insdvl.navigation import kalman
from insdvl.navigation.channels import in_doubt
from insdvl.navigation.error_state import VELOCITY
from insdvl.navigation.events import NS, Measurement
from insdvl.navigation.gate import imu_step, ordinary
from insdvl.navigation.gate.chi_square import exceeded
from insdvl.navigation.gate.ordinary import LEAST_PATIENCE_NS, RETURNS
from insdvl.navigation.gate.parameters import GateParameters
from insdvl.navigation.kalman import Innovated
from insdvl.navigation.measurements.base import Linearised, SensorModel, Vehicle
from insdvl.navigation.process_noise import shown
from insdvl.navigation.state.fields import NEVER, State

#: A measurement whose NIS is so many times the gate's limit is surely no chance.
FAULT = 1.5

#: Whether a sensor has jumped, against the last accepted measurement and by the IMU.
STEP, NO_STEP, UNKNOWN = range(3)

#: In this time [ns] the doubt of a sensor halves that a filter without trust has given in to.
HALF_LIFE_NS = 10 * NS


class Gate:
    """The gate of one kind of measurement.

    Args:
        parameters: Of the gate.
        name: Of the measurement.
        model: Of its sensor.
        vehicle: That carries it.
    """

    def __init__(
        self, parameters: GateParameters, name: str, model: SensorModel[Any], vehicle: Vehicle
    ) -> None:
        self._name = name
        self._model = model
        self._vehicle = vehicle
        #: By the number of rows that were measured.
        self._limits = np.full(model.rows + 1, np.inf)
        if parameters.enabled:
            tail = 1.0 - parameters.probability
            self._limits[1:] = [exceeded(m, tail) for m in range(1, model.rows + 1)]
        self._patience_ns = round(parameters.max_rejection_time * NS)

    def start(self, s: State) -> None:
        """Nothing has borne the filter out yet."""
        g = self._memory(s)
        g["trusted_for"], g["drifts"], g["claim"], g["left"] = 0, 0, 0.0, 0.0
        g["accepted_ns"] = g["doubt_from_ns"] = g["gave_in_ns"] = NEVER
        _trust_sensor(g)

    def _memory(self, s: State) -> State:
        return s["gate"][self._name]

    def take_in(
        self, state: Records, event: Measurement, w_ib_b: Array, share: Array
    ) -> tuple[Array, Array, float] | None:
        """Judge and use an ordinary measurement at once, see `SensorModel.take_in`."""
        memory, limits = state["gate"][self._name], self._limits
        return self._model.take_in(state, memory, event, w_ib_b, share, limits, self._patience_ns)

    def meet(self, state: Records, stamp_ns: int, linearised: Linearised) -> tuple[Innovated, bool]:
        """Compare a measurement with its prediction, and use it if nothing speaks against it.

        Args:
            state: (1,) record at the measurement.
            stamp_ns: Of the measurement.
            linearised: The measurement.

        Returns:
            The measurement against its prediction, with the error that the sensor may have in R,
            and whether it is used; otherwise, with a NIS that is finite, `judge` decides.
        """
        memory, constants = state["gate"][self._name], self._vehicle.constants
        z_minus_h, H, own = linearised
        R, S, K = np.empty(own.shape), np.empty(own.shape), np.empty(H.shape[::-1])
        nis, rows, used = ordinary.is_ordinary(
            state, memory, constants, stamp_ns, z_minus_h, H, own, self._limits, R, S, K
        )
        return Innovated(z_minus_h, H, R, S, K, nis, rows), used

    def judge(
        self, state: Records, stamp_ns: int, now: Innovated, R: Array
    ) -> tuple[Innovated, bool, str]:
        """Decide on a measurement; the covariance may be inflated, or the state restarted.

        Args:
            state: (1,) record at the measurement.
            stamp_ns: Of the measurement.
            now: The measurement against its prediction, see `meet`.
            R: (m, m) covariance of its own noise.

        Returns:
            The same, with the error that it may have in R; whether it is used; and the reason:
            empty, ``gate``, or ``restarted`` where the state was set from it.
        """
        s = state[0]
        g, m, limit = self._memory(s), self._model.rows, float(self._limits[now.rows])
        now = self._take_back(s, stamp_ns, now, R)
        fair = self._fair(s, now)
        if fair.nis > limit and self._imu_explains(s, stamp_ns, fair, limit):
            now = self._again(s, now, now.R)
            fair = self._fair(s, now)
        goes_on = False
        probability = self._fault_probability(s, stamp_ns, fair)
        if probability > 0.0:
            # With an error smaller than the filter's own sigma it still knows more than the filter.
            error = np.sqrt(probability) * g["first"][:m]
            goes_on = probability > 0.5 and bool(error @ error > np.trace(fair.S - fair.R))
            if not goes_on:
                now = self._again(s, now, now.R + np.outer(error, error))
                fair = self._fair(s, now)
                if probability > 0.5:
                    error_size, from_ns = float(np.linalg.norm(error)), int(g["rejected_from_ns"])
                    _doubt(g, error_size, from_ns, int(g["patient_for"]))
        if not goes_on:
            if not fair.nis > limit:
                g["drifts"] = 0
                rejections = int(g["rejected_from_ns"]), int(g["gave_in_ns"])
                ordinary.note_claim(g["claim"], g["first"], *rejections, now.innovation)
                return now, True, ""
            if not self._is_fault(s, stamp_ns, fair, limit):
                return self._with_drift(s, stamp_ns, now, fair, limit), True, ""
        if goes_on or fair.nis > FAULT * limit:
            g["fault"][:m], g["fault_ns"] = now.innovation, stamp_ns
        return now, *self._reject(state, stamp_ns, fair)

    def accept(self, state: Records, stamp_ns: int, H: Array, K: Array, left: Array) -> None:
        """A measurement has corrected the state.

        Args:
            state: (1,) record, corrected.
            stamp_ns: Of the measurement.
            H: (m, n) Jacobian at the prediction.
            K: (n, m) gain.
            left: (m,) innovation that the correction left.
        """
        memory, tells = state["gate"][self._name], self._model.tells_velocity
        of_update = stamp_ns, H, K, left, self._patience_ns, tells
        ordinary.accept(state, memory, self._vehicle.constants, *of_update)

    # ---------------------------------------------------------------- the filter, or its IMU

    @staticmethod
    def _again(s: State, now: Innovated, R: Array) -> Innovated:
        """The same with another R, against P as it is now."""
        return kalman.innovate(s["nav"]["P"], now.innovation, now.H, R)

    @staticmethod
    def _fair(s: State, now: Innovated) -> Innovated:
        """The same against a covariance whose process noise is never below what the IMU shows."""
        if not s["noise"]["excess"].any():
            return now
        P = shown.covariance(s, now.H)
        return kalman.innovate(P, now.innovation, now.H, now.R)

    def _imu_explains(self, s: State, stamp_ns: int, fair: Innovated, limit: float) -> bool:
        accepted_ns = int(self._memory(s)["accepted_ns"])
        if not imu_step.explains(s, self._vehicle, accepted_ns, stamp_ns, fair, limit):
            return False
        self._memory(s)["inflations"] += 1
        return True

    def _with_drift(
        self, s: State, stamp_ns: int, now: Innovated, fair: Innovated, limit: float
    ) -> Innovated:
        """A misfit that is no fault of the sensor: with a gain that is smaller by NIS over limit.

        A second one in a row far beyond the limit tells that the filter has drifted: its covariance
        is inflated.
        """
        g = self._memory(s)
        again, g["drifts"] = bool(g["drifts"]), fair.nis > FAULT * limit
        if not (again and g["drifts"]):
            return self._again(s, now, now.R + (fair.nis / limit - 1.0) * now.S)
        self._inflate(s, now, _drifted_for(g, stamp_ns))
        return self._again(s, now, now.R)

    def _inflate(self, s: State, now: Innovated, seconds: float | None) -> None:
        """Doubt the state, see `SensorModel.inflate`; a filter in doubt is not trusted."""
        self._model.inflate(s, now.innovation, seconds)
        g = self._memory(s)
        g["trusted_for"] = 0
        g["inflations"] += 1

    # ---------------------------------------------------------------- the sensor

    def _is_fault(self, s: State, stamp_ns: int, fair: Innovated, limit: float) -> bool:
        """Whether a misfit is put down to the sensor: not the first, if small or without a step."""
        if self._memory(s)["rejected_from_ns"] != NEVER or in_doubt(s):
            return True
        return fair.nis > FAULT * limit and self._step(s, stamp_ns, fair) != NO_STEP

    def _fault_probability(self, s: State, stamp_ns: int, now: Innovated) -> float:
        """Probability that this measurement repeats the previous error rather than being good.

        The uncertainty grows while the sensor is rejected, until what was an error fits as well.
        But a lasting error repeats the last innovation, to within the noise of the sensor and what
        the IMU may have drifted in between. The likelihoods of the two explanations are compared.
        """
        g = self._memory(s)
        known = int(g["fault_ns"]), int(g["rejected_from_ns"]), int(g["patient_for"])
        if not ordinary.may_go_on(*known, in_doubt(s), stamp_ns):
            return 0.0
        S_step = self._step_covariance(s, stamp_ns - int(g["fault_ns"]), now)
        step = now.innovation - g["fault"][: self._model.rows]
        of_fault = step @ np.linalg.solve(S_step, step) + np.linalg.slogdet(S_step)[1]
        of_good = now.nis + np.linalg.slogdet(now.S)[1]
        return float(np.exp(-np.logaddexp(0.0, (of_fault - of_good) / 2.0)))

    def _step_covariance(self, s: State, interval_ns: int, now: Innovated) -> Array:
        """Covariance (m, m) of the step between two innovations, nothing corrected in between.

        That of the noise of two measurements, and of the IMU's drift over the interval [ns].
        """
        seconds, H_v = interval_ns / NS, now.H[:, VELOCITY]
        drift = self._model.drift(s, seconds)
        drift = drift + H_v @ shown.drift(s, self._vehicle, seconds) @ H_v.T
        # The last term, far below all noise, gives an R that is singular an inverse.
        return 2.0 * now.R + drift + 1e-9 * np.trace(now.R) * np.eye(len(now.R))

    def _step(self, s: State, stamp_ns: int, now: Innovated) -> int:
        """Whether the sensor has jumped: the IMU has not seen the step since the last accepted.

        Otherwise the filter has drifted. In an outage or a gap there may have been a step.
        """
        g = self._memory(s)
        interval_ns = stamp_ns - int(g["accepted_ns"])
        if g["accepted_ns"] == NEVER or interval_ns > LEAST_PATIENCE_NS or self._has_gap(s):
            return UNKNOWN
        step = now.innovation - g["left"][: self._model.rows]
        S_step = self._step_covariance(s, interval_ns, now)
        return STEP if step @ np.linalg.solve(S_step, step) > self._limits[now.rows] else NO_STEP

    def _has_gap(self, s: State) -> bool:
        """Whether samples are missing since the last accepted measurement."""
        channels = s["channels"]
        open_ns = s["nav"]["time_ns"] - channels["imu_ns"]
        closed = channels["gap_ns"] > self._memory(s)["accepted_ns"]
        return bool(closed or open_ns > self._vehicle.constants[0]["gap_ns"])

    def _reject(self, state: Records, stamp_ns: int, now: Innovated) -> tuple[bool, str]:
        """Reject, but not for ever: give in to the sensor, then restart from it."""
        s = state[0]
        g, m = self._memory(s), self._model.rows
        if g["rejected_from_ns"] == NEVER:
            g["rejected_from_ns"], g["first"][:m] = stamp_ns, now.innovation
            g["steps"] = self._step(s, stamp_ns, now) == STEP
            lasting = g["steps"] and not self._returns(s, stamp_ns, now)
            most_ns = self._patience_ns if lasting else LEAST_PATIENCE_NS
            g["patient_for"] = min(int(g["trusted_for"]), most_ns)
        since_ns = stamp_ns - int(g["rejected_from_ns"])
        if in_doubt(s):
            # An IMU that is in doubt has no patience to ask for, and its own explanation.
            self._inflate(s, now, None)
        elif since_ns >= g["patient_for"]:
            if g["gave_in_ns"] < g["rejected_from_ns"]:
                self._give_in(s, stamp_ns, now)
            elif since_ns >= 2 * g["patient_for"]:
                self._model.restart(s, now.innovation, now.R)
                g["left"] = 0.0
                memory, tells = state["gate"][self._name], self._model.tells_velocity
                ordinary.bear_out(state, memory, stamp_ns, self._patience_ns, tells)
                g["restarts"] += 1
                return True, "restarted"
        return False, "gate"

    def _give_in(self, s: State, stamp_ns: int, now: Innovated) -> None:
        """Doubt the state by as much as the innovation, and the sensor as well if it has jumped.

        Then its error is as likely as the filter's. If the filter was trusted, that error would
        last: all measurements of the doubt weigh as a single one. If the filter was not, little
        speaks for it, and the doubt fades; where the sensor alternates it is renewed, and the state
        stays between its values. If the filter was trusted and gave in a moment ago, what it has
        believed since may have turned it: its tilt is doubted instead of the sensor.
        """
        g, m = self._memory(s), self._model.rows
        claim, trusted = g["claim"][:m], g["patient_for"] > LEAST_PATIENCE_NS
        back = claim @ now.innovation < -RETURNS * claim @ claim
        again = not back and stamp_ns - int(g["gave_in_ns"]) <= 2 * self._patience_ns
        contested = not back and (not trusted if again else bool(g["steps"]))
        known = stamp_ns > g["accepted_ns"] > NEVER and (not g["steps"] or (again and trusted))
        self._inflate(s, now, _drifted_for(g, stamp_ns) if known else None)
        if contested:
            count = 1.0
            if trusted:
                count = max(self._patience_ns / (stamp_ns - int(g["judged_ns"])), 1.0)
            error = np.sqrt(count) * np.linalg.norm(now.innovation)
            _doubt(g, error, stamp_ns, self._patience_ns, 0 if trusted else HALF_LIFE_NS)
        claim[:] = 0.0 if back or again else now.innovation
        g["gave_in_ns"] = stamp_ns

    # ---------------------------------------------------------------- what a sensor claims

    def _returns(self, s: State, stamp_ns: int, now: Innovated) -> bool:
        """Whether a sensor that the filter gave in to jumps back to where it was before.

        The IMU has seen neither jump. One fault of the sensor explains both. While nothing has been
        accepted since, the claim has corrected nothing, and back is where the last accepted was.
        """
        g, m = self._memory(s), self._model.rows
        believed = g["accepted_ns"] >= g["gave_in_ns"]
        claim = g["claim"][:m]
        step = now.innovation - (g["left"][:m] if believed else claim)
        returns = bool(step @ claim < -RETURNS * claim @ claim)
        return returns and self._step(s, stamp_ns, now) == (STEP if believed else NO_STEP)

    def _take_back(self, s: State, stamp_ns: int, now: Innovated, R: Array) -> Innovated:
        """The measurement without the doubt, if the sensor takes back what it is doubted for."""
        g = self._memory(s)
        if not _is_doubted(g, stamp_ns):
            return now
        sure = self._again(s, now, R)
        if not self._returns(s, stamp_ns, sure):
            return now
        g["doubt_from_ns"] = NEVER
        return sure


def _drifted_for(g: State, stamp_ns: int) -> float:
    """The time [s] in which the filter has drifted: since it last agreed, and no shorter than 5 s.

    From one measurement to the next only a tilt or a bias of absurd size makes a misfit. What does
    is older than that: the measurement before was a misfit too.
    """
    return max(stamp_ns - int(g["accepted_ns"]), LEAST_PATIENCE_NS) / NS


def _doubt(g: State, error: float, from_ns: int, lasts_ns: int, half_life_ns: int = 0) -> None:
    g["doubt"], g["doubt_half_life"] = error, half_life_ns
    g["doubt_from_ns"], g["doubt_for"] = from_ns, lasts_ns


def _is_doubted(g: State, stamp_ns: int) -> bool:
    return ordinary.is_doubted(int(g["doubt_from_ns"]), int(g["doubt_for"]), stamp_ns)


def _trust_sensor(g: State) -> None:
    g["rejected_from_ns"] = g["fault_ns"] = NEVER
