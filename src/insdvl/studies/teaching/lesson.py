"""What a recording teaches: its pings, the IMU between them, and the features of its windows.

The filter itself navigates the recording once, as it is configured. It finds the attitude, the
biases and the pings that can be believed; the rest is the likelihood's.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array, Stamps
from insdvl.navigation.coordinates import body_velocity_jacobian
from insdvl.navigation.error_state import ACCELEROMETER_BIAS, ATTITUDE, GYROSCOPE_BIAS
from insdvl.navigation.events import NS, Event
from insdvl.navigation.filter import Filter
from insdvl.navigation.geometry.earth import earth_rate_n, gravity, radii
from insdvl.navigation.geometry.frames import rotation_from_rpy
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.state.fields import State
from insdvl.studies.teaching.increments import increments
from insdvl.studies.teaching.residuals import Start, Stretch
from insdvl.timeline.output import FoldResult
from insdvl.timeline.recorded import fold_arrays
from insdvl.tuner.features.band_groups import GROUP_FEATURE_NAMES, group_features
from insdvl.tuner.features.bands import HISTORY, WINDOW
from insdvl.tuner.offline import at_windows
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.windows import means

#: The filter navigates for this time [s] before a lesson begins.
SETTLE = 20.0
#: Pings of the first seconds of a lesson are not scored: they tell of its start.
UNSCORED = 10.0
#: A lesson ends at a longer interval between samples [s], and the longest lesson is taken.
LONGEST_GAP = 1.0
#: Steps of the small filter are not longer [s].
LONGEST_STEP = 1.0
#: Fewer pings are no lesson.
FEWEST_PINGS = 30
#: Nominal slow error of the DVL where the configuration has none: its sigma over that of a ping,
#: and its correlation time [s].
SLOW, TIME_CONSTANT = 0.3, 10.0


class LessonError(ValueError):
    """A recording cannot teach."""


@dataclass(frozen=True, eq=False)
class Lesson:
    """One recording.

    Attributes:
        name: Of the recording.
        samples: (N, 6) of the IMU.
        stretch: Pings and increments.
        scored: (M,) which pings count.
        X: (K, 6, 7) features of the windows.
        scale: (K, 6) their scales.
        nominal: (6,) variances per sample of the configuration.
    """

    name: str
    samples: Array
    stretch: Stretch
    scored: NDArray[np.bool_]
    X: Array
    scale: Array
    nominal: Array

    @property
    def count(self) -> int:
        """Number of pings that count."""
        return int(np.sum(self.scored))


def lesson_of(
    name: str,
    parameters: FilterParameters,
    tuner: TunerParameters,
    stamps_ns: Stamps,
    samples: Array,
    events: Sequence[Event],
) -> Lesson:
    """The lesson of a recording.

    Args:
        name: Of the recording.
        parameters: Of the filter.
        tuner: With the rate of the windows.
        stamps_ns: (N,) stamps of the samples, increasing.
        samples: (N, 6) specific force [m/s^2] and angular rate [rad/s], IMU axes,
            forward-right-down.
        events: All other events of the filter.

    Raises:
        LessonError: The filter does not start, accepts too few pings, or there are too few samples.
    """
    first, last = _longest(stamps_ns)
    stamps_ns, samples = stamps_ns[first:last], samples[first:last]
    events = [e for e in events if e.stamp_ns <= stamps_ns[-1]]
    every = max(round(parameters.imu.rate), 1)
    folded = fold_arrays(parameters, stamps_ns, samples[:, :3], samples[:, 3:], events, every)
    by_stamp = {e.stamp_ns: e for e in events if isinstance(e, Dvl) and all(e.measured)}
    used = [
        by_stamp[u.stamp_ns]
        for u in folded.updates
        if u.report.measurement == Dvl.name and u.report.corrected and u.stamp_ns in by_stamp
    ]
    if not used:
        raise LessonError(f"{name}: the filter used no measurement of the DVL")
    window_ns, X = at_windows(
        stamps_ns,
        samples,
        _features,
        (len(GROUP_FEATURE_NAMES) + 1,),
        WINDOW,
        tuner.rate,
        round(tuner.max_gap * NS),
        HISTORY,
        pooling=True,
    )
    begin_ns = used[0].stamp_ns + round(SETTLE * NS)
    if len(window_ns):
        begin_ns = max(begin_ns, int(window_ns[0]))
    nav = folded.states["nav"]
    begins = np.flatnonzero((nav["initialised"] != 0) & (nav["time_ns"] >= begin_ns))
    at = int(nav["time_ns"][begins[0]]) if begins.size and len(window_ns) else int(stamps_ns[-1])
    pings = [e for e in used if at < e.stamp_ns <= stamps_ns[-1]]
    if len(pings) < FEWEST_PINGS:
        raise LessonError(
            f"{name} has {len(pings)} measurements of the DVL that the filter used after its "
            f"first {SETTLE:g} s; a lesson needs {FEWEST_PINGS}"
        )
    stretch = _stretch(parameters, folded, begins[0], stamps_ns, samples, pings, window_ns)
    ping_ns = np.array([e.stamp_ns for e in pings])
    scored = ping_ns > at + round(UNSCORED * NS)
    noise = parameters.process_noise
    nominal = np.array([*noise.accelerometer_variance, *noise.gyroscope_variance])
    if noise.convention == "density":
        nominal = nominal / stretch.interval
    return Lesson(name, samples, stretch, scored, X[..., :-1], X[..., -1], nominal)


def _features(windows: Array, k: int) -> Array:
    """Features of means of k samples, and the scale of single ones."""
    X, scale = group_features(means(windows, k))
    return np.hstack([X, k * scale[:, None]])


def _longest(stamps_ns: Stamps) -> tuple[int, int]:
    """First sample and end of the longest part without a gap."""
    breaks = np.flatnonzero(np.diff(stamps_ns) > LONGEST_GAP * NS) + 1
    edges = np.concatenate([[0], breaks, [len(stamps_ns)]])
    k = int(np.argmax(np.diff(edges)))
    return int(edges[k]), int(edges[k + 1])


def _stretch(
    parameters: FilterParameters,
    folded: FoldResult,
    begin: int,
    stamps_ns: Stamps,
    samples: Array,
    pings: Sequence[Dvl],
    window_ns: Stamps,
) -> Stretch:
    """The stretch from the state ``begin`` on."""
    filter_ = folded.filter
    at = int(folded.states["nav"]["time_ns"][begin])
    first = folded.states[np.argmax(folded.states["nav"]["initialised"] != 0)]
    start, bias = _start(filter_, first, folded.states[begin], parameters)
    ping_ns = np.array([e.stamp_ns for e in pings], dtype=np.int64)
    inner = window_ns[(window_ns > at) & (window_ns < ping_ns[-1])]
    bounds_ns = _divided(np.unique(np.concatenate([[at], inner, ping_ns])))
    steps = increments(stamps_ns, samples[:, :3], samples[:, 3:], bias, bounds_ns)
    model = filter_.models[Dvl.name]
    C_d_i = filter_.vehicle.C_b_i.T @ filter_.vehicle.axes.body_rotation(
        rotation_from_rpy(np.array(parameters.dvl.mount))
    )
    R = np.array([model.noise(e) for e in pings])
    slow_std, time_constant = _slow_error(parameters, R)
    return Stretch(
        start=start,
        steps=steps,
        interval=float(np.median(np.diff(stamps_ns))) / NS,
        estimate=np.searchsorted(window_ns, bounds_ns[:-1], side="right") - 1,
        pings=np.searchsorted(bounds_ns, ping_ns) - 1,
        velocities=_velocities(filter_, parameters, stamps_ns, samples - bias, pings, C_d_i),
        noise=np.diagonal(C_d_i @ R @ C_d_i.T, axis1=1, axis2=2).copy(),
        slow_std=slow_std,
        time_constant=time_constant,
        C_d_i=C_d_i,
    )


def _slow_error(parameters: FilterParameters, R: Array) -> tuple[Array, float]:
    """Nominal sigma (3,) of the slow error in DVL axes [m/s], and its time constant [s].

    Args:
        parameters: Of the filter.
        R: (M, 3, 3) covariances of the pings in DVL axes [(m/s)^2].
    """
    told = parameters.dvl
    if told.bias_model != "none" and any(told.bias_std):
        return np.array(told.bias_std), told.bias_time_constant
    return SLOW * np.sqrt(np.diagonal(R.mean(axis=0))), TIME_CONSTANT


def _divided(bounds_ns: Stamps) -> Stamps:
    """The bounds of steps, with further ones in steps that are too long."""
    longest_ns = round(LONGEST_STEP * NS)
    further = [
        np.arange(a + longest_ns, b, longest_ns)
        for a, b in pairwise(bounds_ns)
        if b - a > longest_ns
    ]
    return np.unique(np.concatenate([bounds_ns, *further]))


def _start(
    filter_: Filter, first: State, s: State, parameters: FilterParameters
) -> tuple[Start, Array]:
    """The begin of a stretch, and the biases (6,) that are removed from it, in IMU axes.

    A filter that is told too little of the DVL's errors takes them for biases and tilt, and is sure
    of both. So the biases are those of its first state, and nothing is surer than there.

    Args:
        filter_: That has navigated the recording.
        first: Its first state.
        s: That at the begin.
        parameters: Of the filter.
    """
    nav, C_b_i = s["nav"], filter_.vehicle.C_b_i
    variances = np.maximum(_variances(filter_, first), _variances(filter_, s))
    lat, _, h = nav["llh"]
    w_ie_n = np.empty(3)
    earth_rate_n(lat, w_ie_n)
    noise = parameters.process_noise
    start = Start(
        C_n_i=np.ascontiguousarray(nav["C_n_b"] @ C_b_i),
        v_n=nav["v_n"].copy(),
        variances=variances,
        g_n=np.array([0.0, 0.0, gravity(lat, h)]),
        w_ie_n=w_ie_n,
        radius=radii(lat)[1],
        latitude=float(lat),
        walks=np.repeat([noise.accelerometer_bias_walk, noise.gyroscope_bias_walk], 3),
    )
    biases = first["nav"]
    return start, np.concatenate([C_b_i.T @ biases["b_f"], C_b_i.T @ biases["b_w"]])


def _variances(filter_: Filter, s: State) -> Array:
    """Variances (12,) as `Start` has them."""
    nav, C_b_i = s["nav"], filter_.vehicle.C_b_i
    P = nav["P"][: filter_.n, : filter_.n]
    J = body_velocity_jacobian(
        nav["C_n_b"][None], nav["v_n"][None], invariant=filter_.vehicle.invariant, n=filter_.n
    )[0]
    of_biases = [
        np.diagonal(C_b_i.T @ P[block, block] @ C_b_i)
        for block in (ACCELEROMETER_BIAS, GYROSCOPE_BIAS)
    ]
    return np.concatenate(
        [
            np.diagonal(C_b_i.T @ J @ P @ J.T @ C_b_i),
            np.diagonal(P[ATTITUDE, ATTITUDE]),
            *of_biases,
        ]
    )


def _velocities(
    filter_: Filter,
    parameters: FilterParameters,
    stamps_ns: Stamps,
    samples: Array,
    pings: Sequence[Dvl],
    C_d_i: Array,
) -> Array:
    """(M, 3) velocities of the IMU by the pings, v = C v_d - w x l, in its axes."""
    vehicle = filter_.vehicle
    l_i = vehicle.C_b_i.T @ vehicle.lever_arm(parameters.dvl.lever_arm)
    half_ns = round(0.5 * parameters.dvl.gyro_average * NS)
    ping_ns = np.array([e.stamp_ns for e in pings])
    first = np.searchsorted(stamps_ns, ping_ns - half_ns)
    last = np.maximum(np.searchsorted(stamps_ns, ping_ns + half_ns, side="right"), first + 1)
    summed = np.vstack([np.zeros(3), np.cumsum(samples[:, 3:], axis=0)])
    first, last = np.minimum(first, len(stamps_ns) - 1), np.minimum(last, len(stamps_ns))
    w = (summed[last] - summed[first]) / (last - first)[:, None]
    return np.array([e.v_d for e in pings]) @ C_d_i.T - np.cross(w, l_i)
