"""The error-state extended Kalman filter: predict with IMU samples, update with measurements.

A `Filter` holds what never changes; all that does is in a state record (state/), which its
methods advance in place. `timeline.fold.Fold` decides the order in which they are called.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from insdvl.arrays import Array, Records, Stamps, copy_records
from insdvl.navigation import algebra, channels, coordinates, error_state, kalman, map_to_odom
from insdvl.navigation.error_state import ATTITUDE, HORIZONTAL_POSITION
from insdvl.navigation.events import (
    NS,
    Imu,
    Initial,
    Measurement,
    Orientation,
    Origin,
    ProcessNoise,
    SensorNoise,
)
from insdvl.navigation.gate.gate import Gate
from insdvl.navigation.geometry.frames import CONVENTIONS, rotation_from_rpy
from insdvl.navigation.kalman import Innovated
from insdvl.navigation.measurement_noise import source
from insdvl.navigation.measurement_noise.source import InForce, MeasurementNoise
from insdvl.navigation.measurements import claims
from insdvl.navigation.measurements.base import SensorModel, Turn, Vehicle
from insdvl.navigation.measurements.report import UpdateReport
from insdvl.navigation.parameters import SENSORS, FilterParameters
from insdvl.navigation.prediction import predict
from insdvl.navigation.prediction.kept import Kept
from insdvl.navigation.process_noise import factor, shown, source_of
from insdvl.navigation.process_noise.factor import Factor, estimate
from insdvl.navigation.start import wrong_heading, zero_velocity
from insdvl.navigation.start.initial_state import Start, locate
from insdvl.navigation.state.fields import CORE, NEVER, State
from insdvl.navigation.state.layout import counters, layout
from insdvl.navigation.state.scratch import constants_type, workspace_type

#: Layout of the state record, the same for every filter.
LAYOUT = layout(
    tuple(SENSORS),
    sum(size for group in SENSORS.values() for size in group.ROOM.values()),
    {"dvl_noise": source.FIELDS, factor.GROUP: factor.FIELDS},
)
_NO_SAMPLES = np.empty((0, 6))
_HEADING = ATTITUDE.stop - 1


class Filter:
    """Predict and update on a state record.

    Args:
        parameters: Of the filter.

    Attributes:
        vehicle: Mounts, error state and memory that all parts share.
        n: Number of error states in use.
        C_b_i: (3, 3) rotation from IMU to base_link axes, forward-right-down.
        constants: (1,) record of what the kernels need to know, see `state.constants_type`.
        models: Of the sensors, by the names of their measurements.
        start: Of the state.
    """

    def __init__(self, parameters: FilterParameters) -> None:
        self.parameters = parameters
        blocks = [block for sensor in parameters.sensors.values() for block in sensor.blocks()]
        places, n = {}, CORE
        for block in blocks:
            places[block.name] = slice(n, n + len(block.std))
            n += len(block.std)
        self.n = n
        axes, imu = CONVENTIONS[parameters.frame_convention], parameters.imu
        self.constants = np.zeros(1, constants_type(LAYOUT.size))
        self._workspace = np.zeros(1, workspace_type(LAYOUT.size))
        self.C_b_i = axes.body_rotation(rotation_from_rpy(np.array(imu.mount)))
        self.vehicle = Vehicle(
            axes=axes,
            C_b_i=self.C_b_i,
            l_b_imu=axes.body @ np.array(imu.lever_arm),
            invariant=parameters.error_state == "invariant",
            n=n,
            blocks=places,
            gyroscope_bias_std=parameters.initial.gyroscope_bias_std,
            constants=self.constants,
            workspace=self._workspace,
        )
        self.start = Start(parameters.initial, parameters.origin, self.vehicle, blocks)
        self.process_noise = source_of(parameters.process_noise, self.vehicle)
        adapts = parameters.process_noise.adaptive_factor
        self._factor = Factor(parameters.process_noise, self.vehicle) if adapts else None
        self._fill_constants()
        c = self.constants[0]
        for block in blocks:
            at = self.vehicle.optional(block.name)
            c["variance"][at], c["decay"][at] = np.square(block.std), 1.0 / block.time_constant
        self.models: dict[str, SensorModel[Any]] = {}
        self._gates: dict[str, Gate] = {}
        self._noises: dict[str, MeasurementNoise] = {}
        self.configure(parameters)

    def configure(self, parameters: FilterParameters) -> None:
        """Use the settings of parameters (see settings.py) that are equal in everything else."""
        self.parameters = parameters
        for name, sensor in parameters.sensors.items():
            self.models[name] = sensor.model(self.vehicle)
            self._gates[name] = Gate(parameters.gate, name, self.models[name], self.vehicle)
        self._noises = {
            name: MeasurementNoise(name, model, round(parameters.q_timeout * NS))
            for name, model in self.models.items()
            if model.noise_source != source.NOMINAL
        }

    def noise_in_force(self, s: State, name: str) -> InForce | None:
        """The noise of a measurement in force, None where it is nominal, see `MeasurementNoise`."""
        noise = self._noises.get(name)
        return None if noise is None else noise.in_force(s)

    def _fill_constants(self) -> None:
        parameters, vehicle, c = self.parameters, self.vehicle, self.constants[0]
        noise, imu = parameters.process_noise, parameters.imu
        c["n"], c["invariant"], c["earth_rate"] = self.n, vehicle.invariant, parameters.earth_rate
        c["rate"] = imu.rate
        c["density"] = 1.0 / imu.rate if noise.convention == "per_sample" else 1.0
        c["eps_f"], c["eps_w"] = noise.accelerometer_bias_walk, noise.gyroscope_bias_walk
        c["Q_f_nominal"] = self.process_noise.Q_f_nominal
        c["Q_w_nominal"] = self.process_noise.Q_w_nominal
        c["q_timeout_ns"] = round(parameters.q_timeout * NS)
        c["window"] = self.process_noise.window
        c["literal"] = noise.adaptive_form == "literal"
        c["gap_ns"] = round(imu.max_gap * NS)
        c["gap_f"], c["gap_w"] = imu.gap_acceleration_std, imu.gap_rate_std
        ranges = np.repeat([imu.acceleration_range, imu.rate_range], 3)
        c["C_b_i"], c["frozen"] = self.C_b_i, imu.frozen_samples
        c["range"] = np.where(ranges > 0.0, ranges, np.inf)
        c["l_b_imu"] = vehicle.l_b_imu
        c["nav"], c["body"] = vehicle.axes.nav, vehicle.axes.body

    def empty(self) -> Records:
        """A record, in an array of length 1, to which nothing has happened."""
        state = LAYOUT.empty()
        self.process_noise.start(state[0])
        if self._factor is not None:
            self._factor.start(state[0])
        self.start.locate_from_parameters(state[0])
        return state

    def locate(self, state: Records, origin: Origin) -> None:
        """Odom's origin on the Earth becomes known; the first one counts."""
        locate(state[0], origin)

    def initialise(self, state: Records, initial: Initial, stamp_ns: int, w_ib_b: Array) -> None:
        """The state becomes `initial`, see `Start.initialise`."""
        again = state[0]["nav"]["initialised"]
        if self.start.initialise(state, initial, stamp_ns, w_ib_b):
            state[0]["counters"]["odom_resets"] += again
            self._begin(state[0])

    def await_start(self, state: Records, sample: Imu, reading: Array) -> None:
        """An uninitialised state sees a sample, and may start from it, see `Start.see`."""
        if self.start.see(state, sample, reading):
            self._begin(state[0])

    def _begin(self, s: State) -> None:
        """No measurement has borne the new state out yet, and nothing was learned from any."""
        map_to_odom.begin(s)
        wrong_heading.watch(s)
        self.process_noise.restart(s)
        if self._factor is not None:
            self._factor.restart(s)
        shown.restart(s)
        for noise in self._noises.values():
            noise.start(s)
        for gate in self._gates.values():
            gate.start(s)

    def predict_part(
        self,
        state: Records,
        sample_ns: int,
        f_b: Array,
        w_ib_b: Array,
        reading: Array,
        to_ns: int,
    ) -> None:
        """Advance to a stamp inside the interval of a sample, see `predict_samples`."""
        predict.predict_part(
            state, self._workspace, self.constants, sample_ns, f_b, w_ib_b, reading, to_ns
        )

    def predict_samples(
        self,
        state: Records,
        stamps_ns: Stamps,
        f_b: Array,
        w_ib_b: Array,
        readings: Array,
        first: int,
        last: int,
        kept: Kept,
    ) -> int:
        """Advance over the samples first <= k < last and keep what `kept` keeps of each state.

        It ends at a sample whose state has diverged.

        Args:
            state: (1,) record.
            stamps_ns: (N,) stamps of the samples.
            f_b: (N, 3) specific force [m/s^2], base_link axes.
            w_ib_b: (N, 3) angular rate [rad/s], base_link axes.
            readings: (N, 6) the same as the IMU has read them, in its axes: f, then w.
            first: Index of the first sample.
            last: Index behind the last sample.
            kept: Of N samples.

        Returns:
            The index of that sample; ``last`` where there is none.
        """
        diverged: int = predict.predict_samples(
            state,
            self._workspace,
            self.constants,
            stamps_ns,
            f_b,
            w_ib_b,
            readings,
            first,
            last,
            kept.every,
            kept.states,
            kept.numbers,
            kept.integers,
            kept.verdicts,
        )
        return diverged

    def give_up(self, state: Records) -> None:
        """A state that has diverged becomes one that has not started, as behind a reset.

        What does not come from it stays: the channels of the IMU, where odom lies, and the counts.
        """
        anew, old = self.empty(), state[0]
        new = anew[0]
        new["channels"] = old["channels"]
        new["nav"]["time_ns"] = old["channels"]["imu_ns"]
        for name in ("lat_0", "lon_0", "h_0"):
            new["nav"][name] = old["nav"][name]
        for (group, name), (before, _) in zip(
            counters(new).values(), counters(old).values(), strict=True
        ):
            group[name] = before[name]
        new["counters"]["diverged"] += 1
        new["counters"]["odom_resets"] += 1
        copy_records(state, anew)

    def receive_process_noise(self, state: Records, event: ProcessNoise) -> None:
        """The received Q is in effect from its stamp on."""
        self.process_noise.receive(state[0], event)
        if self._factor is not None:
            self._factor.told(state[0])

    def receive_sensor_noise(self, state: Records, event: SensorNoise) -> None:
        """The received R of a sensor whose noise is estimated is in effect from its stamp on."""
        if (noise := self._noises.get(event.of)) is not None:
            noise.receive(state[0], event)

    def covariance(self, states: Records) -> Array:
        """Covariance (..., n, n) of the error states in use, of records (...)."""
        return np.asarray(states["nav"]["P"][..., : self.n, : self.n])

    def turn_window_ns(self, event: Measurement) -> int:
        """Time before a measurement that its turn rate is taken from; 0 takes one sample."""
        return self.models[event.name].turn_window_ns

    def hear_orientation(self, state: Records, event: Orientation) -> None:
        """An IMU tells its attitude, which only a filter that has not started needs."""
        if not state[0]["nav"]["initialised"]:
            self.start.hear_orientation(state[0], event)

    def update(
        self,
        state: Records,
        event: Measurement,
        w_ib_b: Array,
        share: Array | float,
        samples: Callable[[], Array] = lambda: _NO_SAMPLES,
    ) -> UpdateReport | None:
        """Correct the state, which must be at the measurement's stamp.

        None where the measurement is left out, since it comes too soon behind the one before it.

        Args:
            state: (1,) record.
            event: The measurement.
            w_ib_b: (3,) angular rate at the stamp [rad/s], base_link axes.
            share: (3,) its variance, in units of that of one sample.
            samples: Gives those just before it (N, 6), f then w, base_link axes; only a measurement
                that claims a vehicle at rest asks for them.
        """
        s, model, gate = state[0], self.models[event.name], self._gates[event.name]
        memory, stamp_ns = state["gate"][event.name][0], event.stamp_ns
        if stamp_ns - int(memory["judged_ns"]) < model.interval_ns:
            return None
        reason, initialised = claims.refusal(memory, model, event), s["nav"]["initialised"]
        shares = np.empty(3)
        shares[:] = share
        if initialised and not reason and self._is_alone(s):
            taken = gate.take_in(state, event, w_ib_b, shares)
            if taken is not None:
                return UpdateReport(event.name, *taken, True, "")
        turn, linearised, at_rest = self._turn(state, w_ib_b, shares), None, False
        if not initialised:
            if not reason and (velocity := model.velocity(event, turn)) is not None:
                self.start.hear_velocity(s, stamp_ns, *velocity)
            if not reason and (attitude := model.attitude(event)) is not None:
                self.start.hear_attitude(s, stamp_ns, *attitude)
            reason = reason or "not_initialised"
        elif not reason or model.claims_rest(event):
            linearised = model.linearise(state, event, turn)
            if reason and zero_velocity.confirmed(s, self.vehicle, linearised, samples()):
                reason, at_rest = "", True
        if reason or linearised is None:
            nan = np.full((model.rows, model.rows), np.nan)
            return UpdateReport(event.name, nan[0], nan, np.nan, False, reason)
        for other in self._noises.values():
            other.carry(s)
        noise, nominal = None if at_rest else self._noises.get(event.name), linearised
        if noise is not None:
            linearised = noise.for_gate(s, event, nominal)
        now, accepted = gate.meet(state, stamp_ns, linearised)
        if not math.isfinite(now.nis):
            reason = "bad_covariance" if math.isnan(now.nis) else "not_finite"
            return self._report(event, now, False, reason)
        attitude = s["nav"]["C_n_b"].copy()
        was, used = map_to_odom.before(s, self.vehicle, absolute=model.absolute), now
        if noise is not None:
            now = noise.predicted(s, event, nominal)
        if not accepted:
            used, accepted, reason = gate.judge(state, stamp_ns, used, linearised.R)
        report = self._report(event, now, accepted, reason)
        if report.corrected:
            scaling = self._factor if model.tells_velocity else None
            learns = noise is not None or scaling is not None
            as_it_is = learns and np.array_equal(used.R, linearised.R) and not channels.in_doubt(s)
            if noise is not None and as_it_is:
                used = noise.learn(s, event, nominal, used)
            if scaling is not None:
                before = scaling.meet(s, stamp_ns, used, teaches=as_it_is and not at_rest)
                self._correct(state, event, turn, used)
                scaling.corrected(s, stamp_ns, before)
            elif self._factor is not None:
                before = estimate(s["nav"])
                self._correct(state, event, turn, used)
                self._factor.follow(s, before)
            else:
                self._correct(state, event, turn, used)
        for other in self._noises.values():
            other.follow(s, attitude)
        map_to_odom.moved(state, self.vehicle, was)
        memory["judged_ns"] = stamp_ns
        return report

    def _correct(self, state: Records, event: Measurement, turn: Turn, now: Innovated) -> None:
        s, model, stamp_ns = state[0], self.models[event.name], event.stamp_ns
        judged_ns = s["gate"][event.name]["judged_ns"]
        seconds = (stamp_ns - int(judged_ns)) / NS if judged_ns != NEVER else np.nan
        if model.tells_velocity:
            now = self.process_noise.before_correction(s, now, seconds)
        invariant = self.vehicle.invariant
        covers = invariant and self.parameters.earth_rate and model.angles
        heading = float(s["nav"]["P"][_HEADING, _HEADING]) if covers else 0.0
        K, left = kalman.correct(
            state,
            self.constants,
            now,
            lambda: model.linearise(state, event, turn),
            self._workspace,
            iterate=invariant,
        )
        if invariant and algebra.tells(now.H, HORIZONTAL_POSITION.start, HORIZONTAL_POSITION.stop):
            coordinates.move_reference(s)
        if covers:
            bias = self.parameters.initial.gyroscope_bias_std**2
            error_state.take_earth_rate_from_bias(s, heading, bias)
            wrong_heading.trust(s)
        if s["start"]["heading_watched"] and invariant and self.parameters.earth_rate:
            self.start.doubt_heading(s)
        self._gates[event.name].accept(state, stamp_ns, now.H, K, left)
        if model.tells_velocity:
            self.process_noise.after_correction(s, K, now.innovation, seconds)

    @staticmethod
    def _report(event: Measurement, now: Innovated, accepted: bool, reason: str) -> UpdateReport:
        S = now.S
        if now.rows < len(S):
            S = np.where(np.diag(~now.measured), np.inf, S)
        return UpdateReport(event.name, now.innovation, S, now.nis, accepted, reason)

    def _is_alone(self, s: State) -> bool:
        """Whether nothing but the state and its gate takes part in an update."""
        learns = self._noises or self.process_noise.adapts or self._factor is not None
        return not (learns or s["start"]["heading_watched"])

    def _turn(self, state: Records, w_ib_b: Array, share: Array) -> Turn:
        """The turn rate at a measurement, and what is not known of it."""
        covariance = np.empty((3, 3))
        if channels.turn_noise(state, self.constants, share, covariance):
            w_ib_b, unseen = channels.seen_rate(state[0], self.constants[0], w_ib_b)
            covariance = covariance + unseen
        return Turn(w_ib_b, covariance)
