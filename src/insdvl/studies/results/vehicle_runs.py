"""Runs of the study on recordings: one recording with one draw of noise, through all filters.

The samples of a recording get additional noise of known variances, and every row filters the same
noisy samples: rows differ in the process noise only. Errors are against the recorded reference, at
its stamps.

Rows: `told` receives the injected variances; `told with hand-set` receives their sum with the
hand-set variances of the configuration, which are the noise of the recording itself; the learned
rows and the closed form see the samples only; `hand-set` is the configuration as it is;
`best constant` is the best of a grid. All measurements are used, as in the simulations; the rows
`..., gate on` have the gate of the configuration.
"""

import zlib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from insdvl.arrays import Array, Stamps
from insdvl.navigation.events import NS, ProcessNoise
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.recordings.base import BagError
from insdvl.simulation.drawn.scenarios import COLOURED, DRAWN, GYROSCOPE, WHITE
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.studies.evaluation.approaches import BANDS, BANDS_WITH_FACTOR, FACTOR_WITH_R
from insdvl.studies.replay.inputs.drawn_noise import DrawnNoise
from insdvl.studies.replay.inputs.injection import Injection, announcements
from insdvl.studies.replay.scores import errors_of, innovation_autocorrelation
from insdvl.studies.results.recordings import Recording, Settings, stream_axes
from insdvl.timeline.output import FoldResult
from insdvl.timeline.recorded import fold_arrays
from insdvl.tuner.features.closed_form import degree_5
from insdvl.tuner.models import Model
from insdvl.tuner.offline import tuned, tuned_by_model

Limits = tuple[tuple[float, float], tuple[float, float]]
#: Stamps (K,) from which on variances (K, 6) apply.
Received = tuple[Stamps, Array]

#: Smallest and largest injected variance of the accelerometers and of the gyroscopes: of white
#: noise, or of the noise of a scenario, vibration aside.
INJECTIONS: dict[str, Limits] = {
    "sensor": ((1e-5, 0.05), (1e-7, 5e-4)),
    "published": ((1e-3, 0.05), (1e-3, 0.05)),
    "vibrating": (WHITE, (GYROSCOPE * WHITE[0], GYROSCOPE * WHITE[1])),
    "coloured": (COLOURED, (GYROSCOPE * COLOURED[0], GYROSCOPE * COLOURED[1])),
}
#: Numbers of `errors_of` in the study, and their names in tables.
METRICS = {
    "body_velocity_rmse": "body velocity [m/s]",
    "velocity_rmse": "NED velocity [m/s]",
    "position_rmse_horizontal": "horizontal position [m]",
    "heading_rmse_deg": "heading [deg]",
    "tilt_rmse_deg": "tilt [deg]",
    "nis_mean": "NIS",
    "body_velocity_inside_3_sigma": "inside 3 sigma",
}
#: Numbers of the recordings as they are: beside these, how deep the filter is at the end, and
#: whether its innovations are white.
AS_RECORDED = METRICS | {
    "depth_error_end": "depth at the end [m]",
    "innovation_autocorrelation": "innovations, lag 1",
}
#: The errors among them, which have ratios.
ERRORS = tuple(METRICS)[:5]

TOLD, TOLD_WITH_NOMINAL = "told", "told with hand-set"
CLOSED_FORM, HAND_SET, BEST_CONSTANT = "closed form", "hand-set", "best constant"
GATE_ON = ", gate on"  # of a row's name
WINDOW = 200  # samples of the closed form

TUNING, TEST = 0, 1  # roles of a seed


class Noise(Protocol):
    """Noise for the samples of a recording."""

    @property
    def seed(self) -> int:
        """Random seed."""

    def draw(self, stamps_ns: Stamps) -> tuple[Array, Array]:
        """Variances (N, 6) that a filter needs, and noise (N, 6), in the axes of the stream."""


def injection(
    settings: Settings, recording: Recording, name: str, seed: int, role: int, index: int
) -> Noise:
    """Noise of one run, different for each recording.

    White noise is that which `insdvl replay` would inject.
    """
    key = (role, zlib.crc32(recording.name.encode()), index)
    drawn = int(np.random.SeedSequence(seed, spawn_key=key).generate_state(1)[0])
    if name not in DRAWN:
        return Injection(*INJECTIONS[name], seed=drawn)
    pings = [event.stamp_ns for event in recording.events if isinstance(event, Dvl)]
    rate = NS / float(np.median(np.diff(pings)))
    return DrawnNoise(name, DvlModel(rate=rate, noise_std=settings.filter.dvl.noise_std), drawn)


def filtered(
    settings: Settings,
    recording: Recording,
    samples: Array,
    parameters: FilterParameters,
    received: Received | None = None,
) -> FoldResult:
    """A recording through the filter.

    Args:
        settings: Settings of the study.
        recording: All but the samples of the IMU.
        samples: (N, 6) samples of the IMU, in the axes of the stream.
        parameters: Parameters of the filter.
        received: Process noise, for a filter that receives it.
    """
    events = list(recording.events)
    if received is not None:
        events += process_noise(*received)
    frd = samples @ stream_axes(settings)
    return fold_arrays(parameters, recording.stamps_ns, frd[:, :3], frd[:, 3:], events)


