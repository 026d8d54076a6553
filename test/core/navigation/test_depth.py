"""The depth sensor: its Jacobian, its surface, its refusals, and the vertical channel with it."""

from typing import Any

import numpy as np
import pytest
from places import moved, put
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from told import TOLD

from insdvl.navigation import coordinates
from insdvl.navigation.coordinates import position_error
from insdvl.navigation.error_state import ATTITUDE, POSITION, VELOCITY
from insdvl.navigation.events import NS, Event, Initial, refusal
from insdvl.navigation.filter import Filter
from insdvl.navigation.geometry.earth import gravity
from insdvl.navigation.measurements.base import Turn
from insdvl.navigation.measurements.depth import STANDARD_GRAVITY, Depth
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build
from insdvl.simulation.mission import ImuModel, simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.trajectories import AUV
from insdvl.timeline.output import FoldResult
from insdvl.timeline.recorded import fold_arrays
from insdvl.timeline.state_file import decode, encode

SEED, RUNS, TAIL = 27_182, 60, 0.0005
NO_TURN = Turn(np.zeros(3), np.zeros((3, 3)))
DOWN = POSITION.start + 2
ARM = np.array([1.2, -0.3, 0.4])
DEPTH_STD, DVL_STD, POSITION_STD = 0.02, 0.02, 0.5
VARIANCES = [1e-4] * 3 + [1e-6] * 3


def parameters(**changes: Any) -> FilterParameters:
    values: dict[str, Any] = {
        "frame_convention": "ned",
        "depth.topic": "depth/pressure",
        "depth.lever_arm": tuple(ARM.tolist()),
        "depth.noise_std": DEPTH_STD,
        "dvl.noise_std": (DVL_STD,) * 3,
        "initial.mode": "set_odometry",
        "initial.position_std": POSITION_STD,
        "origin.height": float(AUV.h_0),
        "process_noise.accelerometer_variance": tuple(VARIANCES[:3]),
        "process_noise.gyroscope_variance": tuple(VARIANCES[3:]),
    }
    return build(
        FilterParameters,
        TOLD | values | {name.replace("__", "."): v for name, v in changes.items()},
    )


def mission(seed: int = SEED, duration: float = 120.0) -> Any:
    return simulate(AUV, constant(VARIANCES), seed=seed, duration=duration, imu=ImuModel())


def true_depth(m: Any, surface: float) -> np.ndarray:
    """(N,) depth of the sensor at the stamps of the IMU, of a surface at a height [m]."""
    arm = np.einsum("kij,j->ki", m.truth.C_n_b, ARM)[:, 2]
    return surface - AUV.h_0 + m.truth.p_o[:, 2] + arm


def depths(m: Any, surface: float, rng: np.random.Generator | None, every: int = 20) -> list[Event]:
    found = true_depth(m, surface)
    if rng is not None:
        found = found + DEPTH_STD * rng.standard_normal(len(found))
    rows = slice(every - 1, None, every)
    pairs = zip(m.stamps_ns[rows].tolist(), found[rows].tolist(), strict=True)
    return [Depth(stamp, depth) for stamp, depth in pairs]


def fly(m: Any, settings: FilterParameters, events: list[Event], seed: int | None = SEED) -> Any:
    """The mission with its DVL; the initial error is drawn where there is a seed."""
    C, v_n = m.initial.C_n_b[0], m.initial.v_n[0]
    psi, dv, dp = np.zeros((3, 3))
    if seed is not None:
        rng = np.random.default_rng([seed, 1])
        sigma = settings.initial
        psi = rng.standard_normal(3) * sigma.attitude_std
        dv, dp = (rng.standard_normal(3) * s for s in (sigma.velocity_std, sigma.position_std))
    C_hat = Rotation.from_rotvec(psi).as_matrix().T @ C
    start = Initial(0, C_hat, m.initial.p_o[0] - dp, C.T @ v_n - dv, "body")
    rng = np.random.default_rng([SEED if seed is None else seed, 2])
    ideal = np.einsum("kji,kj->ki", m.truth.C_n_b, m.truth.v_n)[99::100]
    v_d = ideal + DVL_STD * rng.standard_normal(ideal.shape)
    pings = zip(m.stamps_ns[99::100].tolist(), v_d, strict=True)
    return fold_arrays(
        settings,
        m.stamps_ns,
        m.f_b,
        m.w_ib_b,
        [start, *events, *(Dvl(stamp, v) for stamp, v in pings)],
    )


