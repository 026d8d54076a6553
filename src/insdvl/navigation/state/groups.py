"""The fields of the state record, group by group, each declared once with its meaning."""

from insdvl.navigation.state.fields import (
    CORE,
    COUNT,
    COVARIANCE,
    MAX_ROWS,
    MAX_WINDOW,
    NUMBER,
    READINGS,
    STAMP,
    UNKNOWN,
    Field,
)


def nav(n: int) -> tuple[Field, ...]:
    """The state at a time, at the IMU, in the axes of base_link and NED."""
    return (
        Field("time_ns", STAMP),  # of the state
        Field("start_ns", STAMP),  # of the initial state
        Field("initialised", COUNT),
        # Origin of odom on the Earth: latitude, longitude [rad], height [m]
        Field("lat_0", UNKNOWN),
        Field("lon_0", UNKNOWN),
        Field("h_0", UNKNOWN),
        Field("C_n_b", NUMBER, (3, 3)),
        Field("v_n", NUMBER, (3,)),  # m/s
        # Latitude, longitude [rad], height [m], and the same of the position error's reference
        Field("llh", NUMBER, (3,)),
        Field("llh_r", NUMBER, (3,)),
        Field("bend_n", NUMBER, (2,)),  # of the path by the gyroscope's bias, one sigma, m
        Field("b_f", NUMBER, (3,)),  # accelerometer bias, m/s^2
        Field("b_w", NUMBER, (3,)),  # gyroscope bias, rad/s
        Field("optional", NUMBER, (n - CORE,)),  # states of the blocks that are on, in their order
        Field("w_nb_b", NUMBER, (3,)),  # turn rate over the last step, rad/s
        # Covariance of the error state, in the order of error_state.py; zero beyond those in use
        Field("P", COVARIANCE, (n, n)),
    )


def noise(n: int) -> tuple[Field, ...]:
    """Process noise in effect: variances per sample in base_link axes."""
    return (
        Field("Q_f", COVARIANCE, (3, 3)),  # (m/s^2)^2
        Field("Q_w", COVARIANCE, (3, 3)),  # (rad/s)^2
        Field("q_ns", STAMP),  # of a received Q, NEVER while the nominal is in effect
        # Innovation-adaptive: density Q_x = root root^T in the model's coordinates, and innovations
        Field("root", NUMBER, (n, 3)),
        Field("innovations", NUMBER, (MAX_WINDOW, 3)),
        Field("innovation_count", COUNT),
        # Covariance of the errors by noise that is not told, the position in metres, and its stamp
        Field("excess", COVARIANCE, (CORE, CORE)),
        Field("excess_ns", STAMP),
    )


#: What the gate remembers of one kind of measurement. Vectors have the rows that it has in use.
GATE = (
    # Stamps of the last one that was judged and of the last that was accepted
    Field("judged_ns", STAMP),
    Field("accepted_ns", STAMP),
    # The last readings that no claim of their own has refused, the newest first, and how many
    # others in a row were equal to the newest
    Field("readings", UNKNOWN, (READINGS, MAX_ROWS)),
    Field("repeats", COUNT),
    Field("left", NUMBER, (MAX_ROWS,)),  # innovation that the last accepted one left
    Field("drifts", COUNT),  # whether that was far from fitting, without a step of the sensor
    # For how long the sensor has borne the filter out [ns]; since when all are rejected, the first
    # innovation, and for how long that may go on [ns]; when the filter gave in to the sensor
    Field("trusted_for", COUNT),
    Field("rejected_from_ns", STAMP),
    Field("first", NUMBER, (MAX_ROWS,)),
    Field("patient_for", COUNT),
    Field("steps", COUNT),  # whether the first of them was a step that the IMU has not seen
    Field("gave_in_ns", STAMP),
    Field("claim", NUMBER, (MAX_ROWS,)),  # innovation that it gave in to
    # Innovation and stamp of the last that was surely a fault of the sensor
    Field("fault", NUMBER, (MAX_ROWS,)),
    Field("fault_ns", STAMP),
    # The error that the sensor may have at first, one sigma in each row, since when, for how long,
    # and in what time it halves [ns]; 0 if it stays
    Field("doubt", NUMBER),
    Field("doubt_from_ns", STAMP),
    Field("doubt_for", COUNT),
    Field("doubt_half_life", COUNT),
    # How often the covariance was inflated, and the state restarted from it, after rejections
    Field("inflations", COUNT),
    Field("restarts", COUNT),
)

#: Those of them that count events, and go on when the filter starts again.
GATE_COUNTERS = ("inflations", "restarts")

