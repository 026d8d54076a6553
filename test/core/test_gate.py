"""The gate: what passes, what does not, and that no error of the filter locks it for ever."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from insdvl.error_state import VELOCITY, body_velocity_jacobian
from insdvl.events import Dvl, Initial
from insdvl.fold import FoldResult, run
from insdvl.parameters import (
    DvlParameters,
    FilterParameters,
    GateParameters,
    InitialParameters,
    OriginParameters,
    ProcessNoiseParameters,
)
from insdvl.simulation.dvl import DvlModel
from insdvl.simulation.mission import ImuModel, Mission, simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.trajectories import AUV

SEED = 161_803
RUNS = 20
VARIANCES = [1e-4] * 3 + [1e-6] * 3
IMU = ImuModel(accelerometer_bias_walk=1e-9, gyroscope_bias_walk=1e-13)
DVL_STD = 0.05
LIMIT = 4


def parameters(error_state: str = "invariant", **gate: object) -> FilterParameters:
    return FilterParameters(
        frame_convention="ned",
        error_state=error_state,
        dvl=DvlParameters(noise_std=(DVL_STD,) * 3),
        gate=GateParameters(**({"max_rejections": LIMIT} | gate)),
        process_noise=ProcessNoiseParameters(
            accelerometer_variance=tuple(VARIANCES[:3]), gyroscope_variance=tuple(VARIANCES[3:])
        ),
        initial=InitialParameters(mode="set_odometry", velocity_std=0.02, heading_std=0.01),
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
    without: int | None = None,
) -> FoldResult:
    """Start with an error drawn from P_0; take ``v_d`` (M, 3) as the pings, less one of them."""
    rng = np.random.default_rng([seed, 1])
    initial = settings.initial
    stds = [initial.tilt_std, initial.tilt_std, initial.heading_std]
    C = m.initial.C_n_b[0]
    start = Initial(
        stamp_ns=0,
        C_n_b=Rotation.from_rotvec(rng.standard_normal(3) * stds).as_matrix().T @ C,
        p_n=m.initial.p_n[0] - initial.position_std * rng.standard_normal(3),
        v=C.T @ m.initial.v_n[0] - initial.velocity_std * rng.standard_normal(3),
        velocity_frame="body",
    )
    pings = [Dvl(t, v) for t, v in zip(m.dvl_stamps_ns.tolist(), v_d, strict=True)]
    if without is not None:
        del pings[without]
    return run(settings, m.stamps_ns, m.f_b, m.w_ib_b, [start, *pings])


def body_velocity_error(result: FoldResult, m: Mission) -> np.ndarray:
    v_b = np.einsum("kji,kj->ki", result.states["C_n_b"], result.states["v_n"])
    return np.einsum("kji,kj->ki", m.truth.C_n_b, m.truth.v_n) - v_b


@pytest.mark.parametrize("probability", [0.9, 0.999])
def test_the_threshold_is_chi_square_with_three_degrees_of_freedom(probability: float) -> None:
    """The same ping, with its innovation scaled to lie just inside and just outside."""
    m = mission(duration=5.0)
    settings = parameters(probability=probability)
    before = fly(settings, m, m.v_d).updates[-1].report
    predicted = m.v_d[-1] - before.innovation
    for factor, accepted in ((0.999, True), (1.001, False)):
        scale = factor * np.sqrt(chi2.ppf(probability, 3) / before.nis)
        v_d = m.v_d.copy()
        v_d[-1] = predicted + scale * before.innovation
        report = fly(settings, m, v_d).updates[-1].report
        assert report.nis == pytest.approx(factor**2 * chi2.ppf(probability, 3), rel=1e-6)
        expected = float(report.innovation @ np.linalg.solve(report.S, report.innovation))
        assert report.nis == pytest.approx(expected, rel=1e-9)
        assert (report.accepted, report.reason) == (accepted, "" if accepted else "gate")


def test_of_good_measurements_as_many_pass_as_the_probability_says() -> None:
    """The limit is so high that the filter never recovers by force."""
    settings = parameters(probability=0.9, max_rejections=1000)
    rejected = total = 0
    for seed in range(SEED, SEED + RUNS):
        m = mission(seed)
        reports = [u.report for u in fly(settings, m, m.v_d, seed=seed).updates]
        rejected += sum(not r.accepted for r in reports)
        total += len(reports)
    # A rejection makes the filter a little less sure and the next one a little less likely.
    sigma = np.sqrt(0.09 / total)
    assert abs(rejected / total - 0.1) < 3.3 * sigma + 0.005


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
    np.testing.assert_allclose(spoilt.states["v_n"], clean.states["v_n"], atol=1e-9)
    assert not any(spoilt.counts[name] for name in ("inflations", "restarts"))


def test_only_rejections_in_a_row_have_a_consequence() -> None:
    m = mission()
    v_d = m.v_d.copy()
    v_d[5::5] += [3.0, 0.0, 0.0]  # more than twice the limit in all
    result = fly(parameters(), m, v_d)
    assert [not u.report.accepted for u in result.updates] == [
        k > 0 and k % 5 == 0 for k in range(len(v_d))
    ]
    assert not any(result.counts[name] for name in ("inflations", "restarts"))


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
    assert reasons[jump_at : jump_at + LIMIT] == ["gate"] * LIMIT
    first = reasons.index("", jump_at)
    assert first <= jump_at + 2 * LIMIT
    assert reasons[first:] == [""] * (len(reasons) - first)
    assert result.counts["inflations"] == 1
    error = body_velocity_error(result, m)[-1]
    np.testing.assert_allclose(error, -jump, atol=4 * DVL_STD)


def test_after_the_limit_the_velocity_covariance_grows_by_the_innovation() -> None:
    m = mission()
    jump_at = 20
    v_d = m.v_d.copy()
    v_d[jump_at:] += [2.0, -2.0, 1.0]
    result = fly(parameters(), m, v_d)
    last = jump_at + LIMIT - 1
    k = int(np.searchsorted(m.stamps_ns, m.dvl_stamps_ns[last]))
    innovation = result.updates[last].report.innovation
    before, after = result.states[k - 1]["P"], result.states[k]["P"]
    growth = (after - before)[VELOCITY, VELOCITY]
    np.testing.assert_allclose(growth, np.eye(3) * (innovation @ innovation), rtol=1e-3, atol=1e-3)
    assert result.states["inflations"][k - 1 : k + 1].tolist() == [0, 1]


def with_nonsense(m: Mission, at: int) -> np.ndarray:
    """Off by 3 m/s, which the covariance is inflated for, then to and fro by far more than that."""
    v_d = m.v_d.copy()
    v_d[at : at + LIMIT] += [3.0, 0.0, 0.0]
    v_d[at + LIMIT : at + 2 * LIMIT : 2] += [50.0, 0.0, 0.0]
    v_d[at + LIMIT + 1 : at + 2 * LIMIT : 2] -= [50.0, 0.0, 0.0]
    return v_d


@pytest.mark.parametrize("error_state", ["invariant", "ned"])
def test_when_inflation_does_not_help_the_velocity_starts_again(error_state: str) -> None:
    m = mission()
    at = 20
    v_d = with_nonsense(m, at)
    result = fly(parameters(error_state), m, v_d)
    reports = [u.report for u in result.updates]
    last = at + 2 * LIMIT - 1
    assert [r.reason for r in reports[at:last]] == ["gate"] * (2 * LIMIT - 1)
    assert (reports[last].accepted, reports[last].reason) == (True, "restarted")
    k = int(np.searchsorted(m.stamps_ns, m.dvl_stamps_ns[last]))
    s = result.states[k]
    np.testing.assert_allclose(s["C_n_b"].T @ s["v_n"], v_d[last], rtol=1e-9)
    # As certain as the ping, and in body axes independent of everything else.
    invariant = error_state == "invariant"
    J = body_velocity_jacobian(s["C_n_b"], s["v_n"], invariant=invariant, n=15)
    np.testing.assert_allclose(J @ s["P"] @ J.T, DVL_STD**2 * np.eye(3), rtol=1e-6, atol=1e-9)
    rest = np.delete(J @ s["P"], np.r_[0:3], axis=1)
    scale = DVL_STD * np.sqrt(np.diag(s["P"])[3:])
    assert np.abs(rest / scale).max() < (1e-9 if invariant else 1e-2)
    assert np.linalg.eigvalsh(s["P"] / np.sqrt(np.outer(np.diag(s["P"]), np.diag(s["P"]))))[0] > 0.0


def test_a_wrong_restart_is_left_again() -> None:
    """Nonsense for as long as it takes to restart, then good pings: these win in the end."""
    m = mission()
    result = fly(parameters(), m, with_nonsense(m, 10))
    assert result.counts["restarts"] == 1
    assert np.isfinite(result.states["P"]).all()
    good = [u.report.accepted for u in result.updates[-20:]]
    assert good == [True] * 20
    assert np.abs(body_velocity_error(result, m)[-1]).max() < 5 * DVL_STD


def test_a_disabled_gate_accepts_everything() -> None:
    m = mission(duration=10.0)
    result = fly(parameters(enabled=False), m, m.v_d + np.array([50.0, 0.0, 0.0]))
    assert all(u.report.accepted for u in result.updates)
    assert result.updates[0].report.nis > 1e3


def test_an_outage_of_a_minute_is_covered_and_left_smoothly() -> None:
    """30 s of pings, 60 s without, 30 s of pings: errors within sigma, and no jump beyond it."""
    nees, nis = [], []
    for seed in range(SEED, SEED + RUNS):
        m = mission(seed, 120.0, outages=((30.5, 90.5),))
        result = fly(parameters(), m, m.v_d, seed=seed)
        assert len(result.updates) == 60
        assert all(u.report.accepted for u in result.updates)
        back = int(np.searchsorted(m.stamps_ns, 91_000_000_000))
        error = body_velocity_error(result, m)
        s = result.states[back - 1]
        J = body_velocity_jacobian(s["C_n_b"], s["v_n"], invariant=True, n=15)
        P = J @ s["P"] @ J.T
        nees.append(error[back - 1] @ np.linalg.solve(P, error[back - 1]))
        assert np.sqrt(np.trace(P)) > 3 * DVL_STD  # the filter knows that it has drifted
        nis.append(result.updates[30].report.nis)
        assert np.abs(error[back + 1000]).max() < 4 * DVL_STD
    for total in (sum(nees), sum(nis)):
        assert chi2.ppf(0.0005, 3 * RUNS) < total < chi2.isf(0.0005, 3 * RUNS)
