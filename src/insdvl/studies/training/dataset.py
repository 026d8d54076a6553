"""The published data set: windows of an IMU with known white noise, and their features.

Four trajectories of 400 s at 100 Hz, each recorded with 15 noise variances, equal on all six
channels and in the square of the channel's unit; 200 windows of 2 s in each channel: 72,000
examples. The variances are 15 equally spaced values from 0.001 to 0.05: the text gives the range
and the number, and equal spacing is the plain reading. The best possible estimator, which knows
the grid, has an RMSE of 2.6e-3 there; with equal ratios in place of equal steps it would be 1.7e-3.

Windows of another length lie in the same recordings: shorter ones begin where those of 200 samples
do, longer ones follow each other, as many as 400 s hold.

Every recording has its own random stream, made from the seed, the trajectory and the variance, so
that the data are the same on any number of workers.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insdvl.jobs.parallel import Pool, Result, Store
from insdvl.simulation.imu import ideal_imu, white_noise
from insdvl.simulation.trajectories import BASELINE
from insdvl.tuner.features.schemas import SCHEMAS
from insdvl.tuner.windows import CHANNELS

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

RATE = 100  # Hz
WINDOW = 200  # samples
WINDOWS = 200  # of each channel of a recording
SAMPLES = WINDOWS * WINDOW  # of each channel of a recording
VARIANCES = np.linspace(0.001, 0.05, 15)
TRAIN_FRACTION = 0.8

#: Streams of a seed that belong to no recording; those have (trajectory, variance).
_SPLIT_STREAM = (1000,)


@dataclass(frozen=True)
class Recipe:
    """Which data set; its first windows only where n_windows is given.

    Attributes:
        schema: Name of the feature schema.
        seed: Any non-negative integer.
        window: Number of samples N of a window, at most SAMPLES.
        n_windows: Windows of each channel of a recording, from its start, as far as 400 s go.
    """

    schema: str
    seed: int
    window: int = WINDOW
    n_windows: int = WINDOWS

    @property
    def name(self) -> str:
        """Tells data sets apart that a study makes."""
        return f"{self.schema}-{self.window}"

    @property
    def stride(self) -> int:
        """Samples from the beginning of a window to that of the next."""
        return max(self.window, WINDOW)

    @property
    def windows_per_channel(self) -> int:
        """Windows of each channel of a recording."""
        return min(self.n_windows, SAMPLES // self.stride)


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


def noisy_windows(recipe: Recipe, trajectory: int, variance: int) -> Array:
    """Windows (6 * windows_per_channel, window) of one recording: ideal readings and white noise.

    Args:
        recipe: Of the data set.
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


def build(recipe: Recipe, pool: Pool, store: Store | None = None) -> DataSet:
    """The data set, the same wherever and by however many it is made.

    Args:
        recipe: Which.
        pool: Computes the recordings.
        store: Keeps them.
    """
    recordings = {
        f"{name}-{j:02}": (i, j) for i, name in enumerate(BASELINE) for j in range(VARIANCES.size)
    }
    parts = pool.run(
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
    """Training and test examples as published: 80 : 20 at random over all n."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=_SPLIT_STREAM))
    order = rng.permutation(n)
    n_train = round(TRAIN_FRACTION * n)
    return np.sort(order[:n_train]), np.sort(order[n_train:])


def trajectory_split(data: DataSet, unseen: int) -> tuple[Indices, Indices]:
    """Training and test examples that share neither a trajectory nor a random stream."""
    test = data.trajectory == unseen
    return np.flatnonzero(~test), np.flatnonzero(test)