#: Channels of the IMU, in its axes, f x, y, z then w x, y, z.
CHANNELS = (
    Field("imu_ns", STAMP),  # of the last sample that is complete
    Field("gap_ns", STAMP),  # and of the last one that ended a gap
    Field("told_ns", STAMP),  # of the last accepted measurement that tells velocity and tilt
    Field("reading", NUMBER, (6,)),  # the last one
    # How many samples have been exactly equal to it, and the stamp of the first of them
    Field("equal", COUNT, (6,)),
    Field("equal_ns", STAMP, (6,)),
    Field("unseen_ns", STAMP, (6,)),  # since when a channel does not show the motion
    # Mean square of the change between neighbours [reading^2], number of samples that have told it,
    # the last reading that was believed, stamp and verdicts of the last sample that was judged
    Field("change", NUMBER, (6,)),
    Field("changes", COUNT),
    Field("believed", NUMBER, (6,)),
    Field("verdict_ns", STAMP),
    Field("verdict", COUNT, (6,)),
    # What the filter adds to the last sample, and what a doubted one has left out [reading s]
    Field("amends", NUMBER, (6,)),
    Field("left_out", NUMBER, (6,)),
    # Largest step of a channel since velocity was told, stamps before the first and of the last
    Field("step", NUMBER, (6,)),
    Field("step_from_ns", STAMP, (6,)),
    Field("step_ns", STAMP, (6,)),
)

START = (
    # Levelling: sums of specific force and angular rate, number of samples, stamp of the first
    Field("level_f", NUMBER, (3,)),
    Field("level_w", NUMBER, (3,)),
    Field("level_count", COUNT),
    Field("level_ns", STAMP),
    # Sums of the earlier half of it, f then w, its number, and sums of products
    Field("level_half", NUMBER, (6,)),
    Field("level_half_count", COUNT),
    Field("level_products", NUMBER, (6, 6)),
    # Gyrocompassing, over many levellings: sum of both, number of samples, sums of their variances,
    # stamp of the first, number of comparisons of a block with those before, sum of squared misfits
    Field("rest_sum", NUMBER, (6,)),
    Field("rest_count", COUNT),
    Field("rest_noise", NUMBER, (2, 3, 3)),
    Field("rest_ns", STAMP),
    Field("rest_blocks", COUNT),
    Field("rest_nis", NUMBER),
    # What has become of it, and the number that led to it, see gyrocompass.py
    Field("compass", COUNT),
    Field("compass_number", NUMBER),
    # Whether the heading may be half a turn off, see wrong_heading.py
    Field("heading_watched", COUNT),
    # What the mode 'auto' has heard, see automatic.py: an attitude whose heading is known, one
    # sigma, its stamp and source; velocity of base_link in body axes; a position kept over a reset
    # and the speed then
    Field("told_C", NUMBER, (3, 3)),
    Field("told_std", NUMBER),
    Field("told_ns", STAMP),
    Field("told_by", COUNT),
    Field("velocity", NUMBER, (3,)),
    Field("velocity_P", COVARIANCE, (3, 3)),
    Field("velocity_ns", STAMP),
    Field("kept_p", NUMBER, (3,)),
    Field("kept_P", COVARIANCE, (3, 3)),
    Field("kept_ns", STAMP),
    Field("kept_speed", NUMBER),
    # And how it has begun: source and sigma of the heading, sigma of the tilt, whether the vehicle
    # was at rest, and whether its velocity was told
    Field("heading_from", COUNT),
    Field("heading_std", NUMBER),
    Field("tilt_std", NUMBER),
    Field("at_rest", COUNT),
    Field("velocity_told", COUNT),
)

#: Map and odom, see map_to_odom.py; north, east, down.
ODOM = (
    # Position of odom's origin in map [m], and yaw of its axes [rad]
    Field("p", NUMBER, (3,)),
    Field("yaw", NUMBER),
    # Covariance of what absolute inputs have corrected, of the position and of yaw in odom's axes,
    # without what a turn about the start makes of it; and that start in odom [m]
    Field("P", COVARIANCE, (4, 4)),
    Field("reference", NUMBER, (3,)),
    # By how much other measurements have turned odom since the start [rad], and had when a reset
    # was counted last
    Field("turned", NUMBER),
    Field("turned_at_reset", NUMBER),
)

COUNTERS = (
    Field("gaps", COUNT),
    Field("saturated", COUNT),  # samples
    Field("frozen", COUNT),  # samples
    Field("glitches", COUNT),  # samples
    Field("no_data", COUNT),  # samples
    Field("q_timeouts", COUNT),
    Field("floors", COUNT),
    Field("ceilings", COUNT),
    Field("without_origin", COUNT),
    Field("too_old", COUNT),  # initial states from long before the first sample
    Field("not_level", COUNT),  # levellings that were restarted
    Field("wrong_headings", COUNT),  # found, and contradicted by the gyroscope
    Field("off_the_map", COUNT),  # initial states at no place that the filter could navigate at
    Field("beyond_latitude", COUNT),  # steps that ended at the largest latitude
    Field("diverged", COUNT),  # states that were given up, see kept.py
    Field("odom_resets", COUNT),  # further starts, and steps of odom
)
