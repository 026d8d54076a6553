"""A start that assumes nothing: tilt, gyroscope bias, velocity and heading from what tells them."""

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from insdvl.arrays import Array
from insdvl.navigation.coordinates import body_velocity_jacobian
from insdvl.navigation.error_state import ATTITUDE, GYROSCOPE_BIAS, VELOCITY
from insdvl.navigation.events import NS, Event, Imu, Initial, Orientation, ProcessNoise
from insdvl.navigation.filter import Filter
from insdvl.navigation.geometry.earth import EARTH_RATE, gravity
from insdvl.navigation.geometry.frames import rotation_from_rpy
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.start import automatic, gyrocompass
from insdvl.navigation.state.fields import State
from insdvl.parameters.declaration import ParameterError, build
from insdvl.simulation.grades import GRADES, Grade
from insdvl.simulation.mission import simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.trajectories import AUV
from insdvl.timeline.fold import Fold
from insdvl.timeline.output import FoldResult
from insdvl.timeline.recorded import fold_arrays
from insdvl.watch.start import large_biases, report_of_start

SEED = 95_100  # chosen before the first run
FOG, TACTICAL, MEMS = (GRADES[name] for name in ("fog", "tactical", "mems"))
RATE, LATITUDE_DEG = 100, 40.0
LAT = np.radians(LATITUDE_DEG)
G_N = np.array([0.0, 0.0, gravity(LAT, 0.0)])
W_IE_N = EARTH_RATE * np.array([np.cos(LAT), 0.0, -np.sin(LAT)])
RPY = (0.04, -0.08, 2.0)
DVL_STD = 0.02


def settings(grade: Grade, **values: object) -> FilterParameters:
    """A filter that is told its IMU, and nothing of its start."""
    variances = grade.variances(float(RATE)).tolist()
    told = {
        "frame_convention": "ned",
        "origin.latitude_deg": LATITUDE_DEG,
        "dvl.noise_std": (DVL_STD,) * 3,
        "initial.accelerometer_bias_std": grade.accelerometer_bias,
        "initial.gyroscope_bias_std": grade.gyroscope_bias,
        "process_noise.accelerometer_variance": tuple(variances[:3]),
        "process_noise.gyroscope_variance": tuple(variances[3:]),
        "process_noise.accelerometer_bias_walk": 0.0,
        "process_noise.gyroscope_bias_walk": 0.0,
    }
    return build(FilterParameters, told | values)


