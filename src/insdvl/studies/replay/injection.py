"""White noise that is added to the IMU of a recording, with variances that are known."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from insdvl.arrays import Array, Stamps
from insdvl.messages.convert import RejectedMessage, sensor_stamp_ns, stamp_ns
from insdvl.messages.topics import IMU, PROCESS_NOISE, TRUE_PROCESS_NOISE
from insdvl.navigation.events import NS
from insdvl.recordings.base import Raw, decode, encode
from insdvl.recordings.messages import imu_message
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

    def applied(self, recording: Sequence[Raw]) -> list[Raw]:
        """The recording with a noisier IMU, and the added variances as the true process noise.

        Recorded process noise and the covariances in the IMU messages no longer hold: they are left
        out, as are samples without a usable stamp.
        """
        recording = [raw for raw in recording if _has_stamp(raw)]
        samples = [decode(raw).message for raw in recording if raw.topic == IMU]
        stamps_ns = np.array([stamp_ns(sample.header) for sample in samples])
        q, noise = self.draw(stamps_ns)
        announced_at = dict(announcements(stamps_ns, q))
        noisy: list[Raw] = []
        k = 0
        for raw in recording:
            if raw.topic in (PROCESS_NOISE, TRUE_PROCESS_NOISE):
                continue
            if raw.topic != IMU:
                noisy.append(raw)
                continue
            header = samples[k].header
            if k in announced_at:
                Q_f, Q_w = np.diag(q[k, :3]), np.diag(q[k, 3:])
                message = imu_message(
                    announced_at[k], header.frame_id, np.zeros(3), np.zeros(3), Q_f, Q_w
                )
                noisy.append(encode(TRUE_PROCESS_NOISE, raw.time_ns, message))
            f = np.array(samples[k].linear_acceleration) + noise[k, :3]
            w = np.array(samples[k].angular_velocity) + noise[k, 3:]
            message = imu_message(int(stamps_ns[k]), header.frame_id, f, w)
            noisy.append(encode(raw.topic, raw.time_ns, message))
            k += 1
        return noisy


def _has_stamp(raw: Raw) -> bool:
    """Whether noise can be drawn for a message: it is not a sample, or has a stamp."""
    if raw.topic != IMU:
        return True
    try:
        return sensor_stamp_ns(decode(raw).message.header) > 0
    except RejectedMessage:
        return False


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
