"""The study on recordings of a real vehicle: learned process noise against what else there is.

The IMU of a recording is made noisier by known variances, and every row filters the same noisy
samples: rows differ in the process noise alone. Errors are against the recorded reference, at its
stamps. Without injected noise the question is whether learning does harm.

Rows: `told` knows the injected variances; `told with hand-set` adds to them the hand-set variances
of the configuration, the noise that the recording has without them; the learned rows and the closed
form see the samples only; `hand-set` is the configuration as it is; `best constant` is the best of
a grid on the other recordings, with other seeds. Recordings of one stretch of the voyage are not
independent of each other: they are left out together, and drawn together by the bootstrap.

As in the simulations all measurements are used: where the noise has just grown the gate refuses
good ones, and a row that believes too much is then punished for the gate. The rows `..., gate on`
have the gate of the configuration.
"""

import hashlib
import pickle
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from insdvl.jobs.parallel import Pool, Store
from insdvl.messages.feed import Feed
from insdvl.navigation.events import NS, Event, Imu, ProcessNoise
from insdvl.navigation.geometry.frames import CONVENTIONS
from insdvl.navigation.parameters import FilterParameters, ProcessNoiseParameters
from insdvl.parameters.declaration import flatten
from insdvl.parameters.sections import load_section
from insdvl.recordings.base import BagError
from insdvl.recordings.parameters import ReplayParameters
from insdvl.studies.evaluation import statistics
from insdvl.studies.evaluation.metrics import Track
from insdvl.studies.evaluation.tables import interval, number, table
from insdvl.studies.replay.fold import feed_recording, read
from insdvl.studies.replay.injection import Injection, announcements
from insdvl.studies.replay.scores import errors_of, truth_of
from insdvl.timeline.output import FoldResult
from insdvl.timeline.recorded import fold_arrays
from insdvl.tuner.features.closed_form import degree_5
from insdvl.tuner.features.differences import bounded
from insdvl.tuner.models import Model
from insdvl.tuner.offline import Estimator, tuned
from insdvl.tuner.parameters import TunerParameters

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]
Limits = tuple[tuple[float, float], tuple[float, float]]
#: Stamps (K,) from which on variances (K, 6) hold.
Told = tuple[Stamps, Array]

#: Smallest and largest injected variance, of the accelerometers and of the gyroscopes.
INJECTIONS: dict[str, Limits] = {
    "sensor": ((1e-5, 0.05), (1e-7, 5e-4)),
    "published": ((1e-3, 0.05), (1e-3, 0.05)),
}
#: Numbers of `errors_of` that are kept, and how a table calls them.
METRICS = {
    "body_velocity_rmse": "body velocity [m/s]",
    "velocity_rmse": "NED velocity [m/s]",
    "position_rmse_horizontal": "horizontal position [m]",
    "heading_rmse_deg": "heading [deg]",
    "tilt_rmse_deg": "tilt [deg]",
    "nis_mean": "NIS",
    "body_velocity_inside_3_sigma": "inside 3 sigma",
}
#: Those that are errors: their ratios are told.
ERRORS = tuple(METRICS)[:5]

TOLD, TOLD_WITH_NOMINAL = "told", "told with hand-set"
CLOSED_FORM, HAND_SET, BEST_CONSTANT = "closed form", "hand-set", "best constant"
GATE_ON = ", gate on"  # of a row's name
WINDOW = 200  # samples, of the closed form

TUNING, TEST = 0, 1  # roles of a seed
_BOOTSTRAP = 2006  # key of the random stream
_SAME_VOYAGE = 0.01  # share of equal samples above which two recordings are of one stretch


# ---------------------------------------------------------------- recordings