def at_rest(
    grade: Grade, seconds: float, seed: int = 0, rpy: Sequence[float] = RPY
) -> tuple[np.ndarray, Array, Array, Array]:
    """Stamps (N,), f_b and w_ib_b (N, 3) with noise and a bias (6,), and that bias."""
    rng = np.random.default_rng([SEED, seed])
    n = round(seconds * RATE)
    bias = np.repeat([grade.accelerometer_bias, grade.gyroscope_bias], 3) * rng.standard_normal(6)
    error = bias + rng.standard_normal((n, 6)) * np.sqrt(grade.variances(float(RATE)))
    C = rotation_from_rpy(np.array(rpy))
    stamps_ns = NS + np.arange(n) * (NS // RATE)
    return stamps_ns, -C.T @ G_N + error[:, :3], C.T @ W_IE_N + error[:, 3:], bias


def rocked(stamps_ns: np.ndarray, f_b: Array, w_ib_b: Array, *, after: float) -> None:
    """From a time on the vehicle rolls by 1 deg with a period of 6 s, in place."""
    t = (stamps_ns - stamps_ns[0]) / NS - after
    angle = np.where(t > 0.0, np.radians(1.0) * np.sin(2 * np.pi * t / 6.0), 0.0)
    rolled = Rotation.from_rotvec(angle[:, None] * [1.0, 0.0, 0.0])
    f_b[:] = rolled.inv().apply(f_b)
    w_ib_b[:] = rolled.inv().apply(w_ib_b)
    w_ib_b[:, 0] += np.gradient(angle) * RATE


def pings(stamps_ns: np.ndarray, v_b: Sequence[float], every: int = RATE) -> list[Event]:
    """A DVL of base_link's velocity (3,), with noise."""
    rng = np.random.default_rng([SEED, 1])
    return [Dvl(int(ns), v_b + DVL_STD * rng.standard_normal(3)) for ns in stamps_ns[::every]]


def first_of(result: FoldResult) -> State:
    known = result.states["nav"]["initialised"]
    assert known.any(), "it has not started"
    return result.states[np.argmax(known)]


def error_of(s: State, C: Array) -> Array:
    """(3,) rotation from the state's attitude to the true one [rad]."""
    return Rotation.from_matrix(C @ s["nav"]["C_n_b"].T).as_rotvec()


def sigmas(s: State, at: slice) -> Array:
    return np.sqrt(np.diag(s["nav"]["P"])[at])


# ------------------------------------------------------------------ under way


@pytest.mark.parametrize("name", GRADES)
def test_under_way_it_starts_with_the_velocity_of_the_dvl_and_an_unknown_heading(name: str) -> None:
    grade = GRADES[name]
    mission = simulate(
        AUV, constant(grade.variances()), seed=SEED, duration=30.0, imu=grade.imu(), start_ns=NS
    )
    parameters = settings(
        grade,
        **{"origin.latitude_deg": float(np.degrees(AUV.lat_0)), "dvl.noise_std": (0.1,) * 3},
    )
    events = [Dvl(int(ns), v_d) for ns, v_d in zip(mission.dvl_stamps_ns, mission.v_d, strict=True)]
    result = fold_arrays(parameters, mission.stamps_ns, mission.f_b, mission.w_ib_b, events)
    s = first_of(result)
    assert s["nav"]["time_ns"] <= mission.start_ns + 2.1 * NS
    assert s["start"]["heading_from"] == automatic.UNKNOWN
    assert sigmas(s, ATTITUDE)[2] == pytest.approx(np.radians(100.0), rel=1e-6)
    # Tilt and velocity are independent of the heading, and right.
    first = int(np.argmax(result.states["nav"]["initialised"]))
    for k in (first, first + 100, len(result.states) - 1):
        s, truth = result.states[k], mission.truth
        up, true_up = s["nav"]["C_n_b"][2], truth.C_n_b[k, 2]
        tilt = np.linalg.norm(np.cross(up, true_up))
        assert tilt < 3.0 * np.linalg.norm(sigmas(s, ATTITUDE)[:2])
        v_b = s["nav"]["C_n_b"].T @ s["nav"]["v_n"]
        assert np.abs(v_b - truth.C_n_b[k].T @ truth.v_n[k]).max() < 0.4
    refused = [u.report.reason for u in result.updates if not u.report.accepted]
    assert set(refused) <= {"not_initialised"}


@pytest.mark.long
@pytest.mark.parametrize("name", GRADES)
def test_a_start_under_way_is_as_good_as_it_says(name: str) -> None:
    """NEES of body velocity, tilt and biases over 30 runs: inside 1 +- 4 sigma, or below it."""
    grade, runs = GRADES[name], 30
    parameters = settings(grade, **{"origin.latitude_deg": float(np.degrees(AUV.lat_0))})
    squares: dict[str, list[float]] = {"velocity": [], "tilt": [], "biases": []}
    dof = {"velocity": 3, "tilt": 2, "biases": 6}
    for run in range(runs):
        mission = simulate(
            AUV,
            constant(grade.variances()),
            seed=SEED + run,
            duration=200.0,
            imu=grade.imu(),
            dvl=DvlModel(noise_std=np.full(3, DVL_STD)),
            start_ns=NS,
        )
        events = [
            Dvl(int(ns), v_d) for ns, v_d in zip(mission.dvl_stamps_ns, mission.v_d, strict=True)
        ]
        result = fold_arrays(parameters, mission.stamps_ns, mission.f_b, mission.w_ib_b, events)
        nav, truth = result.states[-1]["nav"], mission.truth
        C, C_true, P = nav["C_n_b"], truth.C_n_b[-1], nav["P"][:15, :15]
        H = body_velocity_jacobian(C, nav["v_n"], invariant=True, n=15)
        e = C_true.T @ truth.v_n[-1] - C.T @ nav["v_n"]
        squares["velocity"].append(e @ np.linalg.solve(H @ P @ H.T, e))
        down = C @ (C_true[2] - C[2])  # -(psi x d)
        e = np.array([down[1], -down[0]])
        squares["tilt"].append(e @ np.linalg.solve(P[3:5, 3:5], e))
        e = mission.bias[-1] - np.concatenate([nav["b_f"], nav["b_w"]])
        squares["biases"].append(e @ np.linalg.solve(P[6:12, 6:12], e))
    for block, values in squares.items():
        n = dof[block]
        assert np.mean(values) / n < 1.0 + 4.0 * np.sqrt(2.0 / (n * runs)), block
        assert np.mean(values) / n > 0.3, block  # not far too careful either


def test_an_unknown_velocity_is_set_by_the_first_measurement() -> None:
    """It moves, so it starts; the DVL comes later and is not refused."""
    stamps_ns, f_b, w_ib_b, _ = at_rest(TACTICAL, 8.0)
    rocked(stamps_ns, f_b, w_ib_b, after=0.0)
    events = pings(stamps_ns[500:], (1.5, 0.0, 0.0))
    result = fold_arrays(settings(TACTICAL), stamps_ns, f_b, w_ib_b, events)
    s = first_of(result)
    assert s["nav"]["time_ns"] < stamps_ns[0] + 1.1 * NS
    assert not s["start"]["at_rest"] and not s["start"]["velocity_told"]
    assert sigmas(s, VELOCITY).min() > 4.9
    assert all(update.report.accepted for update in result.updates)
    last = result.states[-1]["nav"]
    assert np.abs(last["C_n_b"].T @ last["v_n"] - (1.5, 0.0, 0.0)).max() < 0.2


# ------------------------------------------------------------------ at rest


def test_at_rest_it_waits_for_a_velocity_or_for_motion() -> None:
    stamps_ns, f_b, w_ib_b, _ = at_rest(MEMS, 6.0)
    assert (
        not fold_arrays(settings(MEMS), stamps_ns, f_b, w_ib_b, [])
        .states["nav"]["initialised"]
        .any()
    )
    result = fold_arrays(settings(MEMS), stamps_ns, f_b, w_ib_b, pings(stamps_ns, (0.0,) * 3))
    assert first_of(result)["nav"]["time_ns"] == stamps_ns[100]
    zeros: list[Event] = [Dvl(int(ns), np.zeros(3)) for ns in stamps_ns[::100]]
    waits = fold_arrays(settings(MEMS), stamps_ns, f_b, w_ib_b, zeros)
    assert not waits.states["nav"]["initialised"].any()


def test_what_only_vibrates_is_waited_for_but_is_no_rest() -> None:
    """Five times the told noise: no way is made, and tilt and bias are not those of a rest."""
    stamps_ns, f_b, w_ib_b, _ = at_rest(TACTICAL, 4.0)
    rng = np.random.default_rng([SEED, 3])
    sigma = 5.0 * np.sqrt(TACTICAL.variances(float(RATE)))
    f_b += sigma[:3] * rng.standard_normal(f_b.shape)
    w_ib_b += sigma[3:] * rng.standard_normal(f_b.shape)
    waits = fold_arrays(settings(TACTICAL), stamps_ns, f_b, w_ib_b, [])
    assert not waits.states["nav"]["initialised"].any()
    events = pings(stamps_ns, (0.0,) * 3)
    s = first_of(fold_arrays(settings(TACTICAL), stamps_ns, f_b, w_ib_b, events))
    assert not s["start"]["at_rest"]
    assert s["start"]["tilt_std"] > np.radians(2.0)


def test_the_covariance_of_a_start_at_rest_is_that_of_its_errors() -> None:
    """Tilt and gyroscope bias of a MEMS over many biases, 5 states: the mean NEES is 5 +- 4 sigma.

    The two sigma of motion that nobody sees are not in these runs, so it may be below.
    """
    C, squares, runs = rotation_from_rpy(np.array(RPY)), [], 40
    for seed in range(runs):
        stamps_ns, f_b, w_ib_b, bias = at_rest(MEMS, 1.2, seed)
        events = pings(stamps_ns, (0.0,) * 3)
        s = first_of(fold_arrays(settings(MEMS), stamps_ns, f_b, w_ib_b, events))
        assert s["start"]["at_rest"]
        assert sigmas(s, GYROSCOPE_BIAS).max() < 0.6 * MEMS.gyroscope_bias
        # The heading is taken out: it is arbitrary, and horizontal axes turn with it.
        yaw = rotation_from_rpy(np.array([0.0, 0.0, RPY[2]]))
        tilt = error_of(s, yaw.T @ C)[:2]
        e = np.concatenate([tilt, bias[3:] - s["nav"]["b_w"]])
        P = s["nav"]["P"][np.ix_([3, 4, 9, 10, 11], [3, 4, 9, 10, 11])]
        squares.append(e @ np.linalg.solve(P, e))
    assert np.mean(squares) < 5.0 + 4.0 * np.sqrt(10.0 / runs)
    assert np.mean(squares) > 1.0


def test_a_turn_larger_than_the_bias_is_no_rest() -> None:
    stamps_ns, f_b, w_ib_b, _ = at_rest(MEMS, 1.2)
    w_ib_b[:, 2] += 5.0 * MEMS.gyroscope_bias
    events = pings(stamps_ns, (0.0,) * 3)
    s = first_of(fold_arrays(settings(MEMS), stamps_ns, f_b, w_ib_b, events))
    assert not s["start"]["at_rest"]
    np.testing.assert_array_equal(s["nav"]["b_w"], 0.0)
    assert sigmas(s, GYROSCOPE_BIAS).min() == pytest.approx(MEMS.gyroscope_bias)


# ------------------------------------------------------------------ heading


@pytest.mark.parametrize("source", ["constant", "external"])
def test_on_a_stand_a_fog_finds_the_heading_and_carries_it_to_the_water(source: str) -> None:
    """Still for 15 s, then it rolls: it starts within a second, with the heading of the stand."""
    stamps_ns, f_b, w_ib_b, _ = at_rest(FOG, 20.0)
    rocked(stamps_ns, f_b, w_ib_b, after=15.3)
    told = {"initial.gyrocompass_time": 12.0, "process_noise.source": source}
    events = learned(stamps_ns, FOG, 1.0) if source == "external" else []
    result = fold_arrays(settings(FOG, **told), stamps_ns, f_b, w_ib_b, events)
    s = first_of(result)
    assert s["start"]["heading_from"] == automatic.GYROCOMPASS
    assert 15.3 < (s["nav"]["time_ns"] - stamps_ns[0]) / NS < 17.0
    psi = error_of(s, rotation_from_rpy(np.array(RPY)))
    sigma = np.radians(1.0)  # of 12 s, and of the roll in the block that has seen it
    assert abs(psi[2]) < 3.0 * sigma
    assert sigmas(s, ATTITUDE)[2] < sigma


@pytest.mark.parametrize(("grade", "largest_deg"), [(FOG, 0.2), (TACTICAL, 7.0)])
def test_a_minute_on_a_stand_tells_the_heading(grade: Grade, largest_deg: float) -> None:
    """In a tank, where the DVL shows a velocity of zero: it waits until the minute is over."""
    stamps_ns, f_b, w_ib_b, _ = at_rest(grade, 62.0)
    result = fold_arrays(settings(grade), stamps_ns, f_b, w_ib_b, pings(stamps_ns, (0.0,) * 3))
    s = first_of(result)
    assert s["start"]["heading_from"] == automatic.GYROCOMPASS
    assert 60.0 <= (s["nav"]["time_ns"] - stamps_ns[0]) / NS < 62.0
    sigma = sigmas(s, ATTITUDE)[2]
    assert sigma < np.radians(largest_deg)
    assert abs(error_of(s, rotation_from_rpy(np.array(RPY)))[2]) < 3.0 * sigma


def test_a_float_that_rocks_has_no_heading() -> None:
    stamps_ns, f_b, w_ib_b, _ = at_rest(FOG, 3.0)
    rocked(stamps_ns, f_b, w_ib_b, after=0.0)
    s = first_of(fold_arrays(settings(FOG), stamps_ns, f_b, w_ib_b, []))
    assert s["start"]["heading_from"] == automatic.UNKNOWN


def learned(stamps_ns: np.ndarray, grade: Grade, factor: float) -> list[Event]:
    """Each second a Q that is a factor of the variance of the samples."""
    q = factor * grade.variances(float(RATE))
    return [ProcessNoise(int(ns), np.diag(q[:3]), np.diag(q[3:])) for ns in stamps_ns[::RATE]]


@pytest.mark.parametrize("factor", [0.3, 1.0, 2.0])
@pytest.mark.parametrize("mode", ["auto", "gyrocompassing"])
def test_a_learned_noise_that_is_a_factor_off_hides_no_rest(mode: str, factor: float) -> None:
    """What a filter integrates is no variance of samples, and known to a factor only."""
    stamps_ns, f_b, w_ib_b, _ = at_rest(FOG, 62.0)
    parameters = settings(FOG, **{"process_noise.source": "external", "initial.mode": mode})
    events = pings(stamps_ns, (0.0,) * 3) + learned(stamps_ns, FOG, factor)
    s = first_of(fold_arrays(parameters, stamps_ns, f_b, w_ib_b, events))
    assert s["start"]["compass"] == gyrocompass.FOUND
    sigma = sigmas(s, ATTITUDE)[2]
    assert np.radians(0.05) < sigma < np.radians(0.3)
    assert abs(error_of(s, rotation_from_rpy(np.array(RPY)))[2]) < 3.0 * sigma


@pytest.mark.parametrize("factor", [0.3, 1.0, 2.0])
def test_a_learned_noise_makes_no_rest_of_a_float_that_rocks(factor: float) -> None:
    stamps_ns, f_b, w_ib_b, _ = at_rest(FOG, 3.0)
    rocked(stamps_ns, f_b, w_ib_b, after=0.0)
    parameters = settings(FOG, **{"process_noise.source": "external"})
    s = first_of(fold_arrays(parameters, stamps_ns, f_b, w_ib_b, learned(stamps_ns, FOG, factor)))
    assert s["start"]["heading_from"] == automatic.UNKNOWN
    assert not s["start"]["at_rest"]


def test_a_rest_that_becomes_quiet_keeps_its_noise() -> None:
    """A pump that stops in the last second: the mean is of all samples."""
    stamps_ns, f_b, w_ib_b, _ = at_rest(FOG, 62.0)
    pumped = (stamps_ns - stamps_ns[0]) / NS < 59.4
    noise = np.random.default_rng(4).standard_normal((len(stamps_ns), 6))
    noise *= 10.0 * np.sqrt(FOG.variances(float(RATE))) * pumped[:, None]
    parameters = settings(FOG, **{"process_noise.source": "external"})
    events = pings(stamps_ns, (0.0,) * 3) + learned(stamps_ns, FOG, 1.0)
    s = first_of(
        fold_arrays(parameters, stamps_ns, f_b + noise[:, :3], w_ib_b + noise[:, 3:], events)
    )
    assert s["start"]["heading_from"] == automatic.GYROCOMPASS
    assert np.radians(0.8) < sigmas(s, ATTITUDE)[2] < np.radians(1.6)


@pytest.mark.parametrize("mode", ["auto", "gyrocompassing"])
def test_a_block_of_one_sample_shows_no_spread(mode: str) -> None:
    stamps_ns, f_b, w_ib_b, _ = at_rest(FOG, 1.0)
    told = {"initial.mode": mode, "initial.levelling_time": 1e-10}
    parameters = settings(FOG, **{"process_noise.source": "external"}, **told)
    result = fold_arrays(parameters, stamps_ns, f_b, w_ib_b, learned(stamps_ns, FOG, 1.0))
    assert len(result.states) == len(stamps_ns)


def orientations(stamps_ns: np.ndarray, std: float) -> list[Event]:
    C = rotation_from_rpy(np.array(RPY))
    return [Orientation(int(ns), C, std) for ns in stamps_ns]


def test_the_orientation_of_the_imu_tells_the_heading() -> None:
    stamps_ns, f_b, w_ib_b, _ = at_rest(MEMS, 1.5)
    events = pings(stamps_ns, (0.0,) * 3) + orientations(stamps_ns, 0.05)
    s = first_of(fold_arrays(settings(MEMS), stamps_ns, f_b, w_ib_b, events))
    assert s["start"]["heading_from"] == automatic.IMU
    psi = error_of(s, rotation_from_rpy(np.array(RPY)))
    assert abs(psi[2]) < 0.01  # told exactly; the tilt is that of the accelerometers
    assert sigmas(s, ATTITUDE)[2] == pytest.approx(0.05, rel=0.05)


def test_an_orientation_in_other_axes_is_not_used() -> None:
    """Up and down exchanged, as of an ENU orientation in an NED stream."""
    stamps_ns, f_b, w_ib_b, _ = at_rest(MEMS, 1.5)
    C = np.diag([1.0, -1.0, -1.0]) @ rotation_from_rpy(np.array(RPY))
    wrong: list[Event] = [Orientation(int(ns), C, 0.05) for ns in stamps_ns]
    events = pings(stamps_ns, (0.0,) * 3) + wrong
    s = first_of(fold_arrays(settings(MEMS), stamps_ns, f_b, w_ib_b, events))
    assert s["start"]["heading_from"] == automatic.UNKNOWN


@pytest.mark.parametrize(
    ("choice", "source"),
    [
        ("parameters", automatic.PARAMETERS),
        ("gyrocompass", automatic.UNKNOWN),  # a MEMS cannot
        ("unknown", automatic.UNKNOWN),
    ],
)
def test_another_choice_does_not_ask_the_imu(choice: str, source: int) -> None:
    stamps_ns, f_b, w_ib_b, _ = at_rest(MEMS, 1.5)
    values = {"initial.heading": choice, "initial.rpy": (0.0, 0.0, 1.0)}
    events = pings(stamps_ns, (0.0,) * 3) + orientations(stamps_ns, 0.05)
    s = first_of(fold_arrays(settings(MEMS, **values), stamps_ns, f_b, w_ib_b, events))
    assert s["start"]["heading_from"] == source
    if source == automatic.PARAMETERS:
        C = s["nav"]["C_n_b"]
        assert np.arctan2(C[1, 0], C[0, 0]) == pytest.approx(1.0)
        assert sigmas(s, ATTITUDE)[2] == pytest.approx(np.radians(1.0), rel=0.01)


def test_told_to_use_the_imu_it_waits_for_its_orientation() -> None:
    stamps_ns, f_b, w_ib_b, _ = at_rest(MEMS, 4.0)
    parameters = settings(MEMS, **{"initial.heading": "imu"})
    events = pings(stamps_ns, (0.0,) * 3) + orientations(stamps_ns[250:], 0.05)
    s = first_of(fold_arrays(parameters, stamps_ns, f_b, w_ib_b, events))
    assert s["nav"]["time_ns"] > stamps_ns[250]


def test_set_odometry_comes_before_all_else() -> None:
    stamps_ns, f_b, w_ib_b, _ = at_rest(MEMS, 2.0)
    C = rotation_from_rpy(np.array([0.0, 0.0, 1.3]))
    told = Initial(int(stamps_ns[30]), C, np.ones(3), np.zeros(3), "body")
    events = [told, *pings(stamps_ns, (0.0,) * 3), *orientations(stamps_ns, 0.05)]
    result = fold_arrays(settings(MEMS), stamps_ns, f_b, w_ib_b, events)
    s = first_of(result)
    assert s["nav"]["time_ns"] == stamps_ns[30]
    assert s["start"]["heading_from"] == automatic.TOLD


def test_a_heading_with_another_mode_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"initial\.heading.*'levelling'"):
        build(FilterParameters, {"initial.mode": "levelling", "initial.heading": "imu"})


