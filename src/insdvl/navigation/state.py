"""The filter's whole memory as one nested record, so that a snapshot is a copy of it.

A record is a numpy structured scalar. Its fields are named in Python (``s["nav"]["v_n"]``) and in
the kernels (``s.nav.v_n``) alike, and it passes between the two without conversion. Everything that
the future depends on is in it.

Every field is declared once, with what it may hold: the empty record, the counters of diagnostics
and the check of a state file follow from the declaration. The record has room for every
measurement's gate and for every block of optional error states, whatever is configured, so no
compiled type depends on the configuration.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, TypeAlias

import numpy as np

from insdvl.arrays import Records, copied

# A record's fields are attributes in kernels and keys in Python, which no static type expresses.
#: A state record, see `state_type`.
State: TypeAlias = Any
#: Constants of a filter, see `constants_type`.
Constants: TypeAlias = Any
#: Scratch memory of the kernels, see `workspace_type`.
Workspace: TypeAlias = Any

#: Stamp of something that has not happened.
NEVER = -(2**62)
#: A stamp after all others.
FOREVER = 2**62

#: Error states that every filter has, see error_state.py.
CORE = 15
#: Their number rounded up to whole registers of four; no matrix of error states has shorter rows.
PADDED = 16
#: Most rows of one measurement.
MAX_ROWS = 4
#: Most innovations that the adaptive process noise averages.
MAX_WINDOW = 50
#: Readings of each kind of measurement that are remembered, to tell a repeated one.
READINGS = 8

# What a field holds, for the empty record and for the check of a stored one.
STAMP = "stamp"  # nanoseconds, NEVER at first
COUNT = "count"  # an integer, 0 at first
NUMBER = "number"  # finite, 0 at first
UNKNOWN = "unknown"  # finite once it is known, nan at first
COVARIANCE = "covariance"  # symmetric, positive semidefinite, 0 at first


@dataclass(frozen=True)
class Field:
    """One field of the record: its name, what it holds, its shape and the meaning."""

    name: str
    holds: str
    shape: tuple[int, ...] = ()

    @property
    def dtype(self) -> tuple[str, str, tuple[int, ...]]:
        """As numpy wants it."""
        return self.name, "i8" if self.holds in (STAMP, COUNT) else "f8", self.shape


def _nav(n: int) -> tuple[Field, ...]:
    """The state at a time, at the IMU, in the axes of base_link and NED."""
    return (
        Field("time_ns", STAMP),  # of the state
        Field("start_ns", STAMP),  # of the initial state
        Field("initialised", COUNT),
        # Origin of odom on the Earth: lat, lon [rad], h [m]
        *(Field(name, UNKNOWN) for name in ("lat_0", "lon_0", "h_0")),
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


def _noise(n: int) -> tuple[Field, ...]:
    """Process noise in effect: variances per sample in base_link axes."""
    return (
        Field("Q_f", COVARIANCE, (3, 3)),  # (m/s^2)^2
        Field("Q_w", COVARIANCE, (3, 3)),  # (rad/s)^2
        Field("q_ns", STAMP),  # of a received Q, NEVER while the nominal is in effect
        # Innovation-adaptive: density Q_x = root root^T in the model's coordinates, and innovations
        Field("root", NUMBER, (n, 3)),
        Field("innovations", NUMBER, (MAX_WINDOW, 3)),
        Field("innovation_count", COUNT),
        # Covariance of the errors by noise that is not told, of all but the position, and its stamp
        Field("excess", COVARIANCE, (12, 12)),
        Field("excess_ns", STAMP),
    )


#: What the gate remembers of one kind of measurement. Vectors have the rows that it has in use.
_GATE = (
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
    # The error that the sensor may have, one sigma in each row, since when and for how long [ns]
    Field("doubt", NUMBER),
    Field("doubt_from_ns", STAMP),
    Field("doubt_for", COUNT),
    # How often the covariance was inflated, and the state restarted from it, after rejections
    Field("inflations", COUNT),
    Field("restarts", COUNT),
)

#: Those of them that count events, and go on when the filter starts again.
GATE_COUNTERS = ("inflations", "restarts")

#: Channels of the IMU, in its axes, f x, y, z then w x, y, z.
_CHANNELS = (
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

_START = (
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
_ODOM = (
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

_COUNTERS = (
    Field("gaps", COUNT),
    Field("saturated", COUNT),  # samples
    Field("frozen", COUNT),  # samples
    Field("glitches", COUNT),  # samples
    Field("no_data", COUNT),  # samples
    *(Field(name, COUNT) for name in ("q_timeouts", "floors", "ceilings")),
    Field("without_origin", COUNT),
    Field("too_old", COUNT),  # initial states from long before the first sample
    Field("not_level", COUNT),  # levellings that were restarted
    Field("wrong_headings", COUNT),  # found, and contradicted by the gyroscope
    Field("off_the_map", COUNT),  # initial states at no place that the filter could navigate at
    Field("beyond_latitude", COUNT),  # steps that ended at the largest latitude
    Field("diverged", COUNT),  # states that were given up, see kept.py
    Field("odom_resets", COUNT),  # further starts, and steps of odom
)


@dataclass(frozen=True)
class Layout:
    """Which groups and fields a state record has.

    Attributes:
        groups: Fields of each group, by its name.
        gates: Fields of the gate, the same for each measurement in ``measurements``.
        measurements: Names of all kinds of measurements.
        size: Most error states n that can be in use.
    """

    groups: dict[str, tuple[Field, ...]]
    gates: tuple[Field, ...]
    measurements: tuple[str, ...]
    size: int

    def fields(self) -> Iterator[tuple[tuple[str, ...], Field]]:
        """Path (group, or ``gate`` and measurement) and declaration of each field."""
        for group, fields in self.groups.items():
            for field in fields:
                yield (group,), field
        for name in self.measurements:
            for field in self.gates:
                yield ("gate", name), field

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """Type of the record.

        It is one object: a call of a kernel would compare another field by field.
        """
        groups = [(name, _type(fields)) for name, fields in self.groups.items()]
        gates = [(name, _type(self.gates)) for name in self.measurements]
        return np.dtype([*groups, ("gate", np.dtype(gates, align=True))], align=True)

    def empty(self) -> Records:
        """One record, in an array of length 1, of a filter to which nothing has happened."""
        return copied(self._empty)

    @cached_property
    def _empty(self) -> Records:
        states = np.zeros(1, self.dtype)
        for path, field in self.fields():
            group = part(states[0], path)
            if field.holds == STAMP:
                group[field.name] = NEVER
            elif field.holds == UNKNOWN:
                group[field.name] = np.nan
        return states


def _type(fields: Sequence[Field]) -> np.dtype[np.void]:
    return np.dtype([field.dtype for field in fields], align=True)


def part(s: State, path: Sequence[str]) -> State:
    """The group of a record at a path of names."""
    for name in path:
        s = s[name]
    return s


def counters(s: State) -> dict[str, tuple[State, str]]:
    """Group and field of each counter in a record, by its name in diagnostics.

    Those of a gate have the name of its measurement before them: ``dvl inflations``.
    """
    found = {field.name: (s["counters"], field.name) for field in _COUNTERS}
    for measurement in s["gate"].dtype.names:
        for name in GATE_COUNTERS:
            found[gate_counter(measurement, name)] = s["gate"][measurement], name
    return found


def gate_counter(measurement: str, name: str) -> str:
    """Name in diagnostics of a counter of a measurement's gate."""
    return f"{measurement} {name}"


def layout(
    measurements: Sequence[str], optional: int, groups: Mapping[str, tuple[Field, ...]]
) -> Layout:
    """Layout of the state record.

    Args:
        measurements: Names of all kinds of measurements.
        optional: Number of error states in all optional blocks together.
        groups: Further groups of fields, which stand beside their users.
    """
    n = max(CORE + optional, PADDED)
    every = {
        "nav": _nav(n),
        "noise": _noise(n),
        "channels": _CHANNELS,
        "start": _START,
        "odom": _ODOM,
        "counters": _COUNTERS,
        **groups,
    }
    return Layout(every, _GATE, tuple(measurements), n)


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