@dataclass(frozen=True)
class Recording:
    """What the study needs of a recording.

    Attributes:
        name: Of its folder.
        stamps_ns: (N,) stamps of the IMU, increasing.
        samples: (N, 6) specific force [m/s^2] and angular rate [rad/s], in the axes of the stream.
        events: What else the filter takes.
        truth_ns: (M,) stamps of the reference.
        truth: The reference, in the axes of the stream.
        rejected: Messages that cannot be used, by ``topic: reason``.
    """

    name: str
    stamps_ns: Stamps
    samples: Array
    events: tuple[Event, ...]
    truth_ns: Stamps
    truth: Track
    rejected: Mapping[str, int]


@dataclass(frozen=True)
class Settings:
    """The sections of a configuration that a replay reads.

    Attributes:
        filter: Its process noise is the hand-set one; its gate is for the rows with the gate.
        tuner: Its rate, largest gap and differences; the models are those of the study.
        replay: Topics of the recordings.
    """

    filter: FilterParameters
    tuner: TunerParameters
    replay: ReplayParameters

    @classmethod
    def load(cls, config: Path) -> "Settings":
        """The settings of a YAML file.

        Raises:
            ParameterError: The file is not usable.
        """
        return cls(
            load_section(config, "insdvl_filter", FilterParameters, required=True),
            load_section(config, "insdvl_tuner", TunerParameters),
            load_section(config, "insdvl_replay", ReplayParameters),
        )

    def constant(self, q: Sequence[float] | None = None, *, gate: bool = False) -> FilterParameters:
        """The filter with a constant process noise: hand-set, or variances of the two triads."""
        noise = replace(self.filter.process_noise, source="constant")
        if q is not None:
            noise = replace(
                noise, accelerometer_variance=(q[0],) * 3, gyroscope_variance=(q[1],) * 3
            )
        return self._with(noise, gate)

    def told(self, *, gate: bool = False) -> FilterParameters:
        """The filter that is told its process noise."""
        return self._with(replace(self.filter.process_noise, source="external"), gate)

    def _with(self, noise: ProcessNoiseParameters, gate: bool) -> FilterParameters:
        return replace(
            self.filter, process_noise=noise, gate=replace(self.filter.gate, enabled=gate)
        )

    @property
    def nominal(self) -> Array:
        """(6,) hand-set variances."""
        noise = self.filter.process_noise
        return np.array(noise.accelerometer_variance + noise.gyroscope_variance)


def load(path: Path, settings: Settings) -> Recording:
    """A recording as arrays.

    Raises:
        BagError: It cannot be read, lacks something, or its stamps do not increase.
    """
    messages = read(path, settings.replay)
    stamps: list[int] = []
    samples, others = [], []
    feed = Feed(settings.constant())
    for event, _ in chain.from_iterable(feed_recording(messages, feed)):
        if isinstance(event, Imu):
            stamps.append(event.stamp_ns)
            samples.append(np.concatenate([event.f_b, event.w_ib_b]))
        else:
            others.append(event)
    stamps_ns = np.array(stamps, dtype=np.int64)
    if (np.diff(stamps_ns) <= 0).any():
        raise BagError(f"{path}: the stamps of {settings.replay.imu_topic} do not increase")
    truth_ns, truth = truth_of(messages)
    if len(truth_ns) < 2:
        raise BagError(f"{path} has no reference on {settings.replay.ground_truth_topic}")
    return Recording(
        path.name,
        stamps_ns,
        np.array(samples) @ _stream_axes(settings),
        tuple(others),
        truth_ns,
        truth,
        {str(key): count for key, count in feed.refused.items()},
    )


def load_all(folder: Path, settings: Settings) -> list[Recording]:
    """The recordings of a folder, in the order of their names.

    Raises:
        BagError: See `load`; or there are too few to leave one out.
    """
    if not folder.is_dir():
        raise BagError(f"{folder} is no folder of recordings")
    paths = sorted(file.parent for file in folder.glob("*/metadata.yaml"))
    recordings = [load(path, settings) for path in paths]
    if not recordings or len(np.unique(stretches(recordings))) < 2:
        raise BagError(
            f"{folder} has {len(recordings)} recordings, and two of different stretches are needed"
        )
    return recordings


