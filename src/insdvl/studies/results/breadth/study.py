"""The numbers of the study: one comparison for each vehicle.

The scenarios are those whose noise is not white. Each grade of IMU meets each rate, a better DVL at
1 Hz, and outages at 1 Hz: of a minute in all scenarios, shorter and longer ones in the one with
everything together.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

from insdvl.jobs.pool import Pool
from insdvl.jobs.store import Store
from insdvl.simulation.grades import GRADES
from insdvl.studies.evaluation.approaches import (
    BANDS,
    BANDS_WITH_FACTOR,
    BEST_CONSTANT,
    CLOSED_FORM,
    FACTOR_WITH_ERROR,
    FACTOR_WITH_R,
    LEAST_BAND,
    MATCHED,
    ORACLE,
    Setting,
)
from insdvl.studies.evaluation.comparison import Plan, compare
from insdvl.studies.evaluation.sensors import Sensors

SCENARIOS = ("vibrating", "coloured", "waves", "realistic")
RATES = (5.0, 1.0, 0.2)  # Hz
BETTER = 0.02  # m/s, sigma of the better DVL
#: Lengths of the outages [s], in all scenarios and in the last.
LENGTH, LENGTHS = 60.0, (30.0, 60.0, 120.0)
RUNS = 10

#: Learned Q and learned R, which has a meaning in `realistic`: R is not that of the data sheet.
BOTH_LEARNED = (FACTOR_WITH_R, FACTOR_WITH_ERROR)
#: In the order of the tables.
ROWS = (
    *(BEST_CONSTANT, CLOSED_FORM, LEAST_BAND, BANDS, BANDS_WITH_FACTOR),
    *(ORACLE, MATCHED, *BOTH_LEARNED),
)
#: Of a row of a comparison; the rest would repeat what follows from the numbers of the runs.
_KEPT = (
    *("failures", "body_rmse", "depth_rmse", "position_drift_percent"),
    *("outage_velocity", "outage_drift", "outage_depth"),
    *("nees_per_dof", "ratio_to"),
)


def rows_of(scenario: str) -> tuple[str, ...]:
    """The rows of a comparison, in the order of the tables."""
    return tuple(row for row in ROWS if row not in BOTH_LEARNED or scenario == "realistic")


def plans() -> list[Plan]:
    """The comparisons: one for each line of the tables."""
    found = []
    for scenario, grade in product(SCENARIOS, GRADES):
        lengths = LENGTHS if scenario == SCENARIOS[-1] else (LENGTH,)
        vehicles = [Sensors(dvl_rate=rate, imu_grade=grade) for rate in RATES]
        vehicles.append(Sensors(dvl_std=BETTER, imu_grade=grade))
        vehicles += [Sensors(outage=length, imu_grade=grade) for length in lengths]
        settings = [Setting("calibrated", sensors=sensors) for sensors in vehicles]
        found += [Plan(scenario, setting, RUNS, rows=rows_of(scenario)) for setting in settings]
    return found


def study_breadth(
    planned: Sequence[Plan], pool: Pool, store: Store | None = None
) -> dict[str, Any]:
    """The numbers of all comparisons.

    Args:
        planned: See `plans`; those with other numbers of runs differ in these only.
        pool: Computes the runs.
        store: Keeps finished runs; searches are the same with outages and without.
    """
    first = planned[0]
    return {
        "tuning_runs": first.tuning_runs,
        "seed": first.seed,
        "comparisons": [_condensed(compare(plan, pool, store).document) for plan in planned],
    }


def _condensed(document: Mapping[str, Any]) -> dict[str, Any]:
    setting = document["plan"]["setting"]
    return {
        "scenario": document["plan"]["scenario"],
        **{name: setting[name] for name in ("imu_grade", "dvl_rate", "dvl_std", "outage")},
        "omitted": document["omitted"],
        "runs": document["runs"],
        "paired_runs": document["paired_runs"],
        "best_constant": document["searches"][BEST_CONSTANT]["best"],
        "rows": [
            {"approach": row["approach"]} | {name: row[name] for name in _KEPT if name in row}
            for row in document["rows"]
        ],
        "per_run": document["per_run"],
    }


def with_runs(
    planned: Sequence[Plan], *, runs: int | None, tuning_runs: int, seed: int
) -> list[Plan]:
    """Plans with other numbers of runs; None leaves the number as it is."""
    return [
        replace(plan, runs=runs or plan.runs, tuning_runs=tuning_runs, seed=seed)
        for plan in planned
    ]
