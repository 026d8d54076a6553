"""Noise that the IMU shows and that the filter is not told, behind the verdicts of the gate."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.stats import chi2

from insdvl.arrays import Array
from insdvl.navigation.error_state import ATTITUDE, POSITION, VELOCITY
from insdvl.navigation.events import NS, Event
from insdvl.navigation.geometry.earth import displacement
from insdvl.navigation.geometry.rotation import cross_matrix
from insdvl.navigation.measurements.depth import Depth
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import (
    DepthParameters,
    DvlParameters,
    FilterParameters,
    GateParameters,
    OriginParameters,
    ProcessNoiseParameters,
)
from insdvl.navigation.process_noise.between_pings import (
    add_noise,
    add_noise_of_position,
    set_transition,
    set_transition_of_position,
)
from insdvl.navigation.state.fields import CORE
from insdvl.simulation.initial_errors import P_0, drawn_initial
from insdvl.simulation.mission import ImuModel, Mission, simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.trajectories import AUV
from insdvl.timeline.output import FoldResult
from insdvl.timeline.recorded import fold_arrays

SEED = 5_772
TOLD, TRUE = (1e-4, 1e-5), (1e-2, 1e-4)  # variances of specific force and angular rate
DVL_STD, DEPTH_STD = 0.05, 0.02


def mission(seed: int, duration: float, **dvl: float) -> Mission:
    variances = [TRUE[0]] * 3 + [TRUE[1]] * 3
    model = DvlModel(noise_std=np.full(3, DVL_STD), **dvl)
    imu = ImuModel(accelerometer_bias_walk=1e-9, gyroscope_bias_walk=1e-13)
    return simulate(AUV, constant(variances), seed=seed, duration=duration, imu=imu, dvl=model)


def parameters(error_state: str, *, gate: bool) -> FilterParameters:
    return FilterParameters(
        frame_convention="ned",
        error_state=error_state,
        dvl=DvlParameters(noise_std=(DVL_STD,) * 3),
        depth=DepthParameters(topic="depth/pressure", noise_std=DEPTH_STD),
        gate=GateParameters(enabled=gate),
        process_noise=ProcessNoiseParameters(
            accelerometer_variance=(TOLD[0],) * 3, gyroscope_variance=(TOLD[1],) * 3
        ),
        initial=replace(
            P_0, mode="set_odometry", velocity_std=0.02, heading_std=0.01, position_std=0.001
        ),
        origin=OriginParameters(height=float(AUV.h_0)),
    )


def fly(
    settings: FilterParameters, m: Mission, seed: int, *, depth: bool = True, until: float = np.inf
) -> FoldResult:
    """With a depth at 5 Hz, of a sensor at base_link; the pings end after ``until`` seconds."""
    rng = np.random.default_rng([seed, 2])
    start = drawn_initial(m.initial, settings.initial, np.random.default_rng([seed, 1]))
    pings = zip(m.dvl_stamps_ns.tolist(), m.v_d, strict=True)
    last_ns = m.start_ns + min(until, 1e6) * NS
    events: list[Event] = [start, *(Dvl(t, v) for t, v in pings if t <= last_ns)]
    if depth:
        rows = slice(19, None, 20)
        down = m.truth.p_o[rows, 2] + DEPTH_STD * rng.standard_normal(len(m.stamps_ns[rows]))
        pairs = zip(m.stamps_ns[rows].tolist(), (down - AUV.h_0).tolist(), strict=True)
        events += [Depth(stamp_ns, value) for stamp_ns, value in pairs]
    return fold_arrays(settings, m.stamps_ns, m.f_b, m.w_ib_b, events)


def body_velocity_error(result: FoldResult, m: Mission) -> Array:
    v_b = np.einsum("kji,kj->ki", result.states["nav"]["C_n_b"], result.states["nav"]["v_n"])
    return np.einsum("kji,kj->ki", m.truth.C_n_b, m.truth.v_n) - v_b


@pytest.mark.parametrize("invariant", [True, False])
def test_its_step_is_that_of_the_continuous_error_dynamics(invariant: bool) -> None:
    """Van Loan's integral of F and G of the docstring."""
    rng, t = np.random.default_rng(SEED), 0.7
    C, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    C *= np.linalg.det(C)
    v_x, g_x = cross_matrix(rng.standard_normal(3)), cross_matrix(np.array([0.0, 0.0, 9.8]))
    if not invariant:
        v_x = np.zeros((3, 3))
    A, B = rng.standard_normal((2, 3, 3))
    S_f, S_w = 1e-3 * A @ A.T, 1e-5 * B @ B.T
    F, G = np.zeros((CORE, CORE)), np.zeros((CORE, 6))
    F[:3, 3:6], F[:3, 6:9], F[:3, 9:12], F[3:6, 9:12] = g_x, -C, -v_x @ C, -C
    F[12:, :3], F[12:, 3:6] = np.eye(3), -v_x
    G[:3, :3], G[:3, 3:], G[3:6, 3:] = np.eye(3), v_x, np.eye(3)
    density = np.zeros((6, 6))
    density[:3, :3], density[3:, 3:] = S_f, S_w
    both = np.zeros((2 * CORE, 2 * CORE))
    both[:CORE, :CORE], both[:CORE, CORE:], both[CORE:, CORE:] = -F, G @ density @ G.T, F.T
    big = expm(both * t)
    transition = big[CORE:, CORE:].T

    Phi, P = np.eye(CORE), np.zeros((CORE, CORE))
    set_transition(Phi, C, v_x, g_x, t)
    set_transition_of_position(Phi, C, v_x, g_x, t)
    np.testing.assert_allclose(Phi, transition, rtol=1e-12, atol=1e-12)
    add_noise(P, S_f, S_w, v_x, g_x, t)
    add_noise_of_position(P, S_f, S_w, v_x, g_x, t)
    np.testing.assert_allclose(P, transition @ big[:CORE, CORE:], rtol=1e-11, atol=1e-14)


