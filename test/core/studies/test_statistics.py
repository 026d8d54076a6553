"""Bootstrap of paired runs: coverage, pairing, groups."""

import numpy as np
import pytest

from insdvl.studies.evaluation.statistics import mean, ratio_of_means, resamples


def test_interval_of_a_mean_covers_it_as_often_as_it_says() -> None:
    rng = np.random.default_rng(1)
    draws = resamples(np.arange(60), rng)
    covered = 0
    for _ in range(400):
        _, low, high = mean(rng.normal(2.0, 1.0, 60), draws)
        covered += low <= 2.0 <= high
    # 95 % of 400, and four standard deviations of that count.
    assert abs(covered - 380) < 4 * np.sqrt(400 * 0.95 * 0.05) + 8


def test_a_ratio_keeps_the_pairs() -> None:
    rng = np.random.default_rng(2)
    difficulty = rng.lognormal(0.0, 1.0, 100)
    draws = resamples(np.arange(100), rng)
    middle, low, high = ratio_of_means(0.9 * difficulty, difficulty, draws)
    assert middle == pytest.approx(0.9)
    assert high - low < 1e-12
    _, low, high = ratio_of_means(0.9 * rng.permutation(difficulty), difficulty, draws)
    assert high - low > 0.1


def test_runs_of_a_group_are_drawn_together() -> None:
    groups = np.repeat([0, 1, 2], 4)
    draws = resamples(groups, np.random.default_rng(3))
    np.testing.assert_array_equal(draws.sum(axis=1), 12)
    for group in range(3):
        assert (np.ptp(draws[:, groups == group], axis=1) == 0).all()


def test_an_interval_of_one_seed_is_the_same_again() -> None:
    values = np.random.default_rng(4).random(30)
    one = mean(values, resamples(np.arange(30), np.random.default_rng(5)))
    again = mean(values, resamples(np.arange(30), np.random.default_rng(5)))
    assert one == again
