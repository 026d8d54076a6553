"""The error-state extended Kalman filter: predict with IMU samples, update with DVL velocities.

A `Filter` holds what never changes; all that does is in a state record (state.py), which its
methods advance in place. `fold.Fold` decides the order in which they are called.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit
from scipy.stats import chi2

from insdvl.kernels import kernel
from insdvl.navigation import error_state, strapdown
from insdvl.navigation.error_state import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    DVL_ERROR,
    GYROSCOPE_BIAS,
    POSITION,
    VELOCITY,
)
from insdvl.navigation.events import NS, Dvl, Imu, Initial, Origin, ProcessNoise
from insdvl.navigation.geometry.earth import gravity
from insdvl.navigation.geometry.frames import CONVENTIONS, rotation_from_rpy
from insdvl.navigation.geometry.rotation import rotate_back
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.process_noise import ProcessNoiseSource, variational
from insdvl.navigation.state import (
    NEVER,
    Constants,
    State,
    Workspace,
    constants_type,
    empty_state,
    state_size,
    workspace_type,
)

Array = NDArray[np.float64]
Records = NDArray[np.void]

#: A measurement whose NIS is so many times the gate's limit is surely an error of the DVL.
FAULT = 1.5
#: A trusted filter may reject for so long [ns] what need not be an error of the DVL; a longer
#: interval between measurements bears nothing out; two steps farther apart are no way.
LEAST_PATIENCE_NS = 5 * NS
#: A running mean of the NIS, over so many measurements, that a filter of honest covariance has
#: above the limit once in 10,000 measurements, and one of half the covariance in every fifth.
NIS_MEMORY, NIS_LIMIT = 5.0, 7.0
#: Most tilt, one sigma [rad], that an inflation takes for possible.
LARGEST_TILT_DOUBT = 0.5
#: What the mean specific force at rest may differ from gravity, as a fraction of it.
LEVEL_TOLERANCE = 0.05

#: An update is iterated while h bends by more than the mean sigma of R, but not for ever: each
#: iteration leaves a fraction.
_BEND = 1.0  # (sigma)^2
_ITERATIONS = 10


@dataclass(frozen=True)
class UpdateReport:
    """What an update did.

    Attributes:
        innovation: (3,) measured minus predicted velocity [m/s], DVL axes, forward-right-down.
        S: (3, 3) covariance of the innovation [(m/s)^2].
        nis: Normalised innovation squared, chi-square with 3 degrees of freedom when all is well;
            of the filter's own prediction also where the update adapts it.
        accepted: Whether the state was corrected.
        reason: Empty, or why not: ``gate``; ``bad_covariance`` (S is not positive definite);
            ``not_finite`` (the NIS is beyond all numbers). ``restarted`` where the velocity was set
            to the measured one. With ``not_initialised``, ``no_lock`` and ``repeated`` (see
            ``dvl.lock_check``) nothing was predicted: innovation, S and NIS are nan.
    """

    innovation: Array
    S: Array
    nis: float
    accepted: bool
    reason: str

    @property
    def corrected(self) -> bool:
        """Whether the innovation corrected the state; a restart only sets the velocity."""
        return self.accepted and not self.reason


#: The states that the noise of the samples drives are those before this one.
_INPUT = ATTITUDE.stop


@kernel
def _is_saturated(c: Constants, reading: Array, i: int) -> bool:
    return abs(reading[i]) >= c.range[i]


@kernel
def _is_frozen(s: State, c: Constants, reading: Array, i: int) -> bool:
    """Whether the sample is at least the last of ``frozen_samples`` that are equal."""
    return 0 < c.frozen <= s.equal[i] + 1 and reading[i] == s.reading[i]


@kernel
def unseen_sigma(c: Constants, reading: Array, i: int) -> float:
    """One sigma of the motion that a channel in doubt does not see [m/s^2 or rad/s].

    One that is saturated may be stuck there: its range at least.
    """
    sigma = c.gap_f if i < 3 else c.gap_w
    if _is_saturated(c, reading, i):
        return max(sigma, c.range[i])
    return sigma


@kernel
def _growth(from_ns: int, to_ns: int, since_ns: int, is_new: bool) -> float:
    """Density over a step that makes T^2 grow, T being the time since a stamp; or all of it."""
    before = 0.0 if is_new else (from_ns - since_ns) * 1e-9
    after = (to_ns - since_ns) * 1e-9
    return (after**2 - before**2) / ((to_ns - from_ns) * 1e-9)


@kernel
def _doubt(s: State, w: Workspace, c: Constants, reading: Array, to_ns: int) -> bool:
    """Densities, up to a stamp, of the motion that channels do not see; whether there is any.

    As in a gap, a constant error of one sigma over a time T makes (sigma T)^2. T begins with the
    sample that saturates, or with the first of those that are equal: what grew until that was
    noticed comes at once. An accepted DVL measurement tells velocity and tilt, so for them T begins
    again with it; the heading it does not tell.
    """
    any_unseen = False
    for i in range(6):
        w.unseen[i] = w.unseen_heading[i] = 0.0
        frozen = _is_frozen(s, c, reading, i)
        w.frozen[i] = frozen
        if not (frozen or _is_saturated(c, reading, i)):
            continue
        sigma = unseen_sigma(c, reading, i)
        any_unseen = True
        is_new = s.unseen_ns[i] == NEVER
        if is_new:
            s.unseen_ns[i] = s.equal_ns[i] if frozen else s.imu_ns
        told_ns = max(s.unseen_ns[i], s.accepted_ns)
        w.unseen[i] = _growth(s.time_ns, to_ns, told_ns, is_new)
        if i >= 3:
            total = _growth(s.time_ns, to_ns, s.unseen_ns[i], is_new)
            w.unseen_heading[i] = sigma**2 * (total - w.unseen[i])
        w.unseen[i] *= sigma**2
    return any_unseen


@kernel
def _replace_frozen(s: State, w: Workspace, c: Constants, f_hat: Array, w_hat: Array) -> None:
    """A frozen channel tells nothing: what is expected without acceleration and turn replaces it.

    The attitude tells the share of gravity, which may be far more than the motion.
    """
    strapdown.earth_terms(s, w, c)
    rotate_back(w.x4, s.C_n_b, w.g_n)
    for i in range(3):
        force, rate = 0.0, 0.0
        for a in range(3):
            force += c.C_b_i[a, i] * (-w.x4[a] - f_hat[a])
            rate -= c.C_b_i[a, i] * w_hat[a]
        for a in range(3):
            if w.frozen[i]:
                f_hat[a] += c.C_b_i[a, i] * force
            if w.frozen[3 + i]:
                w_hat[a] += c.C_b_i[a, i] * rate


@kernel
def _add_rotated(Q: Array, C: Array, variances: Array, first: int) -> None:
    """Q += C diag(variances[first : first + 3]) C^T."""
    for i in range(3):
        for j in range(3):
            for a in range(3):
                Q[i, j] += C[i, a] * variances[first + a] * C[j, a]


@kernel
def _add_vertical(Q: Array, C_n_b: Array, C_b_i: Array, variances: Array) -> None:
    """Q += sum of variances[3 + k] (a_k . d)^2 d d^T, for the axes a_k and the vertical d."""
    for k in range(3):
        share = 0.0
        for a in range(3):
            share += C_b_i[a, k] * C_n_b[2, a]
        for i in range(3):
            for j in range(3):
                Q[i, j] += variances[3 + k] * share**2 * C_n_b[2, i] * C_n_b[2, j]


@kernel
def _advance(
    s: State,
    w: Workspace,
    c: Constants,
    sample_ns: int,
    f_b: Array,
    w_ib_b: Array,
    reading: Array,
    to_ns: int,
) -> None:
    """Advance an initialised state with (a part of) the sample that ends at ``sample_ns``."""
    if to_ns <= s.time_ns:
        return
    dt = (to_ns - s.time_ns) * 1e-9
    if s.q_ns != NEVER and s.time_ns - s.q_ns > c.q_timeout_ns:
        s.Q_f[:] = c.Q_f_nominal
        s.Q_w[:] = c.Q_w_nominal
        s.q_ns = NEVER
        s.q_timeouts += 1

    f_hat, w_hat = w.x2, w.x3
    for i in range(3):
        f_hat[i] = f_b[i] - s.b_f[i]
        w_hat[i] = w_ib_b[i] - s.b_w[i]
    in_doubt = _doubt(s, w, c, reading, to_ns)
    if in_doubt:
        _replace_frozen(s, w, c, f_hat, w_hat)
    strapdown.mechanise(s, w, c, f_hat, w_hat, dt)

    # Densities of the input noise; in a gap, of the motion that was not seen as well: a constant
    # error of one sigma over the gap T grows to (sigma T)^2, as a density sigma^2 T does.
    Q_f, Q_w = w.N1, w.N2
    adaptive = s.Q_x.shape[0] > 0 and s.innovation_count >= s.innovations.shape[0]
    scale = 0.0 if adaptive and c.literal else c.density
    gap = 0.0
    if s.imu_ns != NEVER and sample_ns - s.imu_ns > c.gap_ns:
        gap = (sample_ns - s.imu_ns) * 1e-9
    for i in range(3):
        for j in range(3):
            Q_f[i, j] = scale * s.Q_f[i, j]
            Q_w[i, j] = scale * s.Q_w[i, j]
        Q_f[i, i] += c.gap_f * c.gap_f * gap
        Q_w[i, i] += c.gap_w * c.gap_w * gap
    if in_doubt:
        _add_rotated(Q_f, c.C_b_i, w.unseen, 0)
        _add_rotated(Q_w, c.C_b_i, w.unseen, 3)
        _add_vertical(Q_w, s.C_n_b, c.C_b_i, w.unseen_heading)

    error_state.dynamics(w, c)
    error_state.discretise(w, c, dt)
    for i in range(s.P.shape[0] - DVL_ERROR.start):
        s.b_d[i] *= w.Phi[DVL_ERROR.start + i, DVL_ERROR.start + i]
    if s.Q_x.shape[0] > 0:
        w.Q_d[:] = 0.0  # Q_x fills elements that input_noise leaves alone
    error_state.input_noise(s, w, c, Q_f, Q_w, dt)
    if adaptive:
        for i in range(s.Q_x.shape[0]):
            for j in range(s.Q_x.shape[0]):
                # In place of the nominal Q, but not of the motion that was not seen.
                if c.literal and (i >= _INPUT or j >= _INPUT):
                    w.Q_d[i, j] = 0.0
                w.Q_d[i, j] += dt * s.Q_x[i, j]
    error_state.propagate(s.P, w)
    s.time_ns = to_ns


@kernel
def _watch(s: State, c: Constants, sample_ns: int, reading: Array) -> None:
    """Remember what the channels read, and which of them are to be believed."""
    saturated, frozen = 0, 0
    for i in range(6):
        if _is_saturated(c, reading, i):
            saturated = 1
        elif _is_frozen(s, c, reading, i):
            frozen = 1
        else:
            s.unseen_ns[i] = NEVER
        if s.equal[i] > 0 and reading[i] == s.reading[i]:
            s.equal[i] += 1
        else:
            s.equal[i] = 1
            s.equal_ns[i] = sample_ns
            s.reading[i] = reading[i]
    s.saturated += saturated
    s.frozen += frozen


@kernel
def _complete(s: State, c: Constants, sample_ns: int, reading: Array) -> None:
    """The sample is used up."""
    if s.imu_ns != NEVER and sample_ns - s.imu_ns > c.gap_ns:
        s.gaps += 1
        s.gap_ns = sample_ns
    _watch(s, c, sample_ns, reading)
    s.imu_ns = sample_ns


@kernel
def _watch_sample(state: Records, constants: Records, sample_ns: int, reading: Array) -> None:
    _watch(state[0], constants[0], sample_ns, reading)


@kernel
def _predict_part(
    state: Records,
    workspace: Records,
    constants: Records,
    sample_ns: int,
    f_b: Array,
    w_ib_b: Array,
    reading: Array,
    to_ns: int,
) -> None:
    _advance(state[0], workspace[0], constants[0], sample_ns, f_b, w_ib_b, reading, to_ns)


@kernel
def _predict_samples(
    state: Records,
    workspace: Records,
    constants: Records,
    stamps_ns: NDArray[np.int64],
    f_b: Array,
    w_ib_b: Array,
    readings: Array,
    first: int,
    last: int,
    states: Records,
) -> None:
    s, w, c = state[0], workspace[0], constants[0]
    for k in range(first, last):
        _advance(s, w, c, stamps_ns[k], f_b[k], w_ib_b[k], readings[k], stamps_ns[k])
        _complete(s, c, stamps_ns[k], readings[k])
        states[k] = s


@kernel
def _set_turn_rate(state: Records, workspace: Records, constants: Records, w_ib_b: Array) -> None:
    s = state[0]
    strapdown.turn_rate(s.w_nb_b, s, workspace[0], constants[0], w_ib_b)


@kernel
def _innovate(
    state: Records, workspace: Records, constants: Records, v_d: Array, w_ib_b: Array, R: Array
) -> float:
    s, w = state[0], workspace[0]
    error_state.dvl_measurement(s, w, constants[0], v_d, w_ib_b)
    return error_state.innovation_covariance(s.P, w, R)


@kernel
def _correct(state: Records, workspace: Records, constants: Records, R: Array) -> None:
    error_state.correct(state[0], workspace[0], constants[0], R)


class Filter:
    """Predict and update on a state record.

    Args:
        parameters: Of the filter.
    """

    def __init__(self, parameters: FilterParameters) -> None:
        self.parameters = parameters
        self.n = state_size(parameters)
        self.invariant = parameters.error_state == "invariant"
        axes = CONVENTIONS[parameters.frame_convention]
        #: (3, 3) rotations from IMU and from DVL to base_link axes, forward-right-down.
        self.C_b_i = axes.body_rotation(rotation_from_rpy(np.array(parameters.imu.mount)))
        self.C_b_d = axes.body_rotation(rotation_from_rpy(np.array(parameters.dvl.mount)))
        #: (3,) position of the IMU in base_link [m], forward-right-down.
        self.l_b_imu = axes.body @ np.array(parameters.imu.lever_arm)
        l_b_dvl = axes.body @ np.array(parameters.dvl.lever_arm) - self.l_b_imu
        self._l_x = self.C_b_d.T @ error_state.cross_matrix(l_b_dvl)
        self._R_default = np.diag(np.square(parameters.dvl.noise_std))
        self._initial = self._initial_from_parameters()
        gate = parameters.gate
        self._gate = float(chi2.ppf(gate.probability, 3)) if gate.enabled else np.inf
        self._patience_ns = round(gate.max_rejection_time * NS)
        self.process_noise = ProcessNoiseSource(parameters, self.C_b_i)

        self._workspace = np.zeros(1, workspace_type(self.n))
        #: (1,) record of what the kernels need to know, see `state.constants_type`.
        self.constants = np.zeros(1, constants_type(self.n))
        c = self.constants[0]
        c["invariant"] = self.invariant
        c["earth_rate"] = parameters.earth_rate
        noise = parameters.process_noise
        c["rate"] = parameters.imu.rate
        c["density"] = 1.0 / parameters.imu.rate if noise.convention == "per_sample" else 1.0
        c["eps_f"], c["eps_w"] = noise.accelerometer_bias_walk, noise.gyroscope_bias_walk
        c["Q_f_nominal"] = self.process_noise.Q_f_nominal
        c["Q_w_nominal"] = self.process_noise.Q_w_nominal
        c["q_timeout_ns"] = round(parameters.q_timeout * NS)
        c["literal"] = noise.adaptive_form == "literal"
        c["gap_ns"] = round(parameters.imu.max_gap * NS)
        c["gap_f"] = parameters.imu.gap_acceleration_std
        c["gap_w"] = parameters.imu.gap_rate_std
        ranges = np.repeat([parameters.imu.acceleration_range, parameters.imu.rate_range], 3)
        c["C_b_i"], c["frozen"] = self.C_b_i, parameters.imu.frozen_samples
        c["range"] = np.where(ranges > 0.0, ranges, np.inf)
        c["C_d_b"] = self.C_b_d.T
        c["l_b"] = l_b_dvl
        c["bias_variance"] = parameters.dvl.bias_std**2
        c["bias_rate"] = 1.0 / parameters.dvl.bias_time_constant
        c["l_b_imu"], c["nav"], c["body"] = self.l_b_imu, axes.nav, axes.body

    def _initial_from_parameters(self) -> Initial:
        axes = CONVENTIONS[self.parameters.frame_convention]
        initial = self.parameters.initial
        velocity = np.array(initial.velocity)
        velocity_axes = axes.body if initial.velocity_frame == "body" else axes.nav
        return Initial(
            stamp_ns=0,
            C_n_b=axes.attitude(rotation_from_rpy(np.array(initial.rpy))),
            p_n=axes.nav @ np.array(initial.position),
            v=velocity_axes @ velocity,
            velocity_frame=initial.velocity_frame,
        )

    def start(self) -> Records:
        """A record, in an array of length 1, to which nothing has happened."""
        state = empty_state(self.n, self.process_noise.window)
        self.process_noise.start(state[0])
        if self.parameters.origin.source == "parameters":
            origin = self.parameters.origin
            self.locate(
                state,
                Origin(
                    0,
                    float(np.radians(origin.latitude_deg)),
                    float(np.radians(origin.longitude_deg)),
                    origin.height,
                ),
            )
        return state

    def locate(self, state: Records, origin: Origin) -> None:
        """Odom's origin on the Earth becomes known; the first one counts."""
        s = state[0]
        if np.isnan(s["lat_0"]):
            s["lat_0"], s["lon_0"], s["h_0"] = origin.lat, origin.lon, origin.h

    def initialise(self, state: Records, initial: Initial, stamp_ns: int, w_ib_b: Array) -> None:
        """The state becomes `initial`, its covariance P_0 mapped to the model's coordinates.

        Without an origin there is no gravity to navigate with: it is counted and left.

        Args:
            w_ib_b: (3,) angular rate at that time [rad/s], base_link axes, for the IMU's lever arm.
        """
        s = state[0]
        if np.isnan(s["lat_0"]):
            s["without_origin"] += 1
            return
        parameters = self.parameters.initial
        C, l_b = initial.C_n_b, self.l_b_imu
        in_body = initial.velocity_frame == "body"
        s["b_f"] = self.C_b_i @ self._body_axes(parameters.accelerometer_bias)
        s["b_w"] = self.C_b_i @ self._body_axes(parameters.gyroscope_bias)
        s["b_d"] = 0.0
        s["C_n_b"], s["p_n"] = C, initial.p_n + C @ l_b
        s["v_n"] = C @ initial.v if in_body else initial.v
        _set_turn_rate(state, self._workspace, self.constants, w_ib_b - s["b_w"])
        v_arm = C @ np.cross(s["w_nb_b"], l_b)  # of the IMU against base_link
        s["v_n"] += v_arm

        P = np.zeros((self.n, self.n))
        P[VELOCITY, VELOCITY] = _or_isotropic(initial.P_v, parameters.velocity_std)
        P[ATTITUDE, ATTITUDE] = (
            np.diag(np.square(parameters.attitude_std)) if initial.P_psi is None else initial.P_psi
        )
        P[ACCELEROMETER_BIAS, ACCELEROMETER_BIAS] = np.eye(3) * parameters.accelerometer_bias_std**2
        P[GYROSCOPE_BIAS, GYROSCOPE_BIAS] = np.eye(3) * parameters.gyroscope_bias_std**2
        P[POSITION, POSITION] = _or_isotropic(initial.P_p, parameters.position_std)
        if self.n > POSITION.stop:
            P[DVL_ERROR, DVL_ERROR] = np.eye(3) * self.parameters.dvl.bias_std**2
        T = error_state.from_ordinary_errors(
            C, s["v_n"], invariant=self.invariant, velocity_frame=initial.velocity_frame, n=self.n
        )
        # From base_link to the IMU: its arm turns with the attitude, at the rate of a noisy sample.
        T[POSITION, ATTITUDE] = -error_state.cross_matrix(C @ l_b)
        if not in_body:
            T[VELOCITY, ATTITUDE] -= error_state.cross_matrix(v_arm)
        T[VELOCITY, GYROSCOPE_BIAS] = C @ error_state.cross_matrix(l_b)
        P = T @ P @ T.T
        arm_rate = T[VELOCITY, GYROSCOPE_BIAS]
        P[VELOCITY, VELOCITY] += arm_rate @ self.sample_variance_w(s) @ arm_rate.T
        s["P"] = (P + P.T) / 2
        if s["imu_ns"] == NEVER:
            s["imu_ns"] = stamp_ns  # samples are missing from here on: a long wait is a gap
        s["time_ns"], s["initialised"] = stamp_ns, 1
        s["innovation_count"], s["Q_x"], s["trusted_for"] = 0, 0.0, 0
        s["nis"], s["doubt_until_ns"] = 3.0, NEVER
        self._trust_dvl(s)
        # What a channel has not shown before is in the state that was told.
        s["unseen_ns"], s["equal_ns"] = NEVER, np.maximum(s["equal_ns"], stamp_ns)

    def _body_axes(self, values: tuple[float, ...]) -> Array:
        return CONVENTIONS[self.parameters.frame_convention].body @ np.array(values)

    def await_start(self, state: Records, sample: Imu, reading: Array) -> None:
        """An uninitialised state sees a sample (base_link axes), and may start from it.

        Args:
            sample: The sample.
            reading: (6,) the same as the IMU has read it, in its axes: f, then w.
        """
        s = state[0]
        _watch_sample(state, self.constants, sample.stamp_ns, reading)
        mode = self.parameters.initial.mode
        if not np.isnan(s["lat_0"]):
            if mode == "parameters":
                self.initialise(state, self._initial, sample.stamp_ns, sample.w_ib_b)
            elif mode == "levelling":
                self._level(state, sample)
        s["imu_ns"] = s["time_ns"] = sample.stamp_ns

    def _level(self, state: Records, sample: Imu) -> None:
        """Collect the specific force at rest, f_b = -C_b_n g_n, then start from its direction.

        Behind a gap it begins anew, and where the mean is not as large as gravity.
        """
        s = state[0]
        is_gap = s["level_count"] and sample.stamp_ns - s["imu_ns"] > self.constants[0]["gap_ns"]
        if is_gap:
            self._level_again(s)
        if s["level_count"] == 0:
            s["level_ns"] = sample.stamp_ns
        s["level_f"] += sample.f_b
        s["level_count"] += 1
        duration = round(self.parameters.initial.levelling_time * NS)
        if sample.stamp_ns - s["level_ns"] < duration:
            return
        bias = self.C_b_i @ self._body_axes(self.parameters.initial.accelerometer_bias)
        f_b = s["level_f"] / s["level_count"] - bias
        g = gravity(s["lat_0"], s["h_0"])
        if abs(np.hypot.reduce(f_b) - g) > LEVEL_TOLERANCE * g:  # cannot overflow
            self._level_again(s)
            return
        roll = np.arctan2(-f_b[1], -f_b[2])
        pitch = np.arctan2(f_b[0], np.hypot(f_b[1], f_b[2]))
        C = self._initial.C_n_b
        heading = np.arctan2(C[1, 0], C[0, 0])
        initial = Initial(
            stamp_ns=sample.stamp_ns,
            C_n_b=rotation_from_rpy(np.array([roll, pitch, heading])),
            p_n=self._initial.p_n,
            v=self._initial.v,
            velocity_frame=self._initial.velocity_frame,
        )
        self.initialise(state, initial, sample.stamp_ns, sample.w_ib_b)

    def _level_again(self, s: State) -> None:
        s["level_f"], s["level_count"] = 0.0, 0
        s["not_level"] += 1

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
        _predict_part(
            state, self._workspace, self.constants, sample_ns, f_b, w_ib_b, reading, to_ns
        )

    def predict_samples(
        self,
        state: Records,
        stamps_ns: NDArray[np.int64],
        f_b: Array,
        w_ib_b: Array,
        readings: Array,
        first: int,
        last: int,
        states: Records,
    ) -> None:
        """Advance over the samples first <= k < last and keep each state in ``states[k]``.

        Args:
            stamps_ns: (N,) stamps of the samples.
            f_b: (N, 3) specific force [m/s^2], base_link axes.
            w_ib_b: (N, 3) angular rate [rad/s], base_link axes.
            readings: (N, 6) the same as the IMU has read them, in its axes: f, then w.
            states: (N,) records.
        """
        _predict_samples(
            state,
            self._workspace,
            self.constants,
            stamps_ns,
            f_b,
            w_ib_b,
            readings,
            first,
            last,
            states,
        )

    def tell_process_noise(self, state: Records, event: ProcessNoise) -> None:
        """Q is as told from the event's stamp on."""
        self.process_noise.told(state[0], event.stamp_ns, event.Q_f, event.Q_w)

    def update(self, state: Records, dvl: Dvl, w_ib_b: Array, samples: int) -> UpdateReport:
        """Correct the state, which must be at the measurement's stamp.

        Args:
            dvl: The measurement.
            w_ib_b: (3,) mean angular rate up to the stamp [rad/s], base_link axes.
            samples: Number of samples in that mean.
        """
        s = state[0]
        reason = self._lock_loss(s, dvl)
        if not s["initialised"]:
            reason = "not_initialised"
        if reason:
            return UpdateReport(np.full(3, np.nan), np.full((3, 3), np.nan), np.nan, False, reason)
        Q_w_mean = self.sample_variance_w(s) / samples
        if self._in_doubt(s):
            w_ib_b, unseen = self._seen_rate(s, w_ib_b)
            Q_w_mean += unseen
        R = (self._R_default if dvl.R is None else dvl.R) + self._l_x @ Q_w_mean @ self._l_x.T
        R = (R + R.T) / 2
        if dvl.stamp_ns < s["doubt_until_ns"]:
            R += np.outer(s["doubt"], s["doubt"])
        w = self._workspace[0]
        nis = _innovate(state, self._workspace, self.constants, dvl.v_d, w_ib_b, R)
        innovation, S = w["innovation"].copy(), w["S"].copy()
        if not np.isfinite(nis):
            reason = "bad_covariance" if np.isnan(nis) else "not_finite"
            return UpdateReport(innovation, S, nis, False, reason)
        goes_on, accepted, reason = False, True, ""
        probability = self._fault_probability(s, dvl, nis, innovation, S, R)
        if probability > 0.0:
            # With an error smaller than the filter's own sigma it still knows more than the filter.
            error = np.sqrt(probability) * s["first"]
            goes_on = probability > 0.5 and bool(error @ error > np.trace(S - R))
            if not goes_on:
                R += np.outer(error, error)
                nis = _innovate(state, self._workspace, self.constants, dvl.v_d, w_ib_b, R)
                S = w["S"].copy()
                if probability > 0.5:
                    s["doubt"] = error
                    s["doubt_until_ns"] = s["rejected_from_ns"] + s["patient_for"]
        if goes_on or nis > self._gate:
            if goes_on or nis > FAULT * self._gate:
                s["fault"], s["fault_ns"] = innovation, dvl.stamp_ns
            accepted, reason = self._recover(s, dvl, innovation, nis, R)
        else:
            if self.process_noise.tau is not None:
                s["P"] = variational(s["P"], w["H"], R, innovation, self.process_noise.tau)
                _innovate(state, self._workspace, self.constants, dvl.v_d, w_ib_b, R)
            K = self._correct(state, dvl, w_ib_b, R)
            s["nis"] += (nis - s["nis"]) / NIS_MEMORY
            self._accepted(s, dvl.stamp_ns)
            self.process_noise.innovated(s, K, innovation)
        s["dvl_ns"] = dvl.stamp_ns
        return UpdateReport(innovation, S, float(nis), accepted, reason)

    def _correct(self, state: Records, dvl: Dvl, w_ib_b: Array, R: Array) -> Array:
        """Correct with the innovation and the gain of the workspace, and return the gain (n, 3).

        After a long outage the correction can be so large that h is not linear over it: the product
        of a turn psi and a change of velocity dv is missed. Where what is left of the innovation is
        not what a linear h leaves, the update is iterated from the same prior with h at the
        corrected state (Gauss-Newton; Bell and Cathey, IEEE Transactions on Automatic Control
        38(2), 1993). `ned` is the published filter, and corrects once.
        """
        w, prior = self._workspace[0], state.copy()
        P = prior[0]["P"]
        H, K, innovation = w["H"].copy(), w["K"].copy(), w["innovation"].copy()
        T = np.eye(self.n)  # errors of the corrected state, by those of the prior that are left
        smallest, corrected, used = np.inf, state.copy(), (H, K, T)
        for _ in range(_ITERATIONS):
            dx = K @ innovation
            left = innovation - H @ dx
            _correct(state, self._workspace, self.constants, R)
            _innovate(state, self._workspace, self.constants, dvl.v_d, w_ib_b, R)
            state[0]["left"] = w["innovation"]
            bend = w["innovation"] - left
            size = bend @ bend / (np.trace(R) / 3.0)
            if size < smallest:  # should the iteration lead away, the best correction stands
                smallest, corrected, used = size, state.copy(), (H, K, T)
            if size < _BEND or not np.isfinite(size) or not self.invariant:
                break
            T = np.eye(self.n)
            T[VELOCITY, ATTITUDE] = error_state.cross_matrix(dx[VELOCITY])
            H = w["H"] @ T
            S = H @ P @ H.T + R
            if not np.linalg.det(S) > 0.0:  # lost in rounding
                break
            K = np.linalg.solve(S, H @ P).T
            innovation = w["innovation"] + H @ dx
            w["H"], w["K"], w["innovation"] = H, K, innovation
            state[:] = prior
        state[:] = corrected
        H, K, T = used
        if T[VELOCITY, ATTITUDE].any():
            # Joseph form with T inside, where large numbers cancel before they are squared.
            A, B = T @ (np.eye(self.n) - K @ H), T @ K
            P = A @ P @ A.T + B @ R @ B.T
            state[0]["P"] = (P + P.T) / 2
        return K

    def sample_variance_w(self, s: State) -> Array:
        """Variance (3, 3) of one angular rate sample [(rad/s)^2], whatever Q's convention is."""
        c = self.constants[0]
        return s["Q_w"] * (c["density"] * c["rate"])

    @staticmethod
    def _in_doubt(s: State) -> bool:
        """Whether a channel of the IMU is saturated or frozen."""
        return bool((s["unseen_ns"] != NEVER).any())

    def _seen_rate(self, s: State, w_ib_b: Array) -> tuple[Array, Array]:
        """The rate without that of frozen channels, and the variance (3, 3) of what is not seen."""
        least, c = self.parameters.imu.frozen_samples, self.constants[0]
        unseen = s["unseen_ns"][3:] != NEVER
        frozen = unseen & (s["equal"][3:] + 1 >= least) & (least > 0)
        sigma = unseen * [unseen_sigma(c, s["reading"], i) for i in (3, 4, 5)]
        C = self.C_b_i
        w = np.where(frozen, C.T @ s["b_w"], C.T @ w_ib_b)
        return C @ w, C @ np.diag(sigma**2) @ C.T

    def _lock_loss(self, s: State, dvl: Dvl) -> str:
        """What says that the DVL has not measured: ``no_lock``, ``repeated``; else nothing."""
        if not self.parameters.dvl.lock_check:
            return ""
        repeated = bool((dvl.v_d == s["v_d"]).all())
        s["v_d"] = dvl.v_d
        if not dvl.v_d.any():
            return "no_lock"
        return "repeated" if repeated else ""

    def _fault_probability(
        self, s: State, dvl: Dvl, nis: float, innovation: Array, S: Array, R: Array
    ) -> float:
        """That a measurement has the error of those before it, if one of the two it is.

        The uncertainty grows while the DVL is rejected, until what was an error fits as well. But
        an error that goes on repeats the last innovation, to within the noise of the DVL and what
        the IMU may have drifted in between. The likelihoods of the two explanations are compared.
        """
        known = s["fault_ns"] != NEVER and not self._in_doubt(s)
        if not known or dvl.stamp_ns - s["rejected_from_ns"] >= s["patient_for"]:
            return 0.0
        S_step = self._step_covariance(s, dvl.stamp_ns - int(s["fault_ns"]), R)
        step = innovation - s["fault"]
        of_fault = step @ np.linalg.solve(S_step, step) + np.linalg.slogdet(S_step)[1]
        of_good = nis + np.linalg.slogdet(S)[1]
        return float(expit((of_good - of_fault) / 2.0))

    def _step_covariance(self, s: State, interval_ns: int, R: Array) -> Array:
        """Covariance (3, 3) of the step between two innovations, nothing corrected in between.

        That of the noise of two measurements, and of the IMU's drift over the interval [ns].
        """
        dt = interval_ns / NS
        C, P, Q_f = s["C_n_b"], s["P"], s["Q_f"]
        g_x = error_state.cross_matrix(self._workspace[0]["g_n"])
        acceleration = g_x @ P[ATTITUDE, ATTITUDE] @ g_x.T
        acceleration += C @ P[ACCELEROMETER_BIAS, ACCELEROMETER_BIAS] @ C.T
        drift = dt**2 * acceleration + dt * self.constants[0]["density"] * (C @ Q_f @ C.T)
        C_n_d = C @ self.C_b_d
        # The last term, far below all noise, gives an R that is singular an inverse.
        return 2.0 * R + C_n_d.T @ drift @ C_n_d + 1e-9 * np.trace(R) * np.eye(3)

    def _step_nis(self, s: State, step: Array, interval_ns: int, R: Array) -> float:
        """Of the step between two innovations: beyond the gate it is one that the IMU missed."""
        return float(step @ np.linalg.solve(self._step_covariance(s, interval_ns, R), step))

    def _patience(self, s: State, stamp_ns: int, innovation: Array, R: Array) -> int:
        """How long [ns] the filter may reject from this measurement on.

        A step that the IMU did not see is the DVL's, and then as long as the DVL has borne the
        filter out before. Else the filter has drifted, or its own covariance is wrong.
        """
        if s["accepted_ns"] == NEVER:
            return 0
        interval_ns = stamp_ns - int(s["accepted_ns"])
        # Behind an outage, or a gap, nobody has seen whether there was a step.
        seen = interval_ns <= LEAST_PATIENCE_NS and not self._has_gap(s)
        if seen and self._step_nis(s, innovation - s["left"], interval_ns, R) > self._gate:
            return int(s["trusted_for"])
        return min(LEAST_PATIENCE_NS, int(s["trusted_for"]))

    def _has_gap(self, s: State) -> bool:
        """Whether samples are missing since the last accepted measurement."""
        open_ns = s["time_ns"] - s["imu_ns"]
        return bool(s["gap_ns"] > s["accepted_ns"] or open_ns > self.constants[0]["gap_ns"])

    def _wanders(self, s: State, stamp_ns: int, innovation: Array, R: Array) -> bool:
        """Whether the innovations wander: then it is the filter that does.

        An error of the DVL that goes on would repeat itself, and outliers, each for itself, would
        be as far from each other as from the truth. They wander by steps that the IMU missed, or
        by a drift since the first of them that is too unlikely beside an error of the DVL: one
        error of the filter, as unlikely as the first innovation, explains both.
        """
        step = innovation - s["rejected"]
        small = np.hypot.reduce(step) < np.hypot.reduce(innovation) / 2.0  # cannot overflow
        if not small:
            return False
        drift = innovation - s["first"]
        surprise = self._step_nis(s, drift, stamp_ns - int(s["rejected_from_ns"]), R) - len(drift)
        drifts = s["first_nis"] < self._gate + surprise
        if not drifts and self._step_nis(s, step, stamp_ns - int(s["rejected_ns"]), R) < self._gate:
            return False
        again = s["wandered_ns"] != NEVER and stamp_ns - s["wandered_ns"] <= LEAST_PATIENCE_NS
        s["wandered_ns"] = stamp_ns
        return bool(again)

    def _accepted(self, s: State, stamp_ns: int) -> None:
        if s["accepted_ns"] != NEVER:
            since_ns = stamp_ns - int(s["accepted_ns"])
            steady = since_ns <= LEAST_PATIENCE_NS and not s["rejections"]
            # What was contradicted, or not looked at, counts double against the filter.
            trust_ns = int(s["trusted_for"]) + (since_ns if steady else -2 * since_ns)
            honest = s["nis"] <= NIS_LIMIT and not self._in_doubt(s)
            s["trusted_for"] = min(max(trust_ns, 0), self._patience_ns) if honest else 0
        s["accepted_ns"] = stamp_ns
        self._trust_dvl(s)

    def _trust_dvl(self, s: State) -> None:
        s["rejections"] = 0
        s["rejected_from_ns"] = s["rejected_ns"] = s["wandered_ns"] = s["fault_ns"] = NEVER

    def _recover(
        self, s: State, dvl: Dvl, innovation: Array, nis: float, R: Array
    ) -> tuple[bool, str]:
        """Reject, but not for ever: inflate the velocity covariance, then restart the velocity.

        A filter that nothing has borne out yet, or whose NIS say that it is too sure of itself, has
        no patience: it rejects once.
        """
        if s["rejections"] == 0:
            s["rejected_from_ns"] = s["rejected_ns"] = dvl.stamp_ns
            s["patient_for"] = self._patience(s, dvl.stamp_ns, innovation, R)
            s["first"], s["first_nis"] = innovation, nis
        since_ns = dvl.stamp_ns - int(s["rejected_from_ns"])
        if s["rejections"] and self._wanders(s, dvl.stamp_ns, innovation, R):
            s["patient_for"] = min(int(s["patient_for"]), since_ns)
        before_ns = int(s["rejected_ns"]) - int(s["rejected_from_ns"])
        inflated = s["rejections"] > 0 and before_ns >= s["patient_for"]
        s["rejections"] += 1
        s["rejected"], s["rejected_ns"] = innovation, dvl.stamp_ns
        # An IMU that is in doubt itself has no patience to ask for.
        in_doubt = self._in_doubt(s)
        if in_doubt or (not inflated and since_ns >= s["patient_for"]):
            self._inflate(s, dvl.stamp_ns, innovation)
        if in_doubt or not inflated or since_ns < 2 * s["patient_for"]:
            return False, "gate"
        # Velocity from this measurement alone, independent of all else; as uncertain as the two
        # are apart, for one of them is wrong.
        C_n_d = s["C_n_b"] @ self.C_b_d
        s["v_n"] += C_n_d @ innovation
        P = s["P"]
        P[VELOCITY, :] = 0.0
        P[:, VELOCITY] = 0.0
        T = error_state.from_ordinary_errors(
            s["C_n_b"], s["v_n"], invariant=self.invariant, velocity_frame="body", n=self.n
        )
        doubt = R + np.outer(innovation, innovation)
        P[VELOCITY, VELOCITY] = self.C_b_d @ doubt @ self.C_b_d.T
        P[:] = T @ P @ T.T
        P[:] = (P + P.T) / 2
        s["left"] = 0.0
        self._accepted(s, dvl.stamp_ns)
        s["restarts"] += 1
        return True, "restarted"

    def _inflate(self, s: State, stamp_ns: int, innovation: Array) -> None:
        """Doubt the velocity, and the tilt that may have led it astray since it last fitted.

        A tilt error psi drives the velocity by [g x] psi; the one that makes the innovation in the
        time that has passed is one sigma.
        """
        variance = float(innovation @ innovation)
        s["P"][VELOCITY, VELOCITY] += np.eye(3) * variance
        # A channel that is in doubt has its own explanation.
        known = s["accepted_ns"] != NEVER and stamp_ns > s["accepted_ns"]
        if known and not self._in_doubt(s):
            g_n = self._workspace[0]["g_n"]
            seconds = (stamp_ns - int(s["accepted_ns"])) / NS
            sigma = min(np.sqrt(variance) / (np.linalg.norm(g_n) * seconds), LARGEST_TILT_DOUBT)
            A = np.zeros((self.n, 2))  # of the turns about north and east
            A[ATTITUDE] = np.eye(3)[:, :2]
            A[VELOCITY] = seconds * error_state.cross_matrix(g_n)[:, :2]
            s["P"] += sigma**2 * (A @ A.T)
        s["trusted_for"] = 0
        s["inflations"] += 1


def _or_isotropic(P: Array | None, std: float) -> Array:
    return np.eye(3) * std**2 if P is None else P
