"""F, Phi, G, H, the injection and the changes of coordinates against the code that they stand for.

Derivatives are central differences of nine points with large steps, through the definition of the
error: C_true = exp([psi x]) C, v_true = v + dv or exp([psi x]) v + dv, p_true = p + dp or
r + exp([psi x]) (p - r) + dp, and sums for all else.
"""

from itertools import product

import numpy as np
import pytest
from oracle import skew, van_loan
from places import moved
from scipy.spatial.transform import Rotation

from insdvl.navigation import coordinates, error_state
from insdvl.navigation.error_state import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    GYROSCOPE_BIAS,
    POSITION,
    VELOCITY,
)
from insdvl.navigation.events import NS
from insdvl.navigation.filter import LAYOUT, Filter
from insdvl.navigation.geometry import earth
from insdvl.navigation.geometry.earth import displacements
from insdvl.navigation.measurements.base import Turn
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import (
    DvlParameters,
    FilterParameters,
    ImuParameters,
    OriginParameters,
    ProcessNoiseParameters,
)
from insdvl.navigation.prediction import strapdown
from insdvl.navigation.state.scratch import workspace_type

MODELS = ("invariant", "ned")
DVL_ERROR, DVL_MOUNT = slice(15, 18), slice(18, 21)
WEIGHTS = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
STEPS = (
    (VELOCITY, 1.0),
    (ATTITUDE, 0.1),
    (ACCELEROMETER_BIAS, 1.0),
    (GYROSCOPE_BIAS, 0.1),
    (POSITION, 1000.0),
    (DVL_ERROR, 0.1),
    (DVL_MOUNT, 0.1),
)
NOMINAL = ("C_n_b", "v_n", "b_f", "b_w", "llh", "llh_r", "optional")


def random_spd(rng, scale):
    root = rng.standard_normal((3, 3))
    return scale * (root @ root.T + 0.3 * np.eye(3))


