"""The nominal process noise: constants from the parameters."""

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.process_noise.parameters import ProcessNoiseParameters


def nominal(parameters: ProcessNoiseParameters, C_b_i: Array) -> tuple[Array, Array]:
    """Nominal variances per sample (Q_f, Q_w), each (3, 3), rotated from IMU to base_link axes."""
    Q_f = C_b_i @ np.diag(parameters.accelerometer_variance) @ C_b_i.T
    Q_w = C_b_i @ np.diag(parameters.gyroscope_variance) @ C_b_i.T
    return symmetric(Q_f), symmetric(Q_w)


def symmetric(Q: Array) -> Array:
    """Without what rounding makes of a product; P is as symmetric as Q is."""
    return (Q + Q.T) / 2
