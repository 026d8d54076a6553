"""What the samples of an IMU show: gravity, noise, rest, and readings that are none.

The noise is that of differences, which motion does not disturb. Behind a low-pass in the IMU they
show less than the noise that a filter integrates, and of vibration more; there the model `bands`
finds it.
"""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from insdvl.arrays import Array, Records, Stamps
from insdvl.kernels import kernel
from insdvl.navigation import channels
from insdvl.navigation.events import Imu
from insdvl.navigation.filter import Filter
from insdvl.navigation.geometry.earth import gravity
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.start.gyrocompass import Noise
from insdvl.navigation.start.rest import LEAST_SAMPLES, Misfit, misfit_to_rest, window_of
from insdvl.tuner.features.differences import (
    HIGHER,
    LOWER,
    difference_variances,
    is_low_passed,
)
from insdvl.tuner.models import load_model
from insdvl.tuner.windows import pool_of, pooled, rate_of

CHUNK = 2000  # samples that are looked at together: a window of `bands` at any rate
WINDOW = 100  # samples of one estimate of the noise
#: A channel that repeats its largest reading so often in a row stands at the end of its range,
#: where that is so far from its mean [m/s^2, rad/s]: no resolution explains it.
STANDS, AWAY = 3, (5.0, 0.5)
#: Differences that show so many times the noise at low frequencies show vibration: the model's
#: median is rarely half of the variance of white noise.
SHAKEN = 2.0
NAMES = ("f_x", "f_y", "f_z", "w_x", "w_y", "w_z")


@dataclass(frozen=True)
class ImuFacts:
    """What the samples show; triads are in the axes of the stream, force before rate.

    Attributes:
        count: Number of samples that could be read.
        refused: Number of messages that could not, by reason.
        mean: (6,) mean [m/s^2, rad/s].
        largest: (6,) largest size of a reading.
        variance: (6,) of the noise of a sample; zeros with too few samples.
        low_passed: Whether the noise falls towards half the rate, by a low-pass or by vibration;
            `variance` is then that at low frequencies.
        shaken: Channels whose noise vibration hides from the differences; their `variance` is that
            at low frequencies.
        stands: Channels at the end of their range, with that reading.
        saturated: Number of samples at the declared range.
        frozen: Number of samples with a frozen channel.
        glitches: Number of samples with a reading that leaves its neighbours.
        no_data: Number of samples whose specific force is exactly zero.
        start: How far the first samples are from those of a vehicle at rest; None with too few.
    """

    count: int
    refused: Counter[str]
    mean: Array
    largest: Array
    variance: Array
    low_passed: bool
    shaken: tuple[str, ...]
    stands: dict[str, float]
    saturated: int
    frozen: int
    glitches: int
    no_data: int
    start: Misfit | None


@kernel
def _watch(state: Records, constants: Records, stamps_ns: Stamps, readings: Array) -> None:
    s, c = state[0], constants[0]
    for k in range(len(stamps_ns)):
        channels.watch(s, c, stamps_ns[k], readings[k])
        s.channels.imu_ns = stamps_ns[k]


