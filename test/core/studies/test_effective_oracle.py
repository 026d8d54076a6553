"""The oracle of `coloured`: consistent, and no factor on what it is told makes it better."""

import numpy as np
import pytest

from insdvl.simulation.drawn import scenarios
from insdvl.studies.evaluation.approaches import ORACLE, Setting, approach
from insdvl.studies.evaluation.monte_carlo import (
    METRICS,
    TEST,
    Run,
    Study,
    assess,
    mission_of_run,
)

BODY_RMSE, NEES = METRICS.index("body_rmse"), METRICS.index("nees_velocity")
TOLD = approach(ORACLE, Setting("calibrated")).parameters


def metrics(run, variances):
    stamps, _ = run.mission.process_noise()
    return assess(run.fold_received(TOLD, stamps, variances, told_r=True), run)[0]


def over_interval(monkeypatch, study, number):
    """What a filter is told that knows the density over the interval between pings."""
    with monkeypatch.context() as patch:
        patch.setattr(scenarios, "vertical", lambda f, dvl: f.mean_density(dvl.interval))
        patch.setattr(
            scenarios,
            "horizontal",
            lambda f, w, dvl: (f.mean_density(dvl.interval), w.mean_density(dvl.interval)),
        )
        return mission_of_run(study, TEST, number).process_noise()[1]


def test_a_told_factor_shows_in_the_nees(monkeypatch):
    """Two runs of four minutes; the NEES of a run has a sigma of about 0.2, its ratios far less."""
    study, nees = Study("coloured", seed=11, duration=240.0), []
    for number in range(2):
        run = Run(study, TEST, number)
        _, q = run.mission.process_noise()
        interval = over_interval(monkeypatch, study, number)
        nees.append([metrics(run, told)[NEES] for told in (q, q / 4.0, interval)])
    oracle, quarter, over = np.transpose(nees)
    assert 0.55 < oracle.mean() < 1.45
    assert (quarter > 1.2 * oracle).all()
    assert (over > oracle).all()


@pytest.mark.long
def test_the_oracle_is_consistent_and_no_common_factor_is_better(monkeypatch):
    study = Study("coloured", seed=12)
    factors = (0.25, 0.5, 1.0, 2.0, 4.0)
    rmse, nees, interval = [], [], []
    for number in range(60):
        run = Run(study, TEST, number)
        _, q = run.mission.process_noise()
        found = np.array([metrics(run, factor * q) for factor in factors])
        rmse.append(found[:, BODY_RMSE])
        nees.append(found[2, NEES])
        interval.append(metrics(run, over_interval(monkeypatch, study, number))[[BODY_RMSE, NEES]])
    mean = np.mean(rmse, axis=0)
    other = np.mean(interval, axis=0)
    print(f"NEES {np.mean(nees):.3f}, RMSE over the oracle's: {mean / mean[2]}")
    print(f"told the density over the interval: NEES {other[1]:.2f}, {other[0] / mean[2]:.3f}")
    assert 0.95 < np.mean(nees) < 1.08
    assert mean.min() > 0.98 * mean[2]
    assert other[0] > mean[2]
    assert other[1] > 1.1 * np.mean(nees)
