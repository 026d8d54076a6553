"""The heading of a vehicle at rest, from the rotation of the Earth: where it is found, how well.

Statistics of `insdvl.studies.consistency.gyrocompassing`; seeds were chosen before the first run.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from insdvl.navigation.events import NS, Event, Imu, Initial, ProcessNoise
from insdvl.navigation.geometry.earth import EARTH_RATE, gravity
from insdvl.navigation.geometry.frames import rotation_from_rpy
from insdvl.navigation.parameters import (
    FilterParameters,
    InitialParameters,
    OriginParameters,
)
from insdvl.navigation.start import gyrocompass
from insdvl.navigation.start.gyrocompass import (
    FOUND,
    GAP,
    INACCURATE,
    MOVES,
    NOT_THE_EARTH,
    UNDECIDED,
)
from insdvl.navigation.state.fields import State
from insdvl.parameters.declaration import ParameterError
from insdvl.simulation.grades import GRADES, Grade
from insdvl.studies.consistency.errors import heading_sigma_deg, nees
from insdvl.studies.consistency.flights import Case, flown, process_noise_of
from insdvl.studies.consistency.gyrocompassing import DEPARTURE, Departure, depart, rocked
from insdvl.timeline.fold import Fold
from insdvl.timeline.recorded import fold_arrays

FOG, TACTICAL, MEMS = (GRADES[name] for name in ("fog", "tactical", "mems"))
SEED = 93_500
RUNS, SHORT_RUNS, SHORT = 100, 5, 240.0

LATITUDE_DEG, RATE = 52.0, 100
LAT = np.radians(LATITUDE_DEG)
G_N = np.array([0.0, 0.0, gravity(LAT, 0.0)])
W_IE_N = EARTH_RATE * np.array([np.cos(LAT), 0.0, -np.sin(LAT)])
RPY = (0.05, -0.1, 2.2)


# ------------------------------------------------------------------ the matrices


@pytest.mark.parametrize("rpy", [(0.0, 0.0, 0.0), RPY, (-0.4, 0.3, -1.2)])
def test_the_jacobian_is_that_of_the_attitude(rpy: tuple[float, float, float]) -> None:
    """Central differences of the rotation that errors of the two means leave."""
    C = rotation_from_rpy(np.array(rpy))
    f, w = -C.T @ G_N, C.T @ W_IE_N

    def psi(e: np.ndarray) -> np.ndarray:
        return Rotation.from_matrix(C @ gyrocompass.attitude(f + e[:3], w + e[3:]).T).as_rotvec()

    found = np.empty((3, 6))
    for k, step in enumerate([1e-4] * 3 + [1e-9] * 3):
        e = np.eye(6)[k] * step
        found[:, k] = (psi(e) - psi(-e)) / (2.0 * step)
    np.testing.assert_allclose(psi(np.zeros(6)), 0.0, atol=1e-12)
    J = gyrocompass.jacobian(C, LAT, 0.0)
    np.testing.assert_allclose(J[:, :3], found[:, :3], atol=1e-8)
    np.testing.assert_allclose(J[:, 3:] * EARTH_RATE, found[:, 3:] * EARTH_RATE, atol=1e-8)


# ------------------------------------------------------------------ the start


def settings(grade: Grade, **initial: object) -> FilterParameters:
    return FilterParameters(
        frame_convention="ned",
        process_noise=process_noise_of(grade),
        initial=InitialParameters(
            mode="gyrocompassing",
            rpy=(0.0, 0.0, -0.5),
            heading_std=np.radians(45.0),
            accelerometer_bias_std=grade.accelerometer_bias,
            gyroscope_bias_std=grade.gyroscope_bias,
            **initial,
        ),
        origin=OriginParameters(latitude_deg=LATITUDE_DEG),
    )


def readings(
    grade: Grade, seed: int, seconds: float = 65.0, bias: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps (N,), f_b and w_ib_b (N, 3) at rest, with noise and one bias (6,)."""
    rng = np.random.default_rng([SEED, seed])
    n = round(seconds * RATE)
    C = rotation_from_rpy(np.array(RPY))
    noise = rng.standard_normal((n, 6)) * np.sqrt(grade.variances(float(RATE)))
    if bias is not None:
        noise += bias
    stamps_ns = NS + np.arange(n) * (NS // RATE)
    return stamps_ns, -C.T @ G_N + noise[:, :3], C.T @ W_IE_N + noise[:, 3:]


def first_state(parameters: FilterParameters, *arrays: np.ndarray) -> State:
    states = fold_arrays(parameters, *arrays, []).states
    return states[np.argmax(states["nav"]["initialised"])]


def outcome(parameters: FilterParameters, *arrays: np.ndarray) -> int:
    s = first_state(parameters, *arrays)
    assert s["nav"]["initialised"]
    return int(s["start"]["compass"])


def heading(s: State) -> float:
    C = s["nav"]["C_n_b"]
    return float(np.arctan2(C[1, 0], C[0, 0]))


def told(s: State) -> bool:
    """Whether it has started with the heading, and the sigma, that were told."""
    sigma = np.sqrt(s["nav"]["P"][5, 5])
    return np.isclose(heading(s), -0.5) and np.isclose(sigma, np.radians(45.0))


def test_a_fog_finds_the_heading_and_its_covariance_with_the_biases() -> None:
    """P_0 against the errors of many starts, biases drawn from what is told; 9 of 15 states."""
    parameters, runs = settings(FOG, gyrocompass_time=12.0), 60
    sigma = np.repeat([FOG.accelerometer_bias, FOG.gyroscope_bias], 3)
    C, errors = rotation_from_rpy(np.array(RPY)), []
    for run in range(runs):
        bias = sigma * np.random.default_rng([SEED, 50, run]).standard_normal(6)
        s = first_state(parameters, *readings(FOG, run, 13.0, bias))
        assert s["start"]["compass"] == FOUND
        psi = Rotation.from_matrix(C @ s["nav"]["C_n_b"].T).as_rotvec()
        errors.append([*psi, *bias])
    P = s["nav"]["P"][3:12, 3:12]
    white = np.linalg.solve(np.linalg.cholesky(P), np.array(errors).T)
    # A sample covariance of `runs` normal vectors, to five sigma of an element.
    np.testing.assert_allclose(white @ white.T / runs, np.eye(9), atol=5.0 * np.sqrt(2.0 / runs))
    assert np.sqrt(P[2, 2]) == pytest.approx(s["start"]["compass_number"])


def test_a_mems_starts_after_a_second_with_what_is_told() -> None:
    s = first_state(settings(MEMS), *readings(MEMS, 0, 5.0))
    assert s["start"]["compass"] == INACCURATE
    assert s["nav"]["time_ns"] == 2 * NS
    assert told(s)


def test_a_sigma_that_is_told_smaller_is_used() -> None:
    """A tactical gyroscope reaches some degrees: better than 45, worse than 1."""
    arrays = readings(TACTICAL, 0)
    assert outcome(settings(TACTICAL), *arrays) == FOUND
    parameters = settings(TACTICAL)
    known = replace(parameters.initial, heading_std=np.radians(1.0))
    assert outcome(replace(parameters, initial=known), *arrays) == INACCURATE


@pytest.mark.parametrize("amplitude", [3e-6, 1e-5, 1e-2])
def test_a_swing_is_recognised(amplitude: float) -> None:
    """The smallest, by the sum of many misfits: it would turn the heading by 0.1 deg."""
    stamps_ns, f_b, w_ib_b = readings(FOG, 1)
    phase = 2.0 * np.pi * 0.15 * stamps_ns / NS
    swung = w_ib_b + np.outer(amplitude * 2.0 * np.pi * 0.15 * np.cos(phase), [0.0, 0.0, 1.0])
    s = first_state(settings(FOG), stamps_ns, f_b, swung)
    assert s["start"]["compass"] == MOVES
    assert told(s)


def test_a_slow_turn_is_recognised() -> None:
    """Of 1 deg/h about the vertical: constant, so nothing but the Earth's rate tells it."""
    stamps_ns, f_b, w_ib_b = readings(FOG, 2)
    turned = w_ib_b + np.array([0.0, 0.0, np.radians(1.0) / 3600.0])
    assert outcome(settings(FOG), stamps_ns, f_b, turned) == NOT_THE_EARTH


def test_a_wrong_latitude_is_recognised() -> None:
    elsewhere = replace(settings(FOG), origin=OriginParameters(latitude_deg=50.0))
    assert outcome(elsewhere, *readings(FOG, 3)) == NOT_THE_EARTH


def test_a_gap_ends_it_and_the_filter_starts() -> None:
    stamps_ns, f_b, w_ib_b = readings(FOG, 4)
    stamps_ns[1000:] += NS // 2
    s = first_state(settings(FOG), stamps_ns, f_b, w_ib_b)
    assert s["start"]["compass"] == GAP
    assert s["nav"]["time_ns"] == stamps_ns[1100]
    assert told(s)


def test_zeros_in_the_first_second_only_restart_it() -> None:
    stamps_ns, f_b, w_ib_b = readings(FOG, 5)
    f_b[:50], w_ib_b[:50] = 0.0, 0.0
    assert outcome(settings(FOG), stamps_ns, f_b, w_ib_b) == FOUND


def test_a_vehicle_at_rest_is_not_taken_for_a_moving_one() -> None:
    """The tests together fail a start at rest less than once in 5,000: 60 blocks, two tests each.

    The squared misfits of the blocks have the mean of their degrees of freedom.
    """
    misfits, blocks = 0.0, 0
    for run in range(8):
        s = first_state(settings(FOG), *readings(FOG, 100 + run))
        assert s["start"]["compass"] == FOUND
        misfits += s["start"]["rest_nis"]
        blocks += s["start"]["rest_blocks"]
    dof = 6 * blocks
    assert abs(misfits - dof) < 5.0 * np.sqrt(2.0 * dof)


def test_half_a_second_of_vibration_does_not_end_it_with_a_learned_noise() -> None:
    """Alone it would make a heading of 60 degrees; among 60 s it counts with its share."""
    received = settings(FOG)
    received = replace(received, process_noise=replace(received.process_noise, source="external"))
    stamps_ns, f, w = readings(FOG, 0)
    during = slice(30 * RATE, 30 * RATE + RATE // 2)
    shaken = w.copy()
    shaken[during] += 2e-4 * np.sin(2.0 * np.pi * 10.0 * np.arange(RATE // 2) / RATE)[:, None]
    Q = np.diag(FOG.variances(float(RATE)))
    told_ns = range(NS + 1, int(stamps_ns[-1]), NS)
    learned: list[Event] = [ProcessNoise(t, Q[:3, :3], Q[3:, 3:]) for t in told_ns]
    sigmas = []
    for rates in (w, shaken):
        states = fold_arrays(received, stamps_ns, f, rates, learned).states
        s = states[np.argmax(states["nav"]["initialised"])]
        assert s["start"]["compass"] == FOUND
        sigmas.append(float(np.sqrt(s["nav"]["P"][5, 5])))
        assert abs(heading(s) - RPY[2]) < 4.0 * sigmas[-1]
    assert sigmas[0] < sigmas[1] < np.radians(5.0)


def test_no_noise_that_is_told_is_no_error() -> None:
    perfect = settings(replace_noise(FOG))
    stamps_ns, f_b, w_ib_b = readings(FOG, 6, 3.0)
    assert outcome(perfect, stamps_ns, f_b, w_ib_b) == MOVES


def replace_noise(grade: Grade) -> Grade:
    return replace(grade, accelerometer_noise=0.0, gyroscope_noise=0.0)


def test_any_order_of_arrival_gives_the_same_bits() -> None:
    stamps_ns, f_b, w_ib_b = readings(FOG, 7, 13.0)
    parameters = settings(FOG, gyrocompass_time=12.0)
    events = [Imu(*sample) for sample in zip(stamps_ns.tolist(), f_b, w_ib_b, strict=True)]
    expected = fold_arrays(parameters, stamps_ns, f_b, w_ib_b, []).states[-1]
    assert expected["start"]["compass"] == FOUND
    rng, fold = np.random.default_rng(SEED), Fold(parameters)
    keys = [event.stamp_ns + rng.uniform(0.0, 1.9 * NS) for event in events]
    for k in np.argsort(keys):
        assert fold.add(events[k]) is None
        if k % 50 == 0:
            fold.take()
    assert fold.latest.tobytes() == expected.tobytes()


def test_an_initial_state_that_arrives_meanwhile_is_no_gyrocompassing() -> None:
    stamps_ns, f_b, w_ib_b = readings(FOG, 8, 30.0)
    C = rotation_from_rpy(np.array(RPY))
    pose = Initial(int(stamps_ns[2000]), C, np.zeros(3), np.zeros(3), "body")
    states = fold_arrays(settings(FOG), stamps_ns, f_b, w_ib_b, [pose]).states
    assert not states[1999]["nav"]["initialised"]
    assert states[-1]["nav"]["initialised"]
    assert states[-1]["start"]["compass"] == UNDECIDED


def test_parameters_that_cannot_work_are_refused() -> None:
    with pytest.raises(ParameterError, match=r"initial\.mode.*earth_rate"):
        FilterParameters(earth_rate=False, initial=InitialParameters(mode="gyrocompassing"))
    with pytest.raises(ParameterError, match=r"gyrocompass_time.*at least 10 times"):
        InitialParameters(mode="gyrocompassing", gyrocompass_time=5.0)


# ------------------------------------------------------------------ and then the vehicle leaves


@cache
def departures(case: Case, runs: int) -> list[Departure]:
    return [depart(case, SEED + k) for k in range(runs)]


def mean_nees(found: list[Departure], name: str) -> float:
    """Per degree of freedom, over all runs and seconds."""
    return float(np.mean([d.nees[name] for d in found]))


CASES = [
    Case(FOG, 45.0, trajectory=DEPARTURE),
    Case(FOG, 100.0, uniform_heading=True, trajectory=DEPARTURE),
]


@pytest.mark.parametrize(
    "case",
    [pytest.param(CASES[0], id="45"), pytest.param(CASES[1], id="100", marks=pytest.mark.long)],
)
def test_attitude_and_biases_are_as_good_as_they_say(case: Case) -> None:
    """Limits of five short runs; all errors at the start are within five sigmas."""
    found = departures(replace(case, duration=SHORT), SHORT_RUNS)
    assert {d.compass for d in found} == {FOUND}
    assert 0.4 < mean_nees(found, "attitude") < 2.5
    assert 0.4 < mean_nees(found, "biases") < 2.5
    assert max(abs(d.heading_deg[0]) for d in found) < 5.0 * 0.12


def test_without_it_a_wrong_heading_is_found_as_well_as_it_says() -> None:
    """Told with 45 deg, one sigma: one draw per run, so the mean is chi-square by its number."""
    found = []
    for k in range(SHORT_RUNS):
        run = flown(CASES[0], SEED + k)
        found.append(3.0 * nees(run)["attitude"].mean())
        assert heading_sigma_deg(run)[-1] < 1.0
    low, high = chi2.ppf([0.0005, 0.9995], 3 * SHORT_RUNS)
    assert low < sum(found) < high


@pytest.mark.parametrize("period", [5.0, 10.0])
@pytest.mark.parametrize("case", CASES, ids=["45", "100"])
def test_a_rocked_vehicle_starts_with_what_is_told(case: Case, period: float) -> None:
    moved = replace(case, duration=20.0, trajectory=rocked(1.0, period))
    for d in departures(moved, 2):
        assert d.compass == MOVES
        assert d.start < 3.0
        sigma = d.heading_sigma_deg[0]
        assert sigma == pytest.approx(case.heading_std_deg)


@pytest.mark.long
@pytest.mark.parametrize("case", CASES, ids=["45", "100"])
def test_100_departures(case: Case) -> None:
    found = departures(case, RUNS)
    attitude, biases = mean_nees(found, "attitude"), mean_nees(found, "biases")
    at_start = np.sqrt(np.mean([d.heading_deg[0] ** 2 for d in found]))
    print(f"NEES attitude {attitude:.2f}, biases {biases:.2f}, heading {at_start:.3f} deg")
    assert {d.compass for d in found} == {FOUND}
    assert 0.7 < attitude < 1.4
    assert 0.7 < biases < 1.4
    assert at_start < 0.15
