"""The tuner: when it answers, from which samples, and what it does with bad ones."""

import numpy as np
import pytest

from insdvl.navigation.events import NS
from insdvl.parameters.declaration import ParameterError
from insdvl.tuner.models import load_model
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.tuner import TunedNoise, Tuner
from insdvl.tuner.windows import Window

START = 1_700_000_000 * NS
STEP = NS // 100
N = 200
MODEL = load_model("default")


def samples(n: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    sigma = np.sqrt([0.01, 0.02, 0.03, 0.005, 0.01, 0.04])
    return np.array([0.0, 0.0, -9.8, 0.0, 0.0, 0.0]) + sigma * rng.standard_normal((n, 6))


def run(tuner: Tuner, stamps_ns: np.ndarray, data: np.ndarray) -> list[TunedNoise]:
    estimates = (tuner.add(stamp, row) for stamp, row in zip(stamps_ns, data, strict=True))
    return [estimate for estimate in estimates if estimate is not None]


def grid(n: int, first: int = 1) -> np.ndarray:
    return START + STEP * np.arange(first, first + n)


def seconds(estimates: list[TunedNoise]) -> list[float]:
    return [(estimate.stamp_ns - START) / NS for estimate in estimates]


def same(a: list[TunedNoise], b: list[TunedNoise]) -> bool:
    return [(e.stamp_ns, e.variances.tobytes()) for e in a] == [
        (e.stamp_ns, e.variances.tobytes()) for e in b
    ]


# Schedule


def test_answers_at_multiples_of_the_period_from_the_first_full_window_on():
    tuner = Tuner(TunerParameters())
    assert seconds(run(tuner, grid(550), samples(550))) == [2.0, 3.0, 4.0, 5.0]
    assert tuner.counts["windows"] == 4


def test_a_window_is_the_last_n_samples_and_includes_the_one_that_closes_it():
    data = samples(450)
    tuner = Tuner(TunerParameters())
    estimates = run(tuner, grid(450), data)
    assert seconds(estimates) == [2.0, 3.0, 4.0]
    for estimate, end in zip(estimates, (200, 300, 400), strict=True):
        expected = MODEL.variances(data[end - N : end].T)
        np.testing.assert_array_equal(estimate.variances, expected)


def test_no_window_one_sample_short_of_full():
    assert seconds(run(Tuner(TunerParameters()), grid(400, first=2), samples(400))) == [3.0, 4.0]


@pytest.mark.parametrize(
    ("rate", "expected"),
    [
        (2.0, [2.0, 2.5, 3.0, 3.5, 4.0]),
        (0.5, [2.0, 4.0]),
        (0.1, []),
        (5.0, [2.0, 2.2, 2.4, 2.6, 2.8, 3.0, 3.2, 3.4, 3.6, 3.8, 4.0]),
    ],
)
def test_the_rate_is_of_the_stamps(rate, expected):
    stamps = grid(400)
    assert seconds(run(Tuner(TunerParameters(rate=rate)), stamps, samples(400))) == expected


def test_a_rate_above_the_samples_answers_at_every_sample():
    stamps = START + 2 * STEP * np.arange(300)
    estimates = run(Tuner(TunerParameters(rate=100.0)), stamps, samples(300))
    assert [e.stamp_ns for e in estimates] == stamps[199:].tolist()


@pytest.mark.parametrize("rate", [0.3, 0.7, 1.0 / 3.0, 3.0, 7.0])
def test_a_rate_that_divides_no_second_does_not_drift(rate):
    """One answer in each period, however far the stamps are from zero."""
    stamps = grid(4000)
    estimates = run(Tuner(TunerParameters(rate=rate)), stamps, samples(4000))
    assert len(estimates) == pytest.approx(38.0 * rate, abs=1.0)
    gaps = np.diff([estimate.stamp_ns for estimate in estimates])
    assert np.abs(gaps - NS / rate).max() <= STEP


def test_stamps_beside_the_grid_answer_at_the_first_sample_of_each_period():
    stamps = grid(550) + 3_141_592
    estimates = run(Tuner(TunerParameters()), stamps, samples(550))
    assert [e.stamp_ns - START for e in estimates] == [k * NS + 3_141_592 for k in (2, 3, 4, 5)]


def test_jitter_moves_an_answer_by_a_sample_at_most_and_loses_none():
    rng = np.random.default_rng(3)
    stamps = grid(3000) + rng.integers(-STEP // 3, STEP // 3, 3000)
    estimates = run(Tuner(TunerParameters()), stamps, samples(3000))
    late = (
        np.array([e.stamp_ns - START for e in estimates]) - NS * np.arange(2, 31)[: len(estimates)]
    )
    assert len(estimates) >= 28
    assert late.min() >= 0 and late.max() < 2 * STEP


def test_when_it_was_started_makes_no_difference():
    stamps, data = grid(1500), samples(1500)
    early = run(Tuner(TunerParameters()), stamps, data)
    late = run(Tuner(TunerParameters()), stamps[437:], data[437:])
    assert seconds(late)[0] == 7.0
    assert same(early[-len(late) :], late)


def test_two_runs_give_the_same_bits_whatever_integer_the_stamps_are():
    stamps, data = grid(900), samples(900)
    plain = run(Tuner(TunerParameters(rate=0.3)), [int(stamp) for stamp in stamps], data)
    assert plain
    assert same(run(Tuner(TunerParameters(rate=0.3)), stamps, data), plain)


def test_any_rate_of_samples_will_do():
    stamps = START + 40_000_000 * np.arange(1, 500)  # 25 Hz: a window is 8 s
    estimates = run(Tuner(TunerParameters()), stamps, samples(499))
    assert seconds(estimates) == list(range(8, 20))


# Bad samples


def test_samples_that_are_not_finite_are_dropped_and_counted():
    stamps, data = grid(400), samples(400)
    good = np.ones(400, bool)
    for k, (channel, value) in enumerate([(0, np.nan), (3, np.inf), (5, -np.inf)]):
        data[250 + 20 * k, channel] = value
        good[250 + 20 * k] = False
    tuner = Tuner(TunerParameters())
    estimates = run(tuner, stamps, data)
    assert tuner.counts["not_finite"] == 3
    assert seconds(estimates) == [2.0, 3.0, 4.0]
    assert same(estimates, run(Tuner(TunerParameters()), stamps[good], data[good]))


def test_duplicates_and_late_samples_are_dropped_and_counted():
    stamps, data = grid(400), samples(400)
    order = [*range(300), 299, 298, 290, *range(300, 400)]
    other = samples(len(order), seed=9)
    other[:300], other[303:] = data[:300], data[300:]
    tuner = Tuner(TunerParameters())
    estimates = run(tuner, stamps[order], other)
    assert tuner.counts["duplicates"] == 1
    assert tuner.counts["out_of_order"] == 2
    assert same(estimates, run(Tuner(TunerParameters()), stamps, data))


def test_no_window_spans_a_gap():
    stamps, data = grid(1000), samples(1000)
    stamps[500:] += 10 * STEP + 1  # from 5 s on; the interval is 11 steps, 0.11 s
    tuner = Tuner(TunerParameters(max_gap=0.1))
    assert [round(s) for s in seconds(run(tuner, stamps, data))] == [2, 3, 4, 5, 8, 9, 10]
    assert tuner.counts["gaps"] == 1


def test_an_interval_of_max_gap_is_no_gap():
    stamps, data = grid(1000), samples(1000)
    stamps[500:] += 9 * STEP  # the interval is 0.1 s
    tuner = Tuner(TunerParameters(max_gap=0.1))
    assert len(run(tuner, stamps, data)) == 9
    assert tuner.counts["gaps"] == 0


def test_a_burst_of_bad_samples_is_a_gap():
    stamps, data = grid(1000), samples(1000)
    data[500:520, 2] = np.nan
    tuner = Tuner(TunerParameters())
    assert seconds(run(tuner, stamps, data)) == [2.0, 3.0, 4.0, 5.0, 8.0, 9.0, 10.0]
    assert tuner.counts["gaps"] == 1 and tuner.counts["not_finite"] == 20


@pytest.mark.parametrize("jump_s", [-3600, -5, 3600])
def test_a_jump_of_time_starts_the_window_again_and_does_not_lock_it(jump_s):
    data = samples(1000)
    stamps = grid(1000)
    stamps[500:] += jump_s * NS
    tuner = Tuner(TunerParameters())
    estimates = run(tuner, stamps, data)
    assert seconds(estimates) == [2.0, 3.0, 4.0, 5.0, *(s + jump_s for s in (7.0, 8.0, 9.0, 10.0))]
    assert tuner.counts["restarts" if jump_s < 0 else "gaps"] == 1
    fresh = run(Tuner(TunerParameters()), stamps[500:], data[500:])
    assert same(estimates[4:], fresh)


@pytest.mark.parametrize(("model", "least"), [("default", 0.0), ("paper", 0.001)])
def test_constant_channels_are_answered(model, least):
    """A channel that is stuck has no noise, or the smallest variance that the model knows."""
    data = samples(200)
    data[:, 1] = 0.25
    data[:, 4] = 0.0
    (estimate,) = run(Tuner(TunerParameters(model=model)), grid(200), data)
    assert np.isfinite(estimate.variances).all()
    stuck = [1, 4]
    np.testing.assert_allclose(estimate.variances[stuck], least, rtol=1e-12)
    assert (np.delete(estimate.variances, stuck) > 0.001).all()


@pytest.mark.parametrize("value", [1e71, 1e200, -1e308])
def test_samples_too_large_for_features_are_counted_and_leave_nothing_behind(value):
    data = samples(800)
    data[310, 2] = value
    tuner = Tuner(TunerParameters())
    assert seconds(run(tuner, grid(800), data)) == [2.0, 3.0, 6.0, 7.0, 8.0]
    assert tuner.counts["too_large"] == 2


# Switch, model


def test_a_disabled_tuner_is_silent_and_goes_on_filling_its_window():
    stamps, data = grid(1000), samples(1000)
    tuner = Tuner(TunerParameters(enabled=False))
    assert run(tuner, stamps[:450], data[:450]) == []
    assert tuner.counts["windows"] == 0
    tuner.enabled = True
    resumed = run(tuner, stamps[450:], data[450:])
    assert seconds(resumed) == [5.0, 6.0, 7.0, 8.0, 9.0, 10.0]
    assert same(resumed, run(Tuner(TunerParameters()), stamps, data)[3:])


def test_learns_the_variance_of_white_noise():
    estimates = run(Tuner(TunerParameters()), grid(6000), samples(6000))
    mean = np.mean([estimate.variances for estimate in estimates], axis=0)
    np.testing.assert_allclose(mean, [0.01, 0.02, 0.03, 0.005, 0.01, 0.04], rtol=0.1)


def test_a_wrong_model_is_an_error_at_once():
    with pytest.raises(ParameterError, match="absent"):
        Tuner(TunerParameters(model="absent"))


# Window


def test_window_keeps_the_last_samples_in_order():
    window = Window(5, max_gap_ns=10)
    for k in range(13):
        assert window.filled == min(k, 5)
        assert window.add(k, np.arange(6.0) + 10.0 * k)
    expected = np.arange(6.0)[:, None] + 10.0 * np.arange(8, 13)
    np.testing.assert_array_equal(window.samples(), expected)
    assert window.stamp_ns == 12
    assert window.counts["samples"] == 13


def test_window_survives_a_step_back_of_max_gap_only():
    window = Window(3, max_gap_ns=10)
    for stamp in (100, 105, 110):
        window.add(stamp, np.zeros(6))
    assert not window.add(100, np.ones(6))
    assert window.filled == 3 and window.stamp_ns == 110
    assert window.add(99, np.ones(6))
    assert window.filled == 1 and window.stamp_ns == 99
    assert window.counts["restarts"] == 1