# ------------------------------------------------------------------ interruptions


@pytest.mark.parametrize("interruption", ["gap", "force"])
def test_what_interrupts_the_wait_for_a_velocity_starts_gyrocompassing_again(
    interruption: str,
) -> None:
    """The heading is found after 12 s; at 14 s samples are missing or it is shaken; DVL at 16 s."""
    stamps_ns, f_b, w_ib_b, _ = at_rest(FOG, 29.0)
    events = pings(stamps_ns[1600:], (0.0,) * 3)
    if interruption == "force":
        f_b[1430:1470] *= 1.3
    else:
        stamps_ns, f_b, w_ib_b = (
            np.delete(x, range(1400, 1430), 0) for x in (stamps_ns, f_b, w_ib_b)
        )
    parameters = settings(FOG, **{"initial.gyrocompass_time": 12.0})
    result = fold_arrays(parameters, stamps_ns, f_b, w_ib_b, events)
    s = first_of(result)
    assert np.isfinite(s["nav"]["P"]).all() and np.isfinite(s["nav"]["C_n_b"]).all()
    assert s["start"]["heading_from"] == automatic.GYROCOMPASS
    assert (s["nav"]["time_ns"] - NS) / NS > 26.0
    psi = error_of(s, rotation_from_rpy(np.array(RPY)))
    assert abs(psi[2]) < 3.0 * sigmas(s, ATTITUDE)[2] < np.radians(3.0)


