"""Comparison of all approaches in one scenario: searches, paired runs, ratios, intervals."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from insdvl.arrays import Array
from insdvl.files import finite
from insdvl.jobs.pool import Pool
from insdvl.jobs.store import Store
from insdvl.studies.evaluation import outages, statistics
from insdvl.studies.evaluation.approaches import (
    BEST_CONSTANT,
    BEST_CONSTANT_SRMSE,
    BEST_XI,
    FIRST_CONSTANT,
    FLOORS,
    MATCHED,
    ORACLE,
    R_NOMINAL,
    R_ORACLE,
    ROWS,
    SAGE_HUSA,
    VARIATIONAL,
    Approach,
    Setting,
    adaptives,
    approach,
    constants,
    nominal,
    unavailable,
)
from insdvl.studies.evaluation.missions import Study
from insdvl.studies.evaluation.monte_carlo import METRICS, evaluate_run, numbered, tuning_run

#: A row that fails in more than this share of the runs is left out of the pairs: its other runs say
#: little, and it would remove its failed runs from all other rows.
MOST_FAILURES = 0.1
_BOOTSTRAP = 2003  # key of the random stream
#: Numbers of a mission with outages alone.
_OF_OUTAGES = frozenset(outages.METRICS)
RATIO_METRICS = ("body_rmse", "srmse", *outages.ERRORS)
_NEES = "nees_"  # in the names of metrics
_SEARCHED = (BEST_CONSTANT, BEST_CONSTANT_SRMSE, BEST_XI, VARIATIONAL, *SAGE_HUSA)


@dataclass(frozen=True)
class Plan:
    """One comparison.

    Attributes:
        scenario: Key of `monte_carlo.PROFILES`.
        setting: Setting of the filters.
        runs: Number of runs.
        tuning_runs: Number of runs of a search, on seeds of their own.
        seed: Random seed.
        rows: Names in `ROWS`.
        duration: Length of a mission [s]; None for the whole trajectory.
    """

    scenario: str
    setting: Setting
    runs: int = 100
    tuning_runs: int = 20
    seed: int = 1
    rows: tuple[str, ...] = ROWS
    duration: float | None = None

    @property
    def vehicle(self) -> str:
        """The scenario, and what of the sensors differs from that of most tables."""
        sensors, parts = self.setting.sensors, [self.scenario]
        if sensors.imu_grade:
            parts.append(sensors.imu_grade)
        if sensors.dvl_rate != 1.0:
            parts.append(f"{sensors.dvl_rate:g} Hz")
        if sensors.dvl_std != 0.1:
            parts.append(f"DVL of {sensors.dvl_std:g} m per s")
        if sensors.outliers:
            parts.append(f"outliers {sensors.outliers:g}")
        if sensors.outliers_missing:
            parts.append("missing")
        return ", ".join(parts)

    @property
    def label(self) -> str:
        """The vehicle, its outages, and what of the filters differs from most tables."""
        setting, parts = self.setting, [self.vehicle]
        if setting.sensors.outage:
            parts.append(f"outages of {setting.sensors.outage:g} s")
        if setting.gate:
            parts.append("gate")
        if setting.q_factor != 1.0:
            parts.append(f"{setting.q_factor:g} Q")
        return ", ".join(parts)

    def document(self) -> dict[str, Any]:
        """The plan as JSON, where the sensors are among the other settings."""
        found = asdict(self)
        found["setting"] |= found["setting"].pop("sensors")
        return found


@dataclass(frozen=True)
class Comparison:
    """Results of a comparison.

    Attributes:
        document: The numbers of all rows, as JSON.
        series: (R, K, 4) of each row with a filter, see `monte_carlo.SERIES`.
    """

    document: dict[str, Any]
    series: Mapping[str, Array]


def compare(plan: Plan, pool: Pool, store: Store | None = None) -> Comparison:
    """Do the searches, fold all runs and summarise them."""
    omitted = unavailable(plan.rows)
    rows = [row for row in plan.rows if row not in omitted]
    study = Study(plan.scenario, plan.seed, plan.duration, plan.setting.sensors)
    approaches, searches = _approaches(rows, plan, study, pool, store)

    results = pool.compute(
        evaluate_run,
        numbered(plan.runs),
        shared=(study, tuple(approaches)),
        store=store,
        label=f"{plan.label}: runs",
    )
    scores = {
        entry.name: np.array([result["scores"][i] for result in results])
        for i, entry in enumerate(approaches)
    }
    for i, name in enumerate(FLOORS):
        if name in rows:
            scores[name] = np.array([result["floors"][i] for result in results])
    scores = {row: scores[row] for row in rows}
    document = {
        "plan": plan.document() | {"rows": rows},
        "omitted": omitted,
        "searches": searches,
        **summary(scores, np.random.default_rng(_stream(plan.seed))),
    }
    series = {
        entry.name: np.array([result["series"][i] for result in results])
        for i, entry in enumerate(approaches)
        if entry.name in rows
    }
    return Comparison(document, series)


def _stream(seed: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(seed, spawn_key=(_BOOTSTRAP,))


# ---------------------------------------------------------------- searches


def _approaches(
    rows: Sequence[str], plan: Plan, study: Study, pool: Pool, store: Store | None
) -> tuple[list[Approach], dict[str, Any]]:
    """The approaches of the rows, and the results of their searches, which have no outages."""
    found: dict[str, Approach] = {}
    searches: dict[str, Any] = {}
    setting = plan.setting
    searched = replace(study, sensors=replace(study.sensors, outage=0.0))

    def mean_errors(candidates: Sequence[Approach], stage: str) -> Array:
        """Mean errors (A, 2) of the candidates: RMSE of the body velocity, SRMSE."""
        results = pool.compute(
            tuning_run,
            numbered(plan.tuning_runs),
            shared=(searched, tuple(candidates)),
            store=store,
            label=f"{plan.vehicle}: {stage}",
        )
        return np.mean([result["errors"] for result in results], axis=0)

    def choose(row: str, candidates: Sequence[Approach], errors: Array, metric: int) -> Approach:
        best = candidates[int(np.argmin(errors[:, metric]))]
        found[row] = replace(best, name=row)
        searches[row] = {
            "best": best.name,
            "candidates": {
                candidate.name: [finite(float(value)) for value in values]
                for candidate, values in zip(candidates, errors, strict=True)
            },
        }
        return best

    if any(row in _SEARCHED for row in rows):
        coarse = constants(setting, plan.scenario)
        coarse_errors = mean_errors(coarse, "constants, coarse")
        for metric, row in enumerate((BEST_CONSTANT, BEST_CONSTANT_SRMSE)):
            if row == BEST_CONSTANT_SRMSE and row not in rows:
                continue
            around = coarse[int(np.argmin(coarse_errors[:, metric]))]
            fine = constants(setting, plan.scenario, around)
            choose(row, fine, mean_errors(fine, f"{row}, fine"), metric)
        for row, candidates in adaptives(setting, nominal(found[BEST_CONSTANT])).items():
            if row in rows:
                choose(row, candidates, mean_errors(candidates, row), 0)
    needed = [row for row in rows if row not in FLOORS]
    if any(row in FLOORS for row in rows) and ORACLE not in needed:
        needed.append(ORACLE)
    return [found.get(row) or approach(row, setting) for row in needed], searches


# ---------------------------------------------------------------- numbers


def summary(scores: Mapping[str, Array], rng: np.random.Generator) -> dict[str, Any]:
    """Means, medians, intervals and ratios of all rows.

    Means and ratios are over the runs in which no row failed, except for rows that fail in more
    than a tenth of all runs, which are left out; medians and failures are over all runs.

    Args:
        scores: (R, len(METRICS)) numbers of each row.
        rng: Generator of the bootstrap.
    """
    failure = METRICS.index("failed")
    measured = [
        metric
        for i, metric in enumerate(METRICS[:failure])
        if metric not in _OF_OUTAGES or any(np.isfinite(v[:, i]).any() for v in scores.values())
    ]
    compared = [metric for metric in RATIO_METRICS if metric in measured]
    failures = {row: int(np.sum(values[:, failure])) for row, values in scores.items()}
    n_runs = len(next(iter(scores.values())))
    paired = {row for row, count in failures.items() if count <= MOST_FAILURES * n_runs}
    whole = np.full(n_runs, bool(paired))
    for row in paired:
        whole &= scores[row][:, failure] == 0.0
    if not whole.any():
        paired = set()  # there is no run to compare them on
    numbers: dict[str, Any] = {
        "runs": n_runs,
        "paired_runs": int(whole.sum()),
        "rows": [],
        "per_run": {
            metric: {
                row: [finite(float(f"{v:.6g}")) for v in values[:, METRICS.index(metric)]]
                for row, values in scores.items()
            }
            for metric in compared
        },
    }
    draws = statistics.resamples(np.arange(max(int(whole.sum()), 1)), rng)

    def column(row: str, metric: str) -> Array:
        return scores[row][whole, METRICS.index(metric)]

    references = {
        label: row
        for label, row in (
            ("oracle", ORACLE),
            ("matched", MATCHED),
            ("R oracle", R_ORACLE),
            ("R nominal", R_NOMINAL),
            ("best constant", BEST_CONSTANT),
            ("best constant for SRMSE", BEST_CONSTANT_SRMSE),
            ("first constant", FIRST_CONSTANT),
            ("closed form", "closed form"),
        )
        if row in paired
    }
    for row, values in scores.items():
        means: dict[str, Any] = dict.fromkeys(measured)
        intervals: dict[str, Any] = {}
        ratios: dict[str, Any] = {}
        if row in paired:
            for metric in measured:
                if np.isfinite(column(row, metric)).all():
                    middle, low, high = statistics.mean(column(row, metric), draws)
                    means[metric], intervals[metric] = middle, [low, high]
            ratios = {
                label: {
                    metric: list(
                        statistics.ratio_of_means(
                            column(row, metric), column(reference, metric), draws
                        )
                    )
                    for metric in compared
                    if metric in intervals
                }
                for label, reference in references.items()
            }
        lost = values[:, failure] == 1.0  # worse than any number
        medians = {
            metric: finite(
                float(np.median(np.where(lost, np.inf, values[:, METRICS.index(metric)])))
            )
            for metric in measured
        }
        numbers["rows"].append(
            {
                "approach": row,
                "failures": failures[row],
                **{m: v for m, v in means.items() if not m.startswith(_NEES)},
                "nees_per_dof": {
                    m.removeprefix(_NEES): v for m, v in means.items() if m.startswith(_NEES)
                },
                "interval": intervals,
                "median": medians,
                "ratio_to": ratios,
            }
        )
    return numbers
