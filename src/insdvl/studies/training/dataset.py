"""The published data set: windows of an IMU with known white noise, and their features.

Four trajectories of 400 s at 100 Hz, each recorded with 15 noise variances, which are equal on all
six channels, in the square of the channel's unit; 200 windows of 2 s per channel: 72,000 examples.
The variances are 15 equally spaced values from 0.001 to 0.05: the text gives the range and the
number, and equal spacing is the plain reading. The best possible estimator, which knows the grid,
has an RMSE of 2.6e-3; with equal ratios instead of equal steps it would be 1.7e-3.

Windows of another length lie in the same recordings: shorter ones start where those of 200 samples
start, longer ones follow each other up to 400 s.

Every recording has its own random stream, made from seed, trajectory and variance, so the data do
not depend on the number of workers.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array
from insdvl.jobs.pool import Pool
from insdvl.jobs.store import Store
from insdvl.jobs.tasks import Result
from insdvl.simulation.sensors.imu import ideal_imu, white_noise
from insdvl.simulation.trajectories import BASELINE
from insdvl.tuner.features.schemas import SCHEMAS
from insdvl.tuner.windows import CHANNELS

Indices = NDArray[np.intp]

RATE = 100  # Hz
WINDOW = 200  # samples
WINDOWS = 200  # per channel of a recording
SAMPLES = WINDOWS * WINDOW  # per channel of a recording
VARIANCES = np.linspace(0.001, 0.05, 15)
TRAIN_FRACTION = 0.8

#: Random streams that belong to no recording; those have (trajectory, variance).
_SPLIT_STREAM = (1000,)


@dataclass(frozen=True)
class Recipe:
    """Settings of a data set.

    Attributes:
        schema: Name of the feature schema.
        seed: Random seed, not negative.
        window: Number of samples N of a window, at most SAMPLES.
        n_windows: Largest number of windows per channel of a recording, from its start.
    """

    schema: str
    seed: int
    window: int = WINDOW
    n_windows: int = WINDOWS

    @property
    def name(self) -> str:
        """Name that is unique among the data sets of a study."""
        return f"{self.schema}-{self.window}"

    @property
    def stride(self) -> int:
        """Samples from the start of a window to that of the next."""
        return max(self.window, WINDOW)

    @property
    def windows_per_channel(self) -> int:
        """Number of windows per channel of a recording."""
        return min(self.n_windows, SAMPLES // self.stride)


@dataclass(frozen=True)
class DataSet:
    """M examples, ordered by trajectory, variance, channel, window.

    Attributes:
        X: (M, F) features.
        scale: (M,) variances that the targets are relative to, see `Schema`.
        q: (M,) variance per sample of the added noise.
        trajectory: (M,) index in BASELINE; recordings of two trajectories share no random numbers.
    """

    X: Array
    scale: Array
    q: Array
    trajectory: NDArray[np.int64]


def noisy_windows(recipe: Recipe, trajectory: int, variance: int) -> Array:
    """Windows (6 * windows_per_channel, window) of a recording: ideal readings plus white noise.

    Args:
        recipe: Settings of the data set.
        trajectory: Index in BASELINE.
        variance: Index in VARIANCES.
    """
    n, stride = recipe.windows_per_channel, recipe.stride
    stamps_s = np.arange(1, n * stride + 1) / RATE
    f_b, w_ib_b = ideal_imu(list(BASELINE.values())[trajectory], stamps_s, 1.0 / RATE)
    stream = np.random.SeedSequence(recipe.seed, spawn_key=(trajectory, variance))
    readings = np.hstack([f_b, w_ib_b])
    readings += white_noise(
        np.full(readings.shape, VARIANCES[variance]), np.random.default_rng(stream)
    )
    windows = np.ascontiguousarray(readings.T).reshape(CHANNELS * n, stride)
    return np.ascontiguousarray(windows[:, : recipe.window])


def build_data_set(recipe: Recipe, pool: Pool, store: Store | None = None) -> DataSet:
    """The data set; it does not depend on the workers.

    Args:
        recipe: Settings of the data set.
        pool: Computes the recordings.
        store: Keeps finished recordings.
    """
    recordings = {
        f"{name}-{j:02}": (i, j) for i, name in enumerate(BASELINE) for j in range(VARIANCES.size)
    }
    parts = pool.compute(
        _examples, recordings, shared=recipe, store=store, label=f"data set {recipe.name}"
    )
    size = CHANNELS * recipe.windows_per_channel
    return DataSet(
        X=np.concatenate([part["X"] for part in parts]),
        scale=np.concatenate([part["scale"] for part in parts]),
        q=np.repeat([VARIANCES[j] for _, j in recordings.values()], size),
        trajectory=np.repeat([i for i, _ in recordings.values()], size),
    )


def _examples(recipe: Recipe, recording: tuple[int, int]) -> Result:
    X, scale = SCHEMAS[recipe.schema].extract(noisy_windows(recipe, *recording))
    return {"X": X, "scale": scale}


def random_split(n: int, seed: int) -> tuple[Indices, Indices]:
    """Training and test examples as published: 80 : 20 at random over all n examples."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=_SPLIT_STREAM))
    order = rng.permutation(n)
    n_train = round(TRAIN_FRACTION * n)
    return np.sort(order[:n_train]), np.sort(order[n_train:])


def trajectory_split(data: DataSet, unseen: int) -> tuple[Indices, Indices]:
    """Training and test examples that share neither a trajectory nor a random stream."""
    test = data.trajectory == unseen
    return np.flatnonzero(~test), np.flatnonzero(test)
