"""The filter's whole memory as one flat record, so that a snapshot is a copy of it.

A record is a numpy structured scalar: its fields are named in Python and in the kernels alike, and
it passes between the two without conversion. Everything that the future depends on is in it.
"""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from insdvl.navigation.parameters import FilterParameters

# A record's fields are attributes in kernels and keys in Python, which no static type expresses.
#: A state record, see `state_type`.
State: TypeAlias = Any
#: Constants of a filter, see `constants_type`.
Constants: TypeAlias = Any
#: Scratch memory of the kernels, see `workspace_type`.
Workspace: TypeAlias = Any

#: Stamp of something that has not happened.
NEVER = -(2**62)


def state_size(parameters: FilterParameters) -> int:
    """Number of error states n: 15, and 3 more with a model of the DVL's error."""
    return 15 if parameters.dvl.bias_model == "none" else 18


def state_type(n: int, window: int) -> np.dtype[np.void]:
    """Type of the state record.

    Args:
        n: Number of error states, 15 or 18.
        window: Number of innovations that the adaptive process noise keeps, 0 for none.
    """
    adaptive = n if window else 0
    return np.dtype(
        [
            # Time
            ("time_ns", "i8"),  # stamp of the state
            ("imu_ns", "i8"),  # stamp of the last IMU sample that is complete
            ("gap_ns", "i8"),  # and of the last one that ended a gap
            # Origin of odom on the Earth, nan until it is known: lat, lon [rad], h [m]
            ("lat_0", "f8"),
            ("lon_0", "f8"),
            ("h_0", "f8"),
            # Nominal state, at the IMU, in the axes of base_link and NED
            ("initialised", "i8"),
            ("C_n_b", "f8", (3, 3)),
            ("v_n", "f8", (3,)),  # m/s
            ("p_n", "f8", (3,)),  # m from the origin
            ("b_f", "f8", (3,)),  # accelerometer bias, m/s^2
            ("b_w", "f8", (3,)),  # gyroscope bias, rad/s
            ("b_d", "f8", (3,)),  # DVL error in DVL axes, m/s
            ("w_nb_b", "f8", (3,)),  # turn rate over the last step, rad/s
            # Covariance of the error state, in the order of error_state.py
            ("P", "f8", (n, n)),
            # Process noise in effect: variances per sample in base_link axes
            ("Q_f", "f8", (3, 3)),  # (m/s^2)^2
            ("Q_w", "f8", (3, 3)),  # (rad/s)^2
            ("q_ns", "i8"),  # stamp of a Q that was told, NEVER while the nominal is in effect
            # Adaptive process noise: density in the model's coordinates, and past innovations
            ("Q_x", "f8", (adaptive, adaptive)),
            ("innovations", "f8", (window, 3)),
            ("innovation_count", "i8"),
            # DVL: stamps of the last measurement that the gate judged and of the last it accepted,
            # and the last reading, nan before the first
            ("dvl_ns", "i8"),
            ("accepted_ns", "i8"),
            ("v_d", "f8", (3,)),
            ("left", "f8", (3,)),  # innovation that the last accepted one left
            ("nis", "f8"),  # running mean over those accepted
            # Gate: for how long the DVL has borne the filter out [ns], rejections in a row, for how
            # long they may go on [ns], stamp, innovation and NIS of the first, stamp and innovation
            # of the last, and stamp of the last whose innovation had wandered
            ("trusted_for", "i8"),
            ("rejections", "i8"),
            ("patient_for", "i8"),
            ("rejected_from_ns", "i8"),
            ("first", "f8", (3,)),
            ("first_nis", "f8"),
            ("rejected_ns", "i8"),
            ("rejected", "f8", (3,)),
            ("wandered_ns", "i8"),
            # Innovation and stamp of the last of them that was surely an error of the DVL
            ("fault", "f8", (3,)),
            ("fault_ns", "i8"),
            # The error that the DVL may have, one sigma, and until when
            ("doubt", "f8", (3,)),
            ("doubt_until_ns", "i8"),
            # Channels of the IMU, in its axes, f x, y, z then w x, y, z: the last reading, how many
            # samples have been exactly equal to it and the stamp of the first of them, and since
            # when the channel does not show the motion (NEVER while it does)
            ("reading", "f8", (6,)),
            ("equal", "i8", (6,)),
            ("equal_ns", "i8", (6,)),
            ("unseen_ns", "i8", (6,)),
            # Levelling: sum of the specific force, number of samples, stamp of the first
            ("level_f", "f8", (3,)),
            ("level_count", "i8"),
            ("level_ns", "i8"),
            # Counters for diagnostics
            ("gaps", "i8"),
            ("saturated", "i8"),  # samples
            ("frozen", "i8"),  # samples
            ("q_timeouts", "i8"),
            ("floors", "i8"),
            ("ceilings", "i8"),
            ("inflations", "i8"),
            ("restarts", "i8"),
            ("without_origin", "i8"),
            ("too_old", "i8"),  # initial states from long before the first sample
            ("not_level", "i8"),  # levellings that began anew
        ],
        align=True,
    )


