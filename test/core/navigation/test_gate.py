"""The gate: what passes, what does not, and that no error of the filter locks it for ever."""

from dataclasses import replace

import numpy as np
import pytest
from records import P15, fields
from scipy.stats import chi2

from insdvl.navigation.coordinates import body_velocity_jacobian
from insdvl.navigation.error_state import ATTITUDE, VELOCITY
from insdvl.navigation.events import NS
from insdvl.navigation.filter import Filter
from insdvl.navigation.measurements.depth import Depth
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import (
    DvlParameters,
    FilterParameters,
    GateParameters,
    ImuParameters,
    OriginParameters,
    ProcessNoiseParameters,
)
from insdvl.navigation.state.fields import NEVER
from insdvl.simulation.initial_errors import P_0, drawn_initial
from insdvl.simulation.mission import ImuModel, Mission, simulate
from insdvl.simulation.noise import constant, segments
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.trajectories import AUV
from insdvl.timeline.output import FoldResult
from insdvl.timeline.recorded import fold_arrays

SEED = 161_803
RUNS = 20
VARIANCES = [1e-4] * 3 + [1e-6] * 3
IMU = ImuModel(accelerometer_bias_walk=1e-9, gyroscope_bias_walk=1e-13)
DVL_STD = 0.05
LIMIT = 4  # seconds, and pings: there is one each second


def parameters(error_state: str = "invariant", **gate: object) -> FilterParameters:
    return FilterParameters(
        frame_convention="ned",
        error_state=error_state,
        dvl=DvlParameters(noise_std=(DVL_STD,) * 3, max_speed=1000.0),  # the gate's business
        gate=GateParameters(**({"max_rejection_time": float(LIMIT)} | gate)),
        process_noise=ProcessNoiseParameters(
            accelerometer_variance=tuple(VARIANCES[:3]), gyroscope_variance=tuple(VARIANCES[3:])
        ),
        initial=replace(P_0, mode="set_odometry", velocity_std=0.02, heading_std=0.01),
        origin=OriginParameters(height=float(AUV.h_0)),
    )


def mission(seed: int = SEED, duration: float = 60.0, **dvl: object) -> Mission:
    model = DvlModel(noise_std=np.full(3, DVL_STD), **dvl)
    return simulate(AUV, constant(VARIANCES), seed=seed, duration=duration, imu=IMU, dvl=model)


def fly(
    settings: FilterParameters,
    m: Mission,
    v_d: np.ndarray,
    *,
    seed: int = SEED,
    without: int | slice | None = None,
    gap: slice | None = None,
    R: np.ndarray | None = None,
) -> FoldResult:
    """Start with an error drawn from P_0; take ``v_d`` (M, 3) as the pings, less some of them.

    The samples of a gap are missing as well.
    """
    start = drawn_initial(m.initial, settings.initial, np.random.default_rng([seed, 1]))
    pings = [Dvl(t, v, R) for t, v in zip(m.dvl_stamps_ns.tolist(), v_d, strict=True)]
    if without is not None:
        del pings[without]
    samples = [m.stamps_ns, m.f_b, m.w_ib_b]
    if gap is not None:
        samples = [np.delete(array, gap, axis=0) for array in samples]
    return fold_arrays(settings, *samples, [start, *pings])


def body_velocity_error(result: FoldResult, m: Mission) -> np.ndarray:
    v_b = np.einsum("kji,kj->ki", result.states["nav"]["C_n_b"], result.states["nav"]["v_n"])
    return np.einsum("kji,kj->ki", m.truth.C_n_b, m.truth.v_n) - v_b


