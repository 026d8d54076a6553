"""Where Q comes from, what happens to it on the way to P, and what the conventions mean."""

from dataclasses import replace

import numpy as np
import pytest
from records import P15, density
from scipy.spatial.transform import Rotation

from insdvl.navigation.error_state import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    GYROSCOPE_BIAS,
    POSITION,
    VELOCITY,
)
from insdvl.navigation.events import Event, Imu, Initial, ProcessNoise
from insdvl.navigation.geometry.frames import rotation_from_rpy
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import (
    FilterParameters,
    GateParameters,
    ImuParameters,
    ProcessNoiseParameters,
)
from insdvl.navigation.process_noise.received import bounded
from insdvl.parameters.declaration import ParameterError
from insdvl.simulation.initial_errors import P_0
from insdvl.timeline.fold import Fold
from insdvl.timeline.output import FoldResult
from insdvl.timeline.recorded import fold_arrays

RATE = 100.0
NS_STEP = 10_000_000
Q_F, Q_W = np.array([0.01, 0.02, 0.03]), np.array([1e-4, 2e-4, 3e-4])
MOUNT = (0.4, -0.7, 2.0)


def parameters(*, bias_std: float = 0.0, **noise: object) -> FilterParameters:
    values: dict[str, object] = {
        "accelerometer_variance": tuple(Q_F.tolist()),
        "gyroscope_variance": tuple(Q_W.tolist()),
        "accelerometer_bias_walk": 0.0,
        "gyroscope_bias_walk": 0.0,
    }
    return FilterParameters(
        frame_convention="ned",
        earth_rate=False,
        imu=ImuParameters(mount=MOUNT, frozen_samples=0),  # all samples are equal
        gate=GateParameters(enabled=False),
        process_noise=ProcessNoiseParameters(**(values | noise)),
        initial=replace(
            P_0,
            velocity_std=0.0,
            tilt_std=0.0,
            heading_std=0.0,
            accelerometer_bias_std=bias_std,
            gyroscope_bias_std=0.1 * bias_std,
            position_std=0.0,
        ),
    )


C_B_I = rotation_from_rpy(np.array(MOUNT))
AT_REST = C_B_I.T @ np.array([0.0, 0.0, -9.7946])


def sample(k: int) -> Imu:
    return Imu(k * NS_STEP, AT_REST, np.zeros(3))


def at_rest(
    settings: FilterParameters, samples: int, events: list[Event], rate: float = RATE
) -> FoldResult:
    """A vehicle at rest; the filter is certain of its state at sample 0."""
    stamps = np.rint(np.arange(samples) * 1e9 / rate).astype(np.int64)
    return fold_arrays(
        settings, stamps, np.tile(AT_REST, (samples, 1)), np.zeros((samples, 3)), events
    )


# ------------------------------------------------------------------ conventions


@pytest.mark.parametrize("convention", ["per_sample", "density"])
@pytest.mark.parametrize("rate", [50.0, 100.0, 200.0])
def test_a_step_adds_the_density_times_its_length(convention: str, rate: float) -> None:
    """The density is q / imu.rate, or q itself, whatever the rate of the samples that come."""
    settings = parameters(convention=convention)
    s = at_rest(settings, 2, [], rate).states[1]
    density = 1.0 / RATE if convention == "per_sample" else 1.0
    for block, Q in ((VELOCITY, Q_F), (ATTITUDE, Q_W)):
        expected = C_B_I @ np.diag(Q) @ C_B_I.T * density / rate
        np.testing.assert_allclose(
            s["nav"]["P"][block, block], expected, rtol=1e-3, atol=1e-3 * expected.max()
        )


@pytest.mark.parametrize("source", ["constant", "external"])
def test_twice_the_samples_at_the_same_density_leave_the_covariance(source: str) -> None:
    settings = parameters(source=source)
    P = [
        P15(at_rest(settings, 1 + round(2.0 * rate), [], rate).states[-1])
        for rate in (100.0, 200.0)
    ]
    scale = np.sqrt(np.outer(np.diag(P[0]), np.diag(P[0])))[:6, :6]
    assert np.abs((P[1] - P[0])[:6, :6] / scale).max() < 1e-3
    assert P[0][0, 0] > 0.0


def test_the_bias_walks_are_densities() -> None:
    settings = parameters(accelerometer_bias_walk=1e-6, gyroscope_bias_walk=1e-9)
    s = at_rest(settings, 301, []).states[-1]
    P_f, P_w = (
        s["nav"]["P"][ACCELEROMETER_BIAS, ACCELEROMETER_BIAS],
        s["nav"]["P"][GYROSCOPE_BIAS, GYROSCOPE_BIAS],
    )
    np.testing.assert_allclose(P_f, 3e-6 * np.eye(3), rtol=1e-9, atol=1e-20)
    np.testing.assert_allclose(P_w, 3e-9 * np.eye(3), rtol=1e-9, atol=1e-20)


