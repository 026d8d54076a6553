"""The study on recordings of a real vehicle: learned process noise against the alternatives.

`vehicle_runs` has the rows. The best constant is chosen on the other recordings, with other seeds.
Recordings of one stretch of the voyage depend on each other: they are left out together, and the
bootstrap draws them together. Without injected noise the question is whether learning does harm.
"""

from collections.abc import Collection, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array
from insdvl.jobs.pool import Pool
from insdvl.jobs.store import Store
from insdvl.studies.evaluation import statistics
from insdvl.studies.results.recordings import Recording, Settings, stretches
from insdvl.studies.results.vehicle_runs import (
    AS_RECORDED,
    BEST_CONSTANT,
    ERRORS,
    HAND_SET,
    INJECTIONS,
    METRICS,
    TEST,
    TOLD,
    TOLD_WITH_NOMINAL,
    TUNING,
    Limits,
    NoisyRun,
    Shared,
    all_rows,
    constant_run,
    injection,
)
from insdvl.tuner.models import Model

_BOOTSTRAP = 2006  # key of the random stream


def grid(limits: Limits) -> list[tuple[float, float]]:
    """Candidates for the best constant: variances of accelerometers and of gyroscopes.

    For each triad: geometric mean of the limits, mean of the log-uniform variance, upper limit.
    """

    def levels(low: float, high: float) -> tuple[float, float, float]:
        mean = (high - low) / np.log(high / low) if high > low else high
        return float(np.sqrt(low * high)), float(mean), high

    return list(product(levels(*limits[0]), levels(*limits[1])))


def study_recordings(
    recordings: Sequence[Recording],
    settings: Settings,
    models: Mapping[str, Model],
    *,
    runs: int,
    tuning_runs: int,
    seed: int,
    pool: Pool,
    store: Store | None = None,
) -> dict[str, Any]:
    """The numbers of the study.

    Args:
        recordings: See `recordings.load_all`.
        settings: Settings of the configuration.
        models: Models of the learned rows, by row.
        runs: Number of seeds for each recording and injection.
        tuning_runs: Number of further seeds, for the best constant.
        seed: Random seed.
        pool: Computes the runs.
        store: Keeps finished runs.
    """
    names = [recording.name for recording in recordings]
    stretch = stretches(recordings)
    shared = Shared(settings, dict(zip(names, recordings, strict=True)), models)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_BOOTSTRAP,)))

    def execute(
        label: str,
        function: Any,
        tasks: dict[str, NoisyRun],
        metrics: Collection[str] = METRICS,
    ) -> dict[str, Array]:
        results = pool.compute(function, tasks, shared, store, f"vehicle {label}")
        # (recordings, seeds, metrics) of each row
        return {
            row: np.array([result[row] for result in results]).reshape(len(names), -1, len(metrics))
            for row in results[0]
        }

    def tasks(
        name: str, role: int, n: int, constants: Sequence[Mapping[str, tuple[float, float]]]
    ) -> dict[str, NoisyRun]:
        return {
            f"{recording.name} {k}": NoisyRun(
                recording.name, injection(settings, recording, name, seed, role, k), constants[i]
            )
            for i, recording in enumerate(recordings)
            for k in range(n)
        }

    document: dict[str, Any] = {
        "recordings": names,
        "stretches": stretch.tolist(),
        "rejected": {recording.name: dict(recording.rejected) for recording in recordings},
        "runs": runs,
        "tuning_runs": tuning_runs,
        "seed": seed,
        "injections": {},
    }
    for name, limits in INJECTIONS.items():
        candidates = grid(limits)
        every = {f"{i}": q for i, q in enumerate(candidates)}
        tried = execute(
            f"{name}, constants",
            constant_run,
            tasks(name, TUNING, tuning_runs, [every] * len(names)),
        )
        cost = np.array([tried[row][:, :, 0].mean(axis=1) for row in every])  # (9, recordings)
        best = [candidates[int(np.argmin(cost[:, stretch != own].mean(axis=1)))] for own in stretch]
        test = tasks(name, TEST, runs, [{BEST_CONSTANT: q} for q in best])
        rows = execute(name, all_rows, test)
        document["injections"][name] = {
            "limits": limits,
            "grid": candidates,
            "best_constant": dict(zip(names, best, strict=True)),
            "seeds": {
                recording.name: [
                    injection(settings, recording, name, seed, TEST, k).seed for k in range(runs)
                ]
                for recording in recordings
            },
            "rows": _summary(rows, names),
            "ratio_to": {
                reference: _ratios(rows, reference, stretch, rng)
                for reference in (TOLD, TOLD_WITH_NOMINAL, BEST_CONSTANT)
            },
        }
    as_they_are = {name: NoisyRun(name, None, {}) for name in names}
    rows = execute("as recorded", all_rows, as_they_are, AS_RECORDED)
    document["as_recorded"] = {
        "rows": _summary(rows, names, AS_RECORDED),
        "ratio_to": {HAND_SET: _ratios(rows, HAND_SET, stretch, rng)},
    }
    return document


def _summary(
    rows: Mapping[str, Array], names: Sequence[str], metrics: Collection[str] = METRICS
) -> dict[str, Any]:
    """Means over the seeds, for each recording and for all."""
    return {
        row: {
            metric: {
                "mean": float(np.mean(values[:, :, m])),
                **dict(zip(names, np.mean(values[:, :, m], axis=1).tolist(), strict=True)),
            }
            for m, metric in enumerate(metrics)
        }
        for row, values in rows.items()
    }


def _ratios(
    rows: Mapping[str, Array],
    reference: str,
    stretch: NDArray[np.int64],
    rng: np.random.Generator,
) -> dict[str, Any]:
    """Ratios of mean errors to those of a row, with intervals over the stretches of the voyage."""
    seeds = rows[reference].shape[1]
    draws = statistics.resamples(np.repeat(stretch, seeds), rng)
    return {
        row: {
            metric: list(
                statistics.ratio_of_means(
                    values[:, :, m].ravel(), rows[reference][:, :, m].ravel(), draws
                )
            )
            for m, metric in enumerate(ERRORS)
        }
        for row, values in rows.items()
        if row != reference
    }
