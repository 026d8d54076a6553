"""What a fold took of a recording, so that it can be folded again with something changed."""

from array import array
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from insdvl.arrays import Array, Stamps
from insdvl.navigation.events import NS, Event, Imu, ProcessNoise
from insdvl.navigation.parameters import FilterParameters
from insdvl.timeline.output import FoldResult
from insdvl.timeline.recorded import fold_arrays

#: At most so much of a recording is folded again [s].
MOST = 1800.0


class Taken:
    """The events of one part of a recording, between two time jumps.

    The samples of the IMU are kept as numbers, 56 bytes each, of the first `MOST` seconds.

    Attributes:
        events: All events but the samples of the IMU.
    """

    def __init__(self) -> None:
        self._until_ns: int | None = None
        self._stamps = array("q")
        self._readings = array("d")
        self.events: list[Event] = []

    @classmethod
    def of(cls, stamps_ns: Stamps, readings: Array, events: Iterable[Event]) -> "Taken":
        """From samples, arrays (N,) and (N, 6) as in `samples`, and other events."""
        taken = cls()
        taken._stamps.frombytes(np.ascontiguousarray(stamps_ns, dtype=np.int64).tobytes())
        taken._readings.frombytes(np.ascontiguousarray(readings, dtype=np.float64).tobytes())
        taken.events = list(events)
        return taken

    def add(self, event: Event) -> None:
        """Keep an event that the fold took."""
        if isinstance(event, Imu):
            stamps_ns = np.array([event.stamp_ns])
            self.add_samples(stamps_ns, event.f_b[None], event.w_ib_b[None])
        else:
            self.events.append(event)

    def add_samples(self, stamps_ns: Stamps, f_b: Array, w_ib_b: Array) -> None:
        """Keep samples that the fold took, arrays (N,), (N, 3) and (N, 3)."""
        if self._until_ns is None:
            self._until_ns = int(stamps_ns[0]) + round(MOST * NS)
        early = stamps_ns <= self._until_ns
        if early.any():
            self._stamps.frombytes(stamps_ns[early].tobytes())
            self._readings.frombytes(np.hstack([f_b, w_ib_b])[early].tobytes())

    @property
    def samples(self) -> tuple[Stamps, Array]:
        """Stamps (N,) and readings (N, 6) of the IMU, f then w, in the order of the stamps."""
        stamps_ns = np.array(self._stamps, dtype=np.int64)
        readings = np.array(self._readings).reshape(-1, 6)
        order = np.argsort(stamps_ns, kind="stable")
        return stamps_ns[order], readings[order]

    def first(self, seconds: float) -> "Taken":
        """The events of the first seconds."""
        stamps_ns, readings = self.samples
        if not stamps_ns.size:
            return self
        until_ns = int(stamps_ns[0]) + round(seconds * NS)
        count = int(np.searchsorted(stamps_ns, until_ns, side="right"))
        events = [event for event in self.events if event.stamp_ns <= until_ns]
        return Taken.of(stamps_ns[:count], readings[:count], events)

    def averaged(
        self, parameters: FilterParameters, interval: float
    ) -> tuple["Taken", FilterParameters]:
        """The same with the samples averaged over intervals, and the parameters of such an IMU.

        A sample is a mean over its interval already, so little is lost where the vehicle does not
        turn by much in one. The noise keeps its density.

        Args:
            parameters: Of the filter.
            interval: Time over which samples are averaged [s].
        """
        stamps_ns, readings = self.samples
        block = (stamps_ns - stamps_ns[:1]) // round(interval * NS)
        firsts = np.flatnonzero(np.diff(block, prepend=-1))
        counts = np.diff(firsts, append=len(block))
        means = np.add.reduceat(readings, firsts) / counts[:, None]
        number = float(np.median(counts))
        divisor = number if parameters.process_noise.convention == "per_sample" else 1.0
        events = [
            _of_averages(event, divisor) if isinstance(event, ProcessNoise) else event
            for event in self.events
        ]
        part = Taken.of(stamps_ns[firsts + counts - 1], means, events)
        told = parameters.process_noise
        noise = replace(
            told,
            accelerometer_variance=_divided(told.accelerometer_variance, divisor),
            accelerometer_floor=told.accelerometer_floor / divisor,
            accelerometer_ceiling=told.accelerometer_ceiling / divisor,
            gyroscope_variance=_divided(told.gyroscope_variance, divisor),
            gyroscope_floor=told.gyroscope_floor / divisor,
            gyroscope_ceiling=told.gyroscope_ceiling / divisor,
        )
        imu = replace(
            parameters.imu,
            rate=parameters.imu.rate / number,
            max_gap=max(parameters.imu.max_gap, 3.0 * interval),
        )
        return part, replace(parameters, imu=imu, process_noise=noise)

    def folded(
        self, parameters: FilterParameters, events: Iterable[Event] | None = None
    ) -> FoldResult:
        """Fold the samples again, with other parameters, or with other events.

        What became of the measurements is the result; of the states hardly any is kept.

        Args:
            parameters: Of the filter.
            events: In place of those that were taken.
        """
        stamps_ns, readings = self.samples
        chosen = list(self.events if events is None else events)
        samples = stamps_ns, readings[:, :3], readings[:, 3:]
        return fold_arrays(parameters, *samples, chosen, every=max(len(stamps_ns), 1))


def _divided(values: tuple[float, ...], divisor: float) -> tuple[float, ...]:
    return tuple(value / divisor for value in values)


def _of_averages(event: ProcessNoise, divisor: float) -> ProcessNoise:
    """Process noise per sample as that of averages."""
    Q_f, Q_w = (None if Q is None else Q / divisor for Q in (event.Q_f, event.Q_w))
    return replace(event, Q_f=Q_f, Q_w=Q_w)
