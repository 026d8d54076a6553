"""The factor on Q that the innovations tell, and the bank of filters behind it."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from insdvl.arrays import Array
from insdvl.navigation import kalman
from insdvl.navigation.error_state import VELOCITY
from insdvl.navigation.events import NS, Event, Imu, ProcessNoise
from insdvl.navigation.geometry.rotation import cross_matrix
from insdvl.navigation.measurements.depth import Depth
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.process_noise import bank
from insdvl.navigation.process_noise.bank import LEVELS, SIZE
from insdvl.navigation.process_noise.factor import GLITCH, SETTLING
from insdvl.parameters.declaration import ParameterError, build
from insdvl.simulation.grades import GRADES
from insdvl.simulation.initial_errors import drawn_initial
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.trajectories import AUV
from insdvl.studies.evaluation.approaches import Setting
from insdvl.studies.evaluation.monte_carlo import TUNING, Run, Study
from insdvl.timeline.fold import Fold
from insdvl.timeline.output import FoldResult
from insdvl.timeline.recorded import fold_arrays

SEED = 11
#: Nominal variances within the bounds of the test of the bounds.
NOMINAL = {"accelerometer_variance": (0.1,) * 3}


@pytest.fixture(scope="module")
def run() -> Run:
    return Run(Study("constant", SEED), TUNING, 0)  # white, 0.01 and 0.001


def told(run: Run, factor: float, **noise: Any) -> FoldResult:
    """The mission through a filter that receives the true variances times a factor."""
    stamps_ns, q = run.mission.process_noise()
    parameters = Setting("calibrated").filter(source="external", **noise)
    return run.fold_received(parameters, stamps_ns, factor * q)


def log_likelihood(fold: FoldResult, first: int) -> float:
    total = 0.0
    for update in fold.updates[first:]:
        nu, S = update.report.innovation, update.report.S
        total -= 0.5 * (nu @ np.linalg.solve(S, nu) + np.linalg.slogdet(S)[1])
    return total


# ---------------------------------------------------------------- the bank


def packed(P: Array) -> Array:
    """Covariances (L, 12, 12) as the bank keeps them."""
    rows, columns = np.tril_indices(SIZE)
    return P[:, rows, columns]


def random_motion(rng: np.random.Generator) -> dict[str, Any]:
    C, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    A, B = rng.standard_normal((2, 3, 3))
    return {
        "C_n_b": C * np.linalg.det(C),
        "v_n": rng.standard_normal(3),
        "g": 9.8,
        "S_f": 1e-3 * A @ A.T,
        "S_w": 1e-5 * B @ B.T,
        "walk_f": 1e-6,
        "walk_w": 1e-9,
    }


def test_its_prediction_is_that_of_the_continuous_error_dynamics() -> None:
    """Van Loan's integral of F and G of the docstring; Phi is exact, Q but for the bias walks."""
    motion, t = random_motion(np.random.default_rng(SEED)), 0.7
    C, v_x, g_x = motion["C_n_b"], cross_matrix(motion["v_n"]), cross_matrix(np.array([0, 0, 9.8]))
    F, G = np.zeros((SIZE, SIZE)), np.zeros((SIZE, 6))
    F[:3, 3:6], F[:3, 6:9], F[:3, 9:], F[3:6, 9:] = g_x, -C, -v_x @ C, -C
    G[:3, :3], G[:3, 3:], G[3:6, 3:] = C, v_x @ C, C
    density = np.zeros((6, 6))
    density[:3, :3], density[3:, 3:] = motion["S_f"], motion["S_w"]
    van_loan = np.zeros((2 * SIZE, 2 * SIZE))
    van_loan[:SIZE, :SIZE], van_loan[:SIZE, SIZE:] = -F, G @ density @ G.T
    van_loan[SIZE:, SIZE:] = F.T
    big = expm(van_loan * t)
    Phi = big[SIZE:, SIZE:].T
    Q = Phi @ big[:SIZE, SIZE:]
    walks = t * np.diag([0.0] * 6 + [1e-6] * 3 + [1e-9] * 3)

    rng = np.random.default_rng(SEED)
    errors, A = rng.standard_normal((LEVELS.size, SIZE)), rng.standard_normal((SIZE, SIZE))
    P = np.tile(A @ A.T, (LEVELS.size, 1, 1))
    expected = errors @ Phi.T, Phi @ P @ Phi.T + LEVELS[:, None, None] * Q + walks
    packed_P = packed(P)
    bank.advance(errors, packed_P, **motion, seconds=t)
    np.testing.assert_allclose(errors, expected[0], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(packed_P, packed(expected[1]), rtol=1e-11, atol=1e-11)


def test_its_correction_is_that_of_kalman_filters() -> None:
    """With what the filter has beside the twelve states as noise of the ping."""
    rng = np.random.default_rng(SEED)
    errors = 0.01 * rng.standard_normal((LEVELS.size, SIZE))
    A = 0.1 * rng.standard_normal((LEVELS.size, SIZE, SIZE))
    P = A @ np.swapaxes(A, 1, 2)
    H = np.zeros((3, SIZE))
    H[:, :3], _ = np.linalg.qr(rng.standard_normal((3, 3)))
    R, beside = 0.01 * np.eye(3), np.diag([0.004, 0.002, 0.001])
    now = 5  # the level in effect
    M = H @ P[now] @ H.T + beside
    innovation = 0.1 * rng.standard_normal(3)
    expected = []
    for error, covariance in zip(errors, P, strict=True):
        nu = innovation - H @ error
        one = kalman.innovate(covariance, nu, H, R + beside)
        expected.append(
            (
                error + one.K @ nu,
                covariance - one.K @ one.S @ one.K.T,
                -0.5 * (one.nis + np.linalg.slogdet(one.S)[1]),
            )
        )
    likelihoods = np.empty(LEVELS.size)
    packed_P = packed(P)
    assert bank.correct(errors, packed_P, LEVELS[now], H, innovation, M + R, M, likelihoods)
    for k, (error, covariance, likelihood) in enumerate(expected):
        np.testing.assert_allclose(errors[k], error, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(packed_P[k], packed(covariance[None])[0], rtol=1e-9, atol=1e-12)
        assert likelihoods[k] == pytest.approx(likelihood, rel=1e-9)


def test_a_filter_that_knows_more_than_the_bank_does_not_make_noise_negative() -> None:
    """As after a fix of the position: M is less than the bank's, and R stays what it is."""
    P = packed(np.tile(np.eye(SIZE), (LEVELS.size, 1, 1)))
    errors, likelihoods = np.zeros((LEVELS.size, SIZE)), np.empty(LEVELS.size)
    H, R = np.eye(3, SIZE), 0.01 * np.eye(3)
    M = 1e-6 * np.eye(3)
    assert bank.correct(errors, P, 1.0, H, np.zeros(3), M + R, M, likelihoods)
    np.testing.assert_allclose(likelihoods, -1.5 * np.log(1.01), rtol=1e-12)


@pytest.mark.parametrize("factor", [0.07, 0.7, 1.0, 3.1, 15.0])
def test_between_the_levels_it_is_where_the_likelihood_is_largest(factor: float) -> None:
    """Of likelihoods that leave nothing of the prior."""
    sums = -0.5 * ((np.log(LEVELS) - np.log(factor)) / 1e-3) ** 2
    assert bank.mean_factor(sums) == pytest.approx(factor, rel=1e-5)


@pytest.mark.parametrize(("slope", "end"), [(1e3, 16.0), (-1e3, 1.0 / 16.0)])
def test_beyond_the_levels_it_is_the_last_one(slope: float, end: float) -> None:
    assert bank.mean_factor(slope * np.log(LEVELS)) == end


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("curvature", [0.0, 1e-300, 1e-9, -1e-9])
def test_a_likelihood_without_a_maximum_has_the_last_level(curvature: float) -> None:
    """What is nearly a line, whose parabola has its vertex far beyond all levels."""
    sums = 0.5 * (np.log(LEVELS) / bank.SPREAD) ** 2 + np.log(LEVELS)  # takes off the prior
    sums += curvature * np.log(LEVELS) ** 2
    assert bank.mean_factor(sums) == LEVELS[-1]


def test_it_has_the_mean_standard_deviation_of_prior_and_likelihood() -> None:
    """Two normal distributions of the logarithm, by Bayes' rule, and samples of the posterior."""
    sums = -0.5 * ((np.log(LEVELS) - np.log(4.0)) / 0.5) ** 2
    precision = 1.0 / bank.SPREAD**2 + 1.0 / 0.5**2
    mean, std = np.log(4.0) / 0.5**2 / precision, precision**-0.5
    drawn = np.exp(0.5 * np.random.default_rng(SEED).normal(mean, std, 1_000_000))
    assert bank.mean_factor(sums) == pytest.approx(drawn.mean() ** 2, rel=2e-3)


def test_what_was_learned_loses_its_weight() -> None:
    rng = np.random.default_rng(SEED)
    before, new = rng.standard_normal((2, LEVELS.size))
    after = bank.learned(before, new, bank.MEMORY * np.log(2.0))
    assert after.max() == 0.0
    np.testing.assert_allclose(np.diff(after), np.diff(before / 2.0 + new), atol=1e-12)


# ---------------------------------------------------------------- the filter


@pytest.mark.parametrize("error_state", ["invariant", "ned"])
def test_its_likelihoods_are_those_of_whole_filters(
    run: Run, error_state: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of each level against the told Q, over the mission: what a whole filter with it has."""
    setting, (stamps_ns, q) = Setting("calibrated", error_state), run.mission.process_noise()
    of_bank = np.zeros(LEVELS.size)

    def only_add(sums: Array, likelihoods: Array, seconds: float) -> Array:
        of_bank[:] += likelihoods
        return sums

    monkeypatch.setattr(bank, "learned", only_add)
    fold = run.fold_received(setting.filter(source="external", adaptive_factor=True), stamps_ns, q)
    first = next(
        k
        for k, update in enumerate(fold.updates)
        if update.stamp_ns >= fold.updates[0].stamp_ns + 10 * NS
    )
    whole = np.array(
        [
            log_likelihood(
                run.fold_received(setting.filter(source="external"), stamps_ns, level * q), first
            )
            for level in LEVELS
        ]
    )
    one = int(np.flatnonzero(LEVELS == 1.0)[0])
    whole, of_bank = whole - whole[one], of_bank - of_bank[one]
    np.testing.assert_allclose(of_bank, whole, rtol=0.1, atol=1.0)


@pytest.mark.parametrize("wrong", [1.0 / 12.0, 1.0, 12.0])
def test_it_is_what_a_wrong_q_lacks(run: Run, wrong: float) -> None:
    """Its own sigma at the end of this mission is below 0.1 in the logarithm."""
    states = told(run, wrong, adaptive_factor=True).states
    assert np.log(states["q_factor"]["factor"][-1] * wrong) == pytest.approx(0.0, abs=0.3)
    variance = np.diagonal(states["noise"]["Q_f"][-1])
    np.testing.assert_allclose(variance, states["q_factor"]["factor"][-1] * wrong * 0.01)


def test_it_mends_a_constant(run: Run) -> None:
    parameters = Setting("calibrated").filter((0.1, 0.01), adaptive_factor=True)
    fold = run.fold_received(parameters, np.empty(0, np.int64), np.empty((0, 6)))
    assert fold.states["q_factor"]["factor"][-1] == pytest.approx(0.1, rel=0.35)


def test_floor_and_ceiling_hold_for_the_product(run: Run) -> None:
    """The told Q is within them, the product would not be."""
    floored = told(run, 10.0, adaptive_factor=True, **NOMINAL, accelerometer_floor=0.05).states
    assert floored["q_factor"]["factor"][-1] == pytest.approx(0.1, rel=0.35)
    Q_f = np.diagonal(floored["noise"]["Q_f"], axis1=1, axis2=2)
    assert Q_f.min() == pytest.approx(0.05)
    low = {"gyroscope_variance": (1e-4,) * 3, "gyroscope_ceiling": 8e-4}
    capped = told(run, 0.1, adaptive_factor=True, **low).states
    bound = told(run, 0.1, adaptive_factor=True).states
    assert np.diagonal(bound["noise"]["Q_w"], axis1=1, axis2=2).max() > 8.5e-4
    assert np.diagonal(capped["noise"]["Q_w"], axis1=1, axis2=2).max() <= 8e-4 * (1.0 + 1e-9)


def test_a_nominal_q_outside_of_its_bounds_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"accelerometer_variance.*with adaptive_factor"):
        Setting("calibrated").filter(adaptive_factor=True, accelerometer_floor=0.05)


def test_nothing_is_learned_of_pings_that_the_gate_refuses(run: Run) -> None:
    """1 m/s off in one of twenty, in any direction, of a filter with the right Q."""
    rng = np.random.default_rng(SEED)
    mission, bad = run.mission, Run(Study("constant", SEED), TUNING, 0)
    off = np.flatnonzero(rng.random(len(mission.v_d)) < 0.05)
    v_d = mission.v_d.copy()
    v_d[off] += rng.choice([-1.0, 1.0], (off.size, 3))
    bad.mission = replace(mission, v_d=v_d)
    stamps_ns, q = mission.process_noise()
    parameters = Setting("calibrated", gate=True).filter(source="external", adaptive_factor=True)
    fold = bad.fold_received(parameters, stamps_ns, q)
    refused = [u for u in fold.updates if not u.report.accepted]
    assert len(refused) >= off.size - 2
    m, times_ns = fold.states["q_factor"], fold.states["nav"]["time_ns"]
    taught = {u.stamp_ns: np.any(change(m["likelihoods"], times_ns, u.stamp_ns)) for u in refused}
    assert not any(taught.values())
    used = [u.stamp_ns for u in fold.updates if u.report.accepted][-20:]
    assert sum(np.any(change(m["likelihoods"], times_ns, stamp_ns)) for stamp_ns in used) >= 15
    assert m["factor"][-1] == pytest.approx(1.0, abs=0.3)


def change(values: np.ndarray, times_ns: np.ndarray, stamp_ns: int) -> np.ndarray:
    """From the last state before a stamp to the first one that has it."""
    after = np.searchsorted(times_ns, stamp_ns)
    return values[after] - values[after - 1]


def test_beside_a_source_that_adapts_it_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"process_noise\.adaptive_factor.*'adaptive'"):
        build(
            FilterParameters,
            {"process_noise.source": "adaptive", "process_noise.adaptive_factor": True},
        )


# ---------------------------------------------------------------- times


def events_of(run: Run, seconds: float, silent: tuple[float, float] = (0.0, 0.0)) -> list[Event]:
    """The begin of the mission, without the pings of a time, told ten times Q until then."""
    m = run.mission
    stamps_ns, q = m.process_noise()
    begin, end = (m.start_ns + s * NS for s in silent)
    events: list[Event] = [run._initial]
    events += [
        ProcessNoise(stamp_ns, 10.0 * np.diag(one[:3]), 10.0 * np.diag(one[3:]))
        for stamp_ns, one in zip(stamps_ns.tolist(), q, strict=True)
    ]
    events += [
        Dvl(stamp_ns, v_d)
        for stamp_ns, v_d in zip(m.dvl_stamps_ns.tolist(), m.v_d, strict=True)
        if not begin < stamp_ns <= end
    ]
    samples = zip(m.stamps_ns.tolist(), m.f_b, m.w_ib_b, strict=True)
    events += [Imu(stamp_ns, f_b, w_ib_b) for stamp_ns, f_b, w_ib_b in samples]
    last_ns = m.start_ns + round(seconds * NS)
    return sorted((e for e in events if e.stamp_ns <= last_ns), key=lambda e: e.stamp_ns)


def state_after(events: list[Event], **values: Any) -> Any:
    """The last state of a filter that learns the factor."""
    parameters = Setting("calibrated").filter(source="external", adaptive_factor=True)
    fold = Fold(replace(parameters, **values))
    for event in events:
        fold.add(event)
    fold.take()
    latest = fold.latest
    assert latest is not None
    return latest


@pytest.mark.long
def test_a_sensor_of_one_axis_tells_it(run: Run) -> None:
    """As the wheels of a car: nothing is known of the other axes."""
    events = [
        replace(e, v_d=e.v_d * [1.0, 0.0, 0.0], measured=(True, False, False))
        if isinstance(e, Dvl)
        else e
        for e in events_of(run, 330.0)
    ]
    assert state_after(events)["q_factor"]["factor"] == pytest.approx(0.1, rel=0.5)


def test_a_late_ping_leaves_the_same_bits(run: Run) -> None:
    in_order = events_of(run, 40.0)
    late, waiting = [], []
    for event in in_order:
        if isinstance(event, Dvl):
            waiting.append(event)
            continue
        late.append(event)
        if waiting and event.stamp_ns > waiting[0].stamp_ns + NS // 20:
            late.append(waiting.pop(0))
    late += waiting
    expected = state_after(in_order, output_delay=0.2)["q_factor"]
    assert expected["factor"] < 0.7
    assert state_after(late, output_delay=0.2)["q_factor"].tobytes() == expected.tobytes()


def test_a_pause_of_the_pings_leaves_what_was_learned(run: Run) -> None:
    before = state_after(events_of(run, 60.0))["q_factor"]["factor"]
    after = state_after(events_of(run, 91.0, silent=(60.0, 90.0)))["q_factor"]
    assert before < 0.5
    assert after["factor"] == before
    assert after["begin_ns"] == after["ping_ns"]  # the bank has begun again


def test_a_q_that_has_timed_out_takes_its_factor_with_it(run: Run) -> None:
    """The nominal Q of the configuration is another one; it starts at a factor of one."""
    events = [e for e in events_of(run, 70.0) if not isinstance(e, ProcessNoise)]
    told_once = ProcessNoise(run.mission.start_ns, 0.1 * np.eye(3), 0.01 * np.eye(3))
    state = state_after([told_once, *events], q_timeout=60.0)
    assert state["noise"]["q_ns"] < 0
    assert state["q_factor"]["told_ns"] < 0
    assert 0.5 < state["q_factor"]["factor"] < 2.0
    in_time = state_after([told_once, *events], q_timeout=600.0)
    assert in_time["q_factor"]["factor"] < 0.4


DISTURBED = 100.0  # s, when the factor is known


def gap(events: list[Event], m: Any) -> list[Event]:
    """Without the samples of a second."""
    begin_ns, end_ns = (m.start_ns + round(s * NS) for s in (DISTURBED, DISTURBED + 1.0))
    return [e for e in events if not (isinstance(e, Imu) and begin_ns < e.stamp_ns < end_ns)]


def frozen(events: list[Event], m: Any) -> list[Event]:
    """The accelerometers are stuck for five seconds."""
    begin_ns, end_ns = (m.start_ns + round(s * NS) for s in (DISTURBED, DISTURBED + 5.0))
    return [
        replace(e, f_b=np.array([0.1, 0.2, -9.7]))
        if isinstance(e, Imu) and begin_ns < e.stamp_ns < end_ns
        else e
        for e in events
    ]


def knock(events: list[Event], m: Any) -> list[Event]:
    """A fifth of a second with 15 m/s^2 that nobody has felt."""
    begin_ns, end_ns = (m.start_ns + round(s * NS) for s in (DISTURBED, DISTURBED + 0.2))
    return [
        replace(e, f_b=e.f_b + np.array([15.0, 0.0, 0.0]))
        if isinstance(e, Imu) and begin_ns < e.stamp_ns < end_ns
        else e
        for e in events
    ]


@pytest.mark.parametrize("fault", [gap, frozen, knock])
def test_what_is_no_process_noise_does_not_teach(run: Run, fault: Any) -> None:
    """A gap, a frozen channel, and a step that the gate gives in to: P is inflated, not Q.

    Against the same filter on the same mission without the fault, half a minute later.
    """
    gate = replace(Setting("calibrated", gate=True).filter().gate, enabled=True)
    events = events_of(run, DISTURBED + 30.0)
    expected = state_after(events, gate=gate)["q_factor"]["factor"]
    disturbed = state_after(fault(events, run.mission), gate=gate)["q_factor"]
    assert disturbed["learned_ns"] == run.mission.dvl_stamps_ns[int(DISTURBED) + 29]  # goes on
    assert disturbed["factor"] == pytest.approx(expected, rel=0.35)


def test_nothing_is_learned_right_behind_a_glitch(run: Run) -> None:
    """A tuner has it in its window, and tells a Q that is too large."""
    events = [
        replace(e, f_b=e.f_b + np.array([50.0, 0.0, 0.0]))
        if isinstance(e, Imu) and e.stamp_ns == run.mission.stamps_ns[6049]
        else e
        for e in events_of(run, 60.0 + GLITCH + 3.0)
    ]
    pings_ns = run.mission.dvl_stamps_ns
    until = [e for e in events if e.stamp_ns <= run.mission.start_ns + (60.0 + GLITCH) * NS]
    assert state_after(until)["q_factor"]["learned_ns"] == pings_ns[59]
    assert state_after(events)["q_factor"]["learned_ns"] == pings_ns[59 + int(GLITCH) + 3]


def test_the_bank_settles_before_it_teaches(run: Run) -> None:
    events = events_of(run, SETTLING + 1.0)  # the first ping begins it, at 1 s
    m = state_after(events)["q_factor"]
    assert m["begin_ns"] == run.mission.dvl_stamps_ns[0]
    assert m["learned_ns"] == run.mission.dvl_stamps_ns[int(SETTLING)]
    assert state_after(events_of(run, SETTLING))["q_factor"]["learned_ns"] < 0


def test_a_new_initial_state_begins_the_bank_and_keeps_the_factor(run: Run) -> None:
    m = run.mission
    again = replace(run._initial, stamp_ns=m.start_ns + 60 * NS + NS // 2)
    events = sorted([*events_of(run, 62.0), again], key=lambda e: e.stamp_ns)
    parameters = Setting("calibrated").filter()
    state = state_after(events, initial=replace(parameters.initial, mode="set_odometry"))
    assert state["q_factor"]["factor"] < 0.7
    assert state["q_factor"]["begin_ns"] >= again.stamp_ns


@pytest.mark.long
def test_what_was_learned_fades_in_a_pause(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the time between the pings that teach, whatever lies between."""
    before, after = {}, {}
    for memory in (20.0, 1e9):
        monkeypatch.setattr(bank, "MEMORY", memory)
        before[memory] = state_after(events_of(run, 60.0))["q_factor"]
        after[memory] = state_after(events_of(run, 272.0, silent=(60.0, 260.0)))["q_factor"]
        assert after[memory]["learned_ns"] > before[memory]["learned_ns"] + 200 * NS
    # The pings behind the pause tell both the same; one knows what was before it as well.
    known = after[1e9]["likelihoods"] - after[20.0]["likelihoods"]
    expected = before[1e9]["likelihoods"]
    spread = np.ptp(expected)
    assert spread > 20.0
    np.testing.assert_allclose(known - known.mean(), expected - expected.mean(), atol=0.1 * spread)


def test_the_memory_is_a_time_constant() -> None:
    sums = np.array([-3.0, 0.0, -1.0])
    np.testing.assert_allclose(bank.learned(sums, np.zeros(3), bank.MEMORY), sums / np.e)
    np.testing.assert_allclose(bank.learned(sums, -sums, 0.0), 0.0)


def test_the_estimates_of_the_levels_move_with_the_filter(run: Run) -> None:
    """A level that is told what the filter is told stays where the filter is."""
    stamps_ns, q = run.mission.process_noise()
    parameters = Setting("calibrated").filter(source="external", adaptive_factor=True)
    m = run.fold_received(parameters, stamps_ns, q).states["q_factor"][-1]
    one = int(np.flatnonzero(LEVELS == 1.0)[0])
    full = np.empty((SIZE, SIZE))
    bank.unpack(full, m["P"][one])
    off = m["errors"][one] / np.sqrt(np.diag(full))
    assert np.abs(off).max() < 0.5
    assert np.abs(m["errors"][0] / np.sqrt(np.diag(full))).max() > 0.5  # others do not


# ---------------------------------------------------------------- beside another sensor


def test_what_a_depth_corrects_leaves_the_estimates_of_the_levels(run: Run) -> None:
    """They are relative to the filter, which has moved: their sums are as without it."""
    parameters = Setting("calibrated").filter(source="external", adaptive_factor=True)
    of_depth = replace(parameters.depth, topic="depth", noise_std=0.01, surface_std=0.0)
    events, m = events_of(run, 60.3), run.mission
    last = int(np.searchsorted(m.stamps_ns, events[-1].stamp_ns))
    depth = Depth(events[-1].stamp_ns, -m.truth.llh[last, 2] + 0.2)
    one, other = (
        state_after(own, depth=of_depth, gate=replace(parameters.gate, enabled=False))
        for own in (events, [*events, depth])
    )
    moved = other["nav"]["v_n"] - one["nav"]["v_n"]
    assert np.abs(moved).max() > 0.005
    told = [s["nav"]["v_n"] + s["q_factor"]["errors"][:, VELOCITY] for s in (one, other)]
    np.testing.assert_allclose(told[1], told[0], atol=0.05 * np.abs(moved).max())


def graded(name: str, heading_std: float, **values: Any) -> FilterParameters:
    """A filter with the true noise and the biases of a grade of IMU."""
    grade = GRADES[name]
    q = grade.variances()
    return build(
        FilterParameters,
        {
            "frame_convention": "ned",
            "origin.height": float(AUV.h_0),
            "dvl.noise_std": (0.02,) * 3,
            "process_noise.adaptive_factor": True,
            "process_noise.accelerometer_variance": tuple(q[:3].tolist()),
            "process_noise.gyroscope_variance": tuple(q[3:].tolist()),
            "initial.mode": "set_odometry",
            "initial.tilt_std": 0.01,
            "initial.heading_std": heading_std,
            "initial.velocity_std": 0.1,
            "initial.position_std": 0.1,
            "initial.accelerometer_bias_std": grade.accelerometer_bias,
            "initial.gyroscope_bias_std": grade.gyroscope_bias,
        }
        | values,
    )


def graded_mission(name: str, seed: int, duration: float) -> Mission:
    grade, dvl = GRADES[name], DvlModel(noise_std=(0.02,) * 3)
    q = constant(grade.variances())
    return simulate(AUV, q, seed=seed, duration=duration, imu=grade.imu(), dvl=dvl)


def fold_graded(
    settings: FilterParameters, m: Mission, seed: int, others: Sequence[Event] = ()
) -> FoldResult:
    start = drawn_initial(m.initial, settings.initial, np.random.default_rng([seed, 1]))
    pings = [Dvl(*one) for one in zip(m.dvl_stamps_ns.tolist(), m.v_d, strict=True)]
    return fold_arrays(settings, m.stamps_ns, m.f_b, m.w_ib_b, [start, *pings, *others])


@pytest.mark.parametrize(
    ("grade", "heading_std", "teaches"),
    [("fog", 1.0, False), ("fog", 0.01, True), ("tactical", 0.03, True), ("mems", 1.0, True)],
)
def test_an_unknown_heading_teaches_only_where_the_bias_covers_the_earths_rate(
    grade: str, heading_std: float, teaches: bool
) -> None:
    m = graded_mission(grade, SEED, 40.0)
    learned_ns = fold_graded(graded(grade, heading_std), m, SEED).states["q_factor"]["learned_ns"]
    assert bool(learned_ns[-1] >= 0) == teaches


@pytest.mark.long
def test_a_depth_sensor_does_not_make_the_factor_small() -> None:
    """Of the true Q it is 1 in the mean of the logarithm, to 3 sigma of eight missions of 0.15."""
    settings = graded("mems", 0.02, **{"depth.topic": "depth", "depth.noise_std": 0.01})
    found, rows = [], slice(9, None, 10)
    for seed in range(SEED, SEED + 8):
        m = graded_mission("mems", seed, 240.0)
        told = m.truth.p_o[rows, 2] - AUV.h_0
        told += 0.01 * np.random.default_rng([seed, 2]).standard_normal(len(told))
        pairs = zip(m.stamps_ns[rows].tolist(), told.tolist(), strict=True)
        result = fold_graded(settings, m, seed, [Depth(*pair) for pair in pairs])
        found.append(np.log(result.states["q_factor"]["factor"][-1]))
    assert np.mean(found) == pytest.approx(0.0, abs=3.0 * 0.15 / np.sqrt(8.0))