@pytest.mark.parametrize("probability", [0.9, 0.999])
def test_the_threshold_is_chi_square_with_three_degrees_of_freedom(probability: float) -> None:
    """The same ping, with its innovation scaled to a NIS around the limit.

    Beyond it its gain is as much smaller as the NIS is larger; a large step that the IMU has not
    seen is rejected.
    """
    m, limit = mission(duration=5.0), chi2.ppf(probability, 3)
    settings = parameters(probability=probability)
    before = fly(settings, m, m.v_d).updates[-1].report
    predicted = m.v_d[-1] - before.innovation
    gains = {}
    for square in (0.5, 0.999, 1.2, 1.499, 10.0):
        v_d = m.v_d.copy()
        v_d[-1] = predicted + np.sqrt(square * limit / before.nis) * before.innovation
        result = fly(settings, m, v_d)
        report = result.updates[-1].report
        assert report.nis == pytest.approx(square * limit, rel=1e-6)
        expected = float(report.innovation @ np.linalg.solve(report.S, report.innovation))
        assert report.nis == pytest.approx(expected, rel=1e-9)
        assert (report.accepted, report.reason) == (square < 10.0, "gate" if square == 10.0 else "")
        left = result.states["gate"]["dvl"]["left"][-1, :3]
        gains[square] = 1.0 - left[0] / report.innovation[0]
    assert gains[0.999] == pytest.approx(gains[0.5], rel=1e-3)
    for square in (1.2, 1.499):
        assert gains[square] == pytest.approx(gains[0.5] / square, rel=1e-2)


def test_of_good_measurements_as_many_pass_as_the_probability_says() -> None:
    """The limit is so high that the filter never recovers by force."""
    settings = parameters(probability=0.9, max_rejection_time=1000.0)
    rejected = misfits = total = 0
    for seed in range(SEED, SEED + RUNS):
        m = mission(seed)
        reports = [u.report for u in fly(settings, m, m.v_d, seed=seed).updates]
        rejected += sum(not r.accepted for r in reports)
        misfits += sum(r.nis > chi2.ppf(0.9, 3) for r in reports)
        total += len(reports)
    # A rejection makes the filter a little less sure and the next one a little less likely.
    for count, p in ((misfits, 0.1), (rejected, chi2.sf(1.5 * chi2.ppf(0.9, 3), 3))):
        assert abs(count / total - p) < 3.3 * np.sqrt(p * (1.0 - p) / total) + 0.005


def test_a_single_outlier_leaves_no_trace() -> None:
    """The result is that of a mission without this ping."""
    m = mission()
    at = 20
    v_d = m.v_d.copy()
    v_d[at] += [2.0, -1.0, 0.5]
    spoilt = fly(parameters(), m, v_d)
    report = spoilt.updates[at].report
    assert (report.accepted, report.reason) == (False, "gate")
    assert sum(not u.report.accepted for u in spoilt.updates) == 1
    clean = fly(parameters(), m, v_d, without=at)
    np.testing.assert_allclose(spoilt.states["nav"]["v_n"], clean.states["nav"]["v_n"], atol=1e-9)
    assert not any(spoilt.counts[name] for name in ("dvl inflations", "dvl restarts"))


def test_only_rejections_in_a_row_have_a_consequence() -> None:
    m = mission()
    v_d = m.v_d.copy()
    v_d[5::5] += [3.0, 0.0, 0.0]  # more than twice the limit in all
    result = fly(parameters(), m, v_d)
    assert [not u.report.accepted for u in result.updates] == [
        k > 0 and k % 5 == 0 for k in range(len(v_d))
    ]
    assert not any(result.counts[name] for name in ("dvl inflations", "dvl restarts"))


@pytest.mark.parametrize("error_state", ["invariant", "ned"])
def test_a_filter_that_is_wrong_recovers(error_state: str) -> None:
    """The velocity jumps by 3 m/s, as after a collision that the IMU did not measure."""
    m = mission(duration=40.0)
    jump_at = 20
    jump = np.array([2.0, -2.0, 1.0])
    v_d = m.v_d.copy()
    v_d[jump_at:] += jump
    result = fly(parameters(error_state), m, v_d)
    reasons = [u.report.reason for u in result.updates]
    assert reasons[:jump_at] == [""] * jump_at
    first = jump_at + LIMIT + 1
    assert reasons[jump_at:first] == ["gate"] * (LIMIT + 1)
    assert reasons[first:] == [""] * (len(reasons) - first)
    assert result.counts["dvl inflations"] == 1
    error = body_velocity_error(result, m)[-1]
    np.testing.assert_allclose(error, -jump, atol=4 * DVL_STD)