def of_depth(result: FoldResult) -> list[Any]:
    return [u.report for u in result.updates if u.report.measurement == "depth"]


# ------------------------------------------------------------------ the model


def state_at(filter_: Filter, x: np.ndarray, *, invariant: bool) -> Any:
    """A record that differs by the error x from a nominal state."""
    state = filter_.empty()
    nav = state[0]["nav"]
    C, v_n = Rotation.from_rotvec([0.3, -0.5, 1.1]).as_matrix(), np.array([1.0, -0.4, 0.2])
    turn = Rotation.from_rotvec(x[ATTITUDE]).as_matrix()
    nav["C_n_b"] = turn @ C
    nav["v_n"] = (turn @ v_n if invariant else v_n) + x[VELOCITY]
    put(nav, [50.0, -20.0, 12.0], [49.2, -20.7, 11.0])
    x_n = coordinates.from_reference(nav)
    nav["llh"] = moved(nav["llh"], (turn @ x_n - x_n if invariant else 0.0) + x[POSITION])
    nav["optional"][: len(x) - 15] = 4.0 + x[15:]
    nav["time_ns"], nav["initialised"] = NS, 1
    return state


@pytest.mark.parametrize("error_state", ["invariant", "ned"])
@pytest.mark.parametrize("surface_std", [0.0, 10.0])
@pytest.mark.parametrize("from_pressure", [False, True])
def test_the_jacobian_is_the_derivative_of_h(
    error_state: str, surface_std: float, from_pressure: bool
) -> None:
    settings = parameters(error_state=error_state, depth__surface_std=surface_std)
    filter_ = Filter(settings)
    model = filter_.models["depth"]
    invariant = error_state == "invariant"
    assert filter_.n == (15 if surface_std == 0.0 else 16)

    def linearised(x: np.ndarray) -> Any:
        state = state_at(filter_, x, invariant=invariant)
        return model.linearise(state, Depth(NS, 9.0, None, from_pressure), NO_TURN)

    zero = np.zeros(filter_.n)
    H = linearised(zero).H
    assert H.shape == (1, filter_.n)
    measured = np.empty(filter_.n)
    for i in range(filter_.n):
        x = zero.copy()
        x[i] = 1e-4
        measured[i] = (linearised(-x).z_minus_h - linearised(x).z_minus_h)[0] / 2e-4
    # Gravity changes with the height by 3e-7 of itself per metre: left out of H.
    np.testing.assert_allclose(H[0], measured, atol=1e-8 if not from_pressure else 5e-6)


def test_the_prediction_is_the_depth_of_the_sensor() -> None:
    """A surface at -3 m, an origin at -5 m, 12 m below it, and a sensor below base_link."""
    filter_ = Filter(
        parameters(depth__surface_height=-3.0, depth__surface_std=0.0, origin__height=-5.0)
    )
    state = state_at(filter_, np.zeros(15), invariant=True)
    state[0]["nav"]["C_n_b"] = np.eye(3)
    z = filter_.models["depth"].linearise(state, Depth(NS, 0.0), NO_TURN)
    assert -z.z_minus_h[0] == pytest.approx(-3.0 + 5.0 + 12.0 + ARM[2])


def test_a_pressure_is_converted_with_the_gravity_of_the_place() -> None:
    filter_ = Filter(parameters(origin__latitude_deg=60.0, depth__surface_std=0.0))
    state = state_at(filter_, np.zeros(15), invariant=True)
    model = filter_.models["depth"]
    told = model.linearise(state, Depth(NS, 1000.0), NO_TURN).z_minus_h
    pressure = model.linearise(state, Depth(NS, 1000.0, None, True), NO_TURN).z_minus_h
    g = gravity(float(np.radians(60.0)), AUV.h_0)
    assert (pressure - told)[0] == pytest.approx(1000.0 * (STANDARD_GRAVITY / g - 1.0), abs=0.02)
    assert abs(pressure - told)[0] > 1.0


