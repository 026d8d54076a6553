"""The numbers of the study: one comparison for each vehicle and condition.

All comparisons of a vehicle have the same missions: conditions change the gate, the Q that the
filters are told, or add errors to some pings. So rows of two conditions are pairs as well.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from insdvl.arrays import Array
from insdvl.jobs.pool import Pool
from insdvl.jobs.store import Store
from insdvl.studies.evaluation import statistics
from insdvl.studies.evaluation.approaches import (
    R_ADAPTIVE,
    R_ADAPTIVE_RECEIVED,
    R_ADAPTIVE_WITH_FACTOR,
    R_LEARNED,
    R_LEARNED_RECEIVED,
    R_NOMINAL,
    R_NOMINAL_WITH_FACTOR,
    R_ORACLE,
    R_RECEIVED,
    Setting,
)
from insdvl.studies.evaluation.comparison import Plan, compare
from insdvl.studies.evaluation.sensors import Sensors

RUNS = 100
#: Scenarios, whose sigma of the DVL changes, and pings per second.
TACTICAL, FOG = "bottom-tactical", "bottom-fog"
RATES: Mapping[str, float] = {TACTICAL: 5.0, FOG: 1.0}
STD = 0.05  # m/s, on the data sheet of the DVL

PLAIN, GATE = "gate off", "gate on"
OUTLIERS, LEFT_OUT = "gate on, outliers", "gate on, outliers left out"
SMALL_Q, LARGE_Q = "a hundredth of Q", "a hundred times Q"
_PLAIN = Setting("calibrated", sensors=Sensors(dvl_std=STD))
_SPOILT = replace(_PLAIN.sensors, outliers=0.05)
#: The settings of each; a vehicle has its own rate of pings.
CONDITIONS: Mapping[str, Setting] = {
    PLAIN: _PLAIN,
    GATE: replace(_PLAIN, gate=True),
    OUTLIERS: replace(_PLAIN, gate=True, sensors=_SPOILT),
    LEFT_OUT: replace(_PLAIN, gate=True, sensors=replace(_SPOILT, outliers_missing=True)),
    SMALL_Q: replace(_PLAIN, q_factor=0.01),
    LARGE_Q: replace(_PLAIN, q_factor=100.0),
}
#: In the order of the tables.
ROWS = (
    *(R_NOMINAL, R_NOMINAL_WITH_FACTOR, R_LEARNED, R_LEARNED_RECEIVED),
    *(R_ADAPTIVE, R_ADAPTIVE_RECEIVED, R_ADAPTIVE_WITH_FACTOR, R_ORACLE),
)
#: Conditions with the rows that receive R: the tuner of these takes long.
_RECEIVING = (PLAIN, OUTLIERS, LEFT_OUT)
#: Rows of the same comparison that all rows are compared with.
REFERENCES = (R_ORACLE, R_NOMINAL)
#: Conditions that the same row is compared with.
OWN_REFERENCES = (PLAIN, LEFT_OUT)

_BOOTSTRAP = 9002  # key of the random stream
_ERROR = "body_rmse"

#: Scenario and condition of a comparison.
Key = tuple[str, str]


def plans(runs: int, seed: int) -> dict[Key, Plan]:
    """The comparisons.

    Args:
        runs: Number of missions of each.
        seed: Random seed of the missions.
    """
    return {
        (scenario, name): Plan(
            scenario,
            replace(setting, sensors=replace(setting.sensors, dvl_rate=rate)),
            runs,
            seed=seed,
            rows=tuple(row for row in ROWS if row not in R_RECEIVED or name in _RECEIVING),
        )
        for scenario, rate in RATES.items()
        for name, setting in CONDITIONS.items()
    }


def study_dvl_noise(
    planned: Mapping[Key, Plan], pool: Pool, store: Store | None = None
) -> dict[str, Any]:
    """The numbers of all comparisons.

    Args:
        planned: See `plans`.
        pool: Computes the runs.
        store: Keeps finished runs.
    """
    found = {key: compare(plan, pool, store).document for key, plan in planned.items()}
    plan = next(iter(planned.values()))
    stream = np.random.SeedSequence(plan.seed, spawn_key=(_BOOTSTRAP,))
    draws = statistics.resamples(np.arange(plan.runs), np.random.default_rng(stream))
    return {
        "runs": plan.runs,
        "seed": plan.seed,
        "comparisons": [
            {
                "scenario": scenario,
                "condition": condition,
                "paired_runs": document["paired_runs"],
                "rows": _rows(
                    document, {name: found[scenario, name] for name in OWN_REFERENCES}, draws
                ),
                "per_run": document["per_run"][_ERROR],
            }
            for (scenario, condition), document in found.items()
        ],
    }


def _rows(
    document: Mapping[str, Any], own: Mapping[str, Mapping[str, Any]], draws: statistics.Draws
) -> list[dict[str, Any]]:
    """Numbers of the rows of a comparison; `own` are those of the `OWN_REFERENCES`."""

    def errors(of: Mapping[str, Any], row: str) -> Array:
        return np.array(of["per_run"][_ERROR][row], dtype=np.float64)  # nan for a failure

    def ratio(row: str, reference: Array) -> list[float] | None:
        found = statistics.ratio_of_means(errors(document, row), reference, draws)
        return list(found) if np.isfinite(found).all() else None

    rows = []
    for numbers in document["rows"]:
        row = numbers["approach"]
        rows.append(
            {
                "approach": row,
                "failures": numbers["failures"],
                _ERROR: numbers[_ERROR],
                "nees_velocity": numbers["nees_per_dof"]["velocity"],
                "ratio_to": {
                    **{one: ratio(row, errors(document, one)) for one in REFERENCES},
                    **{name: ratio(row, errors(of, row)) for name, of in own.items()},
                },
            }
        )
    return rows