def test_a_beginning_that_is_not_finite_is_refused() -> None:
    """A rest without samples, of which the record says that it has told the heading."""
    stamps_ns, f_b, w_ib_b, _ = at_rest(FOG, 1.02)
    filter_ = Filter(settings(FOG))
    state = filter_.empty()
    state[0]["start"]["compass"] = gyrocompass.FOUND
    filter_.start.hear_velocity(state[0], int(stamps_ns[0]), np.zeros(3), np.eye(3) * 1e-4)
    with np.errstate(invalid="ignore", divide="ignore"):
        for ns, f, w in zip(stamps_ns, f_b, w_ib_b, strict=True):
            filter_.await_start(state, Imu(int(ns), f, w), np.concatenate([f, w]))
    assert not state[0]["nav"]["initialised"]
    assert state[0]["counters"]["not_level"] == 1
    assert state[0]["start"]["compass"] == gyrocompass.UNDECIDED


def test_a_sample_without_data_does_not_spoil_gyrocompassing() -> None:
    stamps_ns, f_b, w_ib_b, _ = at_rest(FOG, 14.0)
    f_b[600], w_ib_b[600] = 0.0, 0.0
    parameters = settings(FOG, **{"initial.gyrocompass_time": 12.0})
    s = first_of(fold_arrays(parameters, stamps_ns, f_b, w_ib_b, pings(stamps_ns, (0.0,) * 3)))
    assert s["start"]["heading_from"] == automatic.GYROCOMPASS


