"""The mode 'auto': a start that assumes nothing which nobody told.

Tilt from levelling, at rest or as uncertain as the motion makes it; velocity from the first DVL
measurement; heading from what tells it, else unknown. A vehicle at rest is waited for: it starts
with the first velocity, or as soon as it moves. Derivation: docs/explanation/start.md.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.events import NS, Imu, Initial
from insdvl.navigation.gate.chi_square import exceeded
from insdvl.navigation.geometry import odom
from insdvl.navigation.geometry.earth import EARTH_RATE, gravity
from insdvl.navigation.geometry.frames import rotation_from_rpy, rotation_from_vector
from insdvl.navigation.start import gyrocompass, rest
from insdvl.navigation.start.gyrocompass import Noise
from insdvl.navigation.start.parameters import InitialParameters
from insdvl.navigation.start.rest import Attitude, Window
from insdvl.navigation.state.fields import NEVER, State
from insdvl.navigation.state.scratch import Constants

# Where the heading is from, as it stands in the record; TOLD is an initial state of other modes.
TOLD, PARAMETERS, IMU, GYROCOMPASS, KEPT, UNKNOWN, SENSOR = range(7)
#: Of those that are heard of, the better one stays.
_RANK = {IMU: 0, SENSOR: 1, KEPT: 2}

#: One sigma of a heading of which nothing is known [rad]: that of a uniform one.
UNKNOWN_HEADING = math.radians(100.0)
#: Gyrocompassing tells the heading where its sigma is below this [rad].
USEFUL_HEADING = math.radians(20.0)
#: One sigma of the velocity before the first DVL measurement [m/s]: vehicles are below 10 m/s.
UNKNOWN_SPEED = 5.0
#: Largest angle between the tilt that an orientation tells and that of levelling [rad]; beyond it
#: the orientation is in other axes, or of another frame.
LARGEST_TILT_ERROR = 0.5


@dataclass(frozen=True)
class Beginning:
    """How the filter begins."""

    initial: Initial
    attitude: Attitude


@dataclass(frozen=True)
class _Heading:
    """A heading, one sigma [rad], and an attitude that has it; None for gyrocompassing."""

    source: int
    std: float
    C_n_b: Array | None = None


def levelled_jacobian(C_n_b: Array) -> Array:
    """d psi_D / d (psi_N, psi_E) (2,) of an attitude whose yaw is told and whose tilt is measured.

    Roll turns about the nose, which points down by the pitch theta, and the yaw chi stays:
    psi_D = - tan theta (cos chi psi_N + sin chi psi_E). It has no limit as the nose turns vertical.
    """
    forward = C_n_b[:, 0]
    level = float(forward[:2] @ forward[:2])
    return forward[2] / max(level, 1e-12) * forward[:2]


def levelled_covariance(C_n_b: Array, P_tilt: Array, heading_std: float) -> Array:
    """Covariance (3, 3) of psi after levelling with a told yaw [rad^2].

    Args:
        C_n_b: (3, 3) attitude.
        P_tilt: (2, 2) covariance of psi north and east.
        heading_std: One sigma of the told yaw.
    """
    J = np.vstack([np.eye(2), levelled_jacobian(C_n_b)])
    P = J @ P_tilt @ J.T
    P[2, 2] += heading_std**2
    if P[2, 2] > UNKNOWN_HEADING**2:
        P[2, :], P[:, 2] = 0.0, 0.0
        P[2, 2] = max(heading_std, UNKNOWN_HEADING) ** 2
    return P


class Automatic:
    """Decides when, and with what, a filter begins.

    Args:
        parameters: Of the initial state.
        initial: What the parameters tell of it.
        bias: (6,) of accelerometers and gyroscopes, base_link axes.
        constants: Of the filter.
    """

    def __init__(
        self, parameters: InitialParameters, initial: Initial, bias: Array, constants: Constants
    ) -> None:
        self._parameters = parameters
        self._initial = initial
        self._bias = bias
        self._constants = constants
        self._duration_ns = round(parameters.levelling_time * NS)
        self._plan = gyrocompass.Plan(parameters.gyrocompass_time, USEFUL_HEADING)

    # ---------------------------------------------------------------- what is heard

    def hear_heading(self, s: State, stamp_ns: int, C_n_b: Array, std: float, source: int) -> None:
        """An attitude (3, 3) whose heading is known to one sigma [rad], at a stamp."""
        start = s["start"]
        known = start["told_ns"] != NEVER
        if known and _RANK[source] < _RANK[int(start["told_by"])]:
            return
        start["told_C"], start["told_std"] = C_n_b, std
        start["told_ns"], start["told_by"] = stamp_ns, source

    def hear_velocity(self, s: State, stamp_ns: int, v_b: Array, P: Array) -> None:
        """The velocity (3,) of base_link in body axes [m/s] and its covariance, at a stamp."""
        start = s["start"]
        start["velocity"], start["velocity_P"], start["velocity_ns"] = v_b, P, stamp_ns

    def keep_position(self, s: State, initial: Initial) -> None:
        """The position of an initial state is known, and its speed, from before a reset."""
        start = s["start"]
        start["kept_p"], start["kept_P"] = initial.p_o, initial.P_p
        start["kept_ns"], start["kept_speed"] = initial.stamp_ns, np.hypot.reduce(initial.v)

    def carry(self, s: State, sample: Imu) -> None:
        """Turn the told heading on by a sample; in a gap it becomes less certain instead.

        The turn is the one that is believed of the sample.
        """
        start, c = s["start"], self._constants
        if start["told_ns"] == NEVER or sample.stamp_ns <= start["told_ns"]:
            return
        seconds = (sample.stamp_ns - int(start["told_ns"])) / NS
        if seconds * NS > c["gap_ns"]:
            start["told_std"] = np.hypot(start["told_std"], c["gap_w"] * seconds)
        else:
            w_ib_b = sample.w_ib_b + c["C_b_i"] @ s["channels"]["amends"][3:]
            start["told_C"] = start["told_C"] @ rotation_from_vector(
                (w_ib_b - self._bias[3:]) * seconds
            )
        start["told_std"] += (self._parameters.gyroscope_bias_std + EARTH_RATE) * seconds
        start["told_ns"] = sample.stamp_ns

    def collect(self, s: State, sample: Imu) -> None:
        """Add a sample of the block under way to the sums that `Window` needs."""
        start = s["start"]
        x = np.concatenate([sample.f_b, sample.w_ib_b])
        start["level_products"] += np.outer(x, x)
        if 2 * (sample.stamp_ns - start["level_ns"]) < self._duration_ns:
            start["level_half"] += x
            start["level_half_count"] += 1

    # ---------------------------------------------------------------- decision

    def decide(self, s: State, stamp_ns: int, noise: Noise) -> Beginning | None:
        """At the end of a block of plausible gravity: how to begin, None to see another block."""
        start, nav = s["start"], s["nav"]
        window = rest.window_of_block(s)
        noise = rest.noise_at_rest(window, noise)
        g = gravity(nav["lat_0"], nav["h_0"])
        misfit = rest.misfit_to_rest(window, self._bias, noise, g)
        velocity, motion = self._velocity(s, stamp_ns), misfit.motion
        if velocity is not None:
            motion = max(motion, _times_of_zero(*velocity))
        times = max(misfit.spread, motion)
        heading = self._heading(s, stamp_ns, window, noise, times)
        if heading is None or (velocity is None and motion <= 1.0):
            return None
        seconds, moves = (stamp_ns - int(start["level_ns"])) / NS, times > 1.0
        attitude = self._attitude(s, window, noise, heading, moves, seconds)
        P_psi = attitude.P[:3, :3]
        start["heading_from"], start["heading_std"] = heading.source, np.sqrt(P_psi[2, 2])
        start["tilt_std"] = np.sqrt(np.trace(P_psi[:2, :2]) / 2.0)
        start["at_rest"], start["velocity_told"] = not moves, velocity is not None
        v, P = velocity or (np.zeros(3), np.eye(3) * UNKNOWN_SPEED**2)
        p_o, P_p = self._position(s, stamp_ns)
        initial = replace(self._initial, v=v, P_v=P, velocity_frame="body", p_o=p_o, P_p=P_p)
        return Beginning(initial, attitude)

    def _velocity(self, s: State, stamp_ns: int) -> tuple[Array, Array] | None:
        """The last DVL velocity, as uncertain as its age makes it; None where that says nothing."""
        start, c = s["start"], self._constants
        if start["velocity_ns"] == NEVER:
            return None
        seconds = (stamp_ns - int(start["velocity_ns"])) / NS
        v, P = start["velocity"].copy(), start["velocity_P"].copy()
        turn = np.hypot.reduce(v) * c["gap_w"] * seconds
        P += np.eye(3) * ((c["gap_f"] * seconds) ** 2 + turn**2)
        return None if np.trace(P) > 3.0 * UNKNOWN_SPEED**2 else (v, P)

    def _heading(
        self, s: State, stamp_ns: int, window: Window, noise: Noise, times: float
    ) -> _Heading | None:
        """Where the heading is from; None to wait for it."""
        start, choice = s["start"], self._parameters.heading
        std = float(start["told_std"])
        known = start["told_ns"] != NEVER and std < UNKNOWN_HEADING
        # A sensor that tells the yaw only has no tilt to compare.
        source = int(start["told_by"])
        if known and (source == SENSOR or self._is_upright(start["told_C"], window)):
            return _Heading(source, std, start["told_C"].copy())
        if choice == "imu":
            return None
        if choice == "parameters":
            C = _to_local(s, self._initial.p_o) @ self._initial.C_o_b
            return _Heading(PARAMETERS, self._parameters.heading_std, C)
        if choice != "unknown" and self._constants["earth_rate"]:
            if start["compass"] == gyrocompass.UNDECIDED:
                self._compass(s, stamp_ns, window, noise, times)
            if start["compass"] == gyrocompass.UNDECIDED:
                return None
            if start["compass"] == gyrocompass.FOUND:
                return _Heading(GYROCOMPASS, float(start["compass_number"]))
        return _Heading(UNKNOWN, UNKNOWN_HEADING, np.eye(3))

    def _compass(self, s: State, stamp_ns: int, window: Window, noise: Noise, times: float) -> None:
        """Add the block to the time at rest, where it is one."""
        start, nav = s["start"], s["nav"]
        sigma = gyrocompass.heading_sigma(
            noise, self._plan.duration * noise.rate, self._plan.duration, nav["lat_0"], nav["h_0"]
        )
        if times > 1.0 and (sigma < self._plan.heading_std or start["rest_count"] > 0):
            start["compass"], start["compass_number"] = gyrocompass.MOVES, min(times, 1e9)
            return
        mean = window.mean - self._bias
        gyrocompass.see_block(s, mean, window.count, noise, self._plan, stamp_ns)

    def _is_upright(self, C_n_b: Array, window: Window) -> bool:
        """Whether an attitude has the tilt that the specific force shows, roughly."""
        up = C_n_b @ (window.mean[:3] - self._bias[:3])
        return bool(-up[2] > math.cos(LARGEST_TILT_ERROR) * np.hypot.reduce(up))

    def _attitude(
        self,
        s: State,
        window: Window,
        noise: Noise,
        heading: _Heading,
        moves: bool,
        seconds: float,
    ) -> Attitude:
        """Attitude at the end of the block, with the gyroscope's bias of a rest."""
        nav, b_w = s["nav"], self._bias[3:]
        mean = window.mean - self._bias
        if heading.C_n_b is None:
            found = gyrocompass.at_rest(s, noise)
            C = found.C_n_b
            if moves:  # since the time at rest, for the length of a block
                C = C @ rotation_from_vector((mean[3:] - found.mean[3:]) * seconds)
            return Attitude(C, b_w, found.covariance(noise))
        # The mean force is that of the middle of the block.
        half = rotation_from_vector(mean[3:] * (seconds / 2.0)) if moves else np.eye(3)
        if heading.source in (IMU, KEPT):
            C = _upright(heading.C_n_b @ half.T, mean[:3])
        else:
            told = heading.C_n_b @ half.T if heading.source == SENSOR else heading.C_n_b
            yaw = math.atan2(told[1, 0], told[0, 0])
            C = rotation_from_rpy(np.array([*gyrocompass.level(mean[:3]), yaw]))
        unseen = self._constants["gap_f"] if moves else rest.UNSEEN_ACCELERATION
        P_b = noise.of_biases()
        P_f = noise.of_mean(window.count, seconds)[:3, :3] + np.eye(3) * unseen**2
        J = np.zeros((3, 6))
        J[:2] = gyrocompass.jacobian(C, nav["lat_0"], nav["h_0"])[:2]
        std = heading.std
        if heading.source in (PARAMETERS, SENSOR):
            J[2] = levelled_jacobian(C) @ J[:2]
            of_roll = math.sqrt(J[2, :3] @ (P_b[:3, :3] + P_f) @ J[2, :3])
            if of_roll > UNKNOWN_HEADING:  # the nose is vertical: the yaw tells no direction
                J[2], std = 0.0, UNKNOWN_HEADING
        P = np.zeros((9, 9))
        P[:3, :3] = J @ P_b @ J.T + J[:, :3] @ P_f @ J[:, :3].T
        P[2, 2] += std**2
        P[:3, 3:], P[3:, :3], P[3:, 3:] = J @ P_b, P_b @ J.T, P_b
        attitude = Attitude(C @ half, b_w, P)
        if moves:
            return attitude
        w = window.mean[3:]
        return rest.with_gyroscope_bias(attitude, w, window.count, noise, nav["lat_0"])

    def _position(self, s: State, stamp_ns: int) -> tuple[Array, Array | None]:
        """Position in odom, and its covariance: as told, or kept over a reset."""
        start = s["start"]
        if start["kept_ns"] == NEVER:
            return self._initial.p_o, self._initial.P_p
        path = start["kept_speed"] * (stamp_ns - int(start["kept_ns"])) / NS
        return start["kept_p"].copy(), start["kept_P"] + np.eye(3) * path**2


