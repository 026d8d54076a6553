"""The initial state and its covariance P0: as it is told, or found by a vehicle at rest."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from insdvl.arrays import Array, Records
from insdvl.kernels import kernel
from insdvl.navigation import channels, coordinates
from insdvl.navigation.error_state import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    GYROSCOPE_BIAS,
    POSITION,
    VELOCITY,
)
from insdvl.navigation.events import NS, Imu, Initial, Orientation, Origin
from insdvl.navigation.geometry import odom
from insdvl.navigation.geometry.earth import gravity, move
from insdvl.navigation.geometry.frames import rotation_from_rpy
from insdvl.navigation.geometry.rotation import cross_matrix
from insdvl.navigation.measurements.base import Block, Vehicle
from insdvl.navigation.prediction import strapdown
from insdvl.navigation.start import automatic, gyrocompass, wrong_heading
from insdvl.navigation.start.automatic import Automatic
from insdvl.navigation.start.parameters import InitialParameters, OriginParameters
from insdvl.navigation.start.rest import Attitude, noise_at_rest, window_of_block
from insdvl.navigation.state.fields import NEVER, State

#: What the mean specific force at rest may differ from gravity, as a fraction of it.
LEVEL_TOLERANCE = 0.05
#: Attitude and both biases, as neighbours.
_ATTITUDE_AND_BIASES = slice(ATTITUDE.start, GYROSCOPE_BIAS.stop)


@kernel
def _set_turn_rate(state: Records, workspace: Records, constants: Records, w_ib_b: Array) -> None:
    s = state[0]
    strapdown.turn_rate(s.nav.w_nb_b, s, workspace[0], constants[0], w_ib_b)


@kernel
def _watch(state: Records, constants: Records, sample_ns: int, reading: Array) -> None:
    channels.watch(state[0], constants[0], sample_ns, reading)


def locate(s: State, origin: Origin) -> None:
    """Odom's origin on the Earth becomes known; the first one counts."""
    nav = s["nav"]
    if np.isnan(nav["lat_0"]):
        nav["lat_0"], nav["lon_0"], nav["h_0"] = origin.lat, origin.lon, origin.h


def sample_variance_w(s: State, vehicle: Vehicle) -> Array:
    """Variance (3, 3) of one angular rate sample [(rad/s)^2], whatever Q's convention is."""
    c = vehicle.constants[0]
    return s["noise"]["Q_w"] * (c["density"] * c["rate"])