class Case:
    """A filter at a random state."""

    def __init__(
        self,
        model,
        seed,
        *,
        speed=4.0,
        lat_deg=None,
        bias_model="none",
        mount_std=0.0,
        earth_rate=True,
    ):
        rng = np.random.default_rng(seed)
        lat_deg = rng.uniform(-79.0, 79.0) if lat_deg is None else lat_deg
        self.filter = Filter(
            FilterParameters(
                frame_convention="ned",
                error_state=model,
                earth_rate=earth_rate,
                origin=OriginParameters(latitude_deg=float(lat_deg), height=-50.0),
                imu=ImuParameters(lever_arm=(0.3, -0.2, 0.1), mount=(0.1, -0.2, 0.3)),
                dvl=DvlParameters(
                    lever_arm=(-0.8, 0.5, 1.1),
                    mount=(0.02, -0.3, 0.8),
                    bias_model=bias_model,
                    mount_std=(mount_std,) * 3,
                ),
                process_noise=ProcessNoiseParameters(
                    accelerometer_bias_walk=3e-4, gyroscope_bias_walk=2e-5
                ),
            )
        )
        self.invariant = model == "invariant"
        self.n = self.filter.n
        self.constants = self.filter.constants[0]
        self.workspace = np.zeros(1, workspace_type(LAYOUT.size))[0]
        origin = np.array([np.radians(lat_deg), 0.0, -50.0])
        self.nominal = {
            "C_n_b": Rotation.from_rotvec(3.0 * unit(rng)).as_matrix(),
            "v_n": speed * unit(rng),
            "b_f": rng.uniform(-0.1, 0.1, 3),
            "b_w": rng.uniform(-0.01, 0.01, 3),
            "llh": moved(origin, rng.uniform(-20.0, 20.0, 3)),
            "llh_r": moved(origin, [5.0, -3.0, 2.0]),
            "optional": optional(rng.uniform(-0.1, 0.1, 3 if self.n < 21 else 6)),
        }
        self.f_b = np.array([0.0, 0.0, -9.8]) + rng.uniform(-2.0, 2.0, 3)
        self.w_ib_b = rng.uniform(-0.3, 0.3, 3)
        self.Q_f, self.Q_w = random_spd(rng, 1e-4), random_spd(rng, 1e-5)

    def record(self, nominal):
        state = self.filter.empty()
        for name in NOMINAL:
            state[0]["nav"][name] = nominal[name]
        return state

    def plus(self, nominal, x):
        """The true state that differs by the error x from the nominal one."""
        tilt, heading = self.turns(x[ATTITUDE])
        x_n = displacements(nominal["llh_r"], nominal["llh"])
        return {
            "C_n_b": heading @ tilt @ nominal["C_n_b"],
            "v_n": self.turned(nominal["v_n"], x[ATTITUDE], x[VELOCITY]),
            "b_f": nominal["b_f"] + x[ACCELEROMETER_BIAS],
            "b_w": nominal["b_w"] + x[GYROSCOPE_BIAS],
            "llh": moved(nominal["llh"], self.turned(x_n, x[ATTITUDE], x[POSITION]) - x_n),
            "llh_r": nominal["llh_r"],
            "optional": nominal["optional"] + optional(x[15:]),
        }

    def turns(self, psi):
        """R_t and R_h for `invariant`; for `ned` the rotation by psi and none."""
        if not self.invariant:
            return Rotation.from_rotvec(psi).as_matrix(), np.eye(3)
        down = np.array([0.0, 0.0, 1.0])
        tilt = Rotation.from_rotvec(psi - psi[2] * down)
        return tilt.as_matrix(), Rotation.from_rotvec(psi[2] * down).as_matrix()

    def turned(self, a, psi, da):
        """A vector with its error: R_h (R_t a + da) for `invariant`, a + da for `ned`."""
        if not self.invariant:
            return a + da
        tilt, heading = self.turns(psi)
        return heading @ (tilt @ a + da)

    def ordinary(self, J):
        """J (..., n) with the derivatives by psi taken at the position, not at dp_i.

        What is left out of a matrix in the columns of position comes back in those of the attitude,
        since dp = dp_i - [x x] psi.
        """
        J = J.copy()
        if self.invariant:
            x_n = displacements(self.nominal["llh_r"], self.nominal["llh"])
            J[..., ATTITUDE] += J[..., POSITION] @ skew(x_n)
        return J

    def minus(self, true, nominal):
        """The error (n,) by which a true state differs from a nominal one."""
        x = np.zeros(self.n)
        turn = true["C_n_b"] @ nominal["C_n_b"].T
        if self.invariant:
            # R_h R_t: the first of the extrinsic rotations that ends about down
            tilted = np.cross(turn.T @ [0.0, 0.0, 1.0], [0.0, 0.0, 1.0])
            size = np.linalg.norm(tilted)
            x[ATTITUDE] = np.arcsin(size) / size * tilted if size > 0.0 else 0.0
            heading = turn @ Rotation.from_rotvec(x[ATTITUDE]).as_matrix().T
            x[ATTITUDE.stop - 1] = Rotation.from_matrix(heading).as_rotvec()[2]
        else:
            x[ATTITUDE] = Rotation.from_matrix(turn).as_rotvec()
        tilt, heading = self.turns(x[ATTITUDE])
        back = heading.T
        nominal_v = nominal["v_n"] if not self.invariant else tilt @ nominal["v_n"]
        x[VELOCITY] = back @ true["v_n"] - nominal_v
        x[ACCELEROMETER_BIAS] = true["b_f"] - nominal["b_f"]
        x[GYROSCOPE_BIAS] = true["b_w"] - nominal["b_w"]
        way = displacements(nominal["llh"], true["llh"])
        x_n = displacements(nominal["llh_r"], nominal["llh"])
        x[POSITION] = back @ (x_n + way) - tilt @ x_n if self.invariant else way
        x[15:] = (true["optional"] - nominal["optional"])[: self.n - 15]
        return x

    def jacobian(self, function):
        """Derivative (..., n) of an array-valued function of the error at zero."""
        columns = []
        for block, step in STEPS:
            for i in range(block.start, min(block.stop, self.n)):
                column = 0.0
                for k, weight in enumerate(WEIGHTS, start=1):
                    x = np.zeros(self.n)
                    x[i] = k * step
                    column = column + weight / step * (function(x) - function(-x))
                columns.append(column)
        return np.array(columns).T

    def moved(self, nominal, dt, f_b=None, w_ib_b=None):
        """The state after a step of the mechanisation; the workspace is that of the step."""
        state = self.record(nominal)
        f_b = (self.f_b if f_b is None else f_b) - nominal["b_f"]
        w_ib_b = (self.w_ib_b if w_ib_b is None else w_ib_b) - nominal["b_w"]
        strapdown.mechanise(state[0], self.workspace, self.constants, f_b, w_ib_b, dt)
        return {name: state[0]["nav"][name].copy() for name in NOMINAL}

    def transition(self, dt):
        """Phi as the mechanisation has it, (n, n), from differences."""
        after = self.moved(self.nominal, dt)
        return self.jacobian(
            lambda x: self.minus(self.moved(self.plus(self.nominal, x), dt), after)
        )

    def model(self, dt):
        """F and Phi of the filter for that step."""
        self.moved(self.nominal, dt)
        state = self.record(self.nominal)[0]  # P is zero
        error_state.transition(state, self.workspace, self.constants, dt)
        used = slice(0, self.n)
        return self.workspace["F"][used, used].copy(), self.workspace["Phi"][used, used].copy()

    def linearised(self, nominal, v_d):
        """The DVL's measurement at a state, with a turn rate that is known."""
        turn = Turn(self.w_ib_b, np.zeros((3, 3)))
        return self.filter.models["dvl"].linearise(self.record(nominal), Dvl(1, v_d), turn)

    def innovation(self, nominal, v_d):
        return self.linearised(nominal, v_d).z_minus_h

    @property
    def C_d_b(self):  # noqa: N802
        mount = Rotation.from_euler("xyz", self.filter.parameters.dvl.mount)
        return mount.as_matrix().T

    @property
    def l_b(self):
        return np.subtract(
            self.filter.parameters.dvl.lever_arm, self.filter.parameters.imu.lever_arm
        )


