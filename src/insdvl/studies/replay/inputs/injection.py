"""White noise that is added to the IMU of a recording, with variances that are known."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np

from insdvl.arrays import Array, Stamps
from insdvl.messages.convert import RejectedMessage, sensor_stamp_ns
from insdvl.messages.topics import IMU, PROCESS_NOISE, TRUE_PROCESS_NOISE
from insdvl.navigation.events import NS
from insdvl.recordings.base import Raw, decode, encode
from insdvl.recordings.messages import imu_message
from insdvl.recordings.played import Recording
from insdvl.simulation.noise import segments
from insdvl.simulation.sensors.imu import white_noise


@dataclass(frozen=True)
class Injection:
    """White noise for the IMU of a recording.

    Each channel keeps a log-uniform variance for 15 to 45 s, as in the scenario ``varying``.

    Attributes:
        accelerometer: Smallest and largest variance [(m/s^2)^2].
        gyroscope: Smallest and largest variance [(rad/s)^2].
        seed: Random seed.
    """

    accelerometer: tuple[float, float]
    gyroscope: tuple[float, float]
    seed: int

    def variances(self, stamps_ns: Stamps, rng: np.random.Generator) -> Array:
        """Variance (N, 6) of each sample, f x, y, z then w x, y, z."""
        t = (stamps_ns - stamps_ns.min()) / NS
        columns = [
            segments(*limits)(float(t.max()) + 1.0, child).variance_at(t)[:, :3]
            for limits, child in zip(
                (self.accelerometer, self.gyroscope), rng.spawn(2), strict=True
            )
        ]
        return np.concatenate(columns, axis=1)

    def draw(self, stamps_ns: Stamps) -> tuple[Array, Array]:
        """Variance (N, 6) and noise (N, 6) of each sample, in the axes of the stream."""
        variance_rng, noise_rng = np.random.default_rng(self.seed).spawn(2)
        q = self.variances(stamps_ns, variance_rng)
        return q, white_noise(q, noise_rng)


class Injected(Recording):
    """A recording with a noisier IMU, and the added variances as the true process noise.

    Recorded process noise and the covariances in the IMU messages no longer hold: they are left
    out, as are samples without a usable stamp.

    Args:
        recording: The recording.
        injection: What is added.
    """

    def __init__(self, recording: Recording, injection: Injection) -> None:
        self._recording = recording
        stamps_ns = [_stamp(raw) for raw in recording.on([IMU])]
        self._stamps_ns = np.array([stamp for stamp in stamps_ns if stamp], dtype=np.int64)
        self._q, self._noise = injection.draw(self._stamps_ns)
        self._announced_at = dict(announcements(self._stamps_ns, self._q))

    @property
    def topics(self) -> frozenset[str]:
        """See `Recording`."""
        return (self._recording.topics - {PROCESS_NOISE}) | {TRUE_PROCESS_NOISE}

    def on(self, topics: Collection[str]) -> Iterator[Raw]:
        """See `Recording`."""
        if not {IMU, TRUE_PROCESS_NOISE}.intersection(topics):
            yield from self._recording.on(set(topics) - {PROCESS_NOISE})
            return
        k = 0
        for raw in self._recording.on({*topics, IMU} - {PROCESS_NOISE, TRUE_PROCESS_NOISE}):
            if raw.topic != IMU:
                yield raw
            elif _stamp(raw):
                yield from (noisy for noisy in self._noisy(raw, k) if noisy.topic in topics)
                k += 1

    def _noisy(self, raw: Raw, k: int) -> Iterator[Raw]:
        """Sample k with its noise, and before it the variances where they are announced."""
        sample, q = decode(raw).message, self._q[k]
        frame_id = sample.header.frame_id
        if k in self._announced_at:
            stamp_ns, zeros = self._announced_at[k], np.zeros(3)
            Q_f, Q_w = np.diag(q[:3]), np.diag(q[3:])
            message = imu_message(stamp_ns, frame_id, zeros, zeros, Q_f, Q_w)
            yield encode(TRUE_PROCESS_NOISE, raw.time_ns, message)
        f = np.array(sample.linear_acceleration) + self._noise[k, :3]
        w = np.array(sample.angular_velocity) + self._noise[k, 3:]
        message = imu_message(int(self._stamps_ns[k]), frame_id, f, w)
        yield encode(raw.topic, raw.time_ns, message)


def _stamp(raw: Raw) -> int:
    """The stamp of a sample [ns]; 0 for one that has none, or none that can be used."""
    try:
        return sensor_stamp_ns(decode(raw).message.header)
    except RejectedMessage:
        return 0


def announcements(stamps_ns: Stamps, q: Array) -> list[tuple[int, int]]:
    """When variances (N, 6) of samples are announced: index of the sample, and stamp.

    A variance holds from the beginning of its first sample's interval, which is the stamp before.
    It is announced there, and again every second.
    """
    changed = (q[1:] != q[:-1]).any(axis=1)
    found: list[tuple[int, int]] = []
    for k in range(len(stamps_ns)):
        begin_ns = int(stamps_ns[max(k - 1, 0)])
        if k == 0 or changed[k - 1] or begin_ns - found[-1][1] >= NS:
            found.append((k, begin_ns))
    return found