class ImuLog:
    """Looks at the samples in chunks; memory is bounded but for one estimate of the noise each.

    Args:
        parameters: Of the filter, whose rules for the channels are applied.
    """

    def __init__(self, parameters: FilterParameters) -> None:
        filter_ = Filter(parameters)
        self._parameters = parameters
        self._axes = np.tile(np.diag(filter_.vehicle.axes.body), 2)
        self._constants, self._state = filter_.constants, filter_.empty()
        self._stamps: list[int] = []
        self._readings: list[Array] = []
        self._newest_ns = -1
        self._sum, self._count, self._used = np.zeros(6), 0, 0
        self._low, self._high = np.full(6, np.inf), np.full(6, -np.inf)
        self._runs: list[dict[float, int]] = [{} for _ in range(6)]
        self._variances: list[Array] = []
        self._higher: list[Array] = []
        self._chunks: list[Array] = []
        self._bands = load_model("bands")
        self._first: list[Array] = []
        self.refused: Counter[str] = Counter()

    def add(self, sample: Imu) -> None:
        """Take a sample, in the order of arrival; one that is late is only counted."""
        self._count += 1
        if sample.stamp_ns <= self._newest_ns:
            return
        self._newest_ns = sample.stamp_ns
        self._stamps.append(sample.stamp_ns)
        self._readings.append(np.concatenate([sample.f_b, sample.w_ib_b]))
        if len(self._stamps) == CHUNK:
            self._look()

    def _look(self) -> None:
        """Look at the chunk."""
        if not self._stamps:
            return
        stamps, readings = np.array(self._stamps, np.int64), np.array(self._readings)
        self._stamps, self._readings = [], []
        _watch(self._state, self._constants, stamps, readings)
        if not self._first:
            self._first = list(readings)
        self._sum += readings.sum(axis=0)
        self._used += len(readings)
        windows = readings[: len(readings) // WINDOW * WINDOW].reshape(-1, WINDOW, 6)
        for window in windows:
            self._variances.append(difference_variances(window.T, LOWER))
            self._higher.append(difference_variances(window.T, HIGHER))
        if len(readings) >= self._bands.window:
            k = pool_of(rate_of(int(stamps[0]), int(stamps[-1]), len(stamps)))
            if len(readings) >= k * self._bands.window:
                self._chunks.append(pooled(self._bands.variances, k)(readings.T))
        for i in range(6):
            self._remember_extremes(i, readings[:, i])

    def _remember_extremes(self, i: int, values: Array) -> None:
        """Longest run of each of the two extreme readings of a channel."""
        runs = self._runs[i]
        for value in (float(values.min()), float(values.max())):
            at = np.flatnonzero(np.diff(np.concatenate([[0], values == value, [0]])))
            run = int((at[1::2] - at[::2]).max())
            runs[value] = max(run, runs.get(value, 0))
        self._low[i] = min(self._low[i], values.min())
        self._high[i] = max(self._high[i], values.max())
        self._runs[i] = {v: n for v, n in runs.items() if v in (self._low[i], self._high[i])}

    def variance(self) -> Array:
        """Variance (6,) of the noise of a sample, see `ImuFacts`."""
        self._look()
        return self._noise()[0]

    def facts(self, gyroscope_bias_std: float) -> ImuFacts:
        """What all samples have shown.

        Args:
            gyroscope_bias_std: One sigma by which a rest is judged [rad/s].
        """
        self._look()
        counters = self._state[0]["counters"]
        variance, low_passed, shaken = self._noise()
        mean = self._sum / max(self._used, 1)
        stands = {
            NAMES[i]: self._axes[i] * value
            for i in range(6)
            for value, run in self._runs[i].items()
            if run >= STANDS and abs(value - mean[i]) > AWAY[i // 3]
        }
        return ImuFacts(
            count=self._count,
            refused=self.refused,
            mean=self._axes * mean,
            largest=np.maximum(np.abs(self._low), np.abs(self._high)) if self._first else mean,
            variance=variance,
            low_passed=low_passed,
            shaken=shaken,
            stands=stands,
            saturated=int(counters["saturated"]),
            frozen=int(counters["frozen"]),
            glitches=int(counters["glitches"]),
            no_data=int(counters["no_data"]),
            start=self._start(variance, gyroscope_bias_std),
        )

    def _noise(self) -> tuple[Array, bool, tuple[str, ...]]:
        """Variances (6,) of a sample's noise, whether it is low-passed, and what is shaken."""
        if not self._variances:
            return np.zeros(6), False, ()
        variance = np.median(self._variances, axis=0)
        if not self._chunks:
            return variance, False, ()
        at_low = np.median(self._chunks, axis=0)
        if is_low_passed(variance, np.median(self._higher, axis=0)):
            return at_low, True, ()
        shaken = variance > SHAKEN * at_low
        names = tuple(name for name, is_shaken in zip(NAMES, shaken, strict=True) if is_shaken)
        return np.where(shaken, at_low, variance), False, names

    def _start(self, variance: Array, gyroscope_bias_std: float) -> Misfit | None:
        """How far the first samples are from those of a vehicle at rest, as the filter judges."""
        p = self._parameters
        samples = np.array(self._first[: round(p.initial.levelling_time * p.imu.rate)])
        if len(samples) < 2 * LEAST_SAMPLES or not variance.all():
            return None
        noise = Noise(
            f=np.diag(variance[:3]),
            w=np.diag(variance[3:]),
            walk_f=p.process_noise.accelerometer_bias_walk,
            walk_w=p.process_noise.gyroscope_bias_walk,
            bias_f=p.initial.accelerometer_bias_std,
            bias_w=gyroscope_bias_std,
            rate=p.imu.rate,
        )
        return misfit_to_rest(window_of(samples), np.zeros(6), noise, gravity(p.origin.place[0], 0))
