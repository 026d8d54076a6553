"""A bad link loses, doubles and delays as often and as long as it is told to."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, kstest

from insdvl.parameters.declaration import ParameterError
from insdvl.studies.faults.link import Link, RelayParameters, links

SIZE = 100_000


def fates(parameters: RelayParameters, size: int = SIZE) -> list[tuple[float, ...]]:
    link = Link(parameters, np.random.default_rng(parameters.seed))
    return [link.delays() for _ in range(size)]


def likely(count: int, size: int, probability: float) -> bool:
    low, high = binom.interval(1.0 - 1e-6, size, probability)
    return bool(low <= count <= high)


@pytest.mark.parametrize("loss", [0.0, 0.001, 0.01, 0.1, 1.0])
def test_loss_is_binomial(loss: float) -> None:
    lost = np.array([not delays for delays in fates(RelayParameters(loss=loss))])
    assert likely(int(lost.sum()), SIZE, loss)
    # Of the messages after a lost one just as many: losses are independent.
    assert likely(int(lost[1:][lost[:-1]].sum()), int(lost[:-1].sum()), loss)


@pytest.mark.parametrize("duplication", [0.0, 0.01, 1.0])
def test_copies_are_binomial_among_those_that_arrive(duplication: float) -> None:
    copies = [len(d) for d in fates(RelayParameters(loss=0.1, duplication=duplication)) if d]
    assert set(copies) <= {1, 2}
    assert likely(copies.count(2), len(copies), duplication)


def test_delay_of_each_copy_is_even_within_the_jitter() -> None:
    parameters = RelayParameters(duplication=1.0, delay=0.2, jitter=0.05)
    delays = np.array(fates(parameters, 5000))
    for copy in delays.T:
        assert kstest(copy, "uniform", args=(0.2, 0.05)).pvalue > 1e-4
    assert abs(np.corrcoef(delays.T)[0, 1]) < 0.07


def test_a_setting_changes_nothing_but_what_it_says() -> None:
    parameters = RelayParameters(loss=0.1, duplication=0.3, jitter=1.0)
    before = fates(parameters, 2000)
    less = fates(replace(parameters, loss=0.05), 2000)
    assert [b for b in before if b] == [b for a, b in zip(before, less, strict=True) if a]
    assert sum(map(bool, less)) > sum(map(bool, before))
    assert fates(replace(parameters, seed=2), 2000) != before


def test_topics_are_independent_and_a_seed_repeats() -> None:
    parameters = RelayParameters(loss=0.5)
    first, again = links(parameters), links(parameters)
    drawn = {topic: [link.delays() for _ in range(100)] for topic, link in first.items()}
    # The order in which topics take their turns does not matter.
    for topic in reversed(parameters.topics):
        assert [again[topic].delays() for _ in range(100)] == drawn[topic]
    imu, dvl = drawn.values()
    assert imu != dvl


def test_a_relay_that_would_hear_itself_is_refused() -> None:
    with pytest.raises(ParameterError, match="'prefix' must not be empty"):
        RelayParameters(prefix="")