def _to_local(s: State, p_o: Array) -> Array:
    """Rotation (3, 3) from odom's axes to north, east and down at a position (3,) in odom."""
    origin = np.array([s["nav"][name] for name in ("lat_0", "lon_0", "h_0")])
    place = odom.place_of(p_o, origin)
    return np.eye(3) if place is None else np.asarray(odom.jacobian(place, origin)[1].T)


def _upright(C_n_b: Array, f_b: Array) -> Array:
    """The attitude nearest to another one that has the tilt of a mean specific force (3,)."""
    u = C_n_b @ f_b
    axis = np.array([-u[1], u[0], 0.0])  # u x (0, 0, -1)
    size = math.hypot(u[0], u[1])
    if size == 0.0:
        return C_n_b
    return rotation_from_vector(axis / size * math.atan2(size, -u[2])) @ C_n_b


def _times_of_zero(v: Array, P: Array) -> float:
    """How many times larger than chance a velocity is if the true one is zero.

    Directions that were not measured, of `UNKNOWN_SPEED`, say nothing of it.
    """
    variances, axes = np.linalg.eigh(P)
    measured = variances < UNKNOWN_SPEED**2 / 2.0
    if not measured.any():
        return 0.0
    squares = (axes.T @ v)[measured] ** 2 / variances[measured]
    return float(squares.sum()) / exceeded(int(measured.sum()), rest.FALSE_ALARM)