class Start:
    """Starts a state: on an initial state, from the parameters, or from what a sensor shows.

    Args:
        parameters: Of the initial state.
        origin: Where odom's origin is on the Earth.
        vehicle: What starts.
        blocks: Optional error states that are in use.
    """

    def __init__(
        self,
        parameters: InitialParameters,
        origin: OriginParameters,
        vehicle: Vehicle,
        blocks: Iterable[Block],
    ) -> None:
        self._parameters = parameters
        self._origin = origin
        self._vehicle = vehicle
        self._blocks = tuple(blocks)
        self._plan = gyrocompass.Plan(parameters.gyrocompass_time, parameters.heading_std)
        axes = vehicle.axes
        in_body = parameters.velocity_frame == "body"
        self._initial = Initial(
            stamp_ns=0,
            C_o_b=axes.attitude(rotation_from_rpy(np.array(parameters.rpy))),
            p_o=axes.nav @ np.array(parameters.position),
            v=(axes.body if in_body else axes.nav) @ np.array(parameters.velocity),
            velocity_frame=parameters.velocity_frame,
        )
        accelerometer = self._bias(parameters.accelerometer_bias)
        gyroscope = self._bias(parameters.gyroscope_bias)
        self._told_bias = np.concatenate([accelerometer, gyroscope])
        self._automatic = Automatic(
            parameters, self._initial, self._told_bias, vehicle.constants[0]
        )

    def locate_from_parameters(self, s: State) -> None:
        """Set the origin, where the parameters tell it."""
        origin = self._origin
        if origin.source == "parameters":
            locate(s, Origin(0, *origin.place.tolist()))

    def initialise(self, state: Records, initial: Initial, stamp_ns: int, w_ib_b: Array) -> bool:
        """The state becomes `initial`, its covariance P0 mapped to the model's coordinates.

        Without an origin there is no gravity to navigate with, and no place on the Earth; that is
        counted, and nothing starts. The same holds for a position that is no place at which the
        filter navigates.

        Args:
            state: (1,) record.
            initial: What it becomes.
            stamp_ns: When.
            w_ib_b: (3,) angular rate at that time [rad/s], base_link axes, for the IMU's lever arm.

        Returns:
            Whether the state is initialised now.
        """
        state[0]["start"]["compass"] = gyrocompass.UNDECIDED
        state[0]["start"]["heading_from"] = automatic.TOLD
        return self._begin(state, initial, stamp_ns, w_ib_b, None)

    def _begin(
        self,
        state: Records,
        initial: Initial,
        stamp_ns: int,
        w_ib_b: Array,
        found: Attitude | None,
    ) -> bool:
        """See `initialise`; an attitude that was found takes the place of the initial one."""
        s, vehicle, parameters = state[0], self._vehicle, self._parameters
        nav, imu = s["nav"], s["channels"]
        if found is not None and not found.is_finite:
            self._restart_levelling(s)
            return False
        if np.isnan(nav["lat_0"]):
            s["counters"]["without_origin"] += 1
            return False
        origin = np.array([nav["lat_0"], nav["lon_0"], nav["h_0"]])
        place = odom.place_of(initial.p_o, origin)
        if place is None:
            s["counters"]["off_the_map"] += 1
            return False
        J, turn = odom.jacobian(place, origin)
        to_n, J_inverse = turn.T, np.linalg.inv(J)
        C, l_b = to_n @ initial.C_o_b if found is None else found.C_n_b, vehicle.l_b_imu
        in_body = initial.velocity_frame == "body"
        nav["b_f"] = self._told_bias[:3]
        nav["b_w"] = self._told_bias[3:] if found is None else found.b_w
        nav["optional"] = 0.0
        nav["C_n_b"], nav["llh"], nav["llh_r"] = C, place, place
        move(nav["llh"], C @ l_b)
        nav["bend_n"] = 0.0
        nav["v_n"] = C @ initial.v if in_body else to_n @ initial.v
        _set_turn_rate(state, vehicle.workspace, vehicle.constants, w_ib_b - nav["b_w"])
        v_arm = C @ np.cross(nav["w_nb_b"], l_b)  # of the IMU against base_link
        nav["v_n"] += v_arm

        n = vehicle.n
        P = np.zeros((n, n))
        P[VELOCITY, VELOCITY] = _or_isotropic(initial.P_v, parameters.velocity_std)
        if not in_body:
            P[VELOCITY, VELOCITY] = to_n @ P[VELOCITY, VELOCITY] @ to_n.T
        if found is None:
            P_psi = initial.P_psi
            if P_psi is None:
                P_psi = np.diag(np.square(parameters.attitude_std))
            P[ATTITUDE, ATTITUDE] = to_n @ P_psi @ to_n.T
            b_f, b_w = parameters.accelerometer_bias_std, parameters.gyroscope_bias_std
            P[ACCELEROMETER_BIAS, ACCELEROMETER_BIAS] = np.eye(3) * b_f**2
            P[GYROSCOPE_BIAS, GYROSCOPE_BIAS] = np.eye(3) * b_w**2
        else:
            P[_ATTITUDE_AND_BIASES, _ATTITUDE_AND_BIASES] = found.P
        P_p = _or_isotropic(initial.P_p, parameters.position_std)
        P[POSITION, POSITION] = J_inverse @ P_p @ J_inverse.T
        for block in self._blocks:
            at = vehicle.blocks[block.name]
            P[at, at] = np.diag(np.square(block.std))
            if block.initial:
                nav["optional"][vehicle.optional(block.name)] = block.initial
        if found is not None and s["start"]["heading_from"] == automatic.SENSOR:
            self._correlate(P)
        x_n = coordinates.from_reference(nav)
        T = coordinates.from_ordinary_errors(
            C,
            nav["v_n"],
            x_n,
            invariant=vehicle.invariant,
            velocity_frame=initial.velocity_frame,
            n=n,
        )
        # From base_link to the IMU: its arm turns with the attitude, at the rate of a noisy sample.
        # The reference is where base_link starts, so for `invariant` the two position terms cancel.
        T[POSITION, ATTITUDE] -= cross_matrix(x_n)
        if not in_body:
            T[VELOCITY, ATTITUDE] -= cross_matrix(v_arm)
        T[VELOCITY, GYROSCOPE_BIAS] = C @ cross_matrix(l_b)
        P = T @ P @ T.T
        arm_rate = T[VELOCITY, GYROSCOPE_BIAS]
        P[VELOCITY, VELOCITY] += arm_rate @ sample_variance_w(s, vehicle) @ arm_rate.T
        nav["P"] = 0.0
        nav["P"][:n, :n] = (P + P.T) / 2
        if imu["imu_ns"] == NEVER:
            imu["imu_ns"] = stamp_ns  # samples are missing from here on: a long wait is a gap
        nav["time_ns"], nav["start_ns"], nav["initialised"] = stamp_ns, stamp_ns, 1
        # What a channel has not shown before is in the initial state.
        imu["unseen_ns"], imu["equal_ns"] = NEVER, np.maximum(imu["equal_ns"], stamp_ns)
        return True

    def doubt_heading(self, s: State) -> None:
        """Restart a heading that was unknown and is contradicted, see wrong_heading.py."""
        parameters, walk = self._parameters, float(self._vehicle.constants[0]["eps_w"])
        variance = parameters.gyroscope_bias_std**2
        if wrong_heading.is_contradicted(s, self._told_bias[3:], variance, walk):
            wrong_heading.restart(s, self._vehicle, parameters, self._told_bias, self._blocks)

    def _correlate(self, P: Array) -> None:
        """The slow error of the sensor that has told the heading is in the heading."""
        error, heading = self._vehicle.blocks.get("heading_error"), ATTITUDE.stop - 1
        if error is not None:
            P[heading, error] = P[error, heading] = -P[error, error][0]

    def _bias(self, values: tuple[float, ...]) -> Array:
        """A bias of the parameters, in IMU axes of their convention, in base_link axes (3,)."""
        vehicle = self._vehicle
        return vehicle.C_b_i @ (vehicle.axes.body @ np.array(values))

    def see(self, state: Records, sample: Imu, reading: Array) -> bool:
        """An uninitialised state sees a sample (base_link axes), and may start from it.

        Args:
            state: (1,) record.
            sample: The sample.
            reading: (6,) the same as the IMU has read it, in its axes: f, then w.

        Returns:
            Whether the state is initialised now.
        """
        s, mode, started = state[0], self._parameters.mode, False
        _watch(state, self._vehicle.constants, sample.stamp_ns, reading)
        if not np.isnan(s["nav"]["lat_0"]):
            if mode == "parameters":
                started = self.initialise(state, self._initial, sample.stamp_ns, sample.w_ib_b)
            elif mode in ("auto", "levelling", "gyrocompassing"):
                started = self._level(state, sample)
        s["channels"]["imu_ns"] = s["nav"]["time_ns"] = sample.stamp_ns
        return started

    def hear_orientation(self, s: State, event: Orientation) -> None:
        """The IMU has told its orientation."""
        if self._parameters.takes_orientation:
            C, std = event.C_n_i @ self._vehicle.C_b_i.T, event.heading_std
            self._automatic.hear_heading(s, event.stamp_ns, C, std, automatic.IMU)

    def hear_velocity(self, s: State, stamp_ns: int, v_b: Array, P: Array) -> None:
        """A DVL has told the velocity (3,) of base_link in body axes, and its covariance."""
        if self._parameters.mode == "auto":
            self._automatic.hear_velocity(s, stamp_ns, v_b, P)

    def hear_attitude(self, s: State, stamp_ns: int, C_n_b: Array, std: float) -> None:
        """A heading sensor has told an attitude (3, 3), and one sigma of its heading [rad]."""
        if self._parameters.takes_orientation:
            self._automatic.hear_heading(s, stamp_ns, C_n_b, std, automatic.SENSOR)

    def keep(self, s: State, known: Initial) -> bool:
        """Keep heading and position from before a reset, with their covariance; whether it does.

        Of the heading that holds below the sigma of an unknown one.
        """
        if self._parameters.mode != "auto":
            return False
        nav = s["nav"]
        origin = np.array([nav["lat_0"], nav["lon_0"], nav["h_0"]])
        place = odom.place_of(known.p_o, origin)
        if place is None or known.P_psi is None:
            return False
        _, turn = odom.jacobian(place, origin)
        C, std = turn.T @ known.C_o_b, float(np.sqrt(known.P_psi[2, 2]))
        if std < automatic.UNKNOWN_HEADING:
            self._automatic.hear_heading(s, known.stamp_ns, C, std, automatic.KEPT)
        self._automatic.keep_position(s, known)
        return True

    def _level(self, state: Records, sample: Imu) -> bool:
        """Collect the samples of a block at rest, f_b = -C_b_n g_n, then start from its direction.

        It restarts behind a gap, and where the mean differs from gravity. Samples that are not
        believed are left out; without data for longer than a gap it is one. Gyrocompassing goes on
        over many blocks.
        """
        s, vehicle, parameters = state[0], self._vehicle, self._parameters
        start, nav, mode = s["start"], s["nav"], parameters.mode
        is_automatic = mode == "auto"
        if is_automatic:
            self._automatic.carry(s, sample)
        imu = s["channels"]
        since_ns = sample.stamp_ns - imu["imu_ns"]
        if imu["verdict"][0] == channels.NO_DATA:
            since_ns = max(since_ns, sample.stamp_ns - imu["equal_ns"][0])
        if start["level_count"] + start["rest_count"] and since_ns > vehicle.constants[0]["gap_ns"]:
            if start["rest_count"] and not is_automatic:
                start["compass"] = gyrocompass.GAP
            self._restart_levelling(s)
        if (imu["verdict"] != channels.GOOD).any():
            return False
        if start["level_count"] == 0:
            start["level_ns"] = sample.stamp_ns
        start["level_f"] += sample.f_b
        start["level_w"] += sample.w_ib_b
        start["level_count"] += 1
        if mode != "levelling":  # which judges no rest
            self._automatic.collect(s, sample)
        duration = round(parameters.levelling_time * NS)
        if sample.stamp_ns - start["level_ns"] < duration:
            return False
        count = int(start["level_count"])
        f_b = start["level_f"] / count - self._told_bias[:3]
        w_ib_b = start["level_w"] / count - self._told_bias[3:]
        g = gravity(nav["lat_0"], nav["h_0"])
        if abs(np.hypot.reduce(f_b) - g) > LEVEL_TOLERANCE * g:  # cannot overflow
            self._restart_levelling(s)
            return False
        if is_automatic:
            beginning = self._automatic.decide(s, sample.stamp_ns, self._noise(s))
            self._clear_block(s)
            if beginning is None:
                return False
            initial, found = beginning.initial, beginning.attitude
            return self._begin(state, initial, sample.stamp_ns, sample.w_ib_b, found)
        undecided = start["compass"] == gyrocompass.UNDECIDED
        if mode == "gyrocompassing" and undecided:
            noise = noise_at_rest(window_of_block(s), self._noise(s))
            mean = np.concatenate([f_b, w_ib_b])
            gyrocompass.see_block(s, mean, count, noise, self._plan, sample.stamp_ns)
            if start["compass"] == gyrocompass.FOUND:
                rest = gyrocompass.at_rest(s, noise)
                found = Attitude(rest.C_n_b, self._told_bias[3:], rest.covariance(noise))
                return self._begin(state, self._initial, sample.stamp_ns, sample.w_ib_b, found)
            if start["compass"] == gyrocompass.UNDECIDED:
                self._clear_block(s)
                return False
        C = self._initial.C_o_b
        rpy = np.array([*gyrocompass.level(f_b), np.arctan2(C[1, 0], C[0, 0])])
        C, tilt = rotation_from_rpy(rpy), np.eye(2) * parameters.tilt_std**2
        P_psi = automatic.levelled_covariance(C, tilt, parameters.heading_std)
        initial = replace(self._initial, C_o_b=C, P_psi=P_psi)
        return self._begin(state, initial, sample.stamp_ns, sample.w_ib_b, None)

    def _noise(self, s: State) -> gyrocompass.Noise:
        """What is told of the IMU now."""
        c, parameters = self._vehicle.constants[0], self._parameters
        return gyrocompass.noise_of(
            s, c, parameters.accelerometer_bias_std, parameters.gyroscope_bias_std
        )

    def _restart_levelling(self, s: State) -> None:
        self._clear_block(s)
        start = s["start"]
        start["rest_sum"], start["rest_nis"] = 0.0, 0.0
        start["rest_count"], start["rest_blocks"], start["rest_noise"] = 0, 0, 0.0
        if start["compass"] == gyrocompass.FOUND:  # by the rest that is forgotten here
            start["compass"], start["compass_number"] = gyrocompass.UNDECIDED, 0.0
        s["counters"]["not_level"] += 1

    @staticmethod
    def _clear_block(s: State) -> None:
        start = s["start"]
        start["level_f"], start["level_w"], start["level_count"] = 0.0, 0.0, 0
        start["level_half"], start["level_half_count"], start["level_products"] = 0.0, 0, 0.0


def _or_isotropic(P: Array | None, std: float) -> Array:
    return np.eye(3) * std**2 if P is None else P
