"""The numbers of the study: each vehicle flies some missions, and each filter navigates them.

The best constant is searched on the very missions that are reported, by the error against the
truth. It is a bound for what a constant that is chosen beforehand can have.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from insdvl.arrays import Array
from insdvl.files import finite
from insdvl.jobs.pool import Pool
from insdvl.jobs.store import Store
from insdvl.jobs.tasks import Result
from insdvl.simulation.vehicles import VEHICLES, Vehicle
from insdvl.studies.evaluation import statistics
from insdvl.studies.evaluation.approaches import BEST_CONSTANT
from insdvl.studies.evaluation.metrics import rmse
from insdvl.studies.evaluation.monte_carlo import (
    METRICS,
    Flight,
    assess,
    failed,
    over_effective,
    track_of,
)
from insdvl.studies.results.others.flights import (
    ROWS,
    SOURCES,
    Told,
    by_constant,
    by_row,
    flight_of,
    told_by,
)

RUNS = 6

_BOOTSTRAP = 9001  # key of the random stream
#: Steps of the search for the best constant, in decades of the variances of f and of w: both
#: together, then each on its own.
_STAGES = (
    ((0.5, 0.5),),
    ((0.5, 0.0), (0.0, 0.5)),
    ((0.25, 0.0), (0.0, 0.25)),
)
#: Of the error: a step that gains less is not made, since below some level of Q nothing changes.
_GAIN = 1e-4
#: Metrics of the document.
_KEPT = ("body_rmse", "nees_velocity", "nis")


def study_others(
    runs: int,
    seed: int,
    pool: Pool,
    store: Store | None = None,
    vehicles: Mapping[str, Vehicle] = VEHICLES,
) -> dict[str, Any]:
    """The numbers of the study.

    Args:
        runs: Number of missions of each vehicle.
        seed: Random seed of the missions.
        pool: Computes the vehicles.
        store: Keeps those that are finished.
        vehicles: By name.
    """
    tasks = {name: name for name in vehicles}
    shared = dict(vehicles), seed, runs
    found = pool.compute(of_vehicle, tasks, shared, store, "other vehicles")
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_BOOTSTRAP,)))
    draws = statistics.resamples(np.arange(runs), rng)
    return {
        "runs": runs,
        "seed": seed,
        "vehicles": [
            {
                "vehicle": name,
                "imu_rate": vehicle.imu.rate,
                "dvl_rate": vehicle.dvl.rate,
                "dvl_std": vehicle.dvl.noise_std[0],
                "effective": numbers["effective"].tolist(),
                "best_constant": numbers["constant"].tolist(),
                "tried": int(numbers["tried"]),
                "told_over_effective": dict(zip(sources(), numbers["told"].tolist(), strict=True)),
                "rows": _rows(numbers["scores"], draws),
            }
            for (name, vehicle), numbers in zip(vehicles.items(), found, strict=True)
        ],
    }


def sources() -> tuple[str, ...]:
    """The sources of a Q that changes, each once."""
    return tuple(dict.fromkeys(SOURCES.values()))


def of_vehicle(shared: tuple[Mapping[str, Vehicle], int, int], name: str) -> Result:
    """All missions of a vehicle through all filters.

    Returns:
        ``scores`` (rows, runs, len(METRICS)); ``effective`` (2,), the geometric mean of the
        effective variances of f_b and of w_ib_b; ``constant`` (2,), the best one; ``tried``, the
        number of constants; ``told`` (sources, 2), the geometric mean of what a source tells over
        what is effective, f_b and w_ib_b.
    """
    vehicles, seed, runs = shared
    vehicle = vehicles[name]
    flights = [flight_of(name, vehicle, seed, number) for number in range(runs)]
    effective = _level(np.concatenate([flight.mission.q for flight in flights]))
    constant, tried = best_constant(vehicle, flights, effective)
    scores = np.empty((len(ROWS), runs, len(METRICS)))
    told = np.empty((len(sources()), runs, 2))
    for number, flight in enumerate(flights):
        received = [told_by(source, flight) for source in sources()]
        told[:, number] = [_over_effective(flight, one) for one in received]
        by_source = dict(zip(sources(), received, strict=True))
        for i, row in enumerate(ROWS):
            if row == BEST_CONSTANT:
                fold = by_constant(vehicle, flight, constant)
            else:
                fold = by_row(vehicle, flight, row, by_source[SOURCES[row]])
            scores[i, number] = assess(fold, flight)[0]
    return {
        "scores": scores,
        "effective": np.array(effective),
        "constant": np.array(constant),
        "tried": np.array(tried),
        "told": np.exp(np.mean(np.log(told), axis=1)),
    }


def best_constant(
    vehicle: Vehicle, flights: Sequence[Flight], start: tuple[float, float]
) -> tuple[tuple[float, float], int]:
    """The constant with the least mean RMSE of the body velocity, to a quarter of a decade.

    Each stage of the search goes from the best constant to the best of its neighbours, as long as
    that is better by `_GAIN`.

    Returns:
        The variances of f_b and of w_ib_b, and the number of constants that were tried.
    """

    def at(decades: tuple[float, float]) -> tuple[float, float]:
        return start[0] * 10.0 ** decades[0], start[1] * 10.0 ** decades[1]

    @cache
    def error(decades: tuple[float, float]) -> float:
        return float(np.mean([_error(vehicle, flight, at(decades)) for flight in flights]))

    best = 0.0, 0.0
    for steps in _STAGES:
        while True:
            f, w = best
            near = [(f + s * a, w + s * b) for a, b in steps for s in (1.0, -1.0)]
            found = min(near, key=error)
            if not error(found) < (1.0 - _GAIN) * error(best):
                break
            best = found
    return at(best), error.cache_info().currsize


def _error(vehicle: Vehicle, flight: Flight, variances: tuple[float, float]) -> float:
    """RMSE of the body velocity [m/s]; inf for a failure."""
    result = track_of(by_constant(vehicle, flight, variances))
    if failed(result, flight.truth, vehicle.imu.rate):
        return float("inf")
    return rmse(flight.truth.v_b - result.v_b)


def _level(variances: Array) -> tuple[float, float]:
    """Geometric means over time and axes of variances (N, 6): of f_b and of w_ib_b."""
    f, w = np.exp(np.mean(np.log(variances).reshape(-1, 2, 3), axis=(0, 2))).tolist()
    return f, w


def _over_effective(flight: Flight, told: Told) -> tuple[float, float]:
    return _level(over_effective(flight.mission, *told))


def _rows(scores: Array, draws: statistics.Draws) -> list[dict[str, Any]]:
    """Numbers of each row."""
    base = scores[ROWS.index(BEST_CONSTANT), :, METRICS.index("body_rmse")]
    rows = []
    for row, values in zip(ROWS, scores, strict=True):
        per_run = {name: values[:, METRICS.index(name)] for name in _KEPT}
        rows.append(
            {
                "approach": row,
                "failures": int(np.sum(values[:, METRICS.index("failed")])),
                **_means(per_run, per_run["body_rmse"] / base, draws),
                "per_run": {
                    name: [finite(value) for value in one.tolist()] for name, one in per_run.items()
                },
            }
        )
    return rows


def _means(per_run: Mapping[str, Array], ratio: Array, draws: statistics.Draws) -> dict[str, Any]:
    """Means over the missions; None where the row or the best constant has failed in one."""
    failed_once = not np.isfinite(ratio).all()
    return {
        "over_best_constant": None if failed_once else list(statistics.mean(ratio, draws)),
        "worst": None if failed_once else float(np.max(ratio)),
        **{
            name: None if failed_once else float(np.mean(values))
            for name, values in per_run.items()
        },
    }
