"""A heading sensor in flight: an unknown heading that is told late, glitches, order, invariance."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from insdvl.navigation import coordinates
from insdvl.navigation.error_state import ATTITUDE, GYROSCOPE_BIAS, take_earth_rate_from_bias
from insdvl.navigation.events import NS, Event, Imu, Initial
from insdvl.navigation.filter import Filter
from insdvl.navigation.gate.parameters import GateParameters
from insdvl.navigation.geometry.earth import EARTH_RATE
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.measurements.heading import Heading
from insdvl.navigation.odometry import position_in_odom
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.start import automatic
from insdvl.navigation.start.parameters import InitialParameters
from insdvl.simulation.grades import GRADES
from insdvl.simulation.mission import Mission
from insdvl.simulation.sensors.heading import HeadingModel
from insdvl.studies.consistency.errors import Flown, errors, heading_deg, heading_sigma_deg, nees
from insdvl.studies.consistency.flights import (
    Case,
    folded,
    initial_state,
    mission_of,
    parameters,
)
from insdvl.timeline.fold import Fold
from insdvl.timeline.output import FoldResult
from insdvl.timeline.recorded import fold_arrays

SEED = 33_140  # chosen before the first run
TOLD_AT = 60  # s
SENSOR = HeadingModel(rate=1.0)
UNKNOWN = Case(
    GRADES["mems"], 100.0, uniform_heading=True, duration=75.0, heading=SENSOR, earth_rate=True
)
TOLD = replace(UNKNOWN, heading_std_deg=1.0, uniform_heading=False, duration=120.0)
HEADING = ATTITUDE.stop - 1


def about_down(angle: float) -> np.ndarray:
    return Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()


def late(mission: Mission, seconds: float) -> Mission:
    """The mission with a heading sensor that begins later."""
    seen = mission.heading_stamps_ns >= round(seconds * NS)
    return replace(
        mission,
        heading_stamps_ns=mission.heading_stamps_ns[seen],
        attitude=mission.attitude[seen],
    )


def flight(case: Case, seed: int, *, seconds: float = 0.0) -> Flown:
    mission = mission_of(case, seed)
    initial = initial_state(case, mission.initial, np.random.default_rng([seed, 1]))
    return folded(late(mission, seconds), parameters(case), [initial])


def turned(mission: Mission, seconds: tuple[float, float], angle: float) -> Mission:
    """The mission with a heading sensor that is off by an angle for a time."""
    t = mission.heading_stamps_ns / NS
    wrong = ((t >= seconds[0]) & (t < seconds[1]))[:, None, None]
    return replace(
        mission, attitude=np.where(wrong, about_down(angle) @ mission.attitude, mission.attitude)
    )


def events_of(mission: Mission) -> list[Event]:
    pings = zip(mission.dvl_stamps_ns.tolist(), mission.v_d, strict=True)
    turns = zip(mission.heading_stamps_ns.tolist(), mission.attitude, strict=True)
    return [*(Dvl(at, v) for at, v in pings), *(Heading(at, C) for at, C in turns)]


# ------------------------------------------------------------------ a heading that comes late


def test_a_heading_that_is_told_late_sets_position_and_velocity_right() -> None:
    """60 s under way at 1.8 m/s with a heading that is unknown and 143 deg off, then the first."""
    mission = mission_of(UNKNOWN, SEED)
    initial = initial_state(TOLD, mission.initial, np.random.default_rng([SEED, 1]))
    initial = replace(initial, C_o_b=about_down(2.5) @ initial.C_o_b)
    run = folded(late(mission, TOLD_AT), parameters(UNKNOWN), [initial])
    e = errors(run)
    wrong = abs(e[TOLD_AT - 2, HEADING])
    off = np.linalg.norm(run.truth.p_o[:, :2] - position_in_odom(run.states["nav"])[:, :2], axis=1)
    v_n = np.linalg.norm(run.truth.v_n - run.states["nav"]["v_n"], axis=1)
    assert wrong > 2.0
    assert off[TOLD_AT - 2] > 50.0
    assert v_n[TOLD_AT - 2] > 1.0
    sigma = heading_sigma_deg(run)
    assert sigma[TOLD_AT - 2] > 95.0
    assert 2.0 < sigma[TOLD_AT - 1] < 2.5  # sqrt(2^2 + 1^2)
    assert abs(heading_deg(run)[TOLD_AT - 1]) < 3.0 * sigma[TOLD_AT - 1]
    allowed = 3.0 * np.radians(sigma[TOLD_AT - 1])
    assert v_n[TOLD_AT - 1] < allowed * 2.0 + 0.1
    assert off[TOLD_AT - 1] < allowed * 110.0 + 3.0


@pytest.mark.long
def test_what_follows_a_late_heading_is_consistent() -> None:
    """NEES per degree of freedom right behind it and 15 s later, 60 runs, any heading.

    The 15 states together are those with the gyroscope bias, which has covered for the Earth's
    rotation in a heading that was not known.
    """
    runs, tail = 60, 0.0005
    found = [nees(flight(UNKNOWN, SEED + k, seconds=TOLD_AT)) for k in range(runs)]
    dof = {"velocity": 3, "attitude": 3, "heading": 1, "position": 3, "gyroscope bias": 3}
    dof["all"] = 15
    for block, m in dof.items():
        for at in (TOLD_AT - 1, TOLD_AT + 14):
            mean = np.mean([run[block][at] for run in found])
            low, high = chi2.ppf([tail, 1.0 - tail], m * runs) / (m * runs)
            assert low < mean < high, (block, at)


def test_what_the_bias_gives_back_is_symmetric_to_the_bit() -> None:
    filter_ = Filter(parameters(UNKNOWN))
    state = filter_.empty()
    for seed in range(20):
        s = state[0]
        s["nav"]["P"][:] = 0.0
        s["nav"]["C_n_b"] = Rotation.random(random_state=seed).as_matrix()
        take_earth_rate_from_bias(s, 3.0, 1e-7)
        P = s["nav"]["P"]
        assert P[GYROSCOPE_BIAS, GYROSCOPE_BIAS].any()
        np.testing.assert_array_equal(P, P.T)


@pytest.mark.parametrize("earth_rate", [True, False])
@pytest.mark.parametrize("grade", ["mems", "fog"])
def test_the_bias_gives_back_what_it_has_covered_of_the_earth_rate(
    grade: str, earth_rate: bool
) -> None:
    """Of a heading of 100 deg: r^2 b / (r^2 + b), r from E[cos] = exp(-1.52), b of the bias."""
    case = replace(UNKNOWN, grade=GRADES[grade], earth_rate=earth_rate)
    filter_ = Filter(parameters(case))
    state = filter_.empty()
    start = mission_of(replace(case, duration=1.0), SEED).initial
    v_b = start.C_n_b[0].T @ start.v_n[0]
    initial = Initial(NS, start.C_o_b[0], np.zeros(3), v_b, "body")
    filter_.initialise(state, initial, NS, np.zeros(3))
    nav = state[0]["nav"]
    C, before = nav["C_n_b"].copy(), nav["P"][GYROSCOPE_BIAS, GYROSCOPE_BIAS].copy()
    report = filter_.update(state, Heading(NS, C), np.zeros(3), 1.0)
    assert report is not None and report.accepted
    grown = C @ (nav["P"][GYROSCOPE_BIAS, GYROSCOPE_BIAS] - before) @ C.T
    expected = np.zeros(3)
    if earth_rate:
        one, two = (np.exp(-k * np.radians(100.0) ** 2) for k in (0.5, 2.0))
        cosine = 1.0 - 2.0 * one + 0.5 * (1.0 + two)
        sine = 0.5 * (1.0 - two) - one**2 * np.radians(100.0) ** 2
        r = np.array([cosine, sine, 0.0]) * (EARTH_RATE * np.cos(nav["llh"][0])) ** 2
        b = GRADES[grade].gyroscope_bias ** 2
        expected = r * b / (r + b)
        assert grade == "fog" or np.sqrt(expected[0]) > 6e-5  # rad/s, as the Earth turns
        assert grade == "mems" or expected[0] < b  # it could cover no more than it can be
    np.testing.assert_allclose(grown, np.diag(expected), atol=2e-3 * expected.max())


def automatic_start(case: Case) -> FilterParameters:
    told = parameters(case)
    initial = InitialParameters(
        accelerometer_bias_std=told.initial.accelerometer_bias_std,
        gyroscope_bias_std=told.initial.gyroscope_bias_std,
    )
    return replace(told, initial=initial)


def test_the_start_takes_the_heading_of_the_sensor() -> None:
    """With the covariance of heading and sensor error, P_he = -sigma_e^2."""
    mission = mission_of(replace(TOLD, duration=20.0), SEED)
    run = folded(mission, automatic_start(TOLD), [], from_start=True)
    start, P = run.states["start"][0], run.states["nav"]["P"][0]
    assert start["heading_from"] == automatic.SENSOR
    assert np.degrees(start["heading_std"]) == pytest.approx(np.hypot(2.0, 1.0), rel=0.02)
    e = run.filter.vehicle.blocks["heading_error"].start
    assert P[HEADING, e] == pytest.approx(-(np.radians(1.0) ** 2))
    assert abs(heading_deg(run)[0]) < 3.0 * heading_sigma_deg(run)[0]


@pytest.mark.parametrize("choice", ["unknown", "gyrocompass"])
def test_a_start_that_is_not_to_ask_it_does_not(choice: str) -> None:
    mission = mission_of(replace(TOLD, duration=10.0), SEED)
    settings = automatic_start(TOLD)
    settings = replace(settings, initial=replace(settings.initial, heading=choice))
    run = folded(mission, settings, [], from_start=True)
    assert run.states["start"][0]["heading_from"] == automatic.UNKNOWN
    assert heading_sigma_deg(run)[-1] < 2.0  # it is measured nevertheless


def test_a_heading_that_was_known_before_a_reset_is_better() -> None:
    """Of what is heard before the start: kept over the reset, then a sensor, then the IMU."""
    fold = Fold(automatic_start(TOLD))
    s, hear = fold.filter.empty()[0], fold.filter.start._automatic.hear_heading
    for source, expected in (
        (automatic.IMU, automatic.IMU),
        (automatic.SENSOR, automatic.SENSOR),
        (automatic.IMU, automatic.SENSOR),
        (automatic.KEPT, automatic.KEPT),
        (automatic.SENSOR, automatic.KEPT),
    ):
        hear(s, NS, np.eye(3), 0.1, source)
        assert s["start"]["told_by"] == expected


# ------------------------------------------------------------------ symmetry


@cache
def turned_flight(angle: float) -> FoldResult:
    """The same samples and body velocities, with a start and a sensor that are turned."""
    case = replace(TOLD, earth_rate=False, duration=40.0)
    mission = mission_of(case, SEED)
    initial = initial_state(case, mission.initial, np.random.default_rng([SEED, 1]))
    R = about_down(angle)
    mission = replace(mission, attitude=R @ mission.attitude)
    initial = replace(initial, C_o_b=R @ initial.C_o_b, p_o=np.zeros(3))
    settings = replace(parameters(case), gate=GateParameters())
    arrays = mission.stamps_ns, mission.f_b, mission.w_ib_b
    return fold_arrays(settings, *arrays, [initial, *events_of(mission)])


@pytest.mark.parametrize("angle", [0.7, 2.0, -2.0, np.pi])
def test_a_turned_start_and_sensor_turn_the_solution(angle: float) -> None:
    """Also where the heading passes +-180 deg: no innovation knows of it.

    The Earth's curvature is not the same in all directions: north turns by v tan(lat) / R, that is
    by 2e-7 rad/s and so by 8e-6 rad in 40 s; at 2 m/s by 2e-5 m/s, and by 6e-4 m.
    """
    one, other = turned_flight(0.0), turned_flight(angle)
    R = about_down(angle)
    a, b = one.states["nav"], other.states["nav"]
    np.testing.assert_allclose(b["C_n_b"], R @ a["C_n_b"], atol=1e-5)
    np.testing.assert_allclose(b["v_n"], a["v_n"] @ R.T, atol=2e-5)
    np.testing.assert_allclose(
        coordinates.from_reference(b), coordinates.from_reference(a) @ R.T, atol=6e-4
    )
    np.testing.assert_allclose(b["optional"], a["optional"], atol=1e-5)
    for first, second in zip(one.updates, other.updates, strict=True):
        nu = first.report.innovation, second.report.innovation
        np.testing.assert_allclose(*nu, atol=2e-5)
        assert first.report.reason == second.report.reason


# ------------------------------------------------------------------ the gate


def with_gate(case: Case, mission: Mission, **changes: Any) -> FoldResult:
    initial = initial_state(case, mission.initial, np.random.default_rng([SEED, 1]))
    settings = replace(parameters(case), gate=GateParameters(), **changes)
    arrays = mission.stamps_ns, mission.f_b, mission.w_ib_b
    return fold_arrays(settings, *arrays, [initial, *events_of(mission)])


def heading_errors(result: FoldResult, mission: Mission) -> tuple[np.ndarray, np.ndarray]:
    """Error and sigma (N,) of the heading [deg]."""
    nav = result.states["nav"]
    psi = coordinates.attitude_error(nav, mission.truth.C_n_b, invariant=True)
    return np.degrees(psi[:, 2]), np.degrees(np.sqrt(nav["P"][:, HEADING, HEADING]))


def reasons(result: FoldResult, seconds: tuple[float, float]) -> list[str]:
    first, last = (round(t * NS) for t in seconds)
    return [
        u.report.reason
        for u in result.updates
        if u.report.measurement == "heading" and first <= u.stamp_ns < last
    ]


@pytest.mark.parametrize("angle", [90.0, 179.0])
def test_a_glitch_of_one_sample_is_refused(angle: float) -> None:
    mission = mission_of(TOLD, SEED)
    clean = with_gate(TOLD, mission)
    glitched = with_gate(TOLD, turned(mission, (80.0, 80.5), np.radians(angle)))
    assert reasons(glitched, (80.0, 80.5)) == ["gate"]
    assert "gate" not in reasons(glitched, (0.0, 80.0)) + reasons(glitched, (81.0, 200.0))
    difference = heading_errors(glitched, mission)[0] - heading_errors(clean, mission)[0]
    assert np.abs(difference).max() < 0.5


@pytest.mark.parametrize("angle", [90.0, -20.0])
def test_steel_for_30_seconds_is_refused_and_its_end_is_believed(angle: float) -> None:
    mission = mission_of(TOLD, SEED)
    steel = (60.0, 90.0)
    result = with_gate(TOLD, turned(mission, steel, np.radians(angle)))
    assert set(reasons(result, steel)) == {"gate"}
    assert set(reasons(result, (91.0, 200.0))) == {""}
    error, sigma = heading_errors(result, mission)
    assert (np.abs(error[1000:]) < 3.0 * sigma[1000:]).all()
    assert np.abs(error[5900:]).max() < 3.0


@pytest.mark.long
def test_a_sensor_that_stays_turned_is_followed_in_the_end() -> None:
    """Nobody can tell which of both is wrong; the sigma says so meanwhile."""
    mission = mission_of(replace(TOLD, duration=400.0), SEED)
    angle = np.radians(40.0)
    result = with_gate(TOLD, turned(mission, (100.0, 500.0), angle))
    assert set(reasons(result, (100.0, 150.0))) == {"gate"}
    error, sigma = heading_errors(result, mission)
    assert abs(error[-1] + 40.0) < 3.0 * sigma[-1] + 5.0
    assert reasons(result, (390.0, 400.0)) == [""] * 10


# ------------------------------------------------------------------ order, rate, and other parts


def test_any_order_of_arrival_gives_the_same_bits() -> None:
    """With measurements that are left out as too close to the one before."""
    case = replace(TOLD, duration=10.0, heading=replace(SENSOR, rate=7.0))
    mission = mission_of(case, SEED)
    initial = initial_state(case, mission.initial, np.random.default_rng([SEED, 1]))
    told = parameters(case)
    settings = replace(told, heading=replace(told.heading, interval=0.3), max_delay=1.0)
    samples = zip(mission.stamps_ns.tolist(), mission.f_b, mission.w_ib_b, strict=True)
    events = [initial, *events_of(mission), *(Imu(*row) for row in samples)]
    expected = fold_arrays(
        settings,
        mission.stamps_ns,
        mission.f_b,
        mission.w_ib_b,
        [event for event in events if not isinstance(event, Imu)],
    )
    used = [u.stamp_ns for u in expected.updates if u.report.measurement == "heading"]
    assert np.diff(used).min() >= 0.3 * NS and len(used) < len(mission.heading_stamps_ns) / 2
    rng = np.random.default_rng(SEED)
    for _ in range(3):
        arrival = [event.stamp_ns + rng.uniform(0.0, 0.9) * NS for event in events]
        fold = Fold(settings)
        for k in np.argsort(arrival):
            assert fold.add(events[k]) is None
        assert fold.states.tobytes() == expected.states.tobytes()


def test_an_adaptive_process_noise_does_not_learn_from_it() -> None:
    case = replace(TOLD, duration=20.0)
    mission = mission_of(case, SEED)
    initial = initial_state(case, mission.initial, np.random.default_rng([SEED, 1]))
    noise = replace(parameters(case).process_noise, source="adaptive")
    settings = replace(parameters(case), process_noise=noise)
    arrays = mission.stamps_ns, mission.f_b, mission.w_ib_b
    for events in ([initial, *events_of(mission)], [initial, *events_of(late(mission, 100.0))]):
        result = fold_arrays(settings, *arrays, events)
        dvl = sum(u.report.measurement == "dvl" for u in result.updates)
        assert result.states["noise"]["innovation_count"][-1] == dvl


def test_without_a_heading_nothing_changes_to_the_bit() -> None:
    """A sensor that is declared and never heard."""
    case = replace(TOLD, duration=20.0)
    mission = late(mission_of(case, SEED), 1000.0)
    initial = initial_state(case, mission.initial, np.random.default_rng([SEED, 1]))
    on = folded(mission, parameters(case), [initial]).states["nav"]
    off = folded(mission, parameters(replace(case, heading=HeadingModel())), [initial]).states[
        "nav"
    ]
    for name in ("C_n_b", "v_n", "llh", "b_f", "b_w"):
        np.testing.assert_array_equal(off[name], on[name])
    np.testing.assert_array_equal(off["P"][:, :15, :15], on["P"][:, :15, :15])


def test_a_repeated_heading_is_frozen() -> None:
    case = replace(TOLD, duration=60.0)
    mission = mission_of(case, SEED)
    mission.attitude[29:] = mission.attitude[29]
    told = parameters(case)
    result = with_gate(case, mission, heading=replace(told.heading, frozen_samples=10))
    found = reasons(result, (0.0, 100.0))
    assert "frozen" not in found[:30]
    assert set(found[39:]) == {"frozen"}


def test_the_first_start_is_told_by_the_initial_state_alone() -> None:
    """A sensor that is heard before set_odometry starts nothing."""
    mission = mission_of(replace(TOLD, duration=5.0), SEED)
    result = fold_arrays(
        parameters(TOLD),
        mission.stamps_ns,
        mission.f_b,
        mission.w_ib_b,
        events_of(mission),
    )
    assert not result.states["nav"]["initialised"].any()
    assert {u.report.reason for u in result.updates} == {"not_initialised"}
