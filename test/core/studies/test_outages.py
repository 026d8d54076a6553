"""Outages of the DVL in the comparison: where they are, and the errors at their ends."""

from dataclasses import replace

import numpy as np
import pytest

from insdvl.navigation.events import NS
from insdvl.studies.evaluation import outages
from insdvl.studies.evaluation.approaches import ORACLE, Setting, approach
from insdvl.studies.evaluation.missions import TEST, Study
from insdvl.studies.evaluation.monte_carlo import METRICS, Run, assess, failed, track
from insdvl.studies.evaluation.sensors import Sensors


def test_a_mission_has_as_many_outages_as_it_has_room_for():
    assert outages.outages_in(330.0, 0.0) == ()
    assert outages.outages_in(330.0, 30.0) == ((90.0, 120.0), (180.0, 210.0), (270.0, 300.0))
    assert outages.outages_in(330.0, 60.0) == ((90.0, 150.0), (210.0, 270.0))
    assert outages.outages_in(330.0, 120.0) == ((90.0, 210.0),)
    assert outages.outages_in(149.0, 60.0) == ()


@pytest.mark.parametrize("rate", [5.0, 1.0, 0.2])
def test_an_outage_is_between_the_last_ping_and_its_end(rate):
    sensors = Sensors(dvl_rate=rate, outage=60.0)
    run = Run(Study("varying", seed=5, duration=160.0, sensors=sensors), TEST, 0)
    pings = run.mission.dvl_stamps_ns / NS
    inside = (pings > 90.0) & (pings < 150.0 + 1e-9)
    assert not inside.any()
    assert pings[pings < 91.0].max() == 90.0
    assert pings[pings > 150.0].min() == pytest.approx(150.0 + 1.0 / rate)


def test_errors_at_the_ends_by_hand():
    """Two outages: what counts is the state at each end, and the drift since its begin."""
    t = np.arange(1.0, 11.0)
    dv, dp, position = np.zeros((3, 10, 3))
    P = np.tile(np.eye(3), (10, 1, 1))
    dv[4], dv[9] = [3.0, 0.0, 4.0], [0.0, 0.0, 1.0]
    position[2], position[4] = [1.0, 1.0, 2.0], [4.0, 5.0, 2.5]
    position[7], position[9] = [1.0, 0.0, 0.0], [1.0, 0.0, -1.0]
    dp[4], dp[9] = [2.0, 0.0, 3.0], [0.0, 0.0, 1.0]
    found = outages.errors_at_ends(
        ((3.0, 5.0), (8.0, 10.0)), t, dv=dv, P_v=4.0 * P, dp=dp, P_p=0.5 * P, position=position
    )
    assert found == pytest.approx(
        {
            "outage_velocity": np.sqrt((25.0 + 1.0) / 2.0),
            "outage_drift": np.sqrt((25.0 + 0.0) / 2.0),
            "outage_depth": np.sqrt((0.25 + 1.0) / 2.0),
            "nees_outage_velocity": (25.0 + 1.0) / 4.0 / 2.0 / 3.0,
            "nees_outage_position": (4.0 + 0.0) / 0.5 / 2.0 / 2.0,
            "nees_outage_depth": (9.0 + 1.0) / 0.5 / 2.0,
        }
    )


def test_a_run_with_an_outage_tells_its_errors_and_another_does_not():
    study, setting = Study("varying", seed=5, duration=160.0), Setting("calibrated")
    with_outage = Run(replace(study, sensors=Sensors(outage=60.0)), TEST, 0)
    values, _ = assess(with_outage.fold(approach(ORACLE, setting)), with_outage)
    of = dict(zip(METRICS, values, strict=True))
    assert np.isfinite([of[name] for name in outages.METRICS]).all()
    # The drift of the best filter in a minute is metres.
    assert of["outage_drift"] > 0.3
    assert of["outage_velocity"] > of["body_rmse"]
    without = Run(study, TEST, 0)
    values, _ = assess(without.fold(approach(ORACLE, setting)), without)
    assert np.isnan([values[METRICS.index(name)] for name in outages.METRICS]).all()


def test_a_filter_that_is_right_is_right_at_the_end_of_an_outage():
    """With gyroscopes that leave the tilt small; `varying` has curvature (verdict.md)."""
    study, setting = (
        Study("bottom-tactical", seed=5, duration=155.0, sensors=Sensors(outage=60.0)),
        Setting("calibrated"),
    )
    values = []
    for number in range(24):
        run = Run(study, TEST, number)
        values.append(assess(run.fold(approach(ORACLE, setting)), run)[0])
    mean = dict(zip(METRICS, np.mean(values, axis=0), strict=True))
    for name, dof in zip(outages.CONSISTENCY, (3, 2, 1), strict=True):
        assert mean[name] == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / dof / 24.0)), name


def test_a_drift_in_an_outage_is_no_failure():
    n = 3000
    truth = track(np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3)), np.zeros((n, 3)))
    v_b = np.zeros((n, 3))
    v_b[800:2000, 0] = 9.0
    lost = replace(truth, v_b=v_b)
    assert failed(lost, truth, 100.0)
    assert not failed(lost, truth, 100.0, ((8.0, 20.0),))
    assert failed(lost, truth, 100.0, ((8.0, 9.9),))