def optional(values):
    """Values of the optional states that are in use: the DVL's error, its mount."""
    states = np.zeros(LAYOUT.size - 15)
    states[: len(values)] = values
    return states


def unit(rng):
    x = rng.standard_normal(3)
    return x / np.linalg.norm(x)


@pytest.fixture(params=MODELS)
def model(request):
    return request.param


@pytest.mark.parametrize("seed", range(5))
def test_dynamics(model, seed):
    """(Phi - I) / dt over 2e-5 s; the columns of position are in the next test.

    The rows of position hold that on the equator, where an angle near zero is not rounded to 1e-9 m
    and meridians are parallel; elsewhere those leave out x tan(lat) / R. That x grows by v they
    have but for x v / R, the curvature of the Earth over 20 m.
    """
    dt, keep = 2e-5, np.r_[0:12]
    for lat_deg, rows in ((None, np.r_[0:12]), (0.0, np.r_[0:15])):
        case = Case(model, seed, lat_deg=lat_deg)
        F, Phi = (M[np.ix_(rows, keep)] for M in case.model(dt))
        one = np.eye(15)[np.ix_(rows, keep)]
        measured = case.ordinary(case.transition(dt) - np.eye(15))[np.ix_(rows, keep)] / dt
        x_n = displacements(case.nominal["llh_r"], case.nominal["llh"])
        allowed = np.full(measured.shape, 1e-8)
        curved = np.linalg.norm(x_n) * np.linalg.norm(case.nominal["v_n"]) / 6.37e6
        allowed[12:, ATTITUDE] += curved if case.invariant else 0.0
        assert (abs(measured - (Phi - one) / dt) < allowed).all()
        np.testing.assert_allclose(measured, F, atol=1e-3)  # Phi is that of F


