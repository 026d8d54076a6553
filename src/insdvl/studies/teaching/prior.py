"""What simulated vehicles say of the weights, before a recording does.

Six kinds of simulated vehicles (training/vehicles.py) have six sets of weights, each by ridge
regression of log(q / s^2) with the true effective q. A real vehicle is taken for a seventh: its
weights are normal with the mean of the six and the covariance between them. Beside that every
weight has a spread of its own, and the constant a wide one, since six kinds are few. The table
below is printed by ``python -m insdvl.studies.teaching.prior``.
"""

import numpy as np

from insdvl.arrays import Array
from insdvl.jobs.options import Workers
from insdvl.jobs.pool import open_pool
from insdvl.studies.training.vehicles import KINDS, Recipe, Vehicles, build
from insdvl.tuner.features.band_groups import GROUP_FEATURE_NAMES
from insdvl.tuner.windows import CHANNELS

#: Ridge of features, per example.
RIDGE = 1e-3
#: One sigma of each weight beside what the kinds differ by, and of the constant.
OWN_WEIGHT, OWN_CONSTANT = 0.15, 2.0
#: Vehicles of each kind, their seed, and the length of their missions [s].
VEHICLES, SEED, DURATION = 20, 0, 320.0

#: Constants and weights of `GROUP_FEATURE_NAMES` of the six kinds: accelerometers, gyroscopes.
WEIGHTS = np.array(
    [
        [
            [0.064, 0.011, -0.037, 0.053, 0.079, 0.880, 0.954, -0.043],
            [0.037, 0.008, -0.034, 0.132, 0.125, 0.837, 1.001, -0.037],
            [0.183, -0.014, -0.022, 0.613, 0.337, -0.045, 1.444, -0.079],
            [1.853, 0.193, 0.077, 0.541, 0.182, -0.172, 0.259, -0.560],
            [0.101, -0.002, -0.006, 0.002, 0.044, 0.924, 0.990, -0.038],
            [0.911, 0.032, 0.073, -0.062, 0.077, 0.063, 0.391, -0.498],
        ],
        [
            [0.046, 0.000, -0.021, 0.102, 0.103, 0.847, 0.944, -0.037],
            [0.034, 0.010, -0.031, 0.130, 0.111, 0.845, 1.012, -0.040],
            [0.243, 0.001, -0.028, 0.591, 0.224, -0.045, 1.450, -0.082],
            [2.327, -0.001, 0.193, 0.578, 0.151, -0.222, 0.217, -0.686],
            [0.388, -0.010, -0.002, -0.010, -0.008, 0.325, 1.095, -0.046],
            [0.785, 0.060, 0.080, -0.115, -0.053, 0.080, 0.002, -0.797],
        ],
    ]
)


def prior() -> tuple[Array, Array]:
    """Mean (2, D) and covariance (2, D, D) of constant and weights of both groups of channels."""
    mean = WEIGHTS.mean(axis=1)
    own = np.diag([OWN_CONSTANT, *[OWN_WEIGHT] * len(GROUP_FEATURE_NAMES)]) ** 2
    return mean, np.array([np.cov(kinds.T) + own for kinds in WEIGHTS])


def weights_of(data: Vehicles) -> tuple[Array, Array]:
    """Constant and weights (2, kinds, D) by ridge regression of each kind of vehicles.

    The level is counted from the mean of each channel of each vehicle.

    Returns:
        The weights, and the RMS (2, kinds) of the error of log q.
    """
    channel = np.arange(data.q.size) % CHANNELS
    A, y = np.hstack([np.ones((len(data.X), 1)), data.X]), np.log(data.q / data.scale)
    own = (data.kind * (data.vehicle.max() + 1) + data.vehicle) * CHANNELS + channel
    total = np.bincount(own, weights=A[:, -1])
    A[:, -1] -= (total / np.maximum(np.bincount(own), 1))[own]
    penalty = RIDGE * np.diag([0.0] + [1.0] * len(GROUP_FEATURE_NAMES))
    found, rms = np.empty((2, len(KINDS), A.shape[1])), np.empty((2, len(KINDS)))
    for group in range(2):
        for kind in range(len(KINDS)):
            some = (channel // (CHANNELS // 2) == group) & (data.kind == kind)
            normal = A[some].T @ A[some] / some.sum() + penalty
            found[group, kind] = np.linalg.solve(normal, A[some].T @ y[some] / some.sum())
            rms[group, kind] = np.sqrt(np.mean((A[some] @ found[group, kind] - y[some]) ** 2))
    return found, rms


def main() -> None:
    """Print the table of this file, and how well it fits."""
    with open_pool(Workers(jobs=1)) as pool:
        data = build(Recipe("taught", SEED, VEHICLES, DURATION), pool)
    found, rms = weights_of(data)
    for kinds in found:
        print("        [")
        for row in kinds:
            print("            [" + ", ".join(f"{weight:.3f}" for weight in row) + "],")
        print("        ],")
    for kind, errors in zip(KINDS, rms.T, strict=True):
        print(f"{kind}: RMS of log q {errors[0]:.2f} and {errors[1]:.2f}")


if __name__ == "__main__":
    main()
