"""Process noise from the innovations of the last measurements."""

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.process_noise.parameters import ProcessNoiseParameters
from insdvl.navigation.process_noise.received import ProcessNoiseSource
from insdvl.navigation.state.fields import State


class InnovationAdaptive(ProcessNoiseSource):
    """Estimates the process noise from the last xi innovations.

    Q_x = K (1/xi sum nu nu^T) K^T (Or and Klein, section II; Mohamed and Schwarz, 1999) is the
    covariance of the steps up to the next update, spread evenly over the interval. The state keeps
    a root of its density, Q_x / interval = root root^T, which has at most three columns.
    """

    adapts = True

    def __init__(self, parameters: ProcessNoiseParameters, C_b_i: Array) -> None:
        super().__init__(parameters, C_b_i)
        self.window = parameters.adaptive_window

    def after_correction(self, s: State, K: Array, innovation: Array, seconds: float) -> None:
        """Take the innovation into the window, and estimate once it is full."""
        noise = s["noise"]
        noise["innovations"][int(noise["innovation_count"]) % self.window] = innovation
        noise["innovation_count"] += 1
        if noise["innovation_count"] >= self.window and seconds > 0.0:
            nu = noise["innovations"][: self.window]
            variances, axes = np.linalg.eigh(nu.T @ nu / self.window)
            root = K @ (axes * np.sqrt(np.maximum(variances, 0.0) / seconds))
            noise["root"][: len(K)] = root
