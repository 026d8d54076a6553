"""Runs of the comparison: pairing, initial errors, floors, failures, metrics."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from insdvl.simulation.initial_errors import P_0
from insdvl.studies.evaluation.approaches import (
    BANDS,
    ORACLE,
    TRUE_FACTOR,
    TRUE_FACTORS,
    Setting,
    approach,
)
from insdvl.studies.evaluation.metrics import Track, attitude_error, nees
from insdvl.studies.evaluation.monte_carlo import (
    METRICS,
    TEST,
    TUNING,
    Run,
    Study,
    assess,
    at_true_level,
    evaluate_run,
    failed,
    initial_of_run,
    mission_of_run,
    perfect_heading,
    track,
    tuning_run,
)

STUDY = Study("varying", seed=5, duration=40.0)
CALIBRATED = Setting("calibrated")


@pytest.fixture(scope="module")
def run() -> Run:
    return Run(STUDY, TEST, 0)


def still(n: int) -> Track:
    return track(np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3)), np.zeros((n, 3)))


def test_runs_differ_and_splits_share_nothing() -> None:
    readings = [
        mission_of_run(STUDY, split, number).f_b[0] for split in (TEST, TUNING) for number in (0, 1)
    ]
    assert len(np.unique(readings, axis=0)) == 4
    again = mission_of_run(STUDY, TEST, 0)
    np.testing.assert_array_equal(again.f_b[0], readings[0])


def test_a_search_flies_missions_of_its_own() -> None:
    candidate = approach("constant 0.01/0.001", CALIBRATED)
    of_search = tuning_run((STUDY, (candidate,)), 0)["errors"][0, 0]
    scores = {
        split: assess(Run(STUDY, split, 0).fold(candidate), Run(STUDY, split, 0))[0]
        for split in (TEST, TUNING)
    }
    at = METRICS.index("body_rmse")
    assert of_search == scores[TUNING][at] != scores[TEST][at]


def test_initial_errors_have_the_initial_covariance() -> None:
    sigma = P_0
    mission = mission_of_run(replace(STUDY, duration=10.0), TEST, 0)
    C, v, p = mission.initial.C_n_b[0], mission.initial.v_n[0], mission.initial.p_o[0]
    errors = []
    for number in range(600):
        initial = initial_of_run(mission, STUDY, TEST, number)
        psi = attitude_error(initial.C_o_b[None], C[None])[0]
        errors.append(np.concatenate([psi, C.T @ v - initial.v, p - initial.p_o]))
    expected = np.array(
        [sigma.tilt_std] * 2
        + [sigma.heading_std]
        + [sigma.velocity_std] * 3
        + [sigma.position_std] * 3
    )
    # The standard error of a sigma of 600 draws is 2.9 %, that of a mean 4.1 % of the sigma.
    np.testing.assert_allclose(np.std(errors, axis=0) / expected, 1.0, atol=0.13)
    np.testing.assert_allclose(np.mean(errors, axis=0) / expected, 0.0, atol=0.18)


def test_all_approaches_of_a_run_see_the_same() -> None:
    names = ("constant 0.01/0.001", ORACLE)
    alone = [evaluate_run((STUDY, (approach(name, CALIBRATED),)), 1)["scores"][0] for name in names]
    both = evaluate_run((STUDY, tuple(approach(name, CALIBRATED) for name in names)), 1)["scores"]
    np.testing.assert_array_equal(both, alone)


def test_the_oracle_is_told_the_true_variances(run: Run) -> None:
    fold = run.fold(approach(ORACLE, CALIBRATED))
    told = np.hstack([np.diagonal(fold.states["noise"][q], 0, 1, 2) for q in ("Q_f", "Q_w")])
    # The state after a sample has the Q from its stamp on, which is that of the next sample.
    every = len(run.mission.q) // len(told)
    assert len(told) * every == len(run.mission.q)
    np.testing.assert_array_equal(told[:-1], run.mission.q[every::every])


def test_what_is_off_by_factors_is_right_at_the_true_level(run: Run) -> None:
    stamps_ns = run.mission.stamps_ns[::100]
    right = run.mission.q[::100]
    factors = np.array([0.1, 0.5, 2.0, 1.0, 4.0, 30.0])
    scaled = at_true_level(run.mission, stamps_ns, factors * right, each=True)
    np.testing.assert_allclose(scaled, right, rtol=1e-12)
    np.testing.assert_allclose(
        at_true_level(run.mission, stamps_ns, 7.0 * right), right, rtol=1e-12
    )
    # One factor keeps the ratios of the channels, and has the mean level of the truth.
    common = at_true_level(run.mission, stamps_ns, factors * right)
    found = common / right
    np.testing.assert_allclose(found / found[0, 0], np.broadcast_to(factors / 0.1, found.shape))
    assert np.mean(np.log(common / right)) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("row", "factors"), [(TRUE_FACTOR, 1), (TRUE_FACTORS, 6)])
def test_rows_at_the_true_level_keep_what_bands_tells_of_changes(
    run: Run, row: str, factors: int
) -> None:
    run.fold(approach(BANDS, CALIBRATED))
    run.fold(approach(row, CALIBRATED))
    (stamps_ns, told), (same_ns, scaled) = run._received[BANDS], run._received[row]
    np.testing.assert_array_equal(stamps_ns, same_ns)
    found = scaled / told
    np.testing.assert_allclose(found, np.broadcast_to(found[0], found.shape), rtol=1e-12)
    assert len(np.unique(found[0].round(9))) == factors


def test_a_filter_that_is_right_has_a_nees_of_one() -> None:
    values = np.array(
        [
            evaluate_run((STUDY, (approach(ORACLE, CALIBRATED),)), number)["scores"][0]
            for number in range(24)
        ]
    )
    mean = dict(zip(METRICS, values.mean(axis=0), strict=True))
    spread = dict(zip(METRICS, values.std(axis=0), strict=True))
    for name in ("nees_velocity", "nees_attitude", "nees_velocity_attitude", "nees_bias"):
        assert mean[name] == pytest.approx(1.0, abs=4.0 * spread[name] / np.sqrt(24.0) + 0.05), name
    assert mean["nis"] == pytest.approx(3.0, abs=4.0 * np.sqrt(6.0 / (24 * 40)))


def test_perfect_heading_leaves_tilt_and_body_velocity(run: Run) -> None:
    truth = run.truth
    psi = np.array([0.01, -0.02, 0.3])
    C = Rotation.from_rotvec(-psi).as_matrix() @ truth.C_n_b
    result = perfect_heading(replace(truth, C_n_b=C), truth)
    left = attitude_error(result.C_n_b, truth.C_n_b)
    assert np.abs(left[:, 2]).max() < 0.005
    np.testing.assert_allclose(np.linalg.norm(left[:, :2], axis=1), np.hypot(0.01, 0.02), rtol=0.2)
    np.testing.assert_array_equal(result.v_b, truth.v_b)


def test_failures() -> None:
    truth = still(3000)
    assert not failed(truth, truth, 100.0)
    v_b = np.zeros((3000, 3))
    v_b[500:1499, 0] = 6.0
    assert not failed(replace(truth, v_b=v_b), truth, 100.0)
    v_b[500:1500, 0] = 6.0
    assert failed(replace(truth, v_b=v_b), truth, 100.0)
    v_b[1000] = 0.0
    assert not failed(replace(truth, v_b=v_b), truth, 100.0)
    v_b[2000, 1] = np.nan
    assert failed(replace(truth, v_b=v_b), truth, 100.0)


def test_a_failed_filter_has_no_numbers(run: Run) -> None:
    fold = run.fold(approach(ORACLE, CALIBRATED))
    fold.track["v_n"][-1] = np.nan
    values, series = assess(fold, run)
    assert values[METRICS.index("failed")] == 1.0
    assert np.isnan(values[:-1]).all() and np.isnan(series).all()


def test_nees_by_hand_and_by_statistics() -> None:
    assert nees(np.array([[2.0, 0.0]]), np.array([[[4.0, 0.0], [0.0, 1.0]]]))[0] == 1.0
    rng = np.random.default_rng(6)
    L = np.tril(rng.normal(size=(6, 6))) + 3.0 * np.eye(6)
    error = rng.standard_normal((4000, 6)) @ L.T
    P = np.broadcast_to(L @ L.T, (4000, 6, 6))
    assert nees(error, P).mean() == pytest.approx(6.0, abs=4.0 * np.sqrt(12.0 / 4000))
    assert np.isnan(nees(np.ones((1, 2)), np.array([[[1.0, 2.0], [2.0, 1.0]]]))[0])
