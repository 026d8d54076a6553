"""The records that a kernel takes beside the state: constants of the filter, and scratch memory."""

from functools import cache
from typing import Any, TypeAlias

import numpy as np

from insdvl.navigation.state.fields import CORE

#: Constants of a filter, see `constants_type`.
Constants: TypeAlias = Any
#: Scratch memory of the kernels, see `workspace_type`.
Workspace: TypeAlias = Any


@cache
def constants_type(n: int) -> np.dtype[np.void]:
    """Type of the constants record, with room for n error states."""
    return np.dtype(
        [
            ("n", "i8"),  # error states in use
            ("invariant", "i8"),  # 1: error_state 'invariant', 0: 'ned'
            ("earth_rate", "i8"),
            # Process noise
            ("rate", "f8"),  # Hz
            ("density", "f8"),  # density per variance: 1 / rate, or 1 [s]
            ("eps_f", "f8"),  # density of the accelerometer bias walk
            ("eps_w", "f8"),
            ("Q_f_nominal", "f8", (3, 3)),
            ("Q_w_nominal", "f8", (3, 3)),
            ("q_timeout_ns", "i8"),
            # Innovation-adaptive process noise: innovations it takes (0: off), and whether its
            # estimate replaces the input noise
            ("window", "i8"),
            ("literal", "i8"),
            ("gap_ns", "i8"),
            ("gap_f", "f8"),  # unseen acceleration, one sigma
            ("gap_w", "f8"),
            ("C_b_i", "f8", (3, 3)),  # IMU to base_link
            ("range", "f8", (6,)),  # of the channels, inf where none is declared
            ("frozen", "i8"),  # so many equal samples, in a row
            # Optional states: stationary variance and 1 / time constant
            ("variance", "f8", (n - CORE,)),
            ("decay", "f8", (n - CORE,)),
            # Output
            ("l_b_imu", "f8", (3,)),  # position of the IMU in base_link, m
            ("nav", "f8", (3, 3)),  # NED to the stream's navigation axes
            ("body", "f8", (3, 3)),  # FRD to the stream's body axes
        ],
        align=True,
    )


@cache
def workspace_type(n: int) -> np.dtype[np.void]:
    """Type of the scratch record: what a step leaves for the Jacobians, and their results."""
    wide = -(-n // 8) * 8  # rows of whole cache lines
    return np.dtype(
        [
            # Of the last mechanisation step, at its middle
            ("C_mean", "f8", (3, 3)),  # mean of C_n_b over the step
            ("f_n", "f8", (3,)),  # specific force
            ("g_n", "f8", (3,)),
            ("v_n", "f8", (3,)),
            ("x_n", "f8", (3,)),  # position from the reference
            # Cosine of the latitude, and radii in the meridian and the prime vertical plus height
            ("cosine_lat", "f8"),
            ("R_N", "f8"),
            ("R_E", "f8"),
            ("w_ie_n", "f8", (3,)),
            ("w_en_n", "f8", (3,)),
            ("w_in_n", "f8", (3,)),
            ("W_v", "f8", (3, 3)),  # d w_en / d v_n
            # Readings without bias, and without the channels that are frozen
            ("f_hat", "f8", (3,)),
            ("w_hat", "f8", (3,)),
            # Angular rate of the sample before, without bias, and what the two make by coning
            ("w_before", "f8", (3,)),
            ("coning", "f8", (3,)),
            # Density of the motion that the channels of the IMU do not see, in its axes, what of
            # their turn is about the vertical and not told by a measurement, and which are frozen
            ("unseen", "f8", (6,)),
            ("unseen_heading", "f8", (6,)),
            ("frozen", "i8", (6,)),
            # Densities of the input noise over the step
            ("S_f", "f8", (3, 3)),
            ("S_w", "f8", (3, 3)),
            # Of the Earth's rotation with an uncertain heading: slope, and density north and east
            ("heading_slope", "f8"),
            ("heading_rest", "f8", (2,)),
            # Scratch of the mechanisation: turns over the step and their means, and vectors
            ("turn", "f8", (3, 3)),
            ("mean_turn", "f8", (3, 3)),
            ("frame", "f8", (3, 3)),
            ("frame_mean", "f8", (3, 3)),
            ("rotated", "f8", (3, 3)),
            ("coriolis", "f8", (3,)),  # 2 w_ie + w_en
            ("a_n", "f8", (3,)),
            ("d_n", "f8", (3,)),
            ("w_in_b", "f8", (3,)),
            ("g_b", "f8", (3,)),
            # Scratch of the error dynamics and the input noise: [v x], [x x], another, a block
            ("v_x", "f8", (3, 3)),
            ("x_x", "f8", (3, 3)),
            ("a_x", "f8", (3, 3)),
            ("block", "f8", (3, 3)),
            # Error dynamics and discretisation
            ("F", "f8", (n, wide)),
            ("Phi", "f8", (n, wide)),
            ("Phi_T", "f8", (n, wide)),
            ("Q_d", "f8", (n, wide)),
            ("A", "f8", (n, wide)),  # Phi B
            ("B", "f8", (n, wide)),  # P + Q_d / 2
        ],
        align=True,
    )
