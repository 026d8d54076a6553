"""A process noise that is received, and the interface of all sources."""

import numpy as np

from insdvl.arrays import Array
from insdvl.kernels import kernel
from insdvl.navigation.events import ProcessNoise
from insdvl.navigation.geometry.rotation import product, product_transposed
from insdvl.navigation.kalman import Innovated
from insdvl.navigation.process_noise.nominal import nominal
from insdvl.navigation.process_noise.parameters import ProcessNoiseParameters
from insdvl.navigation.state.fields import NEVER, State


def bounded(Q: Array, floor: float, ceiling: float) -> tuple[Array, bool, bool]:
    """A covariance (3, 3) with every variance, in any direction, between a floor and a ceiling.

    Returns:
        The covariance, whether the floor acted, and whether the ceiling did.
    """
    result, Q = np.zeros((3, 3)), np.array(Q)
    is_diagonal, low, high = _bounded_diagonal(result, Q, floor, ceiling)
    if is_diagonal:
        return result, low, high
    variances, axes = np.linalg.eigh(Q)
    low, high = bool(variances[0] < floor), bool(variances[-1] > ceiling)
    if not (low or high):
        return Q, False, False
    return (axes * np.clip(variances, floor, ceiling)) @ axes.T, low, high


@kernel
def _bounded_diagonal(
    result: Array, Q: Array, floor: float, ceiling: float
) -> tuple[bool, bool, bool]:
    """`bounded` for independent channels; whether they are, into ``result`` (3, 3) of zeros."""
    low, high = False, False
    for i in range(3):
        for j in range(3):
            if i != j and Q[i, j] != 0.0:
                return False, False, False
        low, high = low or Q[i, i] < floor, high or Q[i, i] > ceiling
        result[i, i] = min(max(Q[i, i], floor), ceiling)
    return True, low, high


@kernel
def _rotated(C: Array, Q: Array) -> Array:
    """C Q C^T (3, 3), as symmetric as Q."""
    A, B = np.empty((3, 3)), np.empty((3, 3))
    product(A, C, Q)
    product_transposed(B, A, C)
    for i in range(3):
        for j in range(i):
            B[i, j] = B[j, i] = (B[i, j] + B[j, i]) / 2.0
    return B


class ProcessNoiseSource:
    """Keeps the process noise of a state record up to date: nominal, until another Q is received.

    Args:
        parameters: Of the process noise.
        C_b_i: (3, 3) rotation from IMU to base_link axes.
    """

    #: Number of innovations that the prediction kernel needs before it takes an adapted density.
    window = 0
    #: Whether it takes part in corrections, by `before_correction` or `after_correction`.
    adapts = False

    def __init__(self, parameters: ProcessNoiseParameters, C_b_i: Array) -> None:
        self._parameters = parameters
        self._C_b_i = C_b_i
        self.Q_f_nominal, self.Q_w_nominal = nominal(parameters, C_b_i)

    def start(self, s: State) -> None:
        """The nominal Q takes effect."""
        noise = s["noise"]
        noise["Q_f"], noise["Q_w"], noise["q_ns"] = self.Q_f_nominal, self.Q_w_nominal, NEVER
        self.restart(s)

    def restart(self, s: State) -> None:
        """Forget what was learned from innovations: the state is a new one."""
        s["noise"]["root"], s["noise"]["innovation_count"] = 0.0, 0

    def receive(self, s: State, event: ProcessNoise) -> None:
        """A Q in IMU axes takes effect; a part that is None (unknown) is nominal from now on."""
        p, C, Q_f, Q_w = self._parameters, self._C_b_i, event.Q_f, event.Q_w
        low_f = high_f = low_w = high_w = False
        if Q_f is None:
            Q_f = self.Q_f_nominal
        else:
            Q_f, low_f, high_f = bounded(Q_f, p.accelerometer_floor, p.accelerometer_ceiling)
            Q_f = _rotated(C, Q_f)
        if Q_w is None:
            Q_w = self.Q_w_nominal
        else:
            Q_w, low_w, high_w = bounded(Q_w, p.gyroscope_floor, p.gyroscope_ceiling)
            Q_w = _rotated(C, Q_w)
        noise, counters = s["noise"], s["counters"]
        noise["Q_f"], noise["Q_w"], noise["q_ns"] = Q_f, Q_w, event.stamp_ns
        counters["floors"] += int(low_f or low_w)
        counters["ceilings"] += int(high_f or high_w)

    def before_correction(self, s: State, now: Innovated, seconds: float) -> Innovated:
        """The measurement against its prediction, which a source may change; this one does not.

        Args:
            s: State at the measurement, which is accepted.
            now: The measurement against its prediction.
            seconds: Since the measurement before; nan at the first.
        """
        return now

    def after_correction(self, s: State, K: Array, innovation: Array, seconds: float) -> None:
        """Learn from an accepted measurement; this source does not.

        Args:
            s: State, corrected.
            K: (n, m) gain of the update.
            innovation: (m,) of the update.
            seconds: Since the measurement before; nan at the first.
        """