@pytest.mark.parametrize(
    ("event", "reason"),
    [
        (Depth(0, np.nan), "not_finite"),
        (Depth(0, 1e8), "out_of_range"),
        (Depth(0, 1.0, np.inf), "not_finite"),
        (Depth(0, 1.0, 1e13), "out_of_range"),
        (Depth(0, 1.0), None),
    ],
)
def test_numbers_that_cannot_be_used(event: Depth, reason: str | None) -> None:
    assert refusal(event) == reason


# ------------------------------------------------------------------ the surface


def test_an_unknown_surface_makes_no_step() -> None:
    """An origin 20 m off the height of the surface: the first depth tells the surface instead."""
    m = mission(duration=30.0)
    for surface in (0.0, 15.0, 500.0):
        settings = parameters()
        found = fly(m, settings, depths(m, surface, None))
        without = fly(m, settings, [])
        step = without.states["nav"]["llh"][:, 2] - found.states["nav"]["llh"][:, 2]
        first, second = 19, 39  # from the second depth on it tells the vertical velocity
        assert np.abs(step[first:second]).max() < 1e-4
        at = found.filter.vehicle.optional("surface")
        height = found.states["nav"]["optional"][-1, at][0]
        sigma = np.sqrt(found.filter.covariance(found.states)[-1, 15, 15])
        assert abs(height - surface) < 3.0 * sigma
        assert 0.5 * POSITION_STD < sigma < 1.1 * POSITION_STD


def test_a_known_surface_tells_the_height() -> None:
    m = mission(duration=30.0)
    settings = parameters(depth__surface_std=0.0, depth__surface_height=2.0)
    found = fly(m, settings, depths(m, 2.0, None))
    error = m.truth.llh[-1, 2] - found.states["nav"]["llh"][-1, 2]
    sigma = np.sqrt(found.states["nav"]["P"][-1, DOWN, DOWN])
    assert sigma < 0.02 and abs(error) < 3.0 * sigma


def test_after_a_restart_the_surface_is_known_still() -> None:
    m = mission(duration=30.0)
    settings = parameters()
    found = fly(m, settings, depths(m, 7.0, None))
    record = decode(encode(found.states[-1], settings), Filter(settings))
    at = found.filter.vehicle.optional("surface")
    assert record[0]["nav"]["optional"][at] == found.states[-1]["nav"]["optional"][at]


# ------------------------------------------------------------------ in the filter


@pytest.mark.long
@pytest.mark.parametrize("surface_std", [0.0, 10_000.0])
def test_the_vertical_channel_is_consistent(surface_std: float) -> None:
    """NEES of vertical velocity and position, and of the surface, 60 runs; NIS of the depths."""
    settings = parameters(depth__surface_std=surface_std, gate__enabled=False)
    n = 2 if surface_std == 0.0 else 3
    nees, nis = [], []
    for seed in range(SEED, SEED + RUNS):
        m = mission(seed, duration=60.0)
        found = fly(m, settings, depths(m, 0.0, np.random.default_rng([seed, 3])), seed)
        s, P = found.states[-1]["nav"], found.filter.covariance(found.states)[-1]
        C_true, C_hat = m.truth.C_n_b[-1], s["C_n_b"]
        error = np.zeros(len(P))
        error[VELOCITY] = m.truth.v_n[-1] - C_true @ C_hat.T @ s["v_n"]
        error[POSITION] = position_error(s, C_true, m.truth.llh[-1], invariant=True)
        error[15:] = 0.0 - s["optional"][: len(P) - 15]
        rows = [VELOCITY.start + 2, DOWN, 15][:n]
        nees.append(error[rows] @ np.linalg.solve(P[np.ix_(rows, rows)], error[rows]))
        nis += [report.nis for report in of_depth(found)[1:]]
    assert chi2.ppf(TAIL, n * RUNS) < np.sum(nees) < chi2.isf(TAIL, n * RUNS)
    assert chi2.ppf(TAIL, len(nis)) < np.sum(nis) < chi2.isf(TAIL, len(nis))


