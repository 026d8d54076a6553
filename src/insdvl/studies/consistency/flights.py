"""A mission whose initial error is drawn from P_0, flown by the filter.

All runs of a case differ in their random numbers only, and two cases of the same seed differ in
what they declare only: noise, biases and the unit normal numbers of the initial error are the same.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from insdvl.arrays import Array
from insdvl.messages.topics import HEADING
from insdvl.navigation.channels import ImuParameters
from insdvl.navigation.error_state import HORIZONTAL_POSITION
from insdvl.navigation.events import Event, Initial
from insdvl.navigation.gate.parameters import GateParameters
from insdvl.navigation.geometry.odom import place_of
from insdvl.navigation.measurements.dvl import Dvl, DvlParameters
from insdvl.navigation.measurements.heading import Heading, HeadingParameters
from insdvl.navigation.odometry import odometry
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.process_noise.parameters import ProcessNoiseParameters
from insdvl.navigation.start.parameters import InitialParameters, OriginParameters
from insdvl.simulation.grades import Grade
from insdvl.simulation.initial_errors import drawn_initial
from insdvl.simulation.mission import DEFAULT_HEADING, Mission, simulate
from insdvl.simulation.motion import Channel, Ramp, Trajectory, Truth, Wave
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.sensors.heading import HeadingModel
from insdvl.studies.consistency.errors import Flown, errors, heading_deg, heading_sigma_deg
from insdvl.studies.evaluation import metrics
from insdvl.timeline.recorded import fold_arrays

#: An AUV that goes out and comes part of the way back: 1.08 km in 600 s, at most 0.6 km away.
TRANSIT = Trajectory(
    duration=600.0,
    speed=Channel(1.8, waves=(Wave(0.1, 47.0),)),
    heading=Channel(
        math.radians(20.0),
        ramps=(
            Ramp(60.0, 75.0, math.radians(50.0)),
            Ramp(150.0, 165.0, math.radians(-80.0)),
            Ramp(240.0, 255.0, math.radians(40.0)),
            Ramp(330.0, 345.0, math.radians(60.0)),
            Ramp(420.0, 450.0, math.radians(120.0)),
            Ramp(510.0, 525.0, math.radians(-50.0)),
        ),
        waves=(Wave(math.radians(0.8), 31.0),),
    ),
    pitch=Channel(waves=(Wave(math.radians(0.6), 23.0, 0.5),)),
    roll=Channel(waves=(Wave(math.radians(0.6), 19.0, 1.0),)),
    bank=0.4,
    pivot=0.4,
    h_0=-20.0,
)

_LEG, _TURN = 60.0, 24.0  # s


def _survey() -> Trajectory:
    """Parallel legs, joined by half circles that alternate in sense: 1.08 km in 600 s."""
    period = _LEG + _TURN
    turns = [
        Ramp(k * period + _LEG, (k + 1) * period, (-1) ** k * math.pi)
        for k in range(int(600.0 / period))
    ]
    return replace(
        TRANSIT,
        heading=Channel(
            math.radians(20.0), ramps=tuple(turns), waves=(Wave(math.radians(0.8), 31.0),)
        ),
    )


#: A lawn mower: at most 0.2 km from the start.
SURVEY = _survey()

#: Samples of the IMU per second [Hz].
RATE = 100.0

#: Probability of the published ellipse.
ELLIPSE = 0.95

#: Streams of a run beside those of its mission.
_INITIAL, _EVENTS = 1, 2


@dataclass(frozen=True)
class Case:
    """What is flown, and what the filter is told of it.

    Attributes:
        grade: Of the IMU.
        heading_std_deg: One sigma of the initial heading.
        uniform_heading: Whether the true heading is anything at all, each as likely.
        start: (3,) true start in odom, north-east-down [m].
        position_std: One sigma of each axis of the initial position [m].
        duration: [s].
        earth_rate: Whether the Earth turns, in truth and for the filter.
        dvl_std: White noise of each component of the DVL, one sigma [m/s].
        dvl_rate: Its pings per second [Hz].
        error_state: Of the filter.
        trajectory: The motion.
        latitude_deg: Of the origin of odom.
        silence: Of the DVL, from begin to end [s].
        heading: The heading sensor; by default there is none.
    """

    grade: Grade
    heading_std_deg: float
    uniform_heading: bool = False
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    position_std: float = 0.1
    duration: float = 600.0
    earth_rate: bool = True
    dvl_std: float = 0.02
    dvl_rate: float = 1.0
    error_state: str = "invariant"
    trajectory: Trajectory = TRANSIT
    latitude_deg: float = math.degrees(TRANSIT.lat_0)
    silence: tuple[float, float] = (0.0, 0.0)
    heading: HeadingModel = DEFAULT_HEADING

    @property
    def origin(self) -> Array:
        """Origin of odom (3,): latitude, longitude [rad], height [m]."""
        return np.array([math.radians(self.latitude_deg), TRANSIT.lon_0, TRANSIT.h_0])


@dataclass(frozen=True)
class Flight:
    """Errors at every full second (K,) of one run.

    Attributes:
        nees: Of the horizontal position in the coordinates of the model, per degree of freedom.
        inside: Whether the true position is inside the published ellipse of `ELLIPSE`.
        error: Horizontal distance from the true position [m].
        heading_deg: Error of the heading, within +-180.
        heading_sigma_deg: What the filter says of it, one sigma.
    """

    nees: Array
    inside: Array
    error: Array
    heading_deg: Array
    heading_sigma_deg: Array


#: Makes further events of a run, from its mission and a generator of its own.
EventSource = Callable[[Mission, np.random.Generator], Sequence[Event]]


def process_noise_of(grade: Grade) -> ProcessNoiseParameters:
    """The noise of a grade at `RATE`, whose biases do not walk."""
    variances = grade.variances(RATE).tolist()
    return ProcessNoiseParameters(
        accelerometer_variance=tuple(variances[:3]),
        gyroscope_variance=tuple(variances[3:]),
        accelerometer_bias_walk=0.0,
        gyroscope_bias_walk=0.0,
    )


def parameters(case: Case) -> FilterParameters:
    """The filter of a case: it knows all sigmas, and starts on the initial state it is given."""
    grade = case.grade
    return FilterParameters(
        frame_convention="ned",
        error_state=case.error_state,
        earth_rate=case.earth_rate,
        imu=ImuParameters(rate=RATE),
        dvl=DvlParameters(noise_std=(case.dvl_std,) * 3),
        heading=_heading_parameters(case.heading),
        gate=GateParameters(enabled=False),
        process_noise=process_noise_of(grade),
        initial=InitialParameters(
            mode="set_odometry",
            heading_std=math.radians(case.heading_std_deg),
            position_std=case.position_std,
            accelerometer_bias_std=grade.accelerometer_bias,
            gyroscope_bias_std=grade.gyroscope_bias,
        ),
        origin=OriginParameters(
            latitude_deg=case.latitude_deg,
            longitude_deg=math.degrees(TRANSIT.lon_0),
            height=TRANSIT.h_0,
        ),
    )


def _heading_parameters(sensor: HeadingModel) -> HeadingParameters:
    """What the filter is told of a heading sensor: its true parameters."""
    if sensor.rate == 0.0:
        return HeadingParameters()
    return HeadingParameters(
        topic=HEADING,
        covariance="parameters",
        noise_std=sensor.noise_std,
        roll_pitch_std=sensor.roll_pitch_std,
        error_std=sensor.error_std,
        error_time_constant=sensor.error_time_constant,
        interval=0.0,
    )


def initial_state(case: Case, truth: Truth, rng: np.random.Generator) -> Initial:
    """The true start in odom with an error drawn from P_0."""
    initial = parameters(case).initial
    return drawn_initial(truth, initial, rng, uniform_heading=case.uniform_heading)


def mission_of(case: Case, seed: int) -> Mission:
    """The mission of a run, in the odom of the case."""
    mission = simulate(
        trajectory_from(case),
        constant(case.grade.variances(RATE)),
        seed=seed,
        duration=case.duration,
        imu=case.grade.imu(RATE),
        dvl=DvlModel(rate=case.dvl_rate, noise_std=(case.dvl_std,) * 3, outages=case.silence),
        heading=case.heading,
        earth_rate=case.earth_rate,
    )
    truth, initial = (part.in_odom_at(case.origin) for part in (mission.truth, mission.initial))
    return replace(mission, truth=truth, initial=initial)


def folded(
    mission: Mission,
    settings: FilterParameters,
    events: Sequence[Event],
    *,
    from_start: bool = False,
) -> Flown:
    """The filter in a mission, with its DVL and heading sensor, and with further events.

    Args:
        mission: The mission.
        settings: Of the filter.
        events: All but those of IMU, DVL and heading sensor.
        from_start: Whether the states that are kept are the first of the initialised filter and
            those of each second from there on; otherwise those of every full second.
    """
    pings = zip(mission.dvl_stamps_ns.tolist(), mission.v_d, strict=True)
    turns = zip(mission.heading_stamps_ns.tolist(), mission.attitude, strict=True)
    second = round(RATE)
    result = fold_arrays(
        settings,
        mission.stamps_ns,
        mission.f_b,
        mission.w_ib_b,
        [
            *(Dvl(stamp_ns, v_d) for stamp_ns, v_d in pings),
            *(Heading(stamp_ns, C_n_b) for stamp_ns, C_n_b in turns),
            *events,
        ],
        1 if from_start else second,
    )
    states, at = result.states, slice(second - 1, None, second)
    if from_start:
        at = slice(int(np.argmax(states["nav"]["initialised"])), None, second)
        states = states[at].copy()
    truth = Truth(**{name: array[at] for name, array in vars(mission.truth).items()})
    return Flown(result.filter, states, truth, mission.bias[at])


def flown(
    case: Case,
    seed: int,
    *,
    settings: FilterParameters | None = None,
    events: EventSource | None = None,
) -> Flown:
    """One run of a case, flown by the filter; states are those of every full second.

    Args:
        case: What is flown.
        seed: Of all that is random.
        settings: In place of `parameters`, with sensors that the case does not know.
        events: Further events, such as measurements of these sensors; their mission is counted
            from the origin of odom.
    """
    mission = mission_of(case, seed)
    initial = initial_state(case, mission.initial, np.random.default_rng([seed, _INITIAL]))
    more = events(mission, np.random.default_rng([seed, _EVENTS])) if events else ()
    return folded(mission, settings or parameters(case), [initial, *more])


def fly(
    case: Case,
    seed: int,
    *,
    settings: FilterParameters | None = None,
    events: EventSource | None = None,
) -> Flight:
    """Errors of the position in one run of a case; the arguments are those of `flown`."""
    run = flown(case, seed, settings=settings, events=events)
    P = run.filter.covariance(run.states)[:, HORIZONTAL_POSITION, HORIZONTAL_POSITION]
    published = [odometry(run.filter, run.states, k) for k in range(len(run.states))]
    d = run.truth.p_o[:, :2] - np.array([o.position[:2] for o in published])
    covariance = np.array([o.pose_covariance[:2, :2] for o in published])
    return Flight(
        nees=metrics.nees(errors(run)[:, HORIZONTAL_POSITION], P) / 2.0,
        inside=metrics.nees(d, covariance) <= chdtri(2, 1.0 - ELLIPSE),
        error=np.hypot(d[:, 0], d[:, 1]),
        heading_deg=heading_deg(run),
        heading_sigma_deg=heading_sigma_deg(run),
    )


def trajectory_from(case: Case) -> Trajectory:
    """The motion at its place on the Earth, which is `start` from the origin of odom."""
    place = place_of(np.array(case.start), case.origin)
    if place is None:
        raise ValueError(f"start {case.start} is no place at which the filter navigates")
    lat, lon, height = place.tolist()
    return replace(case.trajectory, lat_0=lat, lon_0=lon, h_0=height)
