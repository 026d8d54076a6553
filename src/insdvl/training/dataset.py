"""The published data set: windows of an IMU with known white noise, and their features.

Four trajectories of 400 s at 100 Hz, each recorded with 15 noise variances, equal on all six
channels and in the square of the channel's unit; 200 windows of 2 s in each channel: 72,000
examples. The variances are 15 equally spaced values from 0.001 to 0.05: the text gives the range
and the number, and equal spacing is the plain reading. The best possible estimator, which knows
the grid, has an RMSE of 2.6e-3 there; with equal ratios in place of equal steps it would be 1.7e-3.

Every recording has its own random stream, made from the seed, the trajectory and the variance, so
that the data are the same on any number of workers.
"""

from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from insdvl.simulation.imu import ideal_imu, white_noise
from insdvl.simulation.trajectories import BASELINE
from insdvl.tuner.schemas import SCHEMAS
from insdvl.tuner.windows import CHANNELS

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

RATE = 100  # Hz
WINDOW = 200  # samples
WINDOWS = 200  # of each channel of a recording
VARIANCES = np.linspace(0.001, 0.05, 15)
TRAIN_FRACTION = 0.8

#: Streams of a seed that belong to no recording; those have (trajectory, variance).
_SPLIT_STREAM = (1000,)


@dataclass(frozen=True)
class DataSet:
    """M examples, ordered by trajectory, variance, channel, window.

    Attributes:
        X: (M, F) features.
        scale: (M,) variances that the answers are relative to, see `Schema`.
        q: (M,) variance per sample of the noise that was added.
        trajectory: (M,) index in BASELINE; recordings of two trajectories share no random numbers.
    """

    X: Array
    scale: Array
    q: Array
    trajectory: NDArray[np.int64]


def noisy_windows(trajectory: int, variance: int, seed: int, n_windows: int = WINDOWS) -> Array:
    """Windows (6 * n_windows, WINDOW) of one recording: ideal readings and white noise.

    Args:
        trajectory: Index in BASELINE.
        variance: Index in VARIANCES.
        seed: Of the data set.
        n_windows: Windows of each channel, from the start of the trajectory.
    """
    stamps_s = np.arange(1, n_windows * WINDOW + 1) / RATE
    f_b, w_ib_b = ideal_imu(list(BASELINE.values())[trajectory], stamps_s, 1.0 / RATE)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(trajectory, variance)))
    readings = np.hstack([f_b, w_ib_b])
    readings += white_noise(np.full(readings.shape, VARIANCES[variance]), rng)
    return np.ascontiguousarray(readings.T).reshape(CHANNELS * n_windows, WINDOW)


def build(schema: str, seed: int, jobs: int, n_windows: int = WINDOWS) -> DataSet:
    """The data set, the same for any number of jobs.

    Args:
        schema: Name of the feature schema.
        seed: Any non-negative integer.
        jobs: Number of processes.
        n_windows: See `noisy_windows`.
    """
    recordings = [(i, j) for i in range(len(BASELINE)) for j in range(len(VARIANCES))]
    parts = Parallel(n_jobs=jobs)(
        delayed(_examples)(schema, i, j, seed, n_windows) for i, j in recordings
    )
    size = CHANNELS * n_windows
    return DataSet(
        X=np.concatenate([X for X, _ in parts]),
        scale=np.concatenate([scale for _, scale in parts]),
        q=np.repeat([VARIANCES[j] for _, j in recordings], size),
        trajectory=np.repeat([i for i, _ in recordings], size),
    )


def _examples(
    schema: str, trajectory: int, variance: int, seed: int, n_windows: int
) -> tuple[Array, Array]:
    return SCHEMAS[schema].extract(noisy_windows(trajectory, variance, seed, n_windows))


def random_split(data: DataSet, seed: int) -> tuple[Indices, Indices]:
    """Training and test examples as published: 80 : 20 at random over all."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=_SPLIT_STREAM))
    order = rng.permutation(data.q.size)
    n_train = round(TRAIN_FRACTION * data.q.size)
    return np.sort(order[:n_train]), np.sort(order[n_train:])


def trajectory_split(data: DataSet, unseen: int) -> tuple[Indices, Indices]:
    """Training and test examples that share neither a trajectory nor a random stream."""
    test = data.trajectory == unseen
    return np.flatnonzero(~test), np.flatnonzero(test)
