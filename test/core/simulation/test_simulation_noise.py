"""Noise profiles: what they hold, and what they refuse."""

import numpy as np
import pytest
from scipy.stats import kstest, uniform

from insdvl.simulation.noise import (
    SCENARIO_TEXTS,
    SCENARIOS,
    NoiseProfile,
    constant,
    from_file,
    on_off,
    segments,
)


def draw(factory, duration=330.0, seed=0):
    return factory(duration, np.random.default_rng(seed))


def test_every_scenario_has_its_text():
    assert list(SCENARIO_TEXTS) == list(SCENARIOS)


def test_constant_scenarios():
    assert (
        draw(SCENARIOS["constant"]).variance_at([0.0, 329.0]).tolist()
        == [[0.01] * 3 + [0.001] * 3] * 2
    )
    np.testing.assert_allclose(
        draw(SCENARIOS["constant-tableI"]).variances, [[0.01**2] * 3 + [0.001**2] * 3]
    )


@pytest.mark.parametrize(("name", "low"), [("varying", 1e-3), ("wide", 1e-5)])
def test_segments_are_log_uniform_and_last_15_to_45_s(name, low):
    profile = draw(SCENARIOS[name], duration=200_000.0, seed=1)
    lengths, levels = [], []
    for channel in profile.variances.T:
        change = np.flatnonzero(np.diff(channel)) + 1
        starts = np.concatenate([[0.0], profile.times[change]])
        lengths.append(np.diff(starts))
        levels.append(np.concatenate([channel[:1], channel[change]]))
    lengths, levels = np.concatenate(lengths), np.concatenate(levels)
    assert lengths.size > 30_000
    assert kstest(lengths, uniform(15.0, 30.0).cdf).pvalue > 1e-3
    assert kstest(np.log(levels), uniform(np.log(low), np.log(0.05 / low)).cdf).pvalue > 1e-3


def test_channels_change_on_their_own():
    profile = draw(SCENARIOS["varying"], duration=400.0)
    changed = np.diff(profile.variances, axis=0) != 0.0
    assert (changed.sum(axis=1) == 1).all()
    assert (changed.sum(axis=0) >= 7).all()


def test_a_longer_profile_begins_as_the_shorter_one():
    t = np.linspace(0.0, 99.9, 1000)
    for name in ("varying", "wide"):
        short, long = (draw(SCENARIOS[name], duration, 7) for duration in (100.0, 400.0))
        np.testing.assert_array_equal(short.variance_at(t), long.variance_at(t))


def test_a_profile_depends_on_the_generator_only():
    first, again, other = (draw(SCENARIOS["varying"], seed=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.variances, again.variances)
    assert not np.array_equal(first.variances[0], other.variances[0])


def test_on_off_switches_between_two_levels():
    off, on = np.arange(1.0, 7.0) * 1e-3, np.arange(1.0, 7.0) * 1e-2
    profile = draw(on_off(off, on, 30.0), duration=100.0)
    np.testing.assert_array_equal(profile.times, [0.0, 30.0, 60.0, 90.0])
    np.testing.assert_array_equal(
        profile.variance_at([0.0, 29.999, 30.0, 60.0, 99.0]), [off, off, on, off, on]
    )


def test_change_belongs_to_the_new_level():
    profile = NoiseProfile(np.array([0.0, 2.0]), np.array([[1.0] * 6, [2.0] * 6]))
    assert profile.variance_at([0.0, np.nextafter(2.0, 0.0), 2.0])[:, 0].tolist() == [1.0, 1.0, 2.0]


@pytest.mark.parametrize(
    ("times", "variances", "message"),
    [
        ([1.0], [[1.0] * 6], "times must start at 0 and increase"),
        ([], np.zeros((0, 6)), "times must start at 0 and increase"),
        ([0.0, 5.0, 5.0], [[1.0] * 6] * 3, "times must start at 0 and increase"),
        ([0.0, np.nan], [[1.0] * 6] * 2, "times must start at 0 and increase"),
        ([0.0], [[1.0] * 5], r"shape \(1, 6\), got \(1, 5\)"),
        ([0.0], [[1.0] * 5 + [-2.0]], r"variances must be finite and >= 0, got .*-2\.0"),
        ([0.0], [[1.0] * 5 + [np.inf]], r"variances must be finite and >= 0, got .*inf"),
    ],
)
def test_wrong_profiles_are_refused(times, variances, message):
    with pytest.raises(ValueError, match=message):
        NoiseProfile(np.array(times), np.array(variances))


def test_constant_refuses_a_wrong_number_of_channels():
    with pytest.raises(ValueError, match="shape"):
        draw(constant([0.01, 0.001]))


def test_segments_shorter_than_one_segment():
    profile = draw(segments(1e-3, 0.05), duration=1.0)
    assert profile.times.tolist() == [0.0]


def test_file(tmp_path):
    path = tmp_path / "noise.csv"
    path.write_text("# t, f, w\n0, 1e-2,2e-2,3e-2, 1e-3,2e-3,3e-3\n\n12.5,1,2,3,4,5,6 # loud\n")
    profile = draw(from_file(path))
    np.testing.assert_array_equal(profile.times, [0.0, 12.5])
    np.testing.assert_array_equal(
        profile.variance_at([12.4, 12.5]),
        [[1e-2, 2e-2, 3e-2, 1e-3, 2e-3, 3e-3], [1, 2, 3, 4, 5, 6]],
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0,1,1,1,1,1,1\n1,1,1,1,x,1,1\n", "line 2: not seven numbers"),
        ("0,1,1,1,1,1\n", "line 1: expected 7 values, got 6"),
        ("# nothing\n", "no line with a time"),
        ("1,1,1,1,1,1,1\n", "times must start at 0"),
        ("0,1,1,1,1,1,-1\n", "variances must be finite and >= 0"),
        ("0,1,1,1,1,1,nan\n", "variances must be finite and >= 0"),
    ],
)
def test_wrong_file_is_named_with_its_line(tmp_path, text, message):
    path = tmp_path / "noise.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=rf"noise\.csv.*{message}"):
        from_file(path)


def test_file_that_is_not_there(tmp_path):
    with pytest.raises(ValueError, match=r"cannot read the noise profile .*absent\.csv"):
        from_file(tmp_path / "absent.csv")
