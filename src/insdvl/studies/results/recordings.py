"""Recordings of a real vehicle as arrays, and the configuration of their filter."""

import hashlib
import pickle
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from insdvl.arrays import Array, Stamps
from insdvl.messages.feed import Feed
from insdvl.navigation.events import Event, Imu
from insdvl.navigation.geometry.frames import CONVENTIONS
from insdvl.navigation.parameters import FilterParameters, ProcessNoiseParameters
from insdvl.parameters.declaration import flatten
from insdvl.parameters.sections import load_section
from insdvl.recordings.base import BagError
from insdvl.recordings.parameters import ReplayParameters
from insdvl.studies.evaluation.metrics import Track
from insdvl.studies.replay.fold import feed_recording, read
from insdvl.studies.replay.reference import truth_of
from insdvl.tuner.models import Model
from insdvl.tuner.parameters import TunerParameters

#: Share of equal samples above which two recordings are of one stretch of the voyage.
_SAME_VOYAGE = 0.01


@dataclass(frozen=True)
class Recording:
    """A recording as arrays.

    Attributes:
        name: Name of its folder.
        stamps_ns: (N,) stamps of the IMU, increasing.
        samples: (N, 6) specific force [m/s^2] and angular rate [rad/s], in the axes of the stream.
        events: All other events of the filter.
        truth_ns: (M,) stamps of the reference.
        truth: The reference, in the axes of the stream.
        rejected: Number of rejected messages by ``topic: reason``.
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
        filter: With the hand-set process noise, and with the gate of the rows with a gate.
        tuner: With rate, largest gap and order of differences; the study has its own models.
        replay: With the topics of the recordings.
    """

    filter: FilterParameters
    tuner: TunerParameters
    replay: ReplayParameters

    @classmethod
    def load(cls, config: Path) -> "Settings":
        """The settings of a YAML file.

        Raises:
            ParameterError: The file cannot be used.
        """
        return cls(
            load_section(config, "insdvl_filter", FilterParameters, required=True),
            load_section(config, "insdvl_tuner", TunerParameters),
            load_section(config, "insdvl_replay", ReplayParameters),
        )

    def constant(self, q: Sequence[float] | None = None, *, gate: bool = False) -> FilterParameters:
        """The filter with constant process noise: hand-set, or variances (2,) of the two triads."""
        noise = replace(self.filter.process_noise, source="constant")
        if q is not None:
            noise = replace(
                noise, accelerometer_variance=(q[0],) * 3, gyroscope_variance=(q[1],) * 3
            )
        return self._with(noise, gate)

    def external(self, *, gate: bool = False, factor: bool = False) -> FilterParameters:
        """The filter with received process noise, and with a factor on it that it learns."""
        noise = self.filter.process_noise
        return self._with(replace(noise, source="external", adaptive_factor=factor), gate)

    def _with(self, noise: ProcessNoiseParameters, gate: bool) -> FilterParameters:
        return replace(
            self.filter, process_noise=noise, gate=replace(self.filter.gate, enabled=gate)
        )

    @property
    def nominal(self) -> Array:
        """(6,) hand-set variances."""
        noise = self.filter.process_noise
        return np.array(noise.accelerometer_variance + noise.gyroscope_variance)


def load_recording(path: Path, settings: Settings) -> Recording:
    """Read a recording.

    Raises:
        BagError: It cannot be read, is incomplete, or its stamps do not increase.
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
        raise BagError(
            f"{path} has fewer than 2 reference states on {settings.replay.ground_truth_topic}"
        )
    return Recording(
        path.name,
        stamps_ns,
        np.array(samples) @ stream_axes(settings),
        tuple(others),
        truth_ns,
        truth,
        {str(key): count for key, count in feed.refused.items()},
    )


def load_all(folder: Path, settings: Settings) -> list[Recording]:
    """The recordings of a folder, in the order of their names.

    Raises:
        BagError: One cannot be used, see `load_recording`, or all are of one stretch.
    """
    if not folder.is_dir():
        raise BagError(f"{folder} is not a folder of recordings")
    paths = sorted(file.parent for file in folder.glob("*/metadata.yaml"))
    recordings = [load_recording(path, settings) for path in paths]
    if not recordings or len(np.unique(stretches(recordings))) < 2:
        raise BagError(
            f"{folder} has {len(recordings)} recordings; two of different stretches are needed"
        )
    return recordings


class Sampled(Protocol):
    """A recording of which the samples are known."""

    @property
    def samples(self) -> Array:
        """(N, 6) of the IMU."""


def stretches(recordings: Sequence[Sampled]) -> NDArray[np.int64]:
    """Number of the stretch (R,) of each recording; recordings with equal samples share one."""
    seen = [{sample.tobytes() for sample in recording.samples} for recording in recordings]
    shared = [[len(a & b) > _SAME_VOYAGE * min(len(a), len(b)) for b in seen] for a in seen]
    return connected_components(np.array(shared), directed=False)[1].astype(np.int64)


def fingerprint(
    recordings: Sequence[Recording], settings: Settings, models: Mapping[str, Model]
) -> dict[str, Any]:
    """What the numbers depend on besides seeds and code, for a `Store`."""
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


def stream_axes(settings: Settings) -> Array:
    """(6, 6) rotation of both triads between the stream and FRD; its own inverse."""
    rotation = np.zeros((6, 6))
    rotation[:3, :3] = rotation[3:, 3:] = CONVENTIONS[settings.filter.frame_convention].body
    return rotation
