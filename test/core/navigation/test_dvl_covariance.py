"""Whose noise a DVL measurement has, and components that it did not measure."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from records import P15
from scipy.stats import chi2, poisson

from insdvl.messages.make import fill_innovation
from insdvl.navigation import kalman
from insdvl.navigation.error_state import ATTITUDE, VELOCITY
from insdvl.navigation.filter import Filter
from insdvl.navigation.measurements.base import Turn
from insdvl.navigation.measurements.dvl import Dvl, DvlModel
from insdvl.navigation.parameters import (
    DvlParameters,
    FilterParameters,
    GateParameters,
    InitialParameters,
    OriginParameters,
    ProcessNoiseParameters,
)
from insdvl.simulation.initial_errors import drawn_initial
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors import dvl as simulated
from insdvl.simulation.trajectories import AUV
from insdvl.timeline.output import FoldResult
from insdvl.timeline.recorded import fold_arrays

SEED = 141_421
VARIANCES = [1e-4] * 3 + [1e-6] * 3
NOISE = 0.01  # m/s, of the simulated DVL
AXIS_Y = (True, False, True)


def parameters(error_state: str = "invariant", **dvl: object) -> FilterParameters:
    return FilterParameters(
        frame_convention="ned",
        error_state=error_state,
        dvl=DvlParameters(**({"noise_std": (NOISE,) * 3} | dvl)),
        process_noise=ProcessNoiseParameters(
            accelerometer_variance=tuple(VARIANCES[:3]), gyroscope_variance=tuple(VARIANCES[3:])
        ),
        initial=InitialParameters(mode="set_odometry", velocity_std=0.02, heading_std=0.01),
        origin=OriginParameters(height=float(AUV.h_0)),
    )


def mission(duration: float, rate: float = 5.0, seed: int = SEED) -> Mission:
    dvl = simulated.DvlModel(noise_std=(NOISE,) * 3, rate=rate)
    return simulate(AUV, constant(VARIANCES), seed=seed, duration=duration, dvl=dvl)


def fly(settings: FilterParameters, m: Mission, pings: list[Dvl], seed: int = SEED) -> FoldResult:
    start = drawn_initial(m.initial, settings.initial, np.random.default_rng([seed, 1]))
    return fold_arrays(settings, m.stamps_ns, m.f_b, m.w_ib_b, [start, *pings])


def pings_of(
    m: Mission, R: np.ndarray | None = None, measured: tuple[bool, bool, bool] = (True, True, True)
) -> list[Dvl]:
    known = np.array(measured)
    stamps = m.dvl_stamps_ns.tolist()
    return [Dvl(t, known * v, R, measured) for t, v in zip(stamps, m.v_d, strict=True)]


def errors_in_sigma(result: FoldResult, m: Mission) -> np.ndarray:
    """(N, 6) errors of body velocity and tilt and heading, in sigma, of ordinary errors."""
    nav = result.states["nav"]
    C, v = nav["C_n_b"], nav["v_n"]
    error = np.einsum("kji,kj->ki", m.truth.C_n_b, m.truth.v_n) - np.einsum("kji,kj->ki", C, v)
    P = P15(result.states)
    P_v = np.einsum("kji,kjl,klm->kim", C, P[:, VELOCITY, VELOCITY], C)
    turn = m.truth.C_n_b @ np.swapaxes(C, 1, 2)
    psi = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)
    sigma = np.sqrt(np.diagonal(P[:, ATTITUDE, ATTITUDE], axis1=1, axis2=2))
    return np.hstack([error / np.sqrt(np.diagonal(P_v, axis1=1, axis2=2)), psi / sigma])


# ------------------------------------------------------------------ whose noise


def noise(event: Dvl, **dvl: object) -> np.ndarray:
    model = Filter(parameters(**dvl)).models["dvl"]
    assert isinstance(model, DvlModel)
    return model.noise(event)


def test_the_largest_keeps_the_correlations() -> None:
    sigma, correlation = (
        np.array([1e-4, 0.005, 0.3]),
        np.array([[1, 0.5, -0.2], [0.5, 1, 0], [-0.2, 0, 1]]),
    )
    event = Dvl(0, np.ones(3), correlation * np.outer(sigma, sigma))
    raised = np.array([0.01, 0.01, 0.3])
    np.testing.assert_allclose(noise(event), correlation * np.outer(raised, raised), rtol=1e-12)
    raised = np.array([0.002, 0.005, 0.3])
    expected = correlation * np.outer(raised, raised)
    np.testing.assert_allclose(noise(event, noise_floor=0.002), expected, rtol=1e-12)
    np.testing.assert_array_equal(noise(event, covariance="message"), event.R)
    own = noise(event, covariance="parameters", noise_std=(0.1, 0.2, 0.3))
    np.testing.assert_array_equal(own, np.diag(np.square([0.1, 0.2, 0.3])))


@pytest.mark.parametrize("covariance", ["largest", "message"])
def test_what_the_message_leaves_open_is_as_declared(covariance: str) -> None:
    """Below the floor too: it is told."""
    R = np.diag([4.0, 0.0, 9.0])
    R[0, 2] = R[2, 0] = 1.0
    settings = {"covariance": covariance, "noise_std": (0.5, 0.001, 0.5)}
    expected = R + np.diag([0.0, 1e-6, 0.0])
    np.testing.assert_allclose(noise(Dvl(0, np.ones(3), R), **settings), expected, rtol=1e-12)
    own = np.diag(np.square([0.5, 0.001, 0.5]))
    np.testing.assert_allclose(noise(Dvl(0, np.ones(3)), **settings), own, rtol=1e-12)


@pytest.mark.parametrize("variance", [2.4e-8, 4e-6, 2.5e-5])
def test_a_driver_that_tells_a_tiny_covariance_does_no_harm(variance: float) -> None:
    """True noise 1 cm/s at 5 Hz. Taken as told, every second good measurement is refused."""
    m = mission(120.0)
    result = fly(parameters(), m, pings_of(m, variance * np.eye(3)))
    reports = [u.report for u in result.updates]
    refused = sum(not r.accepted for r in reports)
    assert refused <= poisson.ppf(0.9999, 0.001 * len(reports))
    nis = np.mean([r.nis for r in reports])
    assert nis < 1.2 * 3.0
    inside = np.abs(errors_in_sigma(result, m)) < 3.0
    assert inside.mean() > 0.98 and inside.mean(axis=0).min() > 0.9


# ------------------------------------------------------------------ what was not measured


@pytest.mark.parametrize("error_state", ["invariant", "ned"])
def test_two_components_correct_as_a_measurement_of_two_rows(error_state: str) -> None:
    """Gain, NIS and corrected state are those of the rows that were measured, exactly."""
    m = mission(10.0)
    settings = parameters(error_state)
    filter_, before = Filter(settings), fly(settings, m, pings_of(m)).states[-1:]
    nav, P = before[0]["nav"], before[0]["nav"]["P"][:15, :15].copy()
    R = np.diag([4e-4, 9e-4, 1e-4])
    event = Dvl(int(nav["time_ns"]), (m.v_d[-1] + 0.01) * AXIS_Y, R, AXIS_Y)
    turn = Turn(np.zeros(3), np.zeros((3, 3)))
    whole = filter_.models["dvl"].linearise(before, replace(event, measured=(True,) * 3), turn)
    rows = np.array([0, 2])
    of_two = kalman.innovate(P, whole.z_minus_h[rows], whole.H[rows], whole.R[np.ix_(rows, rows)])
    after = before.copy()
    report = filter_.update(after, event, np.zeros(3), 0.0)
    assert report.accepted and report.rows == 2
    assert report.nis == pytest.approx(of_two.nis, rel=1e-9)
    np.testing.assert_allclose(report.innovation[rows], of_two.innovation, atol=1e-12)
    np.testing.assert_allclose(report.S[np.ix_(rows, rows)], of_two.S, rtol=1e-9)
    assert report.innovation[1] == 0.0 and np.isinf(report.S[1, 1])
    assert not np.isnan(report.S).any()
    A = np.eye(15) - of_two.K @ of_two.H
    expected = A @ P @ A.T + of_two.K @ of_two.R @ of_two.K.T
    if error_state == "ned":  # the other takes the product of tilt and velocity into P as well
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        assert np.abs((P15(after[0]) - expected) / scale).max() < 1e-9


@pytest.mark.parametrize("probability", [0.9, 0.999])
def test_the_gate_has_as_many_degrees_of_freedom_as_were_measured(probability: float) -> None:
    m = mission(4.0)
    settings = replace(parameters(), gate=GateParameters(probability=probability))
    pings = pings_of(m, None, AXIS_Y)
    before = fly(settings, m, pings).updates[-1].report
    gains = []
    for square in (0.5, 0.999, 1.2):  # beyond the limit it is used softly
        scale = np.sqrt(square * chi2.ppf(probability, 2) / before.nis)
        v_d = pings[-1].v_d + (scale - 1.0) * before.innovation
        result = fly(settings, m, [*pings[:-1], replace(pings[-1], v_d=v_d)])
        left = result.states["gate"]["dvl"]["left"][-1, 0]
        gains.append(1.0 - left / result.updates[-1].report.innovation[0])
    assert gains[1] == pytest.approx(gains[0], rel=1e-3)
    assert gains[2] == pytest.approx(gains[0] / 1.2, rel=1e-2)


def test_an_axis_that_is_never_measured_is_covered() -> None:
    """The lateral velocity is told by the accelerometer alone: its sigma grows, and is right."""
    m = mission(120.0)
    result = fly(parameters(), m, pings_of(m, None, AXIS_Y))
    reports = [u.report for u in result.updates]
    assert sum(r.accepted for r in reports) >= len(reports) - poisson.ppf(
        0.9999, 0.001 * len(reports)
    )
    assert np.mean([r.nis for r in reports]) == pytest.approx(2.0, rel=0.2)
    inside = np.abs(errors_in_sigma(result, m)) < 3.0
    assert inside.mean(axis=0).min() > 0.9
    full = fly(parameters(), m, pings_of(m))
    C = result.states[-1]["nav"]["C_n_b"]
    of_y = [
        float(C[:, 1] @ P15(r.states[-1])[VELOCITY, VELOCITY] @ C[:, 1]) for r in (result, full)
    ]
    assert of_y[0] > 100.0 * of_y[1]


def test_components_that_come_and_go_are_used() -> None:
    """Each is measured with a probability of 0.6; the NIS has as many degrees of freedom."""
    m, rng = mission(120.0), np.random.default_rng(SEED)
    pings = []
    for ping in pings_of(m):
        x, y, z = (rng.random(3) < 0.6).tolist()
        if x or y or z:
            pings.append(replace(ping, v_d=ping.v_d * (x, y, z), measured=(x, y, z)))
    result = fly(parameters(), m, pings)
    reports = [u.report for u in result.updates]
    assert sum(not r.accepted for r in reports) <= poisson.ppf(0.9999, 0.001 * len(reports))
    rows = [r.rows for r in reports]
    assert set(rows) == {1, 2, 3}
    # Chi-square of all of them, and a filter that is not quite white.
    assert np.sum([r.nis for r in reports]) == pytest.approx(np.sum(rows), rel=0.2)
    assert (np.abs(errors_in_sigma(result, m)) < 3.0).mean(axis=0).min() > 0.9


def test_an_innovation_is_published_without_nan() -> None:
    """In the axes of the stream; what was not measured has an infinite variance."""
    model = Filter(replace(parameters(), frame_convention="enu")).models["dvl"]
    S = np.array([[4.0, 0.0, 1.0], [0.0, np.inf, 0.0], [1.0, 0.0, 9.0]])
    innovation, S_stream = model.in_stream(np.array([1.0, 0.0, 2.0]), S)
    np.testing.assert_array_equal(innovation, [1.0, 0.0, -2.0])
    np.testing.assert_array_equal(S_stream, [[4, 0, -1], [0, np.inf, 0], [-1, 0, 9]])
    of = SimpleNamespace
    twist = of(linear=of(), angular=of())
    message = of(header=of(stamp=of()), twist=of(twist=twist))
    fill_innovation(message, 0, innovation, S_stream)
    np.testing.assert_array_equal(message.twist.covariance.reshape(6, 6)[:3, :3], S_stream)


def test_a_restart_leaves_what_was_not_measured_as_it_is() -> None:
    m = mission(10.0)
    settings = parameters()
    state = fly(settings, m, pings_of(m)).states[-1:].copy()
    model = Filter(settings).models["dvl"]
    nav = state[0]["nav"]
    C = nav["C_n_b"].copy()
    v_b, P_v = C.T @ nav["v_n"], C.T @ nav["P"][VELOCITY, VELOCITY] @ C
    event = Dvl(int(nav["time_ns"]), np.array([3.0, 0.0, 0.5]), None, AXIS_Y)
    linearised = model.linearise(state, event, Turn(np.zeros(3), np.zeros((3, 3))))
    model.restart(state[0], linearised.z_minus_h, linearised.R)
    after = C.T @ nav["v_n"]
    np.testing.assert_allclose(after, [3.0, v_b[1], 0.5], atol=1e-9)
    P_after = C.T @ nav["P"][VELOCITY, VELOCITY] @ C
    assert P_v[1, 1] <= P_after[1, 1] <= P_v[1, 1] + 2.0 * NOISE**2
    assert P_after[0, 0] > 1.0


def test_a_held_velocity_of_two_components_is_a_repetition_too() -> None:
    m = mission(10.0)
    pings = pings_of(m, None, AXIS_Y)
    pings[20:] = [replace(ping, v_d=pings[19].v_d) for ping in pings[20:]]
    reasons = [u.report.reason for u in fly(parameters(), m, pings).updates]
    assert reasons[20:] == ["repeated"] * (len(pings) - 20)


def test_what_was_measured_tells_two_measurements_of_one_stamp_apart() -> None:
    whole = Dvl(0, np.zeros(3))
    assert whole.payload() != replace(whole, measured=AXIS_Y).payload()
