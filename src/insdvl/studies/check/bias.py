"""What a recording shows of the gyroscope's bias without a filter.

At rest the mean rate is the bias and the Earth's rate. A steady cruise looks like a rest to an IMU:
the DVL has to read zero.

Under way the vehicle stays upright, so the part of its mean rate that is across gravity is at most
its change of attitude over the duration; the rest is the bias. It is taken across the specific
force of each second: a turn about the vertical then leaks in by the acceleration of the turn only,
whatever the mount of the IMU and the tilt of the vehicle are. About the vertical nothing tells a
bias from a turn; that axis is of the same triad.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, sqrt

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.events import NS, Imu
from insdvl.navigation.gate.chi_square import exceeded
from insdvl.navigation.geometry.earth import EARTH_RATE
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.start.gyrocompass import Noise
from insdvl.navigation.start.rest import (
    LEAST_SAMPLES,
    UNSEEN_RATE,
    Window,
    misfit_to_rest,
    window_of,
)
from insdvl.watch.alignment.gravity import GRAVITY

STEP_NS, STEPS = NS, 5  # a block has five steps of a second
#: Under way the bias is told from this on [s].
LEAST_SECONDS = 60.0
#: One sigma of the change of attitude over the time that is used [rad].
TURNED = 0.2
#: Least length of the mean of the unit vectors along gravity: the vehicle stays within some 25 deg.
UPRIGHT = 0.9
#: A DVL at rest reads at most so many times its noise.
ZERO = 2.0
#: What makes a bias usable that a vehicle shows under way.
REST = "a rest of 10 s at the start"
#: Probability that a bias of the told sigma is called larger.
FALSE_ALARM = 1e-3


@dataclass(frozen=True)
class GyroscopeBias:
    """The bias that a recording shows.

    Attributes:
        mean: (3,) the bias in forward-right-down axes of the IMU, without the part that no axis
            shows [rad/s].
        std: One sigma of a component [rad/s].
        axes: Number of axes that show it: 3 at rest, under way the 2 across gravity.
        seconds: Length of the rest, or of the motion.
        is_usable: Whether a filter can start with such a sigma. Under way a speed along one axis
            does not hold the tilt about that axis.
    """

    mean: Array
    std: float
    axes: int
    seconds: float
    is_usable: bool

    @property
    def size(self) -> float:
        """Its length [rad/s]: no axis that shows it has more."""
        return float(np.linalg.norm(self.mean))

    @property
    def rounded(self) -> float:
        """The length as a parameter has it."""
        return float(f"{self.size:.2g}")

    @property
    def source(self) -> str:
        """What shows it, as part of a sentence."""
        if self.axes == 3:
            return f"the mean rate of {self.seconds:.0f} s at rest"
        return f"the mean rate across gravity of {self.seconds:.0f} s under way"

    def exceeds(self, told: float) -> bool:
        """Whether it contradicts a bias of this sigma [rad/s]."""
        variance = told**2 + self.std**2
        return self.size**2 > exceeded(self.axes, FALSE_ALARM) * variance


@dataclass(frozen=True)
class _Block:
    """Some seconds without a gap.

    Attributes:
        seconds: Length.
        window: Of its samples.
        up: (3,) mean of the unit vectors along the specific force, one of each step.
        across: (3,) mean rate across them [rad/s].
        turn: Mean square of the rate along them [(rad/s)^2].
        square: Mean square of a measured component of the velocity; nan without pings [(m/s)^2].
        speed: Root mean square of the measured speed; nan without pings [m/s].
    """

    seconds: float
    window: Window
    up: Array
    across: Array
    turn: float
    square: float
    speed: float


class BiasLog:
    """Collects means over some seconds; memory is a kilobyte for each.

    Args:
        max_gap: Longest time between two samples that follow each other [s].
    """

    def __init__(self, max_gap: float) -> None:
        self._max_gap_ns = round(max_gap * NS)
        self._blocks: list[_Block] = []
        self._count = self._partial = 0  # pings, and those that lack a component
        self._clear(-1)

    def _clear(self, begin_ns: int) -> None:
        self._begin_ns = self._newest_ns = begin_ns
        self._steps: list[Array] = []  # complete ones, (N, 6) each
        self._step: list[Array] = []
        self._pings: list[Array] = []  # what was measured of each
        self._may_have_no_lock = False

    def add(self, sample: Imu) -> None:
        """Take a sample; one that is late is left out."""
        if sample.stamp_ns <= self._newest_ns:
            return
        if self._newest_ns < 0 or sample.stamp_ns - self._newest_ns > self._max_gap_ns:
            self._clear(sample.stamp_ns)
        self._newest_ns = sample.stamp_ns
        self._step.append(np.concatenate([sample.f_b, sample.w_ib_b]))
        if sample.stamp_ns - self._begin_ns < STEP_NS * (len(self._steps) + 1):
            return
        self._steps.append(np.array(self._step))
        self._step = []
        if len(self._steps) == STEPS:
            self._close()
            self._clear(sample.stamp_ns)

    def add_ping(self, ping: Dvl) -> None:
        """Take a measurement; it belongs to the samples that arrive with it."""
        measured = ping.v_d[np.array(ping.measured)]
        self._pings.append(measured)
        self._count += 1
        self._partial += len(measured) < 3
        # A log along one axis has no lock to lose.
        self._may_have_no_lock |= len(measured) == 3 and not measured.any()

    def _close(self) -> None:
        """Keep the block."""
        means = np.array([step.mean(axis=0) for step in self._steps])
        f, w = means[:, :3], means[:, 3:]
        sizes = np.linalg.norm(f, axis=1, keepdims=True)
        if not sizes.all():
            return
        up = f / sizes
        along = (w * up).sum(axis=1, keepdims=True)
        squares = np.concatenate(self._pings or [np.empty(0)]) ** 2
        has_pings = squares.size > 0
        self._blocks.append(
            _Block(
                seconds=(self._newest_ns - self._begin_ns) / NS,
                window=window_of(np.concatenate(self._steps)),
                up=up.mean(axis=0),
                across=(w - along * up).mean(axis=0),
                turn=float((along**2).mean()),
                square=float(squares.mean())
                if has_pings and not self._may_have_no_lock
                else np.nan,
                speed=sqrt(squares.sum() / len(self._pings)) if has_pings else np.nan,
            )
        )

    def found(self, variance: Array, ping_std: float) -> GyroscopeBias | None:
        """What all samples have shown, by a rest where there is one; None where they are too few.

        Args:
            variance: (6,) of the noise of a sample.
            ping_std: Noise of a component of the DVL, one sigma [m/s].
        """
        if not variance.all():
            return None
        return self._at_rest(variance, ping_std) or self._under_way()

    def _at_rest(self, variance: Array, ping_std: float) -> GyroscopeBias | None:
        rests = [b for b in self._blocks if b.square <= (ZERO * ping_std) ** 2]
        rests = [b for b in rests if _is_steady(b.window, variance)]
        if not rests:
            return None
        w = np.median([b.window.mean[3:] for b in rests], axis=0)
        count = sum(b.window.count for b in rests)
        of_mean = float(variance[3:].max()) / count
        std = sqrt(UNSEEN_RATE**2 + EARTH_RATE**2 + of_mean)
        return GyroscopeBias(w, std, 3, sum(b.seconds for b in rests), is_usable=True)

    def _under_way(self) -> GyroscopeBias | None:
        """By the half of the blocks that turn least."""
        speeds = [b.speed for b in self._blocks if b.speed == b.speed]
        if not speeds:
            return None
        fastest = max(speeds)
        # In a turn the specific force is off the vertical by the speed times the rate over g.
        leaks = np.array(
            [b.turn * (b.speed if b.speed == b.speed else fastest) / GRAVITY for b in self._blocks]
        )
        order = np.argsort(leaks, kind="stable")[: (len(leaks) + 1) // 2]
        used = [self._blocks[k] for k in order]
        seconds = sum(b.seconds for b in used)
        if seconds < LEAST_SECONDS or _length_of_mean([b.up for b in self._blocks]) < UPRIGHT:
            return None
        across = np.array([b.across for b in used])
        scatter = float(np.sqrt(across.var(axis=0, ddof=1).sum() / 2.0 / len(used)))
        std = hypot(TURNED / seconds, scatter) + float(leaks[order].mean())
        is_usable = 2 * self._partial < self._count
        return GyroscopeBias(across.mean(axis=0), std, 2, seconds, is_usable)


def _is_steady(window: Window, variance: Array) -> bool:
    """Whether nothing shows a motion of the vehicle, whatever the biases are."""
    if min(window.counts) < LEAST_SAMPLES:
        return False
    noise = Noise(
        f=np.diag(variance[:3]),
        w=np.diag(variance[3:]),
        walk_f=0.0,
        walk_w=0.0,
        bias_f=GRAVITY,
        bias_w=0.0,
        rate=1.0,
    )
    mean = np.concatenate([np.zeros(3), window.mean[3:]])
    return misfit_to_rest(window, mean, noise, GRAVITY).motion <= 1.0


def _length_of_mean(directions: Sequence[Array]) -> float:
    return float(np.linalg.norm(np.mean(directions, axis=0)))