def test_a_time_without_data_is_a_gap_to_levelling() -> None:
    stamps_ns, f_b, w_ib_b, _ = at_rest(MEMS, 3.0)
    f_b[80:130], w_ib_b[80:130] = 0.0, 0.0
    result = fold_arrays(settings(MEMS), stamps_ns, f_b, w_ib_b, pings(stamps_ns, (0.0,) * 3))
    s = first_of(result)
    assert s["nav"]["time_ns"] == stamps_ns[230]
    assert s["counters"]["not_level"] == 1


def test_a_glitch_does_not_turn_the_told_heading() -> None:
    """20 rad/s in one sample of 10 ms would be 0.2 rad."""
    stamps_ns, f_b, w_ib_b, _ = at_rest(FOG, 1.5)
    w_ib_b[70, 2] = 20.0
    events = pings(stamps_ns, (0.0,) * 3) + orientations(stamps_ns[:1], 0.01)
    s = first_of(fold_arrays(settings(FOG), stamps_ns, f_b, w_ib_b, events))
    assert s["start"]["heading_from"] == automatic.IMU and s["start"]["at_rest"]
    assert abs(error_of(s, rotation_from_rpy(np.array(RPY)))[2]) < 0.01


@pytest.mark.parametrize("speed", [0.0, 3.0])
def test_a_dvl_without_one_component_starts_the_filter(speed: float) -> None:
    """The second axis of a DVL that is turned by 0.5 rad has failed: its velocity is unknown."""
    stamps_ns, f_b, w_ib_b, _ = at_rest(MEMS, 1.5)
    C_b_d = rotation_from_rpy(np.array([0.0, 0.0, 0.5]))
    events: list[Event] = [
        Dvl(event.stamp_ns, event.v_d * [1.0, 0.0, 1.0], measured=(True, False, True))
        for event in pings(stamps_ns, C_b_d.T @ (speed * C_b_d[:, 0]))
        if isinstance(event, Dvl)
    ]
    parameters = settings(MEMS, **{"dvl.mount": (0.0, 0.0, 0.5)})
    s = first_of(fold_arrays(parameters, stamps_ns, f_b, w_ib_b, events))
    assert s["nav"]["time_ns"] == stamps_ns[100]
    assert s["start"]["at_rest"] == (speed == 0.0)
    C_d_n, nav = C_b_d.T @ s["nav"]["C_n_b"].T, s["nav"]
    H = body_velocity_jacobian(nav["C_n_b"], nav["v_n"], invariant=True, n=15)
    sigma = np.sqrt(np.diag(C_b_d.T @ H @ nav["P"][:15, :15] @ H.T @ C_b_d))
    assert sigma[1] == pytest.approx(automatic.UNKNOWN_SPEED, rel=0.02)
    assert sigma[[0, 2]].max() < 1.0
    assert C_d_n @ nav["v_n"] == pytest.approx([speed, 0.0, 0.0], abs=0.1)