@pytest.mark.parametrize("seed", range(5))
def test_the_curvature_that_the_rows_of_position_leave_out_is_small(model, seed):
    """Position over a step, by velocity and attitude: 20 m from the reference, up to 79 deg."""
    case, dt = Case(model, seed), 0.01
    _, Phi = case.model(dt)
    left_out = case.ordinary(case.transition(dt) - Phi)[POSITION, VELOCITY] / dt
    x_n = displacements(case.nominal["llh_r"], case.nominal["llh"])
    tangent = abs(np.tan(case.nominal["llh"][0]))
    assert abs(left_out).max() < 1e-6 + 2.0 * np.linalg.norm(x_n) * tangent / 6.37e6


def test_what_is_left_out_of_the_dynamics_is_small(model):
    """The columns of position at 20 m/s and 80 deg: gravity's gradient leads, but for position
    itself, which a convergence of the meridians by v tan(lat) / R moves.
    """
    largest, dt = 0.0, 0.01
    for seed in range(10):
        case = Case(model, seed, speed=20.0, lat_deg=(-80.0, 80.0)[seed % 2])
        F, _ = case.model(dt)
        assert not F[:, POSITION].any()
        left_out = (case.transition(dt) - np.eye(15))[:, POSITION] / dt
        assert abs(left_out[2, 2]) == pytest.approx(3.08e-6, rel=0.01)
        largest = max(largest, abs(left_out[:12]).max())
        assert abs(left_out[POSITION]).max() < 20.0 * np.tan(np.radians(80.0)) / 6.37e6
    assert largest < 3.2e-6


def test_transition_is_of_second_order(model):
    """The error of Phi over one step falls with the third power of the step."""
    for seed, (lat_deg, rows) in product(range(3), ((None, 12), (0.0, 15))):  # see test_dynamics
        case = Case(model, seed, bias_model="gauss_markov", lat_deg=lat_deg)
        keep = np.r_[0:12]
        errors = []
        for dt in (0.02, 0.01, 0.005):
            _, Phi = case.model(dt)
            left = abs(case.ordinary(case.transition(dt) - Phi))[:rows, keep]
            left[12:, ATTITUDE] -= np.minimum(left[12:, ATTITUDE], 1e-5 * dt)  # x v / R
            errors.append(left.max())
        orders = np.log2(np.divide(errors[:-1], errors[1:]))
        assert (orders > 2.8).all(), (orders, errors)
        assert errors[1] < 5e-6


def test_transition_of_the_dvl_error():
    case, dt = Case("invariant", 0, bias_model="gauss_markov"), 0.05
    _, Phi = case.model(dt)
    np.testing.assert_allclose(
        Phi[DVL_ERROR, DVL_ERROR], np.exp(-dt / 10.0) * np.eye(3), atol=1e-15
    )
    assert not Phi[:15, DVL_ERROR].any()
    assert not Phi[DVL_ERROR, :15].any()

    # The estimate goes the same way: without measurements nothing is known of an old error.
    state = case.record(case.nominal)
    state[0]["nav"]["time_ns"], state[0]["channels"]["imu_ns"] = NS, NS
    end_ns = NS + round(dt * NS)
    case.filter.predict_part(
        state, end_ns, case.f_b, case.w_ib_b, np.hstack([case.f_b, case.w_ib_b]), end_ns
    )
    np.testing.assert_allclose(
        state[0]["nav"]["optional"], np.exp(-dt / 10.0) * case.nominal["optional"], rtol=1e-12
    )


