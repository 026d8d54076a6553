"""A whole recording at once: the windows, the stamps and the bits of the tuner that is fed it."""

import numpy as np
import pytest

from insdvl.navigation.events import NS
from insdvl.tuner.models import load_model
from insdvl.tuner.offline import closing_samples, tuned
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.tuner import Tuner

START = 1_700_000_000 * NS
STEP = NS // 100
MAX_GAP = 0.1


def recording(kind: str) -> np.ndarray:
    """Stamps of 1,500 samples."""
    rng = np.random.default_rng(5)
    stamps = START + STEP * np.arange(1, 1501)
    if kind == "jitter":
        stamps += rng.integers(-STEP // 3, STEP // 3, stamps.size)
    elif kind == "gaps":
        stamps[300:] += 10 * STEP + 1
        stamps[450:] += 3600 * NS
        stamps[1000:] += 9 * STEP  # the interval is max_gap: no gap
        stamps[1499:] += NS
    elif kind == "slow":
        stamps = START + 4 * STEP * np.arange(stamps.size)
    return stamps


@pytest.mark.parametrize("kind", ["regular", "jitter", "gaps", "slow"])
@pytest.mark.parametrize("rate", [1.0, 0.3, 7.0])
@pytest.mark.parametrize("name", ["default", "bands"])
def test_equals_the_tuner_to_the_bit(kind, rate, name):
    stamps = recording(kind)
    samples = 9.8 + 0.1 * np.random.default_rng(6).standard_normal((stamps.size, 6))
    tuner = Tuner(TunerParameters(model=name, rate=rate, max_gap=MAX_GAP))
    answers = [tuner.add(stamp, row) for stamp, row in zip(stamps, samples, strict=True)]
    expected = [answer for answer in answers if answer is not None]
    assert expected
    model = load_model(name)
    at, q = tuned(
        stamps, samples, model.variances, model.window, rate, round(MAX_GAP * NS), model.history
    )
    assert at.tolist() == [answer.stamp_ns for answer in expected]
    np.testing.assert_array_equal(q, [answer.variances for answer in expected])


def test_a_window_is_the_samples_that_end_with_the_closing_one():
    stamps = recording("regular")
    samples = np.arange(6.0) + 10.0 * np.arange(stamps.size)[:, None]
    at, last = tuned(stamps, samples, lambda windows: windows[:, -1], 50, 1.0, NS)
    closing, filled = closing_samples(stamps, 50, 1.0, NS)
    np.testing.assert_array_equal(stamps[closing], at)
    np.testing.assert_array_equal(filled, closing + 1)
    assert ((at - START) / NS).tolist() == list(range(1, 16))
    np.testing.assert_array_equal(last, samples[99::100])
    _, first = tuned(stamps, samples, lambda windows: windows[:, 0], 50, 1.0, NS)
    np.testing.assert_array_equal(first, samples[50::100])


def test_a_history_grows_from_the_window_after_each_gap():
    stamps = recording("regular")
    stamps[700:] += NS
    lengths = lambda windows: np.full(len(windows), float(windows.shape[1]))  # noqa: E731
    at, used = tuned(stamps, np.zeros((stamps.size, 6)), lengths, 150, 1.0, NS // 2, 350)
    seconds = ((at - START) // NS).tolist()
    assert seconds == [2, 3, 4, 5, 6, 7, 10, 11, 12, 13, 14, 15, 16]
    assert used[:, 0].tolist() == [200, 300, 350, 350, 350, 350, 200, 300] + [350] * 5


@pytest.mark.parametrize("n", [0, 1, 199])
def test_a_recording_without_a_full_window_has_no_estimate(n):
    stamps, q = tuned(recording("regular")[:n], np.zeros((n, 6)), np.sum, 200, 1.0, NS)
    assert stamps.shape == (0,) and q.shape == (0, 6)


def test_stamps_that_do_not_increase_are_refused():
    with pytest.raises(ValueError, match="stamps must increase, got 7 and then 7"):
        closing_samples(np.array([5, 7, 7, 9]), 2, 1.0, NS)
