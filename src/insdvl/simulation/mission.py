"""A whole mission: truth, IMU, DVL, depth and heading of one vehicle and one seed."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array, Stamps
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.frames import CONVENTIONS
from insdvl.parameters.declaration import ParameterError
from insdvl.simulation.drawn.imu_errors import ImuErrors
from insdvl.simulation.drawn.scenarios import Disturbances, Scenario
from insdvl.simulation.motion import Trajectory, Truth
from insdvl.simulation.noise import NoiseProfile, ProfileFactory
from insdvl.simulation.parameters import SimulatorParameters, chosen_noise
from insdvl.simulation.sensors.depth import DepthModel, ideal_pressure, pressure_noise
from insdvl.simulation.sensors.dvl import DvlModel, ideal_pings
from insdvl.simulation.sensors.heading import HeadingModel, attitudes
from insdvl.simulation.sensors.imu import ImuModel, biases, ideal_imu, white_noise
from insdvl.simulation.trajectories import trajectory_named

#: Largest number of samples of a mission: 13 hours at 100 Hz. All samples are computed before the
#: first is sent, and take half a kilobyte each.
MAX_SAMPLES = 5_000_000


@dataclass(frozen=True, eq=False)
class Noise:
    """What the noise of a mission is made of, for a filter that models each part.

    Errors of scale and alignment are in none of these.

    Attributes:
        white: (N, 6) variance of the white part in each sample, channels as in `noise`.
        imu: What is added to it; None for white noise alone.
        white_r: (M, 3) variances of the white part of the pings, without those in outages
            [(m/s)^2].
        dvl: The instrument, with the slow error of its readings.
    """

    white: Array
    imu: ImuErrors | None
    white_r: Array
    dvl: DvlModel


@dataclass(frozen=True)
class Mission:
    """Truth and sensor readings of one mission. Frames are NED and forward-right-down.

    Row k of the IMU arrays belongs to the interval that ends at ``stamps_ns[k]``.

    Attributes:
        start_ns: Stamp of the start.
        initial: Truth at the start, N = 1.
        stamps_ns: (N,) stamps of the IMU; the first is one interval after the start.
        truth: Truth at the stamps of the IMU.
        f_b: (N, 3) accelerometer readings [m/s^2].
        w_ib_b: (N, 3) gyroscope readings [rad/s].
        q: (N, 6) variance of white noise in each sample, channels as in `noise`. Where the noise is
            not white, that of the effective density (docs/explanation/effective-noise.md).
        bias: (N, 6) bias in each sample.
        profile: The profile of these variances.
        noise: What the noise is made of.
        dvl_stamps_ns: (M,) stamps of the DVL, without those in outages.
        v_d: (M, 3) DVL readings, in DVL axes [m/s].
        r: (M, 3) variances of their noise, effective ones where it is not white; those of
            `DvlModel.noise_std` where `DvlModel.bias_std` is a setting [(m/s)^2].
        dvl_outlier: (M,) which DVL readings are outliers.
        depth_stamps_ns: (D,) stamps of the depth sensor; none without one.
        pressure: (D,) its readings [Pa].
        heading_stamps_ns: (H,) stamps of the heading sensor; none without one.
        attitude: (H, 3, 3) its readings C_n_b.
        heading: The heading sensor.
    """

    start_ns: int
    initial: Truth
    stamps_ns: Stamps
    truth: Truth
    f_b: Array
    w_ib_b: Array
    q: Array
    bias: Array
    profile: NoiseProfile
    noise: Noise
    dvl_stamps_ns: Stamps
    v_d: Array
    r: Array
    dvl_outlier: NDArray[np.bool_]
    depth_stamps_ns: Stamps
    pressure: Array
    heading_stamps_ns: Stamps
    attitude: Array
    heading: HeadingModel

    def without_outliers(self) -> "Mission":
        """The same mission where the DVL readings that are outliers are missing."""
        good = ~self.dvl_outlier
        return replace(
            self,
            noise=replace(self.noise, white_r=self.noise.white_r[good]),
            dvl_stamps_ns=self.dvl_stamps_ns[good],
            v_d=self.v_d[good],
            r=self.r[good],
            dvl_outlier=self.dvl_outlier[good],
        )

    def process_noise(self, every_ns: int = NS) -> tuple[Stamps, Array]:
        """Stamps (K,) and the variances (K, 6) that apply from each stamp on.

        The stamps are the start, every change, and every multiple of ``every_ns`` after the start.
        """
        begins = np.concatenate([[self.start_ns], self.stamps_ns[:-1]])
        changed = (self.q[1:] != self.q[:-1]).any(axis=1)
        regular = np.arange(self.start_ns, self.stamps_ns[-1], every_ns)
        stamps = np.union1d(regular, begins[1:][changed])
        return stamps, self.q[np.searchsorted(begins, stamps, side="right") - 1]


_STREAMS = 7  # random streams of a mission

DEFAULT_IMU = ImuModel()
DEFAULT_DVL = DvlModel()
DEFAULT_DEPTH = DepthModel()
DEFAULT_HEADING = HeadingModel()


def _stamps(duration: float, rate: float) -> Stamps:
    """Nanoseconds k / rate, k = 1, 2, ... to the duration, each rounded on its own; none at 0."""
    if rate == 0.0:
        return np.empty(0, dtype=np.int64)
    count = int(duration * rate * (1.0 + 1e-12))  # the product may be rounded down
    return np.rint(np.arange(1, count + 1) * (NS / rate)).astype(np.int64)


#: Stamps (N,), truth, and ideal readings f (N, 3), w (N, 3).
_Motion: TypeAlias = tuple[Stamps, Truth, Array, Array]


def _ideal(trajectory: Trajectory, duration: float, rate: float, earth_rate: bool) -> _Motion:
    """Stamps, truth and ideal readings."""
    elapsed_ns = _stamps(duration, rate)
    t = np.minimum(elapsed_ns / NS, duration)  # a stamp may be rounded up
    truth = trajectory.truth(t, earth_rate=earth_rate)
    f_b, w_ib_b = ideal_imu(trajectory, t, 1.0 / rate, earth_rate=earth_rate)
    for array in (elapsed_ns, f_b, w_ib_b, *vars(truth).values()):
        array.setflags(write=False)
    return elapsed_ns, truth, f_b, w_ib_b


def _drawn_stream(seed: np.random.SeedSequence) -> np.random.Generator:
    """The random stream of what is drawn of a mission with a scenario."""
    again = np.random.SeedSequence(seed.entropy, spawn_key=seed.spawn_key)
    return np.random.default_rng(again).spawn(_STREAMS)[-1]


#: For motions that all runs of a Monte Carlo study share.
_shared = lru_cache(maxsize=4)(_ideal)


def simulate(
    trajectory: Trajectory,
    noise: ProfileFactory | Scenario,
    *,
    seed: int | np.random.SeedSequence,
    duration: float | None = None,
    imu: ImuModel = DEFAULT_IMU,
    dvl: DvlModel = DEFAULT_DVL,
    depth: DepthModel = DEFAULT_DEPTH,
    heading: HeadingModel = DEFAULT_HEADING,
    earth_rate: bool = True,
    start_ns: int = 0,
    vehicle: np.random.SeedSequence | None = None,
) -> Mission:
    """Simulate a mission.

    Every sensor and every kind of error draws from a random stream of its own, a child of the seed.
    A changed setting therefore leaves all other errors unchanged to the bit, so runs can be
    compared in pairs; a longer mission begins as the shorter one.

    Args:
        trajectory: The motion.
        noise: Factory of the profile of white noise, such as one of `noise.SCENARIOS`; or a
            scenario, such as those of `drawn.scenarios.DRAWN`, which also changes the motion and
            the sensors.
        seed: Random seed.
        duration: Shorter than the trajectory [s]; all of it by default.
        imu: The IMU.
        dvl: The DVL, with mount and lever arm in forward-right-down.
        depth: The depth sensor, with its lever arm in forward-right-down.
        heading: The heading sensor.
        earth_rate: See `Trajectory.truth`.
        start_ns: Stamp of the start.
        vehicle: Seed of another mission with this scenario, whose vehicle flies this one; see
            `Scenario.draw`. By default the vehicle is drawn as well.

    Raises:
        ValueError: The duration is longer than the trajectory or shorter than one IMU interval.
    """
    if duration is None:
        duration = trajectory.duration
    if not 1.0 / imu.rate <= duration <= trajectory.duration:
        raise ValueError(
            f"duration must be within {1.0 / imu.rate:g} to {trajectory.duration:g} s, "
            f"got {duration!r}"
        )
    streams = np.random.default_rng(seed).spawn(_STREAMS)
    profile_rng, noise_rng, bias_rng, dvl_rng, depth_rng, heading_rng, drawn_rng = streams
    dt = 1.0 / imu.rate
    drawn: Disturbances | None = None
    ideal: Callable[[Trajectory, float, float, bool], _Motion] = _shared
    if isinstance(noise, Scenario):
        draw_rng, error_rng = drawn_rng.spawn(2)
        own = None if vehicle is None else _drawn_stream(vehicle).spawn(2)[0]
        drawn = noise.draw(duration, imu.rate, draw_rng, own)
        moved = drawn.moved(trajectory)
        ideal = _shared if moved is trajectory else _ideal
        trajectory, dvl, noise = moved, drawn.instrument(dvl), noise.profile()
    elapsed_ns, truth, f_b, w_ib_b = ideal(trajectory, duration, imu.rate, earth_rate)
    readings = np.hstack([f_b, w_ib_b])

    profile = noise(duration, profile_rng)
    # A sample has the variance that holds where its interval begins.
    begins = np.concatenate([[0.0], elapsed_ns[:-1] / NS])
    q = white = profile.variance_at(begins)
    bias = biases(
        elapsed_ns.size,
        dt,
        np.repeat([imu.accelerometer_bias_std, imu.gyroscope_bias_std], 3),
        np.repeat([imu.accelerometer_bias_walk, imu.gyroscope_bias_walk], 3),
        bias_rng,
    )
    error = bias + white_noise(q, noise_rng)
    if drawn is None:
        readings = imu.filtered(readings + error)
    else:
        error += drawn.imu.noise(begins, dt, error_rng)
        readings = drawn.imu.counted(imu.filtered(drawn.imu.distorted(readings) + error), dt)

    ping_ns = _stamps(duration, dvl.rate)
    pings = trajectory.truth(np.minimum(ping_ns / NS, duration), earth_rate=earth_rate)
    factors = np.ones(pings.t.size) if drawn is None else drawn.dvl_factors(pings)
    dvl_error, is_outlier = dvl.errors(pings.t, dvl_rng, factors)
    seen = dvl.available(pings.t)
    v_d = ideal_pings(trajectory, pings.t, dvl, earth_rate=earth_rate) + dvl_error
    r = white_r = np.outer(factors**2, np.square(dvl.noise_std))
    if drawn is not None:
        profile, r = drawn.effective(profile, factors, dvl, imu.rate, duration)
        q = profile.variance_at(begins)

    depth_ns = _stamps(duration, depth.rate)
    dives = trajectory.truth(np.minimum(depth_ns / NS, duration), earth_rate=earth_rate)
    pressure = ideal_pressure(dives, depth)
    pressure += pressure_noise(depth, trajectory.lat_0, depth_ns.size, depth_rng)

    heading_ns = _stamps(duration, heading.rate)
    faced = trajectory.truth(np.minimum(heading_ns / NS, duration), earth_rate=earth_rate)
    return Mission(
        start_ns=start_ns,
        initial=trajectory.truth(np.zeros(1), earth_rate=earth_rate),
        stamps_ns=start_ns + elapsed_ns,
        truth=truth,
        f_b=np.ascontiguousarray(readings[:, :3]),
        w_ib_b=np.ascontiguousarray(readings[:, 3:]),
        q=q,
        bias=bias,
        profile=profile,
        noise=Noise(white, None if drawn is None else drawn.imu, white_r[seen], dvl),
        dvl_stamps_ns=start_ns + ping_ns[seen],
        v_d=v_d[seen],
        r=r[seen],
        dvl_outlier=is_outlier[seen],
        depth_stamps_ns=start_ns + depth_ns,
        pressure=pressure,
        heading_stamps_ns=start_ns + heading_ns,
        attitude=attitudes(faced, heading, heading_rng),
        heading=heading,
    )


def mission_of(parameters: SimulatorParameters) -> Mission:
    """The mission that the parameters describe; it starts at stamp 0.

    Raises:
        ParameterError: The noise file cannot be used, or the duration is longer than the
            trajectory.
    """
    trajectory = trajectory_named(parameters.trajectory)
    imu = parameters.imu
    duration = parameters.duration or trajectory.duration
    if min(duration, trajectory.duration) * imu.rate > MAX_SAMPLES:
        raise ParameterError(
            f"parameter 'duration' must be at most {MAX_SAMPLES / imu.rate:g} s at imu.rate "
            f"{imu.rate:g} Hz, got {duration!r}: a mission has at most {MAX_SAMPLES} samples"
        )
    noise = chosen_noise(parameters.noise)
    if isinstance(noise, Scenario) and min(parameters.dvl.noise_std) == 0.0:
        raise ParameterError(
            "parameter 'dvl.noise_std' must be > 0 with noise.profile "
            f"{parameters.noise.profile!r}, whose effective noise depends on it; "
            f"got {list(parameters.dvl.noise_std)!r}"
        )
    try:
        return simulate(
            trajectory,
            noise,
            seed=parameters.seed,
            duration=duration,
            imu=imu,
            dvl=parameters.dvl.in_frd(CONVENTIONS[parameters.frame_convention]),
            depth=parameters.depth.in_frd(CONVENTIONS[parameters.frame_convention]),
            heading=parameters.heading,
            earth_rate=parameters.earth_rate,
        )
    except ValueError as error:
        raise ParameterError(f"parameter 'duration': {error}") from None