# ------------------------------------------------------------------ a vertical vehicle


@pytest.mark.parametrize("pitch", [90.0, -90.0, 88.0, -88.0])
@pytest.mark.parametrize("mode", ["levelling", "auto"])
def test_levelling_a_vertical_vehicle_is_honest_about_the_vertical(pitch: float, mode: str) -> None:
    """A lateral bias of 0.05 m/s^2 beside a nose that points up or down."""
    rpy = (0.0, np.radians(pitch), 0.3)
    stamps_ns, f_b, w_ib_b, _ = at_rest(FOG, 1.5, rpy=rpy)
    f_b[:, 1] += 0.05
    values: dict[str, object] = {
        "initial.mode": mode,
        "initial.rpy": (0.0, 0.0, 0.3),
        "initial.accelerometer_bias_std": 0.05,
    }
    if mode == "auto":
        values["initial.heading"] = "parameters"
    events = pings(stamps_ns, (0.0,) * 3)
    s = first_of(fold_arrays(settings(FOG, **values), stamps_ns, f_b, w_ib_b, events))
    psi = error_of(s, rotation_from_rpy(np.array(rpy)))
    assert (np.abs(psi) < 3.0 * sigmas(s, ATTITUDE)).all()


# ------------------------------------------------------------------ order, reset, findings