def test_after_the_limit_the_velocity_may_be_what_makes_the_innovation() -> None:
    """The DVL has jumped, and a tilt does not make a jump."""
    m = mission()
    jump_at = 20
    v_d = m.v_d.copy()
    v_d[jump_at:] += [2.0, -2.0, 1.0]
    result = fly(parameters(), m, v_d)
    last = jump_at + LIMIT
    k = int(np.searchsorted(m.stamps_ns, m.dvl_stamps_ns[last]))
    innovation = result.updates[last].report.innovation
    before, after = (
        P15(result.states[k - 1]),
        P15(result.states[k]),
    )
    growth, square = after - before, innovation @ innovation
    expected = np.diag([1.0, 1.0, 1.0]) * square
    np.testing.assert_allclose(growth[VELOCITY, VELOCITY], expected, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(growth[ATTITUDE, ATTITUDE], 0.0, atol=1e-5)
    assert result.states["gate"]["dvl"]["inflations"][k - 1 : k + 1].tolist() == [0, 1]


def with_nonsense(m: Mission, at: int) -> np.ndarray:
    """Off by 3 m/s, which the covariance is inflated for, then to and fro by far more than that."""
    v_d = m.v_d.copy()
    inflated, restarted = at + LIMIT + 1, at + 2 * LIMIT + 1
    v_d[at:inflated] += [3.0, 0.0, 0.0]
    v_d[inflated:restarted:2] += [50.0, 0.0, 0.0]
    v_d[inflated + 1 : restarted : 2] -= [50.0, 0.0, 0.0]
    return v_d


@pytest.mark.parametrize("error_state", ["invariant", "ned"])
def test_when_inflation_does_not_help_the_velocity_starts_again(error_state: str) -> None:
    m = mission()
    at = 20
    v_d = with_nonsense(m, at)
    result = fly(parameters(error_state), m, v_d)
    reports = [u.report for u in result.updates]
    last = at + 2 * LIMIT
    assert [r.reason for r in reports[at:last]] == ["gate"] * (2 * LIMIT)
    assert (reports[last].accepted, reports[last].reason) == (True, "restarted")
    k = int(np.searchsorted(m.stamps_ns, m.dvl_stamps_ns[last]))
    s = result.states[k]
    np.testing.assert_allclose(s["nav"]["C_n_b"].T @ s["nav"]["v_n"], v_d[last], rtol=1e-9)
    # As uncertain as ping and filter are apart, and in body axes independent of everything else.
    invariant = error_state == "invariant"
    J = body_velocity_jacobian(s["nav"]["C_n_b"], s["nav"]["v_n"], invariant=invariant, n=15)
    doubt = DVL_STD**2 * np.eye(3) + np.outer(reports[last].innovation, reports[last].innovation)
    np.testing.assert_allclose(J @ P15(s) @ J.T, doubt, rtol=1e-6, atol=1e-9)
    rest = np.delete(J @ P15(s), np.r_[0:3], axis=1)
    scale = DVL_STD * np.sqrt(np.diag(P15(s))[3:])
    assert np.abs(rest / scale).max() < (1e-9 if invariant else 1e-2)
    assert np.linalg.eigvalsh(P15(s) / np.sqrt(np.outer(np.diag(P15(s)), np.diag(P15(s)))))[0] > 0.0


def test_a_wrong_restart_is_left_again() -> None:
    """Nonsense for as long as it takes to restart, then good pings: these win in the end."""
    m = mission()
    result = fly(parameters(), m, with_nonsense(m, 10))
    assert result.counts["dvl restarts"] == 1
    assert np.isfinite(P15(result.states)).all()
    good = [u.report.accepted for u in result.updates[-20:]]
    assert good == [True] * 20
    assert np.abs(body_velocity_error(result, m)[-1]).max() < 5 * DVL_STD


def test_a_disabled_gate_accepts_everything() -> None:
    m = mission(duration=10.0)
    result = fly(parameters(enabled=False), m, m.v_d + np.array([50.0, 0.0, 0.0]))
    assert all(u.report.accepted for u in result.updates)
    assert result.updates[0].report.nis > 1e3


def test_a_filter_that_is_far_too_sure_of_itself_is_not_lost() -> None:
    """The true variances change between a tenth and fifty times those that the filter believes."""
    believed = ProcessNoiseParameters(
        accelerometer_variance=(0.01,) * 3, gyroscope_variance=(0.001,) * 3
    )
    lost = 0
    for seed in range(SEED, SEED + RUNS // 2):
        m = simulate(AUV, segments(1e-3, 0.05), seed=seed, imu=IMU)
        settings = replace(
            parameters(max_rejection_time=60.0), dvl=DvlParameters(), process_noise=believed
        )
        result = fly(settings, m, m.v_d, seed=seed)
        error = np.linalg.norm(body_velocity_error(result, m), axis=1)
        lost += bool((np.convolve(error > 5.0, np.ones(1000)) >= 999.5).any())  # 10 s in a row
    assert lost <= 1


# ------------------------------------------------------------------ who is trusted


def test_a_filter_that_nothing_has_borne_out_rejects_once() -> None:
    """Then it is as uncertain as both are apart: the next measurement tells which was right."""
    m = mission()
    v_d = m.v_d.copy()
    v_d[0] += [3.0, 0.0, 0.0]
    result = fly(parameters(max_rejection_time=60.0), m, v_d)
    assert [u.report.reason for u in result.updates] == ["gate"] + [""] * 59
    assert (result.counts["dvl inflations"], result.counts["dvl restarts"]) == (1, 0)
    k = int(np.searchsorted(m.stamps_ns, m.dvl_stamps_ns[0]))
    assert np.abs(in_sigmas(result, m)[k]).max() < 3.0
    assert np.abs(body_velocity_error(result, m)[-1]).max() < 5 * DVL_STD


def test_a_second_measurement_that_is_off_is_soon_forgotten() -> None:
    """The third is back where the filter still is: one fault of the DVL explains both.

    The filter has given in to the second, which nothing spoke against, but has not believed it.
    """
    m = mission()
    v_d = m.v_d.copy()
    v_d[1] += [3.0, 0.0, 0.0]
    settings = parameters(max_rejection_time=60.0)
    result = fly(settings, m, v_d)
    assert [u.report.reason for u in result.updates] == ["", "gate"] + [""] * 58
    assert result.states["gate"]["dvl"]["doubt_from_ns"][-1] == NEVER
    # From the third on it knows what that says, and is right about how well.
    k = int(np.searchsorted(m.stamps_ns, m.dvl_stamps_ns[2])) + 1
    assert np.sqrt(np.diag(P15(result.states[k]))[VELOCITY]).max() < 1.1 * DVL_STD
    assert np.abs(in_sigmas(result, m)).max() < 4.0


X, Y = np.eye(3)[:2]
#: Pings per second, pings that are missing, and what is added to others [m/s], by what happens.
CLAIMS = {
    "second and third, not alike": (1.0, None, {1: 3.0 * X, 2: 1.5 * X - 3.0 * Y}),
    "second and fourth": (1.0, None, {1: 3.0 * X, 3: -3.0 * X}),
    "second, fourth and fifth": (1.0, None, {1: 3.0 * X, 3: -3.0 * X, 4: -3.0 * X}),
    "every second one": (1.0, None, dict.fromkeys(range(1, 20, 2), 3.0 * X)),
    "second to eighth": (1.0, None, dict.fromkeys(range(1, 8), 3.0 * X)),
    "two of a slow DVL": (0.2, None, dict.fromkeys(range(1, 3), X)),
    "six behind an outage": (1.0, slice(100, 131), dict.fromkeys(range(132, 138), X)),
    "after a rejection, elsewhere": (
        *(1.0, None),
        dict.fromkeys(range(30, 60), 3.0 * X) | dict.fromkeys(range(60, 65), 1.3 * Y),
    ),
    "first, then a bias": (1.0, None, {0: 3.0 * X} | dict.fromkeys(range(120, 145), -2.0 * X)),
    "second, then a bias": (1.0, None, {1: 3.0 * X} | dict.fromkeys(range(120, 145), -2.0 * X)),
}


@pytest.mark.parametrize("which", CLAIMS)
def test_faults_that_little_speaks_against_are_covered(which: str) -> None:
    """It cannot be told which are right. The sigma says so, and the good ones win in the end."""
    rate, missing, off = CLAIMS[which]
    m = mission(duration=190.0, rate=rate)
    v_d = m.v_d.copy()
    for ping, error in off.items():
        v_d[ping] += error
    result = fly(parameters(max_rejection_time=60.0), m, v_d, without=missing)
    assert np.abs(in_sigmas(result, m)).max() < 5.0
    assert np.abs(body_velocity_error(result, m)[-1]).max() < 5 * DVL_STD


def test_the_doubt_of_a_filter_without_trust_fades() -> None:
    """Of 3 m/s, it halves in 10 s.

    After 40 s the last ten pings alone, doubted by 0.4 m/s at most, tell the velocity to 0.12 m/s;
    forty that are all doubted by 3 m/s would tell it to 0.5 m/s.
    """
    m = mission(duration=45.0)
    v_d = m.v_d.copy()
    v_d[1] += 3.0 * X
    v_d[2] -= 3.0 * Y
    result = fly(parameters(max_rejection_time=60.0), m, v_d)
    assert result.states["gate"]["dvl"]["doubt"][-1] == pytest.approx(3.0, abs=5 * DVL_STD)
    k = int(np.searchsorted(m.stamps_ns, m.dvl_stamps_ns[42])) + 1
    assert np.sqrt(np.diag(P15(result.states[k]))[VELOCITY]).max() < 0.2


@pytest.mark.parametrize("outage", [0, 6, 20])
def test_trust_is_the_time_of_accepted_measurements_less_twice_that_of_outages(outage: int) -> None:
    m = mission()
    settings = parameters(max_rejection_time=60.0)
    result = fly(settings, m, m.v_d, without=slice(30, 30 + outage))
    k = int(np.searchsorted(m.stamps_ns, m.dvl_stamps_ns[30 + outage]))
    # The measurement behind the outage is outage + 1 s after the one before it.
    after = 30 if outage == 0 else max(29 - 2 * (outage + 1), 0)
    assert result.counts["dvl restarts"] == 0
    assert result.states["gate"]["dvl"]["trusted_for"][k] == after * NS
    # The most is what the parameter says.
    bounded = fly(parameters(max_rejection_time=10.0), m, m.v_d)
    assert bounded.states["gate"]["dvl"]["trusted_for"].max() == 10 * NS


def test_what_an_outage_may_have_hidden_is_refused_for_five_seconds_at_most() -> None:
    m = mission(duration=43.0)
    v_d = m.v_d.copy()
    v_d[30:] += [5.0, 0.0, 0.0]
    settings = parameters(max_rejection_time=60.0)
    result = fly(settings, m, v_d, without=slice(20, 30))
    reasons = [u.report.reason for u in result.updates]
    assert reasons == [""] * 20 + ["gate"] * 6 + [""] * 7
    # Without the outage the DVL is at fault, and the filter trusted for 29 s.
    assert [u.report.reason for u in fly(settings, m, v_d).updates][30:] == ["gate"] * 13


def test_what_a_gap_may_have_hidden_is_refused_for_five_seconds_at_most() -> None:
    """Two seconds of samples are missing, and in them the velocity has changed by 3 m/s."""
    m = mission(duration=43.0)
    v_d = m.v_d.copy()
    v_d[30:] += [3.0, 0.0, 0.0]
    imu = ImuParameters(gap_acceleration_std=0.05, gap_rate_std=0.002)
    settings = replace(parameters(max_rejection_time=60.0), imu=imu)
    reasons = [u.report.reason for u in fly(settings, m, v_d, gap=slice(2890, 3090)).updates]
    first = reasons.index("gate")
    assert first in (29, 30) and reasons[first:].count("gate") <= 7
    assert not any(reasons[first + 7 :])
    # Without the gap the DVL is at fault, and the filter trusted for 29 s.
    assert [u.report.reason for u in fly(settings, m, v_d).updates][30:] == ["gate"] * 13


def test_a_drift_is_the_filters_and_a_constant_error_is_not() -> None:
    """The innovation grows by 0.1 m/s with every measurement; or it jumps to 5 m/s and stays."""
    m = mission(duration=44.0)
    settings = parameters(max_rejection_time=60.0)
    grows, stays = m.v_d.copy(), m.v_d.copy()
    grows[20:] += np.arange(24)[:, None] * [0.1, 0.0, 0.0]
    stays[20:36] += [5.0, 0.0, 0.0]
    result = fly(settings, m, grows)
    assert [u.report.reason for u in result.updates].count("gate") <= 1
    error = body_velocity_error(result, m)[-1] + [2.3, 0.0, 0.0]
    assert np.abs(error).max() < 0.3
    reasons = [u.report.reason for u in fly(settings, m, stays).updates]
    assert reasons[20:] == ["gate"] * 16 + [""] * 8


# ------------------------------------------------------------------ noise that is not told


@pytest.mark.parametrize("error_state", ["invariant", "ned"])
def test_a_process_noise_that_is_far_too_small_costs_no_measurement(error_state: str) -> None:
    """The IMU shows its noise, a hundred times what is told: with the gate as without."""
    told = ProcessNoiseParameters(
        accelerometer_variance=(1e-4,) * 3, gyroscope_variance=(1e-5,) * 3
    )
    errors, refused = {True: [], False: []}, 0
    for seed in range(SEED, SEED + 5):
        m = simulate(AUV, constant([1e-2] * 3 + [1e-3] * 3), seed=seed, duration=120.0, imu=IMU)
        for enabled in errors:
            settings = replace(
                parameters(error_state, enabled=enabled, max_rejection_time=60.0),
                dvl=DvlParameters(),
                process_noise=told,
            )
            result = fly(settings, m, m.v_d, seed=seed)
            errors[enabled].append(body_velocity_error(result, m)[2000:])
            refused += sum(not u.report.accepted for u in result.updates)
    with_gate, without = (np.sqrt(np.mean(np.square(errors[on]))) for on in (True, False))
    assert with_gate < 1.1 * without
    assert refused <= 6  # of 600


def test_the_untold_noise_is_what_it_makes_with_the_gains_of_the_filter() -> None:
    """P and the untold part together are the covariance of the true error, by 40 flights."""
    told = ProcessNoiseParameters(
        accelerometer_variance=(1e-4,) * 3, gyroscope_variance=(1e-5,) * 3
    )
    squares, predicted = [], []
    for seed in range(SEED, SEED + 40):
        m = simulate(AUV, constant([1e-2] * 3 + [1e-4] * 3), seed=seed, duration=40.0, imu=IMU)
        settings = replace(parameters(enabled=False), dvl=DvlParameters(), process_noise=told)
        result = fly(settings, m, m.v_d, seed=seed)
        error, s = body_velocity_error(result, m)[-1], result.states[-1]
        C, excess = s["nav"]["C_n_b"], s["noise"]["excess"][VELOCITY, VELOCITY]
        squares.append(error**2)
        predicted.append(np.diag(C.T @ (s["nav"]["P"][VELOCITY, VELOCITY] + excess) @ C))
    ratio = np.sum(squares) / np.sum(predicted)
    assert chi2.ppf(0.001, 120) / 120 < ratio < chi2.isf(0.001, 120) / 120


# ------------------------------------------------------------------ a DVL that is at fault


def in_sigmas(result: FoldResult, m: Mission) -> np.ndarray:
    """(N, 3) errors of the body velocity at all stamps, in sigmas."""
    J = body_velocity_jacobian(
        result.states["nav"]["C_n_b"], result.states["nav"]["v_n"], invariant=True, n=15
    )
    variance = np.einsum("kij,kjl,kil->ki", J, P15(result.states), J)
    return body_velocity_error(result, m) / np.sqrt(variance)


@pytest.mark.parametrize(
    ("variances", "dvl_std", "direction"),
    [
        ([1e-6] * 3 + [1e-10] * 3, DVL_STD, [1.0, 0.0, 0.0]),
        pytest.param(VARIANCES, DVL_STD, [-0.6, 0.6, 0.53], marks=pytest.mark.long),
        ([1e-2] * 3 + [1e-3] * 3, 0.1, [0.0, -0.7, 0.71]),
    ],
    ids=["navigation", "tactical", "poor"],
)
def test_a_bias_of_half_a_minute_does_no_harm(
    variances: list[float], dvl_std: float, direction: list[float]
) -> None:
    """A good IMU goes without the DVL throughout; a poor one until its own error would be larger.

    The sigma covers the error all the time, and what comes after the bias is used.
    """
    settings = replace(
        parameters(max_rejection_time=60.0),
        dvl=DvlParameters(noise_std=(dvl_std,) * 3),
        process_noise=ProcessNoiseParameters(
            accelerometer_variance=tuple(variances[:3]), gyroscope_variance=tuple(variances[3:])
        ),
    )
    biased = slice(40, 70)
    worst, refused, lost = [], [], []
    for seed in range(SEED, SEED + RUNS):
        model = DvlModel(noise_std=np.full(3, dvl_std))
        m = simulate(AUV, constant(variances), seed=seed, duration=90.0, imu=IMU, dvl=model)
        v_d = m.v_d.copy()
        v_d[biased] += direction
        result = fly(settings, m, v_d, seed=seed)
        accepted = np.array([u.report.accepted for u in result.updates])
        refused.append(not accepted[biased].any())
        lost.append(not accepted[biased.stop :].all())
        worst.append(np.abs(in_sigmas(result, m)).max())
        error = np.linalg.norm(body_velocity_error(result, m), axis=1)
        # It goes without the DVL until one sigma is as large as the bias.
        assert error.max() < 3.0 * np.linalg.norm(direction)
        assert not any(result.counts[name] for name in ("dvl inflations", "dvl restarts"))
    if variances[0] < 1e-2:
        assert all(refused)
    # Where the IMU drifts as fast as the bias ends, the end may be missed, and the sigma grows on.
    assert sum(lost) <= 2
    # Of 9000 times 3 errors, correlated over seconds, the largest is hardly beyond five sigma.
    assert max(worst) < 5.5


def test_a_burst_of_outliers_leaves_no_trace() -> None:
    """Ten in a row, each in a direction of its own."""
    m = mission()
    v_d = m.v_d.copy()
    v_d[20:30] += 2.0 * np.random.default_rng(SEED).standard_normal((10, 3))
    result = fly(parameters(max_rejection_time=60.0), m, v_d)
    accepted = [u.report.accepted for u in result.updates]
    assert accepted == [True] * 20 + [False] * 10 + [True] * 30
    assert np.abs(in_sigmas(result, m)).max() < 5.5


def test_one_outlier_after_an_outage_restarts_nothing() -> None:
    """However long the last accepted measurement is ago: only rejections make the filter doubt."""
    m = mission(duration=60.0, outages=(20.5, 50.5))
    v_d = m.v_d.copy()
    v_d[20] += [30.0, 0.0, 0.0]
    result = fly(parameters(), m, v_d)
    assert [k for k, u in enumerate(result.updates) if not u.report.accepted] == [20]
    assert not any(result.counts[name] for name in ("dvl inflations", "dvl restarts"))


# ------------------------------------------------------------------ lost bottom lock


#: What a gate remembers of a reading that it has not used.
MEMORY = ("gate.dvl.readings", "gate.dvl.repeats")


def without_memory(result: FoldResult) -> list[bytes]:
    return [v.tobytes() for name, v in fields(result.states) if name not in MEMORY]


@pytest.mark.parametrize("fault", ["zeros", "negative zeros", "repeats"])
def test_without_bottom_lock_it_is_as_without_pings(fault: str) -> None:
    """To the bit; and what comes afterwards is used."""
    m = mission()
    lost = slice(20, 50)
    v_d = m.v_d.copy()
    v_d[lost] = {"zeros": 0.0, "negative zeros": -0.0, "repeats": v_d[19]}[fault]
    settings = parameters()
    spoilt = fly(settings, m, v_d)
    reason = "repeated" if fault == "repeats" else "no_lock"
    reasons = [u.report.reason for u in spoilt.updates]
    assert reasons == [""] * 20 + [reason] * 30 + [""] * 10
    seen = np.delete(np.arange(len(v_d)), lost)
    away = replace(m, dvl_stamps_ns=m.dvl_stamps_ns[seen], v_d=m.v_d[seen])
    assert without_memory(spoilt) == without_memory(fly(settings, away, away.v_d))


def test_two_publishers_of_one_dvl_count_once() -> None:
    """The second one's stamps are its own, a moment later."""
    m = mission()
    twice = replace(
        m,
        dvl_stamps_ns=np.stack([m.dvl_stamps_ns, m.dvl_stamps_ns + 5_000_000], axis=1).ravel()[:-1],
        v_d=np.repeat(m.v_d, 2, axis=0)[:-1],
    )
    result = fly(parameters(), twice, twice.v_d)
    assert [u.report.reason for u in result.updates] == (["", "repeated"] * len(m.v_d))[:-1]
    once = fly(parameters(), m, m.v_d)
    variances = [np.diagonal(P15(each.states), axis1=1, axis2=2) for each in (result, once)]
    np.testing.assert_allclose(*variances, rtol=1e-6)


def test_a_vehicle_at_rest_may_say_so() -> None:
    m = mission(duration=10.0)
    settings = parameters(enabled=False)
    settings = replace(settings, dvl=replace(settings.dvl, lock_check=False))
    result = fly(settings, m, np.zeros_like(m.v_d))
    assert all(u.report.accepted for u in result.updates)


# ------------------------------------------------------------------ numbers out of proportion


@pytest.mark.parametrize("enabled", [True, False])
def test_numbers_beyond_all_numbers_leave_the_state_alone(enabled: bool) -> None:
    """A gate that is off lets everything pass that can be computed with."""
    m = mission(duration=10.0)
    settings = parameters(enabled=enabled)
    filter_ = Filter(settings)
    state = fly(settings, m, m.v_d).states[-1:].copy()
    before, memories = state.tobytes(), state["gate"].copy()
    now_ns = int(state[0]["nav"]["time_ns"])
    for event, reason in (
        (Dvl(now_ns, np.full(3, 1e200)), "too_fast"),
        (Depth(now_ns, 1e200), "not_finite"),
        (Dvl(now_ns, np.full(3, 1e-3), -np.eye(3)), "bad_covariance"),
    ):
        report = filter_.update(state, event, np.zeros(3), 1.0)
        assert (report.accepted, report.reason) == (False, reason)
    for name in ("dvl", "depth"):  # what was read is remembered
        state["gate"][name]["readings"] = memories[name]["readings"]
    assert state.tobytes() == before


# ------------------------------------------------------------------ outages


@pytest.mark.parametrize("outage", [10.0, pytest.param(120.0, marks=pytest.mark.long)])
def test_an_outage_is_covered_and_left_smoothly(outage: float) -> None:
    """30 s of pings, an outage, 30 s of pings: errors within sigma, and no jump beyond it."""
    nees, nis, worst, rejected = [], [], [], 0
    for seed in range(SEED, SEED + RUNS):
        m = mission(seed, 60.0 + outage, outages=(30.5, 30.5 + outage))
        result = fly(parameters(), m, m.v_d, seed=seed)
        assert len(result.updates) == 60
        rejected += sum(not u.report.accepted for u in result.updates)
        assert not any(result.counts[name] for name in ("dvl inflations", "dvl restarts"))
        back = int(np.searchsorted(m.stamps_ns, round((31.0 + outage) * 1e9)))
        error = body_velocity_error(result, m)
        s = result.states[back - 1]
        J = body_velocity_jacobian(s["nav"]["C_n_b"], s["nav"]["v_n"], invariant=True, n=15)
        P = J @ P15(s) @ J.T
        nees.append(error[back - 1] @ np.linalg.solve(P, error[back - 1]))
        worst.append(np.abs(in_sigmas(result, m)).max())
        assert np.sqrt(np.trace(P)) > 0.5 * DVL_STD  # the filter knows that it has drifted
        nis.append(result.updates[30].report.nis)
        # The return is no farther than the filter was unsure, and ends where the DVL says.
        jump = np.abs(error[back] - error[back - 1])
        assert (jump < 5 * np.sqrt(np.diag(P) + DVL_STD**2)).all()
        assert np.abs(error[back + 1000]).max() < 4 * DVL_STD
    assert rejected <= 5  # of 1200 that are good, one is expected
    for total in (sum(nees), sum(nis)):
        assert chi2.ppf(0.0005, 3 * RUNS) < total < chi2.isf(0.0005, 3 * RUNS)
    assert max(worst) < 5.5


def test_a_covariance_without_an_inverse_can_be_used() -> None:
    m = mission(duration=30.0)
    v_d = m.v_d.copy()
    v_d[:, 1] = np.einsum("kji,kj->ki", m.truth.C_n_b, m.truth.v_n)[99::100, 1]
    v_d[12] += 10.0
    result = fly(parameters(), m, v_d, R=np.diag([DVL_STD**2, 0.0, DVL_STD**2]))
    assert [k for k, u in enumerate(result.updates) if not u.report.accepted] == [12]
    assert np.isfinite(P15(result.states)).all()
