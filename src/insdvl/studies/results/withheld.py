"""Recordings as they are, judged without a reference: predictions of pings that were withheld.

The reference of a recording is often a fusion of the same sensors. What a filter predicts of pings
that it was not given is judged by the pings. All rows navigate with the gate of the configuration;
all predict the same pings, those that the hand-set filter accepts. The taught rows have the weights
that the other stretches of the voyage teach.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array
from insdvl.jobs.pool import Pool
from insdvl.jobs.store import Store
from insdvl.jobs.tasks import Result
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.studies.evaluation import statistics
from insdvl.studies.evaluation.approaches import BANDS_WITH_FACTOR
from insdvl.studies.judgement.withheld import WINDOWS, predictions
from insdvl.studies.replay.scores import errors_of
from insdvl.studies.replay.taken import Taken
from insdvl.studies.report.markdown import number, table
from insdvl.studies.results.recorded.predictions import against_hand_set, predictions_table
from insdvl.studies.results.recordings import Recording, Settings, stream_axes, stretches
from insdvl.studies.results.vehicle_runs import HAND_SET, Received, filtered, process_noise
from insdvl.studies.teaching.lesson import lesson_of
from insdvl.studies.teaching.teach import (
    BANDS,
    CONSTANT,
    TeachingError,
    constant_of,
    fits_of,
    teach,
)
from insdvl.tuner.features.bands import WINDOW
from insdvl.tuner.features.schemas import SCHEMAS
from insdvl.tuner.models import Model
from insdvl.tuner.offline import tuned_by_model
from insdvl.tuner.weights import Weights

TAUGHT, TAUGHT_CONSTANT = "taught", "taught constant"
REFUSED = "refused"
#: What a teaching ends with.
ANSWERS = (BANDS, CONSTANT, REFUSED)
#: Of a row whose process noise may be below the floors of the configuration.
FREE = ", no floor"
#: The rows that have another such, since what they learn of the level may be below the floors.
_ALSO_FREE = (TAUGHT, TAUGHT_CONSTANT, BANDS_WITH_FACTOR)
#: The floors [(m/s^2)^2, (rad/s)^2] in their place.
_NO_FLOOR = 1e-12, 1e-15
_BOOTSTRAP = 2007  # key of the random stream
_LIMITS = " limits"  # of a row's array

#: Numbers of a row: of windows of each length, then those against the reference.
_OF_WINDOW = ("count", "error", "log_likelihood", "covered", "nis_mean")
_OF_REFERENCE = ("body_velocity_rmse", "position_rmse_horizontal", "tilt_rmse_deg")
COLUMNS = (*(f"{name} {w:g} s" for w in WINDOWS for name in _OF_WINDOW), *_OF_REFERENCE)


@dataclass(frozen=True)
class Shared:
    """What all recordings need.

    Attributes:
        settings: Of the configuration.
        recordings: By name.
        models: Of each recording by name, by row.
    """

    settings: Settings
    recordings: Mapping[str, Recording]
    models: Mapping[str, Mapping[str, Model]]


def study_withheld(
    recordings: Sequence[Recording],
    settings: Settings,
    models: Mapping[str, Model],
    *,
    seed: int,
    pool: Pool,
    store: Store | None = None,
) -> dict[str, Any]:
    """The numbers of the study.

    Args:
        recordings: See `recordings.load_all`.
        settings: Of the configuration.
        models: Models of the learned rows, by row.
        seed: Random seed, of the bootstrap.
        pool: Computes the recordings.
        store: Keeps those that are finished.
    """
    parts = stretches(recordings)
    names = [recording.name for recording in recordings]
    by_name = dict(zip(names, recordings, strict=True))
    tasks = {f"stretch {part}": int(part) for part in np.unique(parts)}
    shared = recordings, settings, parts
    found = pool.compute(taught_without, tasks, shared, store, "teaching")
    answers = dict(zip(tasks.values(), found, strict=True))
    of_recording = {
        name: {
            **models,
            **{row: _model(answers[int(part)], row) for row in (TAUGHT, TAUGHT_CONSTANT)},
        }
        for name, part in zip(names, parts, strict=True)
    }
    scored = pool.compute(
        scored_rows,
        {name: name for name in names},
        Shared(settings, by_name, of_recording),
        store,
        "recordings",
    )
    rows = {
        row: {
            name: dict(zip(COLUMNS, [float(v) for v in found[row]], strict=True))
            for name, found in zip(names, scored, strict=True)
        }
        for row in scored[0]
    }
    return {
        "recordings": names,
        "stretches": parts.tolist(),
        "seed": seed,
        "taught": {
            name: ANSWERS[int(answers[int(part)]["answer"])]
            for name, part in zip(names, parts, strict=True)
        },
        "rows": rows,
        "against_hand_set": against_hand_set(rows, _draws(parts, seed)),
    }


def _draws(parts: NDArray[np.int64], seed: int) -> statistics.Draws:
    """Weights of the recordings; those of one stretch depend on each other."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_BOOTSTRAP,)))
    return statistics.resamples(parts, rng)