def test_the_start_depends_on_stamps_alone() -> None:
    """Events that arrive late and in any order: the same bits."""
    stamps_ns, f_b, w_ib_b, _ = at_rest(TACTICAL, 4.0)
    rocked(stamps_ns, f_b, w_ib_b, after=2.5)
    events: list[Event] = pings(stamps_ns[130:], (0.3, 0.0, 0.0), every=37)
    events += orientations(stamps_ns[:250:5], 0.1)
    whole = fold_arrays(settings(TACTICAL), stamps_ns, f_b, w_ib_b, events)
    assert first_of(whole)["start"]["heading_from"] == automatic.IMU
    events += [Imu(int(ns), f, w) for ns, f, w in zip(stamps_ns, f_b, w_ib_b, strict=True)]
    rng = np.random.default_rng([SEED, 2])
    arrival = [event.stamp_ns + rng.uniform(0.0, 1.5) * NS for event in events]
    fold = Fold(settings(TACTICAL))
    for k in np.argsort(arrival):
        assert fold.add(events[k]) is None
        if k % 50 == 0:
            fold.take()
    assert fold.states[-1].tobytes() == whole.states[-1].tobytes()


def test_a_reset_keeps_heading_and_position() -> None:
    stamps_ns, f_b, w_ib_b, _ = at_rest(TACTICAL, 6.0)
    C = rotation_from_rpy(np.array(RPY))
    fold = Fold(settings(TACTICAL))
    told = Initial(
        int(stamps_ns[10]),
        C,
        np.array([30.0, -20.0, 4.0]),
        np.zeros(3),
        "body",
        P_psi=np.diag([1e-4, 1e-4, 0.03**2]),
        P_p=np.eye(3) * 4.0,
    )
    events = [told, *pings(stamps_ns, (0.0,) * 3)]
    samples = [Imu(int(ns), f, w) for ns, f, w in zip(stamps_ns, f_b, w_ib_b, strict=True)]
    for event in sorted([*samples, *events], key=lambda event: event.stamp_ns):
        fold.add(event)
        if event.stamp_ns == stamps_ns[300] and isinstance(event, Imu):
            fold.take()
            assert fold.reset()
            assert fold.latest is None
    s = fold.latest
    assert s is not None and s["start"]["heading_from"] == automatic.KEPT
    assert abs(error_of(s, C)[2]) < 0.003
    assert 0.029 < sigmas(s, ATTITUDE)[2] < 0.032
    assert s["nav"]["llh"][2] == pytest.approx(-4.0, abs=0.2)
    assert np.sqrt(s["nav"]["P"][14, 14]) == pytest.approx(2.0, abs=0.1)