def test_the_depth_bounds_the_height_where_the_dvl_is_out() -> None:
    """A minute without DVL: the height stays within centimetres."""
    m = mission(duration=60.0)
    settings = parameters(depth__surface_std=0.0)
    start = Initial(
        0, m.initial.C_n_b[0], m.initial.p_o[0], m.initial.C_n_b[0].T @ m.initial.v_n[0], "body"
    )
    events = depths(m, 0.0, np.random.default_rng(SEED))
    found = fold_arrays(settings, m.stamps_ns, m.f_b, m.w_ib_b, [start, *events])
    error = m.truth.llh[:, 2] - found.states["nav"]["llh"][:, 2]
    assert np.abs(error[1000:]).max() < 0.1


def test_an_outlier_is_refused_and_a_lasting_step_is_followed_in_the_end() -> None:
    m = mission(duration=120.0)
    settings = parameters(depth__surface_std=0.0, gate__max_rejection_time=10.0)
    events = depths(m, 0.0, np.random.default_rng(SEED))
    spoilt = [
        Depth(e.stamp_ns, e.depth + (5.0 if k == 100 else 3.0 if k >= 200 else 0.0))
        for k, e in enumerate(events)
        if isinstance(e, Depth)
    ]
    found = fly(m, settings, list(spoilt))
    reports = of_depth(found)
    assert [k for k, r in enumerate(reports[:200]) if not r.accepted] == [100]
    assert reports[200].reason == "gate"
    assert all(r.accepted for r in reports[-50:])
    assert m.truth.llh[-1, 2] - found.states["nav"]["llh"][-1, 2] == pytest.approx(3.0, abs=0.2)


def test_a_second_depth_that_is_off_leaves_no_doubt() -> None:
    """The third is back where the filter still is, and weighs as ever."""
    m = mission(duration=20.0)
    settings = parameters(depth__surface_std=0.0, gate__max_rejection_time=60.0)
    events = depths(m, 0.0, np.random.default_rng(SEED))
    assert isinstance(events[1], Depth)
    spoilt = [events[0], Depth(events[1].stamp_ns, events[1].depth + 5.0), *events[2:]]
    found, clean = fly(m, settings, spoilt), fly(m, settings, events)
    assert [r.reason for r in of_depth(found)] == ["", "gate"] + [""] * (len(events) - 2)
    sigmas = [np.sqrt(of.states[-1]["nav"]["P"][DOWN, DOWN]) for of in (found, clean)]
    assert sigmas[0] == pytest.approx(sigmas[1], rel=0.05)
    assert abs(m.truth.llh[-1, 2] - found.states["nav"]["llh"][-1, 2]) < 5.0 * sigmas[0]


def test_a_constant_depth_is_refused_as_frozen() -> None:
    m = mission(duration=30.0)
    settings = parameters(depth__frozen_samples=10, depth__surface_std=0.0)
    events = depths(m, 0.0, np.random.default_rng(SEED))
    stuck = [Depth(e.stamp_ns, events[50].depth) if k >= 50 else e for k, e in enumerate(events)]
    reports = of_depth(fly(m, settings, list(stuck)))
    assert [r.reason for r in reports].index("frozen") == 50 + 10 - 1
    assert all(r.reason == "frozen" for r in reports[59:])


def test_without_a_depth_nothing_changes_to_the_bit() -> None:
    """A sensor that is declared and never heard."""
    m = mission(duration=20.0)
    off, on = (fly(m, parameters(depth__topic=topic), []) for topic in ("", "depth"))
    for name in ("C_n_b", "v_n", "llh", "b_f", "b_w"):
        np.testing.assert_array_equal(off.states["nav"][name], on.states["nav"][name])
    P_off, P_on = off.states["nav"]["P"], on.states["nav"]["P"]
    np.testing.assert_array_equal(P_off[:, :15, :15], P_on[:, :15, :15])