@pytest.mark.parametrize(
    ("bias_model", "mount_std"), [("none", 0.0), ("gauss_markov", 0.0), ("gauss_markov", 0.1)]
)
@pytest.mark.parametrize("seed", range(5))
def test_measurement(model, seed, bias_model, mount_std):
    """H is the derivative of h, but for the transport rate in w_nb: 1e-7 per metre of arm."""
    case = Case(model, seed, bias_model=bias_model, mount_std=mount_std)
    measured = -case.jacobian(lambda x: case.innovation(case.plus(case.nominal, x), np.zeros(3)))
    H = case.linearised(case.nominal, np.zeros(3)).H

    W_v = np.zeros((3, 3))
    lat, _, height = case.nominal["llh"]
    a, b, c = earth.transport_rate_coefficients(lat, height)
    W_v[0, 1], W_v[1, 0], W_v[2, 1] = a, b, c
    C_b_n, l_b = case.nominal["C_n_b"].T, case.l_b
    left_out = np.zeros((3, case.n))
    C_d_b = case.C_d_b
    if mount_std:
        C_d_b = Rotation.from_rotvec(-case.nominal["optional"][3:6]).as_matrix() @ C_d_b
    left_out[:, VELOCITY] = C_d_b @ skew(l_b) @ C_b_n @ W_v
    if case.invariant:
        left_out[:, ATTITUDE] = -left_out[:, VELOCITY] @ skew(case.nominal["v_n"])
    assert abs(left_out).max() < 1e-5

    keep = np.delete(np.arange(case.n), np.arange(case.n)[POSITION])
    np.testing.assert_allclose(measured[:, keep], (H + left_out)[:, keep], atol=1e-8)
    assert not H[:, POSITION].any()
    assert abs(measured[:, POSITION]).max() < 1e-10


def test_measurement_is_the_velocity_at_the_dvl():
    """h from the definition, with the arm between IMU and DVL and the Earth rate taken out."""
    case = Case("invariant", 7, bias_model="gauss_markov")
    v_d = np.array([0.3, 0.2, -0.1])
    innovation = case.innovation(case.nominal, v_d)
    C_n_b, mount = case.nominal["C_n_b"], Rotation.from_euler("xyz", [0.02, -0.3, 0.8])
    arm = np.array([-0.8, 0.5, 1.1]) - [0.3, -0.2, 0.1]
    rate = 7.292115e-5
    lat = np.radians(case.filter.parameters.origin.latitude_deg)
    w_in_n = rate * np.array([np.cos(lat), 0.0, -np.sin(lat)])  # transport rate: below 1e-5
    w_nb_b = case.w_ib_b - case.nominal["b_w"] - C_n_b.T @ w_in_n
    v_b = C_n_b.T @ case.nominal["v_n"] + np.cross(w_nb_b, arm)
    expected = v_d - mount.as_matrix().T @ v_b - case.nominal["optional"][:3]
    np.testing.assert_allclose(innovation, expected, atol=1e-5)


