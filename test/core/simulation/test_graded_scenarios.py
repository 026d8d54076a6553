"""Scenarios with the IMU of a grade: its noise is the grade's, and nothing else changes."""

import numpy as np
import pytest

from insdvl.simulation.drawn.scenarios import DRAWN
from insdvl.simulation.grades import GRADES
from insdvl.simulation.mission import simulate
from insdvl.simulation.trajectories import AUV


@pytest.mark.parametrize("name", GRADES)
def test_white_noise_has_the_variances_of_the_grade_in_its_middle(name):
    """Log-uniform over 1e-4 to 0.05, times a factor: the mean of the logarithm is the middle's."""
    profile = GRADES[name].of_scenario(DRAWN["vibrating"]).profile()
    drawn = np.vstack([profile(330.0, np.random.default_rng(k)).variances[0] for k in range(400)])
    expected = np.log(GRADES[name].variances())
    spread = np.log(0.05 / 1e-4) / np.sqrt(12.0)
    np.testing.assert_allclose(np.log(drawn).mean(axis=0), expected, atol=4.0 * spread / 20.0)
    np.testing.assert_allclose(np.log(drawn).std(axis=0), spread, rtol=0.15)


def test_all_that_is_noise_has_the_factors_of_the_grade():
    grade = GRADES["tactical"]
    factors = np.repeat(grade.scale(), 3)
    own, graded = (
        scenario.draw(60.0, 100.0, np.random.default_rng(3)).imu
        for scenario in (DRAWN["realistic"], grade.of_scenario(DRAWN["realistic"]))
    )
    np.testing.assert_allclose(graded.flicker, own.flicker * factors, rtol=1e-12)
    np.testing.assert_allclose(
        graded.coloured.variances, own.coloured.variances * factors, rtol=1e-12
    )
    for field in ("time_constants", "counts", "force", "rate"):
        np.testing.assert_array_equal(getattr(graded, field), getattr(own, field))


def test_the_motion_and_the_pings_are_those_of_the_scenario():
    scenario, grade = DRAWN["realistic"], GRADES["mems"]
    own = simulate(AUV, scenario, seed=6, duration=30.0)
    graded = simulate(AUV, grade.of_scenario(scenario), seed=6, duration=30.0, imu=grade.imu())
    np.testing.assert_array_equal(graded.truth.v_n, own.truth.v_n)
    np.testing.assert_array_equal(graded.v_d, own.v_d)


@pytest.mark.parametrize("name", GRADES)
def test_the_effective_noise_follows_the_grade(name):
    """Where there is white noise and motion alone it is that of the white noise."""
    grade = GRADES[name]
    scenario = grade.of_scenario(DRAWN["vibrating"])
    mission = simulate(AUV, scenario, seed=2, duration=60.0, imu=grade.imu())
    white = simulate(AUV, scenario.profile(), seed=2, duration=60.0, imu=grade.imu())
    np.testing.assert_allclose(mission.q, white.q, rtol=1e-8)
    first = mission.bias[0] / np.repeat([grade.accelerometer_bias, grade.gyroscope_bias], 3)
    unit = simulate(AUV, DRAWN["vibrating"], seed=2, duration=60.0).bias[0]
    np.testing.assert_allclose(first, unit / np.repeat([1e-3, 1e-5], 3), rtol=1e-9)
    assert (mission.bias == mission.bias[0]).all()
