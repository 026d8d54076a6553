"""Which measurements are used: a chi-square gate that neither locks out nor gives in at once.

One `Gate` for each kind of measurement, with one memory in the state record (state.py). It knows m
rows; what the measurement tells of is the model's business. The rules are derived in
docs/explanation/filter.md.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import expit, gammaincinv

from insdvl.arrays import Array
from insdvl.navigation import coordinates, kalman
from insdvl.navigation.channels import in_doubt
from insdvl.navigation.error_state import ATTITUDE, POSITION, VELOCITY
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.rotation import cross_matrix
from insdvl.navigation.kalman import Innovated
from insdvl.navigation.measurements.base import SensorModel, Vehicle
from insdvl.navigation.process_noise import shown
from insdvl.navigation.state import NEVER, State
from insdvl.parameters.declaration import parameter

#: A measurement whose NIS is so many times the gate's limit is surely a fault of the sensor.
FAULT = 1.5
#: A trusted filter may reject for so long [ns] what need not be a fault of the sensor; a longer
#: interval between measurements bears nothing out; two steps farther apart are no drift.
LEAST_PATIENCE_NS = 5 * NS
#: Whether a sensor has jumped.
STEP, NO_STEP, UNKNOWN = range(3)
#: A step of the IMU explains an innovation to within this part of it.
LOOSELY = 0.2
#: Largest step that one sigma takes for possible [rad]; where it is a velocity, all of it is seen.
LARGEST_STEP = 1.0


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
        vehicle: That carries it.
    """

    def __init__(
        self,
        parameters: GateParameters,
        name: str,
        model: SensorModel[Any],
        vehicle: Vehicle,
    ) -> None:
        self._name = name
        self._model = model
        self._vehicle = vehicle
        m = model.rows
        self._limit = (
            2.0 * float(gammaincinv(m / 2.0, parameters.probability))
            if parameters.enabled
            else np.inf
        )
        self._patience_ns = round(parameters.max_rejection_time * NS)

    def start(self, s: State) -> None:
        """Nothing has borne the filter out yet."""
        g = self._memory(s)
        g["trusted_for"], g["doubt_until_ns"], g["gave_in_ns"] = 0, NEVER, NEVER
        g["claim"] = 0.0
        _trust_sensor(g)

    def _memory(self, s: State) -> State:
        return s["gate"][self._name]

    def doubted(self, s: State, stamp_ns: int, R: Array) -> Array:
        """Covariance (m, m) of the noise, with the error that the sensor may have at a stamp."""
        g = self._memory(s)
        if stamp_ns < g["doubt_until_ns"]:
            R = R + g["doubt"] ** 2 * np.eye(len(R))
        return R

    def _takes_back(self, s: State, stamp_ns: int, now: Innovated) -> bool:
        """Whether a sensor that the filter gave in to jumps back to where it was before.

        The IMU has seen neither jump. One fault of the sensor explains both.
        """
        g, m = self._memory(s), self._model.rows
        claim = g["claim"][:m]
        step = now.innovation - g["left"][:m]
        return bool(step @ claim < -0.5 * claim @ claim) and self._step(s, stamp_ns, now) == STEP

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
        g, m = self._memory(s), self._model.rows
        if stamp_ns < g["doubt_until_ns"]:
            R = now.R - g["doubt"] ** 2 * np.eye(m)
            sure = kalman.innovate(s["nav"]["P"], now.innovation, now.H, R)
            if self._takes_back(s, stamp_ns, sure):
                g["doubt_until_ns"], now = NEVER, sure
        fair = self._fair(s, now)
        if fair.nis > self._limit and self._explains(s, stamp_ns, fair):
            now = kalman.innovate(s["nav"]["P"], now.innovation, now.H, now.R)
            fair = self._fair(s, now)
        goes_on = False
        probability = self._fault_probability(s, stamp_ns, fair)
        if probability > 0.0:
            # With an error smaller than the filter's own sigma it still knows more than the filter.
            error = np.sqrt(probability) * g["first"][:m]
            goes_on = probability > 0.5 and bool(error @ error > np.trace(fair.S - fair.R))
            if not goes_on:
                R = now.R + np.outer(error, error)
                now = kalman.innovate(s["nav"]["P"], now.innovation, now.H, R)
                fair = self._fair(s, now)
                if probability > 0.5:
                    g["doubt"] = np.linalg.norm(error)
                    g["doubt_until_ns"] = g["rejected_from_ns"] + g["patient_for"]
        if not goes_on and not fair.nis > self._limit:
            first = g["first"][:m]
            if g["rejected_from_ns"] != NEVER and now.innovation @ first > 0.5 * first @ first:
                g["claim"][:m] = first
            return now, True, ""
        if not goes_on and self._is_mild(s, stamp_ns, fair):
            if fair.nis > FAULT * self._limit:
                self._model.inflate(s, now.innovation, (stamp_ns - int(g["accepted_ns"])) / NS)
                s["counters"]["inflations"] += 1
                return kalman.innovate(s["nav"]["P"], now.innovation, now.H, now.R), True, ""
            R = now.R + (fair.nis / self._limit - 1.0) * fair.S
            return kalman.innovate(s["nav"]["P"], now.innovation, now.H, R), True, ""
        if goes_on or fair.nis > FAULT * self._limit:
            g["fault"][:m], g["fault_ns"] = now.innovation, stamp_ns
        return now, *self._recover(s, stamp_ns, fair)

    def _is_mild(self, s: State, stamp_ns: int, fair: Innovated) -> bool:
        """Whether nothing says that the sensor is at fault: a first misfit, and small or no step.

        It is used with a noise that brings its NIS to the limit.
        """
        g = self._memory(s)
        if g["rejected_from_ns"] != NEVER or in_doubt(s):
            return False
        return fair.nis <= FAULT * self._limit or self._step(s, stamp_ns, fair) == NO_STEP

    def _fair(self, s: State, now: Innovated) -> Innovated:
        """The same against a covariance whose process noise is never below what the IMU shows."""
        if not s["noise"]["excess"].any():
            return now
        P = shown.covariance(s, now.H.shape[1])
        return kalman.innovate(P, now.innovation, now.H, now.R)

    def _explains(self, s: State, stamp_ns: int, fair: Innovated) -> bool:
        """Whether a step of the IMU explains the misfit: then that is what is doubted.

        A sample that left its neighbours was believed since the next one agreed with it. If it was
        wrong all the same, it has turned the state along the axis of its channel: by how much the
        measurement tells.
        """
        g, channels = self._memory(s), s["channels"]
        stepped = np.flatnonzero(channels["step_ns"] > max(int(g["accepted_ns"]), 0))
        if not stepped.size:
            return False
        n, C_n_i = fair.H.shape[1], s["nav"]["C_n_b"] @ self._vehicle.C_b_i
        nu = np.linalg.norm(fair.innovation)
        columns = [LOOSELY * nu * np.eye(n)[:, VELOCITY]]  # the vehicle has moved since then
        for i in stepped:
            impulses, axis = self._impulses(s, int(i), stamp_ns, n), C_n_i[:, i % 3]
            seen = np.linalg.norm(fair.H @ impulses @ axis)
            size = nu / seen if nu < LARGEST_STEP * seen else LARGEST_STEP
            # And turned.
            columns.append(size * impulses @ np.column_stack([axis, LOOSELY * np.eye(3)]))
        A = np.concatenate(columns, axis=1)
        R = fair.R + (fair.H @ A) @ (fair.H @ A).T
        if kalman.innovate(shown.covariance(s, n), fair.innovation, fair.H, R).nis > self._limit:
            return False
        s["nav"]["P"][:n, :n] += A @ A.T
        s["counters"]["inflations"] += 1
        return True

    def _impulses(self, s: State, i: int, stamp_ns: int, n: int) -> Array:
        """Error state (n, 3) at a stamp by unit impulses of a channel's sensor about NED's axes."""
        nav, vehicle = s["nav"], self._vehicle
        A = np.zeros((n, 3))
        if i < 3:
            A[VELOCITY] = np.eye(3)
            return A
        A[ATTITUDE] = np.eye(3)
        seconds = (stamp_ns - int(s["channels"]["step_ns"][i])) / NS
        A[VELOCITY] = seconds * cross_matrix(vehicle.workspace[0]["g_n"])
        if vehicle.invariant:
            A[VELOCITY] += cross_matrix(nav["v_n"])
        # In metres the position stays.
        A[POSITION] = coordinates.turns_position(s, invariant=vehicle.invariant)
        return A

    def accept(self, s: State, stamp_ns: int, left: Array) -> None:
        """A measurement has corrected the state.

        Args:
            s: State, corrected.
            stamp_ns: Of the measurement.
            left: (m,) innovation that the correction left.
        """
        self._memory(s)["left"][: len(left)] = left
        self._bear_out(s, stamp_ns)

    def _bear_out(self, s: State, stamp_ns: int) -> None:
        g = self._memory(s)
        if g["accepted_ns"] != NEVER:
            since_ns = stamp_ns - int(g["accepted_ns"])
            steady = since_ns <= LEAST_PATIENCE_NS and g["rejected_from_ns"] == NEVER
            # What was contradicted, or not looked at, counts double against the filter.
            trust_ns = int(g["trusted_for"]) + (since_ns if steady else -2 * since_ns)
            settled = stamp_ns >= g["doubt_until_ns"] and not in_doubt(s)
            g["trusted_for"] = min(max(trust_ns, 0), self._patience_ns) if settled else 0
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
        S_step = self._step_covariance(s, stamp_ns - int(g["fault_ns"]), now)
        step = now.innovation - g["fault"][: self._model.rows]
        of_fault = step @ np.linalg.solve(S_step, step) + np.linalg.slogdet(S_step)[1]
        of_good = now.nis + np.linalg.slogdet(now.S)[1]
        return float(expit((of_good - of_fault) / 2.0))

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
        return STEP if step @ np.linalg.solve(S_step, step) > self._limit else NO_STEP

    def _has_gap(self, s: State) -> bool:
        """Whether samples are missing since the last accepted measurement."""
        channels = s["channels"]
        open_ns = s["nav"]["time_ns"] - channels["imu_ns"]
        closed = channels["gap_ns"] > self._memory(s)["accepted_ns"]
        return bool(closed or open_ns > self._vehicle.constants[0]["gap_ns"])

    def _recover(self, s: State, stamp_ns: int, now: Innovated) -> tuple[bool, str]:
        """Reject, but not for ever: give in to the sensor, then restart from it."""
        g, m = self._memory(s), self._model.rows
        if g["rejected_from_ns"] == NEVER:
            g["rejected_from_ns"], g["first"][:m] = stamp_ns, now.innovation
            g["steps"] = self._step(s, stamp_ns, now) == STEP
            lasting = g["steps"] and not self._takes_back(s, stamp_ns, now)
            most_ns = self._patience_ns if lasting else LEAST_PATIENCE_NS
            g["patient_for"] = min(int(g["trusted_for"]), most_ns)
        since_ns = stamp_ns - int(g["rejected_from_ns"])
        if in_doubt(s):
            # An IMU that is in doubt has no patience to ask for, and its own explanation.
            self._model.inflate(s, now.innovation, None)
            g["trusted_for"] = 0
            s["counters"]["inflations"] += 1
        elif since_ns >= g["patient_for"]:
            if g["gave_in_ns"] < g["rejected_from_ns"]:
                self._give_in(s, stamp_ns, now)
            elif since_ns >= 2 * g["patient_for"]:
                self._model.restart(s, now.innovation, now.R)
                g["left"] = 0.0
                self._bear_out(s, stamp_ns)
                s["counters"]["restarts"] += 1
                return True, "restarted"
        return False, "gate"

    def _give_in(self, s: State, stamp_ns: int, now: Innovated) -> None:
        """Doubt the state by as much as the innovation, and what contradicts it as well.

        A sensor that was trusted and has jumped is one of two claims, as is one that the filter
        gave in to a moment ago. Then its error is as likely as the filter's, and lasts: for as long
        again the measurements together weigh as one.
        """
        g, m = self._memory(s), self._model.rows
        known = not g["steps"] and stamp_ns > g["accepted_ns"] > NEVER
        self._model.inflate(
            s, now.innovation, (stamp_ns - int(g["accepted_ns"])) / NS if known else None
        )
        claim = g["claim"][:m]
        back = claim @ now.innovation < -0.5 * claim @ claim
        again = not back and stamp_ns - int(g["gave_in_ns"]) <= 2 * self._patience_ns
        if again or (g["steps"] and not back):
            count = 1.0
            if g["patient_for"] > LEAST_PATIENCE_NS and not again:
                count = max(self._patience_ns / (stamp_ns - int(g["judged_ns"])), 1.0)
            g["doubt"] = np.sqrt(count) * np.linalg.norm(now.innovation)
            g["doubt_until_ns"] = stamp_ns + self._patience_ns
        claim[:] = 0.0 if back or again else now.innovation
        g["trusted_for"], g["gave_in_ns"] = 0, stamp_ns
        s["counters"]["inflations"] += 1


def _trust_sensor(g: State) -> None:
    g["rejected_from_ns"] = g["fault_ns"] = NEVER
