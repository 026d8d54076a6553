"""Weights of the bands: the model of one vehicle, by its file, its channels and its unit."""

from pathlib import Path

import numpy as np
import pytest

from insdvl.tuner.features.band_groups import GROUP_FEATURE_NAMES, GROUPS, group_features
from insdvl.tuner.models import load_model, write_model
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.tuner import Tuner
from insdvl.tuner.weights import Weights, WeightsError

F = len(GROUP_FEATURE_NAMES)
LEVEL = GROUP_FEATURE_NAMES.index("level")
CARD = {
    "name": "own",
    "kind": "weights",
    "feature_schema": "taught",
    "features": list(GROUP_FEATURE_NAMES),
    "window": 200,
}
WIDE = np.array([[-50.0, 50.0]] * 2)


def weights(level: float = 0.0) -> np.ndarray:
    rows = np.random.default_rng(4).normal(0.0, 0.3, (2, F + 1))
    rows[:, 1 + LEVEL] = level
    return rows


def windows(n: int = 2000) -> np.ndarray:
    rng = np.random.default_rng(5)
    return rng.normal(0.0, np.geomspace(1e-3, 1.0, 6)[:, None], (6, n))


def model(folder: Path, regressor: Weights):
    path, _ = write_model(folder, regressor.save(), CARD)
    return load_model(str(path))


def test_without_a_weight_of_the_level_a_change_of_unit_is_one_of_the_answer(
    tmp_path: Path,
) -> None:
    own = model(tmp_path, Weights(weights(), WIDE))
    for c in (1e-3, 9.81):
        np.testing.assert_allclose(
            own.variances(c * windows()), c**2 * own.variances(windows()), rtol=1e-9
        )


def test_outside_of_what_was_seen_any_answer_follows_the_unit(tmp_path: Path) -> None:
    """A model that knows its vehicle's level leans on it, within limits relative to the bands."""
    regressor = Weights(weights(level=-1.0), np.array([[-0.5, 0.5]] * 2))
    own = model(tmp_path, regressor)
    loud, louder = (own.variances(c * windows()) for c in (1e6, 1e9))
    np.testing.assert_allclose(louder, 1e6 * loud, rtol=1e-9)


def test_each_group_of_channels_has_its_own_weights() -> None:
    regressor = Weights(weights(), WIDE)
    X = np.tile(np.arange(F, dtype=float), (12, 1))
    found = regressor.predict(X)
    expected = regressor.weights[:, 0] + regressor.weights[:, 1:] @ np.arange(F)
    np.testing.assert_allclose(found, np.tile(np.repeat(expected, 3), 2))
    with pytest.raises(ValueError, match="multiple of 6"):
        regressor.predict(X[:5])


def test_each_group_of_channels_has_its_own_limits() -> None:
    regressor = Weights(np.zeros((2, F + 1)), np.array([[1.0, 2.0], [-2.0, -1.0]]))
    found = regressor.predict(np.zeros((6, F)))
    np.testing.assert_array_equal(found, [1.0] * 3 + [-1.0] * 3)


@pytest.mark.parametrize("louder", [10.0, 0.1])
def test_the_change_is_how_far_the_last_2_s_are_above_the_last_6_s(louder: float) -> None:
    """6 s with the last 2 s at c times the amplitude have (2 + c^2) / 3 times the power."""
    noise = np.random.default_rng(7).normal(0.0, 0.1, (300, 2000))
    noise[:, -200:] *= louder
    X, _ = group_features(noise)
    steady, _ = group_features(np.random.default_rng(8).normal(0.0, 0.1, (300, 2000)))
    at = GROUP_FEATURE_NAMES.index("change")
    expected = np.log(louder**2 / ((2.0 + louder**2) / 3.0))
    assert X[:, at].mean() - steady[:, at].mean() == pytest.approx(expected, abs=0.25)


@pytest.mark.parametrize(
    ("frequency", "group"), [(0.2, "slow_0.1_0.4"), (0.8, "slow_0.4_1.6"), (2.0, "near_1_3.25")]
)
def test_slow_motion_is_in_the_group_of_its_frequency(frequency: float, group: str) -> None:
    """A wave of 30 times the amplitude of the noise."""
    t = 0.01 * np.arange(2000)
    noise = np.random.default_rng(9).normal(0.0, 0.01, (50, 2000))
    phases = np.linspace(0.0, 2.0 * np.pi, 50)[:, None]
    X, _ = group_features(noise + 0.3 * np.sin(2.0 * np.pi * frequency * t + phases))
    means = dict(zip(GROUPS, X.mean(axis=0), strict=False))
    assert max(means, key=means.__getitem__) == group


def test_white_noise_has_its_variance_in_every_group_of_bands() -> None:
    rng = np.random.default_rng(6)
    X, scale = group_features(rng.normal(0.0, 0.02, (400, 2000)))
    power = np.exp(X[:, : len(GROUPS)].mean(axis=0)) * np.exp(np.log(scale).mean())
    # Means of logarithms: below the variance, most where a group has few frequencies.
    assert ((power > 0.6 * 0.02**2) & (power < 1.02 * 0.02**2)).all()
    np.testing.assert_allclose(X[:, LEVEL], np.log(scale))


def test_a_window_without_noise_has_none(tmp_path: Path) -> None:
    own = model(tmp_path, Weights(weights(), WIDE))
    assert not own.variances(np.full((6, 400), 9.8)).any()


def test_the_tuner_takes_the_file_by_its_parameter(tmp_path: Path) -> None:
    own = model(tmp_path, Weights(weights(), WIDE))
    tuner = Tuner(TunerParameters(model=str(own.path)))
    samples = windows(400)
    found = [tuner.add(k * 10_000_000, samples[:, k]) for k in range(400)]
    (last,) = [one for one in found[301:] if one is not None] or [found[300]]
    np.testing.assert_array_equal(last.variances, own.variances(samples[:, :301]))


@pytest.mark.parametrize(
    ("rows", "limits", "words"),
    [
        (np.zeros((3, F)), WIDE, "two rows"),
        (np.full((2, F), np.nan), WIDE, "finite"),
        (np.zeros((2, F)), np.array([[1.0, 0.0]] * 2), "lowest, highest"),
        (np.zeros((2, F)), np.zeros((2, 3)), "lowest, highest"),
        (np.zeros((2, F), np.float32), WIDE, "float64"),
    ],
)
def test_what_is_no_set_of_weights_is_refused(rows, limits, words: str) -> None:
    with pytest.raises(WeightsError, match=words):
        Weights(rows, limits)
    with pytest.raises(WeightsError, match="not a valid"):
        Weights.load(b"no archive")
