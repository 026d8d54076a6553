"""The missions of other vehicles, and their filters, which know the data sheets of the sensors."""

from dataclasses import replace
from typing import Any

import numpy as np

from insdvl.arrays import Array, Stamps
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.start.parameters import InitialParameters
from insdvl.simulation.drawn.scenarios import Scenario
from insdvl.simulation.initial_errors import P_0, drawn_initial
from insdvl.simulation.mission import simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.vehicles import Vehicle
from insdvl.studies.evaluation.approaches import (
    BANDS,
    BANDS_WITH_FACTOR,
    BEST_CONSTANT,
    FACTOR_WITH_R,
    FIRST,
    LEAST_BAND,
    ORACLE,
    TRUE_FACTOR,
    WINDOW,
    Setting,
    model,
)
from insdvl.studies.evaluation.monte_carlo import MAX_GAP_NS, RATE, Flight, at_true_level
from insdvl.timeline.output import FoldResult
from insdvl.tuner.features.band_forms import least_band
from insdvl.tuner.features.bands import NEAR
from insdvl.tuner.offline import at_windows, tuned_by_model
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.windows import pooled

DEFAULT = "hcf default"
#: The rows with a Q that changes, and the source of that Q.
SOURCES = {
    ORACLE: ORACLE,
    DEFAULT: DEFAULT,
    LEAST_BAND: LEAST_BAND,
    BANDS: BANDS,
    BANDS_WITH_FACTOR: BANDS,
    FACTOR_WITH_R: BANDS,
    TRUE_FACTOR: TRUE_FACTOR,
}
#: All rows, in the order of the tables.
ROWS = (BEST_CONSTANT, *SOURCES)

#: Stamps (K,) from which on the variances (K, 6) apply.
Told = tuple[Stamps, Array]

_STREAM = 9000  # first key of the random streams of the missions
_SETTING = Setting("calibrated")
#: The default is 10 m/s, and faster pings are refused; a car is faster.
_MAX_SPEED = 60.0


def flight_of(name: str, vehicle: Vehicle, seed: int, number: int) -> Flight:
    """A mission; it does not depend on which other vehicles there are."""
    key = (_STREAM, *name.encode(), number)
    drawn, flown, started = np.random.SeedSequence(seed, spawn_key=key).spawn(3)
    trajectory = vehicle.motion(np.random.default_rng(drawn), vehicle.duration)
    noise = vehicle.noise
    mission = simulate(
        trajectory,
        noise if isinstance(noise, Scenario) else constant(np.repeat(noise, 3)),
        seed=flown,
        imu=vehicle.imu,
        dvl=vehicle.dvl,
    )
    rng = np.random.default_rng(started)
    sigma = _initial(vehicle)
    return Flight(mission, drawn_initial(mission.initial, sigma, rng, stamp_ns=mission.start_ns))


def _initial(vehicle: Vehicle) -> InitialParameters:
    """The published uncertainty of the start, with the turn-on biases of the IMU."""
    return replace(
        P_0,
        mode="set_odometry",
        accelerometer_bias_std=vehicle.imu.accelerometer_bias_std,
        gyroscope_bias_std=vehicle.imu.gyroscope_bias_std,
    )


def filter_of(
    vehicle: Vehicle, flight: Flight, variances: tuple[float, float] = FIRST, **values: Any
) -> FilterParameters:
    """Parameters of a filter, with nominal variances of f_b and of w_ib_b.

    Args:
        values: Further parameters of the group ``process_noise``, by name.
    """
    imu, (lat, lon, height) = vehicle.imu, flight.mission.initial.llh[0].tolist()
    found = _SETTING.filter(
        variances,
        accelerometer_bias_walk=imu.accelerometer_bias_walk,
        gyroscope_bias_walk=imu.gyroscope_bias_walk,
        **values,
    )
    return replace(
        found,
        imu=replace(found.imu, rate=imu.rate),
        origin=replace(
            found.origin,
            latitude_deg=float(np.degrees(lat)),
            longitude_deg=float(np.degrees(lon)),
            height=height,
        ),
        initial=_initial(vehicle),
        dvl=replace(found.dvl, noise_std=vehicle.dvl.noise_std, max_speed=_MAX_SPEED),
    )


def by_constant(vehicle: Vehicle, flight: Flight, variances: tuple[float, float]) -> FoldResult:
    """The mission through a filter with a constant Q."""
    parameters = filter_of(vehicle, flight, variances)
    return flight.fold_received(parameters, np.empty(0, np.int64), np.empty((0, 6)))


def by_row(vehicle: Vehicle, flight: Flight, row: str, told: Told) -> FoldResult:
    """The mission through the filter of a row of `SOURCES`, which is told its Q."""
    parameters = filter_of(
        vehicle,
        flight,
        source="oracle" if row == ORACLE else "external",
        adaptive_factor=row in (BANDS_WITH_FACTOR, FACTOR_WITH_R),
    )
    if row == FACTOR_WITH_R:
        dvl = replace(parameters.dvl, noise_source="adaptive")
        parameters = replace(parameters, dvl=dvl)
    return flight.fold_received(parameters, *told)


def told_by(source: str, flight: Flight) -> Told:
    """What a source tells of the process noise of a mission."""
    m = flight.mission
    if source == ORACLE:
        return m.process_noise()
    if source == TRUE_FACTOR:
        stamps_ns, told = told_by(BANDS, flight)
        return stamps_ns, at_true_level(m, stamps_ns, told)
    learned = model(source)
    if learned is not None:
        return tuned_by_model(m.stamps_ns, flight.samples, learned, TunerParameters())
    return at_windows(
        m.stamps_ns,
        flight.samples,
        lambda x, pool: pooled(least_band, pool)(x),
        (),
        WINDOW,
        RATE,
        MAX_GAP_NS,
        NEAR,
        pooling=True,
    )