def test_what_the_start_took_and_what_is_missing_is_said() -> None:
    stamps_ns, f_b, w_ib_b, _ = at_rest(MEMS, 1.5)
    events = pings(stamps_ns, (0.0,) * 3)
    result = fold_arrays(settings(MEMS), stamps_ns, f_b, w_ib_b, events)
    report = report_of_start(result.filter, result.states[-1])
    assert "heading unknown" in report.text and "velocity from the DVL" in report.text
    assert "initial.mode:=topic" in report.missing and "100 deg" in report.missing
    told = fold_arrays(
        settings(MEMS), stamps_ns, f_b, w_ib_b, events + orientations(stamps_ns, 0.05)
    )
    report = report_of_start(told.filter, told.states[-1])
    assert not report.missing and "orientation in imu/data_raw" in report.text


def test_a_bias_beyond_four_of_its_initial_sigma_is_a_finding() -> None:
    """A MEMS flown as a FOG; told rightly there is none."""
    stamps_ns, f_b, w_ib_b, _ = at_rest(TACTICAL, 60.0)
    w_ib_b += np.radians([0.0, 0.0, 360.0]) / 3600.0
    C = rotation_from_rpy(np.array(RPY))
    told = Initial(int(stamps_ns[0]), C, np.zeros(3), np.zeros(3), "body")
    f_b[:, 2] += 0.2
    events = [told, *pings(stamps_ns, (0.0,) * 3)]
    values: dict[str, object] = {"initial.mode": "set_odometry", "gate.enabled": False}
    result = fold_arrays(settings(TACTICAL, **values), stamps_ns, f_b, w_ib_b, events)
    found = large_biases(result.filter, result.states[-1])
    assert any("accelerometer bias z" in text for text in found)
    values["initial.accelerometer_bias_std"] = 0.2
    values["initial.gyroscope_bias_std"] = 2e-3
    result = fold_arrays(settings(TACTICAL, **values), stamps_ns, f_b, w_ib_b, events)
    assert not large_biases(result.filter, result.states[-1])


def test_a_bias_that_is_told_exactly_is_no_finding() -> None:
    """A sigma of zero: the estimate differs from what was told by rounding alone."""
    stamps_ns, f_b, w_ib_b, _ = at_rest(MEMS, 1.5)
    values: dict[str, object] = {
        "initial.mode": "parameters",
        "imu.mount": (0.1, 0.2, 0.3),
        "initial.accelerometer_bias": (0.01, 0.02, 0.03),
        "initial.accelerometer_bias_std": 0.0,
        "initial.gyroscope_bias": (1e-4, 2e-4, 3e-4),
        "initial.gyroscope_bias_std": 0.0,
    }
    result = fold_arrays(settings(MEMS, **values), stamps_ns, f_b, w_ib_b, [])
    assert not large_biases(result.filter, result.states[-1])