def test_an_estimated_mount_adds_to_that_of_the_parameters():
    """v_d = exp(-[m x]) C_d_b (...): the DVL is turned by m about its own axes."""
    case = Case("invariant", 7, bias_model="gauss_markov", mount_std=0.1)
    none = dict(case.nominal, optional=optional(case.nominal["optional"][:3]))
    v_d = np.array([0.3, 0.2, -0.1])
    b_d, m = none["optional"][:3], case.nominal["optional"][3:6]
    h = v_d - case.innovation(none, v_d) - b_d
    turned = v_d - case.innovation(case.nominal, v_d) - b_d
    np.testing.assert_allclose(turned, Rotation.from_rotvec(m).as_matrix().T @ h, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_input_noise(model, seed):
    """Q_d / dt is G Q G^T with G the response of the step to the samples' errors."""
    case, dt = Case(model, seed, lat_deg=0.0), 1e-5  # see test_dynamics
    case.model(dt)
    error_state.input_noise(
        case.record(case.nominal)[0], case.workspace, case.constants, case.Q_f, case.Q_w, dt
    )
    Q_d = case.workspace["Q_d"][:15, :15].copy()
    after = case.moved(case.nominal, dt)
    G = np.zeros((15, 12))
    for i, axis in enumerate(np.eye(3)):
        moved_f = case.moved(case.nominal, dt, f_b=case.f_b + axis)
        moved_w = case.moved(case.nominal, dt, w_ib_b=case.w_ib_b + 1e-3 * axis)
        G[:, i] = case.minus(moved_f, after) / dt
        G[:, 3 + i] = case.minus(moved_w, after) / dt / 1e-3
    G[ACCELEROMETER_BIAS, 6:9] = G[GYROSCOPE_BIAS, 9:12] = np.eye(3)
    Q = np.zeros((12, 12))
    Q[:3, :3], Q[3:6, 3:6] = case.Q_f, case.Q_w
    Q[6:9, 6:9], Q[9:12, 9:12] = 3e-4 * np.eye(3), 2e-5 * np.eye(3)
    # Position hears of it over half a step: 5e-6 s times the velocity's.
    np.testing.assert_allclose(Q_d / dt, G @ Q @ G.T, atol=1e-7)


def test_dvl_error_keeps_its_stationary_variance():
    """Whatever the step: it is a stationary process."""
    for dt in (0.001, 0.01, 0.1):
        case = Case("invariant", 1, bias_model="gauss_markov")
        case.model(dt)
        state = case.record(case.nominal)[0]
        error_state.input_noise(state, case.workspace, case.constants, case.Q_f, case.Q_w, dt)
        P = np.eye(LAYOUT.size) * case.constants["variance"][0]
        error_state.propagate(P, case.workspace, case.n)
        variance = np.diagonal(P)[DVL_ERROR]
        np.testing.assert_allclose(variance, case.constants["variance"][:3], rtol=1e-12)


@pytest.mark.parametrize("bias_model", ["none", "gauss_markov"])
def test_covariance_over_a_step(model, bias_model):
    """Phi (P + Q_d / 2) Phi^T + Q_d / 2 is, to second order, what the matrix exponential gives."""
    case = Case(model, 3, bias_model=bias_model)
    n, errors = case.n, []
    rng = np.random.default_rng(4)
    root = rng.standard_normal((n, n))
    P_0 = root @ root.T * 1e-4
    for dt in (0.04, 0.02, 0.01):
        F, _ = case.model(dt)
        state = case.record(case.nominal)[0]
        error_state.input_noise(state, case.workspace, case.constants, case.Q_f, case.Q_w, dt)
        noise = case.workspace["Q_d"][:n, :n] / dt
        if n > 15:
            F[DVL_ERROR, DVL_ERROR] = -0.1 * np.eye(3)
            noise[DVL_ERROR, DVL_ERROR] = 0.2 * case.constants["variance"][0] * np.eye(3)
        Phi, Q_d = van_loan(F, noise, dt)
        room = np.zeros((LAYOUT.size, LAYOUT.size))
        room[:n, :n] = P_0
        error_state.propagate(room, case.workspace, n)
        P = room[:n, :n]
        np.testing.assert_array_equal(P, P.T)
        errors.append(abs(P - Phi @ P_0 @ Phi.T - Q_d).max())
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert (orders > 2.8).all(), (orders, errors)


def test_injection_moves_by_the_error(model):
    """The nominal state becomes the true one, for large errors too."""
    case = Case(model, 5, bias_model="gauss_markov")
    x = np.random.default_rng(6).uniform(-0.5, 0.5, 18)
    state = case.record(case.nominal)
    coordinates.inject(state[0], case.constants, x)
    expected = case.plus(case.nominal, x)
    for name in NOMINAL:
        np.testing.assert_allclose(state[0]["nav"][name], expected[name], atol=1e-13, err_msg=name)


@pytest.mark.parametrize("eta", [0.3, 2.0, -3.0])
def test_a_heading_error_of_any_size_is_in_neither_motion_nor_measurement(eta):
    """Without the Earth's rotation: the other errors go on, and are measured, as without it.

    The vehicle is elsewhere, at another height of the path behind it: x v dt / R of the position.
    """
    case, dt = Case("invariant", 10, lat_deg=0.0, earth_rate=False), 0.01
    x = np.random.default_rng(11).uniform(-0.1, 0.1, case.n)
    turned = x.copy()
    x[ATTITUDE.stop - 1], turned[ATTITUDE.stop - 1] = 0.0, eta
    after, v_d = case.moved(case.nominal, dt), np.zeros(3)
    one, other = (
        case.minus(case.moved(case.plus(case.nominal, e), dt), after) for e in (x, turned)
    )
    allowed = np.full(case.n, 1e-12)
    allowed[POSITION] = 2.0 * 40.0 * 4.0 * dt / 6.37e6
    assert (abs(other - one - (turned - x)) < allowed).all()
    one, other = (case.innovation(case.plus(case.nominal, e), v_d) for e in (x, turned))
    np.testing.assert_allclose(other, one, rtol=0.0, atol=1e-12)


def test_what_remains_behind_a_correction():
    """Of the errors, by those before: at a large heading, velocity and position, without tilt."""
    case = Case("invariant", 12, lat_deg=0.0)
    dx = np.zeros(case.n)
    dx[VELOCITY], dx[POSITION], dx[ATTITUDE.stop - 1] = (3.0, -4.0, 0.5), (80.0, -60.0, 5.0), 2.0
    corrected = case.plus(case.nominal, dx)
    measured = case.jacobian(lambda e: case.minus(case.plus(case.nominal, dx + e), corrected))
    allowed = np.full(measured.shape, 1e-8)
    allowed[POSITION] = 100.0 * 100.0 / 6.37e6  # a path of 100 m that tilts, on a round Earth
    allowed[POSITION, POSITION] = 100.0 / 6.37e6
    assert (abs(coordinates.remaining(dx) - measured) < allowed).all()


@pytest.mark.parametrize("velocity_frame", ["body", "nav"])
def test_initial_errors_to_those_of_the_model(model, velocity_frame):
    """A true state with an error in the declared velocity, in the model's coordinates."""
    case = Case(model, 8)
    C_n_b, v_n = case.nominal["C_n_b"], case.nominal["v_n"]
    x_n = displacements(case.nominal["llh_r"], case.nominal["llh"])

    def error(x):
        true = case.plus(case.nominal, x)
        true["llh"] = moved(case.nominal["llh"], x[POSITION])
        if velocity_frame == "body":
            true["v_n"] = true["C_n_b"] @ (C_n_b.T @ v_n + x[VELOCITY])
        else:
            true["v_n"] = v_n + x[VELOCITY]
        return case.minus(true, case.nominal)

    T = coordinates.from_ordinary_errors(
        C_n_b, v_n, x_n, invariant=case.invariant, velocity_frame=velocity_frame, n=15
    )
    np.testing.assert_allclose(T, case.jacobian(error), atol=1e-8)


def test_body_velocity_jacobian(model):
    case = Case(model, 9, bias_model="gauss_markov")
    C_n_b, v_n = case.nominal["C_n_b"], case.nominal["v_n"]

    def body_velocity(x):
        true = case.plus(case.nominal, x)
        return true["C_n_b"].T @ true["v_n"]

    J = coordinates.body_velocity_jacobian(C_n_b, v_n, invariant=case.invariant, n=18)
    np.testing.assert_allclose(J, case.jacobian(body_velocity), atol=1e-8)
    many = coordinates.body_velocity_jacobian(
        np.stack([np.eye(3), C_n_b]), np.stack([-v_n, v_n]), invariant=case.invariant, n=18
    )
    np.testing.assert_array_equal(many[1], J)