def stretches(recordings: Sequence[Recording]) -> NDArray[np.int64]:
    """Number of the stretch (R,) that each recording is of: those with equal samples share one."""
    seen = [{sample.tobytes() for sample in recording.samples} for recording in recordings]
    shared = [[len(a & b) > _SAME_VOYAGE * min(len(a), len(b)) for b in seen] for a in seen]
    return connected_components(np.array(shared), directed=False)[1].astype(np.int64)


def fingerprint(
    recordings: Sequence[Recording], settings: Settings, models: Mapping[str, Model]
) -> dict[str, Any]:
    """What the numbers depend on beside seeds and sources, for a `Store`."""
    return {
        "recordings": {
            recording.name: hashlib.sha256(pickle.dumps(recording)).hexdigest()
            for recording in recordings
        },
        "settings": [
            flatten(group) for group in (settings.filter, settings.tuner, settings.replay)
        ],
        "models": {row: model.card["sha256"] for row, model in models.items()},
    }


def _stream_axes(settings: Settings) -> Array:
    """(6, 6) rotation of both triads between forward-right-down and the stream; its own inverse."""
    rotation = np.zeros((6, 6))
    rotation[:3, :3] = rotation[3:, 3:] = CONVENTIONS[settings.filter.frame_convention].body
    return rotation


# ---------------------------------------------------------------- runs


def injection(recording: Recording, limits: Limits, seed: int, role: int, index: int) -> Injection:
    """The noise of one run: other noise for each recording, as `insdvl replay` would inject it."""
    key = (role, zlib.crc32(recording.name.encode()), index)
    drawn = np.random.SeedSequence(seed, spawn_key=key).generate_state(1)[0]
    return Injection(*limits, seed=int(drawn))


def fold(
    settings: Settings,
    recording: Recording,
    samples: Array,
    parameters: FilterParameters,
    told: Told | None = None,
) -> FoldResult:
    """A recording through the filter.

    Args:
        settings: Of the study.
        recording: All but the samples.
        samples: (N, 6) of the IMU, in the axes of the stream.
        parameters: Of the filter.
        told: Process noise, for a filter that is told it.
    """
    events = list(recording.events)
    if told is not None:
        events += [
            ProcessNoise(int(stamp_ns), np.diag(q[:3]), np.diag(q[3:]))
            for stamp_ns, q in zip(*told, strict=True)
        ]
    frd = samples @ _stream_axes(settings)
    return fold_arrays(parameters, recording.stamps_ns, frd[:, :3], frd[:, 3:], events)


def _numbers(recording: Recording, result: FoldResult) -> Array:
    """The METRICS of a run."""
    errors = errors_of(result, recording.truth_ns, recording.truth)
    if errors["reference_stamps"] < 2:
        raise BagError(f"{recording.name}: the filter was never initialised beside the reference")
    return np.array([errors[name] for name in METRICS], dtype=float)


@dataclass(frozen=True)
class Shared:
    """What all runs need.

    Attributes:
        settings: Of the study.
        recordings: By their names.
        models: Models of the learned rows.
    """

    settings: Settings
    recordings: Mapping[str, Recording]
    models: Mapping[str, Model]


def learned(shared: Shared, recording: Recording, samples: Array) -> dict[str, Told]:
    """What a tuner would tell: with each model, and with the closed form as it is."""
    tuner = shared.settings.tuner
    estimators: dict[str, tuple[Estimator, int]] = {
        row: (bounded(model.variances, tuner.difference_order), model.window)
        for row, model in shared.models.items()
    }
    estimators[CLOSED_FORM] = degree_5, WINDOW
    return {
        row: tuned(
            recording.stamps_ns, samples, estimate, window, tuner.rate, round(tuner.max_gap * NS)
        )
        for row, (estimate, window) in estimators.items()
    }


@dataclass(frozen=True)
class Run:
    """A recording with the noise of one seed.

    Attributes:
        recording: Its name.
        injection: None for the recording as it is.
        constants: Pairs of constant variances to try, with their rows.
    """

    recording: str
    injection: Injection | None
    constants: Mapping[str, tuple[float, float]]