def process_noise(stamps_ns: Stamps, variances: Array) -> list[ProcessNoise]:
    """Variances (K, 6) that apply from stamps (K,) on, as events."""
    return [
        ProcessNoise(int(stamp_ns), np.diag(q[:3]), np.diag(q[3:]))
        for stamp_ns, q in zip(stamps_ns, variances, strict=True)
    ]


def _numbers(recording: Recording, result: FoldResult, metrics: Collection[str] = METRICS) -> Array:
    """The METRICS of a run, or those AS_RECORDED."""
    errors = errors_of(result, recording.truth_ns, recording.truth)
    if errors["reference_stamps"] < 2:
        raise BagError(
            f"{recording.name}: the filter has a state at fewer than 2 stamps of the reference"
        )
    if "innovation_autocorrelation" in metrics:
        correlated = innovation_autocorrelation(result.updates)
        if correlated is None:
            raise BagError(f"{recording.name}: too few DVL updates for the autocorrelation")
        errors["innovation_autocorrelation"] = correlated[0]
    return np.array([errors[name] for name in metrics], dtype=float)


@dataclass(frozen=True)
class Shared:
    """Data that all runs need.

    Attributes:
        settings: Settings of the study.
        recordings: Recordings by name.
        models: Models of the learned rows.
    """

    settings: Settings
    recordings: Mapping[str, Recording]
    models: Mapping[str, Model]


def learned(shared: Shared, recording: Recording, samples: Array) -> dict[str, Received]:
    """Output of a tuner with each model, and with the closed form without a bound."""
    tuner = shared.settings.tuner
    rows = {
        row: tuned_by_model(recording.stamps_ns, samples, model, tuner)
        for row, model in shared.models.items()
    }
    rows[CLOSED_FORM] = tuned(
        recording.stamps_ns, samples, degree_5, WINDOW, tuner.rate, round(tuner.max_gap * NS)
    )
    return rows


@dataclass(frozen=True)
class NoisyRun:
    """A recording with the noise of one seed.

    Attributes:
        recording: Name of the recording.
        injection: What is injected; None for the recording as it is.
        constants: Constant variances of the two triads by row.
    """

    recording: str
    injection: Noise | None
    constants: Mapping[str, tuple[float, float]]


def constant_run(shared: Shared, task: NoisyRun) -> dict[str, Array]:
    """The METRICS of each constant."""
    settings, recording = shared.settings, shared.recordings[task.recording]
    samples, _ = _noisy(recording, task.injection)
    return {
        row: _numbers(recording, filtered(settings, recording, samples, settings.constant(q)))
        for row, q in task.constants.items()
    }


def all_rows(shared: Shared, task: NoisyRun) -> dict[str, Array]:
    """The METRICS of each row, or those AS_RECORDED where nothing is injected."""
    settings, recording = shared.settings, shared.recordings[task.recording]
    samples, true = _noisy(recording, task.injection)
    received = learned(shared, recording, samples)
    if true is not None:
        stamps_ns, q = true
        received |= {TOLD: true, TOLD_WITH_NOMINAL: (stamps_ns, q + settings.nominal)}
    constants = {HAND_SET: None, **task.constants}
    metrics = AS_RECORDED if true is None else METRICS
    rows = {}
    # Without injected noise the gate has nothing to reject.
    gates = {False: ""} if true is None else {False: "", True: GATE_ON}
    for gate, suffix in gates.items():
        filters: list[tuple[str, FilterParameters, Received | None]] = [
            (row, settings.external(gate=gate), q) for row, q in received.items()
        ]
        if BANDS in received:
            with_factor = settings.external(gate=gate, factor=True)
            filters.append((BANDS_WITH_FACTOR, with_factor, received[BANDS]))
            if true is None:  # what is injected is no noise of the DVL
                dvl = replace(with_factor.dvl, noise_source="adaptive")
                filters.append((FACTOR_WITH_R, replace(with_factor, dvl=dvl), received[BANDS]))
        filters += [(row, settings.constant(q, gate=gate), None) for row, q in constants.items()]
        for row, parameters, process_noise in filters:
            result = filtered(settings, recording, samples, parameters, process_noise)
            rows[row + suffix] = _numbers(recording, result, metrics)
    return rows


def _noisy(recording: Recording, injected: Noise | None) -> tuple[Array, Received | None]:
    """The samples with the injected noise, and its variances as a filter receives them."""
    if injected is None:
        return recording.samples, None
    q, noise = injected.draw(recording.stamps_ns)
    at, stamps_ns = np.array(announcements(recording.stamps_ns, q)).T
    return recording.samples + noise, (stamps_ns, q[at])
