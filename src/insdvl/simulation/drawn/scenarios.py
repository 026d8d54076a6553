"""Scenarios with noise that is not white, and what is drawn for each mission of them.

The numbers were fixed before any estimator was tuned; docs/explanation/effective-noise.md has them
as a table. Ranges of factors, variances and time constants are log-uniform.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from insdvl.arrays import Array
from insdvl.simulation.drawn.dvl_errors import DvlErrors, drawn_dvl_errors
from insdvl.simulation.drawn.effective import Dvl, gains, horizontal, measured, vertical
from insdvl.simulation.drawn.imu_errors import ImuErrors, Line
from insdvl.simulation.drawn.vibration import Vibration, drawn_sines
from insdvl.simulation.drawn.waves import Sea, drawn_sea
from insdvl.simulation.motion import Trajectory, Truth
from insdvl.simulation.noise import NoiseProfile, ProfileFactory, constant, segments
from insdvl.simulation.sensors.dvl import DvlModel

#: Range of the variances per sample of the white noise of an accelerometer [(m/s^2)^2].
WHITE = (1e-4, 0.05)
#: The middle of this range, q_0 [(m/s^2)^2].
MIDDLE = float(np.sqrt(WHITE[0] * WHITE[1]))
#: The variances of a gyroscope [(rad/s)^2] are smaller by this factor [1/m^2]: 0.01 to 0.24
#: deg/sqrt(h) at 100 Hz, so that its noise in the tilt disturbs the velocity about as much.
GYROSCOPE = 1e-5
_SCALE = np.repeat([1.0, GYROSCOPE], 3)

LINES = 3  # most lines of vibration
BAND = (6.0, 48.0)  # Hz, of lines and of broadband vibration
LINE_POWER = (0.1, 30.0)  # variance over the middle of WHITE, of each line in each channel
BROADBAND_POWER = (0.1, 10.0)  # the same of the whole band
_SINES = 48  # of the broadband vibration
PING = 0.02  # s, over which the DVL measures unless its model has a time

#: Variances per sample of white noise with the density of the coloured noise at f = 0.
COLOURED = (1e-3, 0.05)
WHITE_BESIDE_COLOURED = (1e-4, 5e-3)
TIME_CONSTANT = (0.3, 3.0)  # s

FLICKER = (1e-4, 1e-3, 1.5e-6, 1.5e-5)  # bias instability: lowest, highest [m/s^2], then [rad/s]
COUNTS = np.array([2e-4] * 3 + [2e-6] * 3)  # m/s and rad
SCALE_FACTOR = (1e-4, 5e-4)  # sigma of errors of scale and alignment, accelerometers, gyroscopes
#: Variances of a sample at 100 Hz of two grades of IMU (simulation/grades.py), f and w.
FOG, TACTICAL = (2.40e-5, 7.62e-11), (9.62e-5, 8.46e-8)


@dataclass(frozen=True, eq=False)
class Disturbances:
    """What is drawn of a vehicle beside white noise and biases.

    Attributes:
        imu: Errors of the IMU.
        sea: Waves and steering; None for still water.
        vibration: None for a vehicle without.
        dvl: Errors of the DVL; None for those of its model alone.
    """

    imu: ImuErrors
    sea: Sea | None = None
    vibration: Vibration | None = None
    dvl: DvlErrors | None = None

    def moved(self, trajectory: Trajectory) -> Trajectory:
        """The trajectory with waves, steering and vibration; the same where there are none."""
        if self.sea is not None:
            trajectory = self.sea.moved(trajectory)
        if self.vibration is not None:
            trajectory = replace(trajectory, vibration=self.vibration)
        return trajectory

    def instrument(self, dvl: DvlModel) -> DvlModel:
        """The DVL of this vehicle."""
        dvl = replace(dvl, ping=dvl.ping or PING)
        if self.dvl is None:
            return dvl
        return replace(
            dvl,
            bias_std=self.dvl.correlated * max(dvl.noise_std),
            bias_time_constant=self.dvl.correlation_time,
        )

    def dvl_factors(self, pings: Truth) -> Array:
        """Factors (M,) on the sigma of the white noise of the pings."""
        return np.ones(pings.t.size) if self.dvl is None else self.dvl.factors(pings)

    def effective(
        self, white: NoiseProfile, factors: Array, dvl: DvlModel, rate: float, duration: float
    ) -> tuple[NoiseProfile, Array]:
        """The variances of the white noise that a filter needs.

        Args:
            white: The white part of the noise of the IMU.
            factors: (M,) on the sigma of the white noise of the pings.
            dvl: The instrument.
            rate: Of the IMU [Hz].
            duration: Of the mission [s].

        Returns:
            Variances per sample of the IMU, and (M, 3) variances of the pings [(m/s)^2].
        """
        times = white.times
        if self.imu.coloured is not None:
            times = np.union1d(times, self.imu.coloured.times)
        spectra = [
            self.imu.spectra(t, q, 1.0 / rate)
            for t, q in zip(times, white.variance_at(times), strict=True)
        ]
        interval = 1.0 / dvl.rate
        r = np.outer(factors**2, np.square(dvl.noise_std))
        if dvl.bias_std > 0.0:
            seen = Dvl(float(np.mean(r)) + dvl.bias_std**2, interval)
            pairs = [horizontal(channels[0], channels[4], seen) for channels in spectra]
            k_1 = float(np.mean([gains(*pair, seen)[0] for pair in pairs]))
            r = measured(r, dvl.bias_std**2, dvl.bias_time_constant, k_1, interval)
        seen = Dvl(float(np.mean(r)), interval)
        densities = np.empty((times.size, 6))
        for row, channels in zip(densities, spectra, strict=True):
            row[0], row[4] = horizontal(channels[0], channels[4], seen)
            row[1], row[3] = horizontal(channels[1], channels[3], seen)
            row[2] = vertical(channels[2], seen)
            row[5] = channels[5].mean_density(duration)
        return NoiseProfile(times, densities * rate), r


@dataclass(frozen=True)
class Scenario:
    """What is drawn for a mission.

    Attributes:
        white: Range of the variances of the accelerometers' white noise, new every 15 to 45 s.
        vibrating: Whether there is vibration.
        coloured: Whether there is first-order noise.
        waves: Whether there are waves and steering.
        imperfect: Whether there are flicker, counts, and errors of scale and alignment, and a DVL
            whose noise depends on its surroundings.
        grade: Variances of a sample of an IMU with white noise alone, f and w, in place of
            ``white``; and a DVL whose white noise depends on its surroundings.
        scale: Factors on the variances of the white, coloured and flicker noise of accelerometers
            and gyroscopes, for an IMU of another grade (see `simulation.grades`).
    """

    white: tuple[float, float] = WHITE
    vibrating: bool = False
    coloured: bool = False
    waves: bool = False
    imperfect: bool = False
    grade: tuple[float, float] | None = None
    scale: tuple[float, float] = (1.0, 1.0)

    def profile(self) -> ProfileFactory:
        """The white noise."""
        if self.grade is not None:
            return constant(np.repeat(self.grade, 3))
        return _in_all_channels(self.white, self.scale)

    def draw(
        self,
        duration: float,
        rate: float,
        rng: np.random.Generator,
        vehicle: np.random.Generator | None = None,
    ) -> Disturbances:
        """Everything else, of one mission.

        Args:
            duration: [s].
            rate: Of the IMU [Hz].
            rng: Each kind draws from a stream of its own.
            vehicle: Draws what stays from one mission of a vehicle to the next, where that is
                another's: vibration, time constants, and errors of the IMU.
        """
        sea, vibration, coloured, imperfect, dvl = rng.spawn(5)
        profile_rng, tau_rng = coloured.spawn(2)
        if vehicle is not None:
            _, vibration, of_vehicle, imperfect, _ = vehicle.spawn(5)
            tau_rng = of_vehicle.spawn(2)[1]
        lines: tuple[Line, ...] = ()
        shaken: Vibration | None = None
        if self.vibrating:
            shaken, lines = _drawn_vibration(rate, vibration)
        return Disturbances(
            imu=self._errors(duration, lines, profile_rng, tau_rng, imperfect),
            sea=drawn_sea(sea) if self.waves else None,
            vibration=shaken,
            dvl=self._dvl_errors(duration, dvl),
        )

    def _dvl_errors(self, duration: float, rng: np.random.Generator) -> DvlErrors | None:
        if self.imperfect:
            return drawn_dvl_errors(duration, rng)
        if self.grade is not None:
            return replace(drawn_dvl_errors(duration, rng), correlated=0.0)
        return None

    def _errors(
        self,
        duration: float,
        lines: tuple[Line, ...],
        profile_rng: np.random.Generator,
        tau_rng: np.random.Generator,
        imperfect: np.random.Generator,
    ) -> ImuErrors:
        flicker, counts, force, rate = np.zeros(6), np.zeros(6), np.zeros((3, 3)), np.zeros((3, 3))
        if self.imperfect:
            f_low, f_high, w_low, w_high = FLICKER
            instability = np.concatenate(
                [
                    _log_uniform((f_low, f_high), imperfect, 3),
                    _log_uniform((w_low, w_high), imperfect, 3),
                ]
            )
            # The density of a bias instability B is B^2 / (2 pi f) (IEEE Std 952).
            flicker = np.repeat(self.scale, 3) * instability**2 / (2.0 * np.pi)
            counts = COUNTS
            force, rate = (sigma * imperfect.standard_normal((3, 3)) for sigma in SCALE_FACTOR)
        coloured = _in_all_channels(COLOURED, self.scale)
        return ImuErrors(
            coloured=coloured(duration, profile_rng) if self.coloured else None,
            time_constants=_log_uniform(TIME_CONSTANT, tau_rng, 6),
            flicker=flicker,
            counts=counts,
            lines=lines,
            force=force,
            rate=rate,
        )


#: The scenarios by name.
DRAWN: Mapping[str, Scenario] = MappingProxyType(
    {
        "vibrating": Scenario(vibrating=True),
        "coloured": Scenario(white=WHITE_BESIDE_COLOURED, coloured=True),
        "waves": Scenario(waves=True),
        "realistic": Scenario(vibrating=True, coloured=True, waves=True, imperfect=True),
        "bottom-fog": Scenario(grade=FOG),
        "bottom-tactical": Scenario(grade=TACTICAL),
    }
)


def _in_all_channels(limits: tuple[float, float], scale: tuple[float, float]) -> ProfileFactory:
    """Segments of 15 to 45 s in the six channels.

    Args:
        limits: Of the variances of the accelerometers.
        scale: See `Scenario`.
    """
    draw, factors = segments(*limits), _SCALE * np.repeat(scale, 3)

    def scaled(duration: float, rng: np.random.Generator) -> NoiseProfile:
        profile = draw(duration, rng)
        return NoiseProfile(profile.times, profile.variances * factors)

    return scaled


def vibration_in_samples(rate: float, rng: np.random.Generator) -> tuple[Line, ...]:
    """The vibration of a vehicle as an IMU at a rate [Hz] shows it, for a motion that is given."""
    frequency, variance, _ = _drawn_sines(rng)
    return tuple(_in_samples(f, v, rate) for f, v in zip(frequency, variance, strict=True))


def _drawn_vibration(rate: float, rng: np.random.Generator) -> tuple[Vibration, tuple[Line, ...]]:
    """The vibration of a vehicle, and what of it an IMU at a rate [Hz] shows aliased."""
    frequency, variance, phases = _drawn_sines(rng)
    moves = frequency < rate / 2.0
    aliased = tuple(
        _in_samples(f, v, rate) for f, v in zip(frequency[~moves], variance[~moves], strict=True)
    )
    return drawn_sines(2.0 * np.pi * frequency[moves], variance[moves], phases), aliased


def _in_samples(frequency: float, variances: Array, rate: float) -> Line:
    """A sine as it appears in samples: the mean over an interval attenuates, the rest folds."""
    folded = float(abs(frequency - rate * np.rint(frequency / rate)))
    return Line(folded, variances * float(np.sinc(frequency / rate)) ** 2)


def _drawn_sines(rng: np.random.Generator) -> tuple[Array, Array, np.random.Generator]:
    """Frequencies (L,) [Hz] and variances (L, 6) of lines and broadband vibration, and phases."""
    counts, line_rng, band_rng, phases = rng.spawn(4)
    middle = MIDDLE * _SCALE
    number = int(counts.integers(LINES + 1))
    frequency = _log_uniform(BAND, line_rng, number)
    variance = _log_uniform(LINE_POWER, line_rng, (number, 6)) * middle
    low, high = BAND
    edges = np.linspace(low, high, _SINES + 1)
    band = band_rng.uniform(edges[:-1], edges[1:])
    power = _log_uniform(BROADBAND_POWER, band_rng, 6) * middle
    frequency = np.concatenate([frequency, band])
    variance = np.concatenate([variance, np.tile(power / _SINES, (_SINES, 1))])
    return frequency, variance, phases


def _log_uniform(
    limits: tuple[float, float], rng: np.random.Generator, size: int | tuple[int, int]
) -> Array:
    low, high = np.log(limits)
    return np.asarray(np.exp(rng.uniform(low, high, size)), dtype=np.float64)