def constant_run(shared: Shared, task: Run) -> dict[str, Array]:
    """The METRICS of each constant."""
    settings, recording = shared.settings, shared.recordings[task.recording]
    samples, _ = _noisy(recording, task.injection)
    return {
        row: _numbers(recording, fold(settings, recording, samples, settings.constant(q)))
        for row, q in task.constants.items()
    }


def all_rows(shared: Shared, task: Run) -> dict[str, Array]:
    """The METRICS of each row."""
    settings, recording = shared.settings, shared.recordings[task.recording]
    samples, true = _noisy(recording, task.injection)
    told = learned(shared, recording, samples)
    if true is not None:
        stamps_ns, q = true
        told |= {TOLD: true, TOLD_WITH_NOMINAL: (stamps_ns, q + settings.nominal)}
    constants = {HAND_SET: None, **task.constants}
    rows = {}
    # Without injected noise the gate has nothing to refuse.
    gates = {False: ""} if true is None else {False: "", True: GATE_ON}
    for gate, suffix in gates.items():
        filters: list[tuple[str, FilterParameters, Told | None]] = [
            (row, settings.told(gate=gate), q) for row, q in told.items()
        ]
        filters += [(row, settings.constant(q, gate=gate), None) for row, q in constants.items()]
        for row, parameters, process_noise in filters:
            result = fold(settings, recording, samples, parameters, process_noise)
            rows[row + suffix] = _numbers(recording, result)
    return rows


def _noisy(recording: Recording, injected: Injection | None) -> tuple[Array, Told | None]:
    """The samples with the injected noise, and its variances as the filter is told them."""
    if injected is None:
        return recording.samples, None
    q, noise = injected.draw(recording.stamps_ns)
    at, stamps_ns = np.array(announcements(recording.stamps_ns, q)).T
    return recording.samples + noise, (stamps_ns, q[at])


# ---------------------------------------------------------------- study


def grid(limits: Limits) -> list[tuple[float, float]]:
    """Constants (variance of accelerometers and of gyroscopes) for an injection.

    Of each triad the geometric mean of the limits, the mean of the log-uniform variance, and the
    largest.
    """

    def levels(low: float, high: float) -> tuple[float, float, float]:
        mean = (high - low) / np.log(high / low) if high > low else high
        return float(np.sqrt(low * high)), float(mean), high

    return list(product(levels(*limits[0]), levels(*limits[1])))


