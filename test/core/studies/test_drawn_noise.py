"""Noise of a drawn vehicle for a recording: what is told is what integrates."""

import numpy as np
import pytest

from insdvl.navigation.events import NS
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.studies.replay.inputs.drawn_noise import DrawnNoise

STAMPS_NS = 1_700_000_000 * NS + np.arange(1, 40_001) * (NS // 100)
DVL = DvlModel(rate=1.0, noise_std=(0.02,) * 3)
BLOCK = 2000  # samples, 20 s


def powers(scenario: str) -> tuple[float, float]:
    """Over the told variance, in the mean of ten vehicles: that of a sample, and of its sums."""
    of_samples, of_sums = [], []
    for seed in range(10):
        q, noise = DrawnNoise(scenario, DVL, seed).draw(STAMPS_NS)
        white = noise / np.sqrt(q)
        of_samples.append(white.var(axis=0).mean())
        of_sums.append((white.reshape(-1, BLOCK, 6).sum(axis=1) ** 2).mean() / BLOCK)
    return float(np.mean(of_samples)), float(np.mean(of_sums))


def test_vibration_is_in_the_samples_and_not_in_what_is_told() -> None:
    of_samples, of_sums = powers("vibrating")
    assert of_samples > 1.5
    # The mean of 1200 squares is known to 4 %, one sigma.
    assert of_sums == pytest.approx(1.0, abs=0.16)


def test_coloured_noise_is_hardly_in_the_samples() -> None:
    """What is told is the density within the filter's memory, somewhat less than that at 0 Hz."""
    of_samples, of_sums = powers("coloured")
    assert of_samples < 0.5
    assert 0.84 < of_sums < 2.0


@pytest.mark.parametrize("scenario", ["vibrating", "coloured"])
def test_a_seed_reproduces_it(scenario: str) -> None:
    first, again, other = (DrawnNoise(scenario, DVL, seed).draw(STAMPS_NS) for seed in (3, 3, 4))
    for a, b in zip(first, again, strict=True):
        assert np.array_equal(a, b)
    assert not np.array_equal(first[1], other[1])