@pytest.mark.parametrize("error_state", ["invariant", "ned"])
@pytest.mark.parametrize("depth", [True, False])
def test_it_is_what_it_makes_with_the_gains_of_the_filter(error_state: str, depth: bool) -> None:
    """P and the untold part are the covariance of the true error of velocity and position.

    A depth makes the velocity down more certain than that: it counts for the filter alone.
    """
    squares, predicted = [], []
    for seed in range(SEED, SEED + 30):
        m = mission(seed, 60.0)
        result = fly(parameters(error_state, gate=False), m, seed, depth=depth)
        s = result.states[-1]
        nav, C, (x, off) = s["nav"], s["nav"]["C_n_b"], np.empty((2, 3))
        P, excess = nav["P"][:CORE, :CORE], s["noise"]["excess"]
        of_velocity, of_position = np.eye(3, CORE), np.eye(CORE)[POSITION]
        if error_state == "invariant":
            displacement(x, nav["llh_r"], nav["llh"])
            of_position[:, ATTITUDE] = -cross_matrix(x)
        else:
            of_velocity[:, ATTITUDE] = cross_matrix(nav["v_n"])
        of_velocity = C.T @ of_velocity
        told = of_velocity @ (P + excess) @ of_velocity.T
        position = of_position @ P @ of_position.T + excess[POSITION, POSITION]
        displacement(off, nav["llh"], m.truth.llh[-1])
        squares.append(np.square([*body_velocity_error(result, m)[-1], *off]))
        predicted.append([*np.diag(told), *np.diag(position)])
    ratios = np.mean(squares, axis=0) / np.mean(predicted, axis=0)
    n = len(squares)
    assert (ratios < chi2.isf(1e-4, n) / n).all(), ratios
    horizontal = ratios[[0, 1, 3, 4]]
    assert ((ratios if not depth else horizontal) > chi2.ppf(1e-4, n) / n).all(), ratios


def test_a_depth_leaves_the_gate_for_the_dvl_as_it_is() -> None:
    """The same pings are rejected with a depth as without it, and the velocity is no worse."""
    settings, rejected, errors = parameters("invariant", gate=True), {}, {}
    m = mission(SEED, 240.0, outlier_probability=0.05, outlier_size=3.0)
    for depth in (True, False):
        result = fly(settings, m, SEED, depth=depth)
        updates = [u.report for u in result.updates if u.report.measurement == "dvl"]
        rejected[depth] = sum(not report.accepted for report in updates)
        errors[depth] = np.sqrt(np.mean(np.square(body_velocity_error(result, m))))
    outliers = int(m.dvl_outlier.sum())
    assert rejected[False] >= 0.6 * outliers
    assert abs(rejected[True] - rejected[False]) <= 0.2 * outliers
    assert errors[True] < 1.1 * errors[False]


def test_with_a_depth_alone_it_grows_as_the_noise_does() -> None:
    """Five minutes without a ping: a tilt that walks, and what gravity makes of it."""
    m = mission(SEED, 330.0)
    result = fly(parameters("invariant", gate=True), m, SEED, until=30.0)
    excess = result.states[-1]["noise"]["excess"][VELOCITY, VELOCITY]
    density = (TRUE[1] - TOLD[1]) / 100.0  # rad^2/s
    sigma = 9.8 * np.sqrt(density * 300.0**3 / 3.0)
    assert np.sqrt(np.diag(excess))[:2] == pytest.approx([sigma, sigma], rel=0.25)