def study(
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
    """The study's numbers.

    Args:
        recordings: See `load_all`.
        settings: Of the configuration.
        models: Models of the learned rows, by the rows' names.
        runs: Seeds of each recording and injection.
        tuning_runs: As many other seeds, for the best constant.
        seed: Of all that is random.
        pool: Where the runs are computed.
        store: Keeps what is finished.
    """
    names = [recording.name for recording in recordings]
    stretch = stretches(recordings)
    shared = Shared(settings, dict(zip(names, recordings, strict=True)), models)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_BOOTSTRAP,)))

    def execute(label: str, function: Any, tasks: dict[str, Run]) -> dict[str, Array]:
        results = pool.run(function, tasks, shared, store, f"vehicle {label}")
        # (recordings, seeds, METRICS) of each row
        return {
            row: np.array([result[row] for result in results]).reshape(len(names), -1, len(METRICS))
            for row in results[0]
        }

    def tasks(
        limits: Limits, role: int, n: int, constants: Sequence[Mapping[str, tuple[float, float]]]
    ) -> dict[str, Run]:
        return {
            f"{recording.name} {k}": Run(
                recording.name, injection(recording, limits, seed, role, k), constants[i]
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
            tasks(limits, TUNING, tuning_runs, [every] * len(names)),
        )
        cost = np.array([tried[row][:, :, 0].mean(axis=1) for row in every])  # (9, recordings)
        best = [candidates[int(np.argmin(cost[:, stretch != own].mean(axis=1)))] for own in stretch]
        test = tasks(limits, TEST, runs, [{BEST_CONSTANT: q} for q in best])
        rows = execute(name, all_rows, test)
        document["injections"][name] = {
            "limits": limits,
            "grid": candidates,
            "best_constant": dict(zip(names, best, strict=True)),
            "seeds": {
                recording.name: [
                    injection(recording, limits, seed, TEST, k).seed for k in range(runs)
                ]
                for recording in recordings
            },
            "rows": _summary(rows, names),
            "ratio_to": {
                reference: _ratios(rows, reference, stretch, rng)
                for reference in (TOLD, TOLD_WITH_NOMINAL, BEST_CONSTANT)
            },
        }
    rows = execute("as recorded", all_rows, {name: Run(name, None, {}) for name in names})
    document["as_recorded"] = {
        "rows": _summary(rows, names),
        "ratio_to": {HAND_SET: _ratios(rows, HAND_SET, stretch, rng)},
    }
    return document


def _summary(rows: Mapping[str, Array], names: Sequence[str]) -> dict[str, Any]:
    """Means over the seeds, of each recording and of all."""
    return {
        row: {
            metric: {
                "mean": float(np.mean(values[:, :, m])),
                **dict(zip(names, np.mean(values[:, :, m], axis=1).tolist(), strict=True)),
            }
            for m, metric in enumerate(METRICS)
        }
        for row, values in rows.items()
    }


def _ratios(
    rows: Mapping[str, Array],
    reference: str,
    stretch: NDArray[np.int64],
    rng: np.random.Generator,
) -> dict[str, Any]:
    """Ratios of the mean errors to those of a row, with intervals over stretches of the voyage."""
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


# ---------------------------------------------------------------- tables


def markdown(document: Mapping[str, Any]) -> str:
    """The study's tables."""
    parts = []
    for name, numbers in document["injections"].items():
        (acc_low, acc_high), (gyr_low, gyr_high) = numbers["limits"]
        parts.append(
            f"Injected noise `{name}`, variances in [{acc_low:g}, {acc_high:g}] (m/s^2)^2 and "
            f"[{gyr_low:g}, {gyr_high:g}] (rad/s)^2: means over {len(document['recordings'])} "
            f"recordings and {document['runs']} seeds.\n"
        )
        parts.append(_means(numbers["rows"]))
        references = numbers["ratio_to"]
        for metric in ("body_velocity_rmse", "velocity_rmse"):
            parts.append(f"Ratios of the mean {METRICS[metric].split(' [')[0]} errors.\n")
            parts.append(
                table(
                    ["row", *(f"to {reference}" for reference in references)],
                    [
                        [
                            row,
                            *(
                                interval(ratios[row][metric] if row in ratios else None)
                                for ratios in references.values()
                            ),
                        ]
                        for row in numbers["rows"]
                    ],
                )
            )
    clean = document["as_recorded"]
    parts.append("As recorded: means over the recordings.\n")
    parts.append(_means(clean["rows"]))
    ratios = clean["ratio_to"][HAND_SET]
    parts.append(f"Ratios of the errors to those of {HAND_SET}, as recorded.\n")
    names = document["recordings"]
    parts.append(
        table(
            ["row", "all", *names],
            [
                [
                    f"{row}, {METRICS[metric].split(' [')[0]}",
                    interval(ratios[row][metric]),
                    *(
                        number(
                            clean["rows"][row][metric][name]
                            / clean["rows"][HAND_SET][metric][name],
                            3,
                        )
                        for name in names
                    ),
                ]
                for row in ratios
                for metric in ERRORS
            ],
        )
    )
    return "\n".join(parts)


def _means(rows: Mapping[str, Any]) -> str:
    return table(
        ["row", *METRICS.values()],
        [[row, *(number(values[m]["mean"]) for m in METRICS)] for row, values in rows.items()],
    )