# ------------------------------------------------------------------ a Q that is told


def told(settings: FilterParameters, *events: ProcessNoise, samples: int = 11) -> FoldResult:
    return at_rest(settings, samples, list(events))


def rotated(Q: np.ndarray) -> np.ndarray:
    return C_B_I @ Q @ C_B_I.T


def test_a_told_q_is_in_the_axes_of_the_imu() -> None:
    A = np.random.default_rng(5).standard_normal((3, 3))
    Q_f, Q_w = A @ A.T, 0.1 * A.T @ A
    s = told(parameters(source="external"), ProcessNoise(5 * NS_STEP, Q_f, Q_w)).states
    np.testing.assert_allclose(s["noise"]["Q_f"][4], rotated(np.diag(Q_F)), rtol=1e-12)
    for k in (5, 10):
        np.testing.assert_allclose(s["noise"]["Q_f"][k], rotated(Q_f), rtol=1e-12)
        np.testing.assert_allclose(s["noise"]["Q_w"][k], rotated(Q_w), rtol=1e-12)
    assert not s["counters"]["floors"].any()


@pytest.mark.parametrize("unknown", ["f", "w", "both"])
def test_an_unknown_part_is_nominal(unknown: str) -> None:
    """Also where another value was told before; the known part stays in effect."""
    Q = np.eye(3)
    after = ProcessNoise(
        7 * NS_STEP,
        None if unknown in ("f", "both") else 3.0 * Q,
        None if unknown in ("w", "both") else 3.0 * Q,
    )
    s = told(parameters(source="external"), ProcessNoise(5 * NS_STEP, 2.0 * Q, 2.0 * Q), after)
    last = s.states[-1]
    f = rotated(np.diag(Q_F)) if unknown in ("f", "both") else 3.0 * Q
    w = rotated(np.diag(Q_W)) if unknown in ("w", "both") else 3.0 * Q
    np.testing.assert_allclose(last["noise"]["Q_f"], f, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(last["noise"]["Q_w"], w, rtol=1e-12, atol=1e-15)


def test_the_floor_holds_each_axis_and_is_counted() -> None:
    settings = parameters(source="external", accelerometer_floor=1e-3, gyroscope_floor=1e-6)
    fine = ProcessNoise(2 * NS_STEP, np.diag([1e-3, 1e-2, 1.0]), np.diag([1e-6, 1.0, 1.0]))
    low_f = ProcessNoise(4 * NS_STEP, np.diag([1e-9, 1e-2, 0.0]), np.diag([1e-6, 1.0, 1.0]))
    low_w = ProcessNoise(6 * NS_STEP, np.diag([1e-3, 1e-2, 1.0]), np.diag([1.0, 1e-9, 1.0]))
    result = told(settings, fine, low_f, low_w)
    assert result.states["counters"]["floors"].tolist() == [0, 0, 0, 0, 1, 1, 2, 2, 2, 2, 2]
    assert result.counts["floors"] == 2
    s = result.states
    np.testing.assert_allclose(
        s[3]["noise"]["Q_f"], rotated(np.diag([1e-3, 1e-2, 1.0])), rtol=1e-12
    )
    np.testing.assert_allclose(
        s[4]["noise"]["Q_f"], rotated(np.diag([1e-3, 1e-2, 1e-3])), rtol=1e-12
    )
    np.testing.assert_allclose(s[6]["noise"]["Q_w"], rotated(np.diag([1.0, 1e-6, 1.0])), rtol=1e-12)


def test_the_floor_holds_every_direction_of_a_rotated_q() -> None:
    axes = Rotation.from_rotvec([0.3, -0.8, 0.5]).as_matrix()
    Q, *acted = bounded(axes @ np.diag([1e-9, 1e-2, 1e-4]) @ axes.T, 1e-3, 1.0)
    assert acted == [True, False]
    np.testing.assert_allclose(
        Q, axes @ np.diag([1e-3, 1e-2, 1e-3]) @ axes.T, rtol=1e-9, atol=1e-15
    )
    same = axes @ np.diag([1e-3, 1e-2, 2e-3]) @ axes.T
    Q, *acted = bounded(same, 0.9e-3, 1.1e-2)
    assert acted == [False, False]
    np.testing.assert_array_equal(Q, same)


def test_the_ceiling_holds_every_direction_and_is_counted() -> None:
    """One sample that is far off makes the told variance as large as itself."""
    axes = Rotation.from_rotvec([0.3, -0.8, 0.5]).as_matrix()
    Q, *acted = bounded(axes @ np.diag([1e-9, 1e-2, 1e9]) @ axes.T, 1e-3, 2.0)
    assert acted == [True, True]
    np.testing.assert_allclose(Q, axes @ np.diag([1e-3, 1e-2, 2.0]) @ axes.T, rtol=1e-6, atol=1e-6)
    settings = parameters(source="external", accelerometer_ceiling=1e-1, gyroscope_ceiling=1e-2)
    fine = ProcessNoise(2 * NS_STEP, np.diag([1e-1, 1e-2, 1e-3]), 1e-2 * np.eye(3))
    high_f = ProcessNoise(4 * NS_STEP, np.diag([1e9, 1e-2, 1e-3]), 1e-2 * np.eye(3))
    high_w = ProcessNoise(6 * NS_STEP, 1e-2 * np.eye(3), 1e9 * np.eye(3))
    result = told(settings, fine, high_f, high_w)
    assert result.states["counters"]["ceilings"].tolist() == [0, 0, 0, 0, 1, 1, 2, 2, 2, 2, 2]
    assert result.counts["floors"] == 0
    s = result.states
    np.testing.assert_allclose(
        s[4]["noise"]["Q_f"], rotated(np.diag([1e-1, 1e-2, 1e-3])), rtol=1e-9
    )
    np.testing.assert_allclose(s[6]["noise"]["Q_w"], 1e-2 * np.eye(3), rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("sensor", ["accelerometer", "gyroscope"])
def test_a_floor_above_the_ceiling_is_a_contradiction(sensor: str) -> None:
    with pytest.raises(ParameterError, match=rf"{sensor}_floor' must be at most .* \(1\), got 2.0"):
        ProcessNoiseParameters(**{f"{sensor}_floor": 2.0, f"{sensor}_ceiling": 1.0})


def test_a_zero_variance_never_stops_the_noise() -> None:
    """All zeros would be 'unknown' in a message; one that gets here is raised to the floor."""
    settings = parameters(source="external", accelerometer_floor=1e-4, gyroscope_floor=1e-7)
    s = told(settings, ProcessNoise(2 * NS_STEP, np.zeros((3, 3)), np.zeros((3, 3)))).states[-1]
    np.testing.assert_allclose(s["noise"]["Q_f"], 1e-4 * np.eye(3), rtol=1e-12, atol=1e-18)
    np.testing.assert_allclose(s["noise"]["Q_w"], 1e-7 * np.eye(3), rtol=1e-12, atol=1e-21)


# ------------------------------------------------------------------ adaptive


def adaptive(form: str, bias_std: float = 0.0) -> FilterParameters:
    return parameters(bias_std=bias_std, source="adaptive", adaptive_form=form, adaptive_window=3)


PINGS = 8


def with_pings(settings: FilterParameters, count: int = PINGS) -> FoldResult:
    rng = np.random.default_rng(11)
    events = [Dvl(k * 50 * NS_STEP, 0.3 * rng.standard_normal(3)) for k in range(1, count + 1)]
    return at_rest(settings, 50 * count + 60, events)


def gain(result: FoldResult, k: int) -> np.ndarray:
    """K of the update at sample k, from the state after it: K = P_after H^T R^-1."""
    s = result.states[k]
    H = np.zeros((3, 15))
    H[:, VELOCITY] = s["nav"]["C_n_b"].T
    return P15(s) @ H.T / 0.1**2


@pytest.mark.parametrize("form", ["floored", "literal"])
def test_the_estimate_is_k_c_kt_over_the_interval(form: str) -> None:
    result = with_pings(adaptive(form))
    nu = np.array([u.report.innovation for u in result.updates])
    for ping in range(2, PINGS):
        k = 50 * (ping + 1)
        C = sum(np.outer(v, v) for v in nu[ping - 2 : ping + 1]) / 3
        K = gain(result, k)
        expected = K @ C @ K.T / 0.5
        Q_x = density(result.states[k + 20])
        np.testing.assert_allclose(Q_x, expected, rtol=0.02, atol=0.02 * np.abs(expected).max())
        assert np.linalg.matrix_rank(Q_x, tol=1e-9 * np.abs(Q_x).max()) <= 3


@pytest.mark.parametrize("form", ["floored", "literal"])
def test_nominal_until_the_window_is_full(form: str) -> None:
    """Then the literal form replaces the nominal Q, the floored form adds to it."""
    result = with_pings(adaptive(form))
    nominal = with_pings(parameters())
    third = 150
    before = slice(0, third)
    np.testing.assert_array_equal(
        result.states["nav"]["P"][before, :15, :15], nominal.states["nav"]["P"][before, :15, :15]
    )
    assert not density(result.states)[before].any()

    s, s_next = result.states[third], result.states[third + 1]
    dt = 0.01
    Q_n = np.zeros((15, 15))
    Q_n[VELOCITY, VELOCITY] = rotated(np.diag(Q_F)) / RATE
    Q_n[ATTITUDE, ATTITUDE] = rotated(np.diag(Q_W)) / RATE
    growth = P15(s_next) - P15(s)
    Q_d = (density(s) + (Q_n if form == "floored" else 0.0)) * dt
    Phi = np.eye(15)
    g = np.array([0.0, 0.0, 9.7946])
    Phi[VELOCITY, ATTITUDE] = np.cross(g, np.eye(3)).T * dt
    Phi[VELOCITY, ACCELEROMETER_BIAS] = -s["nav"]["C_n_b"] * dt
    Phi[ATTITUDE, GYROSCOPE_BIAS] = -s["nav"]["C_n_b"] * dt
    Phi[POSITION, VELOCITY] = np.eye(3) * dt
    expected = Phi @ P15(s) @ Phi.T + Q_d - P15(s)
    np.testing.assert_allclose(
        growth[:6, :6], expected[:6, :6], rtol=1e-2, atol=1e-2 * np.abs(expected[:3, :3]).max()
    )


def test_the_floored_noise_of_a_step_does_not_depend_on_the_steps_before() -> None:
    """Elements of Q_d that only the adaptive estimate fills must not pile up from step to step."""
    s = with_pings(adaptive("floored", bias_std=0.1)).states
    first = 50 * PINGS
    block = ACCELEROMETER_BIAS, ACCELEROMETER_BIAS  # grows by its part of Q_x, and by no other
    step = 0.01 * density(s)[first][block]
    assert np.count_nonzero(step) == 9
    growth = np.diff(s["nav"]["P"][(slice(first, first + 40), *block)], axis=0)
    np.testing.assert_allclose(
        growth, np.broadcast_to(step, growth.shape), rtol=1e-6, atol=1e-6 * np.abs(step).max()
    )


@pytest.mark.parametrize("form", ["floored", "literal"])
def test_what_a_gap_adds_is_added_to_the_estimate(form: str) -> None:
    """The motion that nobody saw is not in the innovations of the past."""
    settings = adaptive(form)
    rng = np.random.default_rng(11)
    events = [Dvl(k * 50 * NS_STEP, 0.3 * rng.standard_normal(3)) for k in range(1, PINGS + 1)]
    stamps = [k for k in range(50 * PINGS + 60) if not 420 <= k < 440]
    rows = len(stamps)
    result = fold_arrays(
        settings,
        np.array(stamps) * NS_STEP,
        np.tile(AT_REST, (rows, 1)),
        np.zeros((rows, 3)),
        events,
    )
    before, after = result.states[419], result.states[420]
    assert after["counters"]["gaps"] == before["counters"]["gaps"] + 1
    T = 0.21
    growth = np.diag(P15(after) - P15(before))
    estimated = T * np.diag(density(before))
    unseen = np.r_[np.full(3, (0.5 * T) ** 2), np.full(3, (0.05 * T) ** 2)]
    np.testing.assert_allclose((growth - estimated)[3:6], unseen[3:], rtol=0.05)
    assert ((growth - estimated)[:3] > 0.9 * unseen[:3]).all()


@pytest.mark.parametrize("form", ["floored", "literal"])
def test_a_restart_forgets_the_innovations(form: str) -> None:
    """After a new initialisation the filter is as one that has just begun."""
    settings = adaptive(form)
    k0 = 50 * PINGS + 20
    start = Initial(
        k0 * NS_STEP,
        np.eye(3),
        np.zeros(3),
        np.zeros(3),
        "body",
        0.01 * np.eye(3),
        1e-4 * np.eye(3),
    )
    rng = np.random.default_rng(11)
    old = [Dvl(k * 50 * NS_STEP, 0.3 * rng.standard_normal(3)) for k in range(1, PINGS + 1)]
    new = [Dvl(k0 * NS_STEP + k * 50 * NS_STEP, 0.1 * k * np.ones(3)) for k in (1, 2)]
    with_past = at_rest(settings, k0 + 160, [*old, start, *new]).states[k0:]
    fresh = at_rest(settings, k0 + 160, [start, *new]).states[k0:]
    assert P15(with_past).tobytes() == P15(fresh).tobytes()
    assert not density(with_past).any()


def test_the_adaptive_filter_depends_on_stamps_alone() -> None:
    settings = adaptive("floored")
    rng = np.random.default_rng(11)
    pings = [Dvl(k * 50 * NS_STEP, 0.3 * rng.standard_normal(3)) for k in range(1, PINGS + 1)]
    samples = [sample(k) for k in range(50 * PINGS + 60)]
    fold = Fold(settings)
    late = list(pings)
    for event in samples:
        fold.add(event)
        fold.take()
        while late and late[0].stamp_ns <= event.stamp_ns - 17 * NS_STEP:
            fold.add(late.pop(0))
    expected = with_pings(settings).states[-1]
    assert fold.latest.tobytes() == expected.tobytes()
