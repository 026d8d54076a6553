"""A study of the page: how it is computed, and how its numbers are shown."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from insdvl.jobs.pool import Pool
from insdvl.jobs.store import Store


@dataclass(frozen=True)
class Extent:
    """How much is flown.

    Attributes:
        runs: Number of runs of each row.
        seed: Random seed of all runs.
        quick: Whether rows are left out that another one resembles.
    """

    runs: int
    seed: int
    quick: bool = False


@dataclass(frozen=True)
class Study:
    """A section of the page.

    Attributes:
        name: Its name in the numbers of the page.
        source: File of the module that computes it.
        compute: Its numbers, valid JSON; finished runs are kept in the store.
        section: The section, with its heading, from its numbers.
    """

    name: str
    source: Path
    compute: Callable[[Extent, Pool, Store | None], dict[str, Any]]
    section: Callable[[Mapping[str, Any]], str]


def seeds(seed: int, runs: int, *key: int) -> dict[str, int]:
    """The seeds of the runs of a row, as tasks of a pool; rows of other keys have other runs."""
    sequences = (np.random.SeedSequence(seed, spawn_key=(*key, run)) for run in range(runs))
    return {f"{k}": int(s.generate_state(1, np.uint64)[0]) for k, s in enumerate(sequences)}