#: Counters in the state record, by their names in diagnostics.
COUNTERS = (
    "gaps",
    "saturated",
    "frozen",
    "q_timeouts",
    "floors",
    "ceilings",
    "inflations",
    "restarts",
    "without_origin",
    "too_old",
    "not_level",
)


def empty_state(n: int, window: int) -> NDArray[np.void]:
    """One state record, in an array of length 1, of a filter to which nothing has happened."""
    states = np.zeros(1, state_type(n, window))
    stamps = (
        *("time_ns", "imu_ns", "gap_ns", "q_ns", "level_ns"),
        *("dvl_ns", "accepted_ns", "rejected_from_ns", "rejected_ns", "fault_ns"),
        *("wandered_ns", "doubt_until_ns"),
        *("equal_ns", "unseen_ns"),
    )
    for name in stamps:
        states[name] = NEVER
    for name in ("lat_0", "lon_0", "h_0", "v_d"):
        states[name] = np.nan
    return states


def constants_type(n: int) -> np.dtype[np.void]:
    """Type of the constants record of a filter with n error states."""
    return np.dtype(
        [
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
            ("literal", "i8"),  # 1: the adaptive estimate replaces the input noise
            ("gap_ns", "i8"),
            ("gap_f", "f8"),  # unseen acceleration, one sigma
            ("gap_w", "f8"),
            ("C_b_i", "f8", (3, 3)),  # IMU to base_link
            ("range", "f8", (6,)),  # of the channels, inf where none is declared
            ("frozen", "i8"),  # so many equal samples, in a row
            # DVL
            ("C_d_b", "f8", (3, 3)),  # base_link to DVL
            ("l_b", "f8", (3,)),  # from the IMU to the DVL, base_link axes, m
            ("bias_variance", "f8"),  # of the Gauss-Markov error, stationary
            ("bias_rate", "f8"),  # 1 / time constant
            # Output
            ("l_b_imu", "f8", (3,)),  # position of the IMU in base_link, m
            ("nav", "f8", (3, 3)),  # NED to the stream's navigation axes
            ("body", "f8", (3, 3)),  # FRD to the stream's body axes
        ],
        align=True,
    )


def workspace_type(n: int) -> np.dtype[np.void]:
    """Type of the scratch record: what a step leaves for the Jacobians, and their results."""
    return np.dtype(
        [
            # Of the last mechanisation step, at its middle
            ("C_mean", "f8", (3, 3)),  # mean of C_n_b over the step
            ("f_n", "f8", (3,)),  # specific force
            ("g_n", "f8", (3,)),
            ("v_n", "f8", (3,)),
            ("w_ie_n", "f8", (3,)),
            ("w_en_n", "f8", (3,)),
            ("w_in_n", "f8", (3,)),
            ("W_v", "f8", (3, 3)),  # d w_en / d v_n
            # Density of the motion that the channels of the IMU do not see, in its axes, what of
            # their turn is about the vertical and not told by the DVL, and which are frozen
            ("unseen", "f8", (6,)),
            ("unseen_heading", "f8", (6,)),
            ("frozen", "i8", (6,)),
            # Error dynamics and discretisation
            ("F", "f8", (n, n)),
            ("Phi", "f8", (n, n)),
            ("Phi_T", "f8", (n, n)),
            ("Q_d", "f8", (n, n)),
            ("A", "f8", (n, n)),  # scratch, as B
            ("B", "f8", (n, n)),
            # Measurement
            ("H", "f8", (3, n)),
            ("R", "f8", (3, 3)),
            ("S", "f8", (3, 3)),
            ("S_inv", "f8", (3, 3)),
            ("K", "f8", (n, 3)),
            ("innovation", "f8", (3,)),
            # Scratch
            ("N1", "f8", (3, 3)),
            ("N2", "f8", (3, 3)),
            ("M1", "f8", (3, 3)),
            ("M2", "f8", (3, 3)),
            ("M3", "f8", (3, 3)),
            ("M4", "f8", (3, 3)),
            ("x1", "f8", (3,)),
            ("x2", "f8", (3,)),
            ("x3", "f8", (3,)),
            ("x4", "f8", (3,)),
        ],
        align=True,
    )
