"""Behind two minutes without a DVL, with a MEMS: the errors are as large as they say.

Statistics of `insdvl.studies.consistency.outage`; seeds were chosen before the first run.
"""

from collections.abc import Mapping

import numpy as np
import pytest

from insdvl.arrays import Array
from insdvl.simulation.grades import GRADES
from insdvl.studies.consistency.flights import Case
from insdvl.studies.consistency.outage import outage_run

SEED = 92_000
RUNS, SHORT_RUNS = 100, 6


def flights(heading_std_deg: float, runs: int) -> list[Mapping[str, Array]]:
    case = Case(GRADES["mems"], heading_std_deg)
    return [outage_run(case, SEED + k) for k in range(runs)]


def nees(found: list[Mapping[str, Array]], name: str) -> np.ndarray:
    """(K,) mean over the runs at each second behind the outage."""
    return np.mean([run[name] for run in found], axis=0)


def test_attitude_and_velocity_behind_an_outage() -> None:
    found = flights(5.0, SHORT_RUNS)
    assert 0.3 < nees(found, "attitude").mean() < 2.5
    assert 0.7 < nees(found, "velocity").mean() < 1.4
    assert nees(found, "velocity")[0] < 2.5  # right behind the first measurement


@pytest.mark.long
@pytest.mark.parametrize("heading_std_deg", [1.0, 5.0, 30.0])
def test_100_outages(heading_std_deg: float) -> None:
    found = flights(heading_std_deg, RUNS)
    attitude, velocity = nees(found, "attitude"), nees(found, "velocity")
    print(f"attitude {attitude.mean():.2f}, at most {attitude.max():.2f}")
    print(f"velocity {velocity.mean():.2f}, at most {velocity.max():.2f}")
    assert attitude.mean() <= 1.35
    assert attitude.max() <= 1.8
    assert 0.8 < velocity.mean() < 1.2