def taught_without(
    shared: tuple[Sequence[Recording], Settings, NDArray[np.int64]], part: int
) -> Result:
    """The weights and limits that the recordings of all other stretches teach, by row.

    ``answer`` is an index in `ANSWERS`.
    """
    recordings, settings, parts = shared
    lessons = [
        lesson_of(
            recording.name,
            settings.constant(gate=True),
            settings.tuner,
            recording.stamps_ns,
            recording.samples @ stream_axes(settings),
            recording.events,
        )
        for recording, own in zip(recordings, parts, strict=True)
        if own != part
    ]
    constant = constant_of(lessons)
    answer, regressor = REFUSED, constant
    try:
        taught = teach(fits_of(lessons))
        answer, regressor = taught.answer, taught.regressor
    except TeachingError:
        pass
    return {
        "answer": np.array(ANSWERS.index(answer)),
        TAUGHT: regressor.weights,
        f"{TAUGHT}{_LIMITS}": regressor.limits,
        TAUGHT_CONSTANT: constant.weights,
        f"{TAUGHT_CONSTANT}{_LIMITS}": constant.limits,
    }


def scored_rows(shared: Shared, name: str) -> Result:
    """The `COLUMNS` of each row of a recording; nan where there is no room for a window."""
    settings, recording = shared.settings, shared.recordings[name]
    hand_set = settings.constant(gate=True)
    of_hand_set = filtered(settings, recording, recording.samples, hand_set)
    used = {
        u.stamp_ns
        for u in of_hand_set.updates
        if u.report.measurement == Dvl.name and u.report.corrected
    }
    rows = {HAND_SET: _numbers(settings, recording, hand_set, None, used)}
    for model_row, model in shared.models[name].items():
        received = tuned_by_model(recording.stamps_ns, recording.samples, model, settings.tuner)
        for row in (model_row, BANDS_WITH_FACTOR) if model_row == BANDS else (model_row,):
            external = settings.external(gate=True, factor=row == BANDS_WITH_FACTOR)
            rows[row] = _numbers(settings, recording, external, received, used)
            if row in _ALSO_FREE:
                f, w = _NO_FLOOR
                noise = replace(external.process_noise, accelerometer_floor=f, gyroscope_floor=w)
                free = replace(external, process_noise=noise)
                rows[row + FREE] = _numbers(settings, recording, free, received, used)
    return rows


def _numbers(
    settings: Settings,
    recording: Recording,
    parameters: FilterParameters,
    received: Received | None,
    used: set[int],
) -> Array:
    """The `COLUMNS` of a filter."""
    folded = filtered(settings, recording, recording.samples, parameters, received)
    errors = errors_of(folded, recording.truth_ns, recording.truth)
    taken = Taken()
    frd = recording.samples @ stream_axes(settings)
    taken.add_samples(recording.stamps_ns, frd[:, :3], frd[:, 3:])
    taken.events = [*recording.events, *(process_noise(*received) if received else ())]
    values: list[float] = []
    for seconds in WINDOWS:
        found = predictions(taken, parameters, used, seconds)
        values += [np.nan if found is None else getattr(found, name) for name in _OF_WINDOW]
    return np.array([*values, *(errors[name] for name in _OF_REFERENCE)], dtype=float)


def _model(found: Result, row: str) -> Model:
    """A model without a file, of what `taught_without` returns."""
    regressor = Weights(found[row], found[f"{row}{_LIMITS}"])
    return Model(Path(), {}, WINDOW, SCHEMAS["taught"], regressor)


def withheld_tables(document: Mapping[str, Any]) -> str:
    """The tables of the study, means over the recordings."""
    names, rows = document["recordings"], document["rows"]
    lines = []
    for row, values in rows.items():
        cells = [row]
        for w in WINDOWS:
            count = np.array([values[name][f"count {w:g} s"] for name in names])
            cells += [
                number(_mean([values[name][f"{column} {w:g} s"] for name in names], count))
                for column in ("error", "log_likelihood", "covered")
            ]
        lines.append(cells)
    header = [
        f"{text}, {w:g} s"
        for w in WINDOWS
        for text in ("error [m/s]", "log likelihood", "inside 95 %")
    ]
    against = [
        [
            row,
            *(
                number(float(np.mean([values[name][column] for name in names])))
                for column in _OF_REFERENCE
            ),
        ]
        for row, values in rows.items()
    ]
    answers = ", ".join(f"{name} {answer}" for name, answer in document["taught"].items())
    return "\n".join(
        [
            "Predictions of the first ping after windows without the DVL.\n",
            table(["row", *header], lines),
            "Against hand-set noise, over the same pings: ratio of the RMS errors, and difference "
            "of the mean log likelihood.\n",
            predictions_table(document["against_hand_set"]),
            "Errors against the recorded reference.\n",
            table(["row", "body velocity [m/s]", "horizontal position [m]", "tilt [deg]"], against),
            f"What the other stretches taught: {answers}.",
        ]
    )


def _mean(values: Sequence[float], count: Array) -> float:
    """Mean over all predictions."""
    return float(np.nansum(np.array(values) * count) / np.nansum(count))
