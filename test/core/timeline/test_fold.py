"""The state depends on stamps alone: any order of arrival within max_delay gives the same bits."""

import gc
from dataclasses import replace

import numpy as np
import pytest
from places import position
from records import P15

from insdvl.navigation.events import NS, Event, Imu, Initial, Origin, ProcessNoise
from insdvl.navigation.geometry.frames import rotation_from_rpy
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.odometry import Odometry, odometry
from insdvl.navigation.parameters import (
    DvlParameters,
    FilterParameters,
    GateParameters,
    ImuParameters,
    OriginParameters,
    ProcessNoiseParameters,
)
from insdvl.parameters.declaration import ParameterError
from insdvl.simulation.initial_errors import P_0
from insdvl.simulation.mission import simulate
from insdvl.simulation.noise import segments
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.trajectories import AUV
from insdvl.timeline.fold import Fold
from insdvl.timeline.output import AppliedUpdate, FoldResult
from insdvl.timeline.recorded import fold_arrays
from insdvl.timeline.samples import TURN_ACCELERATION, rate_at

SEED = 57_721
STEP = 10_000_000
MAX_DELAY = 0.5
START = 1_700_000_000 * NS + 123_456_789

SETTINGS = FilterParameters(
    frame_convention="ned",
    max_delay=MAX_DELAY,
    q_timeout=1.5,
    gate=GateParameters(max_rejection_time=0.4),
    imu=ImuParameters(
        mount=(0.1, -0.2, 0.3), lever_arm=(0.2, 0.1, -0.1), rate_range=0.5, frozen_samples=10
    ),
    dvl=DvlParameters(
        mount=(0.0, 0.0, 0.7), lever_arm=(0.5, 0.0, 0.3), bias_model="gauss_markov", max_speed=100.0
    ),
    process_noise=ProcessNoiseParameters(source="external"),
    initial=replace(P_0, mode="set_odometry", velocity_std=0.05),
    origin=OriginParameters(source="topic"),
)


def mission(seconds: float, seed: int = SEED) -> list[Event]:
    """Everything that can happen, in the order of stamps.

    Pings and Q lie on samples and between them; a sample, a Q and a ping share some stamps; a gap,
    channels that are frozen or saturated, outliers, single and in a row, pings that repeat, zeros,
    and a Q that comes too seldom are there.
    """
    m = simulate(
        AUV,
        segments(1e-3, 0.05, 0.7, 1.3),
        seed=seed,
        duration=seconds,
        dvl=DvlModel(
            rate=2.0,
            mount=SETTINGS.dvl.mount,
            lever_arm=(0.5, 0.0, 0.3),
        ),
        start_ns=START,
    )
    rng = np.random.default_rng([seed, 1])
    C, v = m.initial.C_n_b[0], m.initial.v_n[0]
    C_b_i = rotation_from_rpy(np.array(SETTINGS.imu.mount))
    events: list[Event] = [
        Origin(START + STEP, AUV.lat_0, AUV.lon_0, AUV.h_0),
        Initial(START + STEP + 3, C, m.initial.p_o[0], C.T @ v, "body"),
    ]
    for k, stamp in enumerate(m.stamps_ns.tolist()):
        if not 230 <= k < 250:
            f_b, w_ib_b = m.f_b[k] @ C_b_i, m.w_ib_b[k] @ C_b_i
            if 400 <= k < 440:
                f_b[1] = 0.1
            events.append(Imu(stamp, f_b, w_ib_b))
    for k, stamp in enumerate(m.dvl_stamps_ns.tolist()):
        v_d = m.v_d[k] + {7: 5.0, 11: -70.0, 12: -2.0, 13: -2.0, 15: -40.0}.get(k, 0.0)
        stamp += 0 if k % 3 == 0 else 1_234_567 * k % STEP
        if k % 5 == 4:
            v_d = np.zeros(3)
        events.append(Dvl(stamp, v_d))
        if k % 4 == 1:
            events.append(Dvl(stamp + 3 * STEP // 2, v_d))
    for stamp in np.arange(
        START + 20 * STEP, START + round(0.6 * seconds * NS), 25 * STEP
    ).tolist():
        q = np.exp(rng.uniform(np.log(1e-3), np.log(0.05), 6))
        shift = int(rng.integers(0, STEP)) if stamp % 2 else 0
        events.append(ProcessNoise(stamp + shift, np.diag(q[:3]), np.diag(q[3:])))
    return sorted(events, key=lambda e: (e.stamp_ns, e.kind, e.payload()))


def offline(settings: FilterParameters, events: list[Event]) -> FoldResult:
    samples = [e for e in events if isinstance(e, Imu)]
    return fold_arrays(
        settings,
        np.array([e.stamp_ns for e in samples]),
        np.array([e.f_b for e in samples]),
        np.array([e.w_ib_b for e in samples]),
        [e for e in events if not isinstance(e, Imu)],
    )


def shuffled(events: list[Event], delay: float, rng: np.random.Generator) -> list[Event]:
    """Each event arrives late by its own random time, at most ``delay`` [s]."""
    late = rng.uniform(0.0, delay, len(events)) * NS
    order = np.argsort([e.stamp_ns + d for e, d in zip(events, late, strict=True)])
    return [events[k] for k in order]


def feed(fold: Fold, events: list[Event], every: int = 7) -> list[Odometry | AppliedUpdate]:
    """Add all events; take what is publishable after every few of them."""
    taken = []
    for k, event in enumerate(events):
        fold.add(event)
        if k % every == 0:
            taken += fold.take()
    return taken + fold.take()


EVENTS = mission(10.0)
DELAY = MAX_DELAY - 0.02  # newest and oldest stamps on the way are then within max_delay


@pytest.fixture(scope="module")
def expected() -> FoldResult:
    return offline(SETTINGS, EVENTS)


# ------------------------------------------------------------------ order of arrival


def test_the_mission_has_what_can_go_wrong(expected: FoldResult) -> None:
    """Otherwise the tests below would show little."""
    reasons = {u.report.reason for u in expected.updates}
    assert reasons == {"", "gate", "restarted", "repeated", "no_lock", "too_fast"}
    assert expected.counts["dvl inflations"] >= 1
    assert expected.counts["gaps"] == 1
    assert expected.counts["frozen"] == 31
    assert expected.counts["saturated"] >= 5
    assert expected.counts["q_timeouts"] >= 1
    stamps = [
        {e.stamp_ns for e in EVENTS if isinstance(e, kind)} for kind in (Imu, Dvl, ProcessNoise)
    ]
    assert stamps[0] & stamps[1]
    assert stamps[1] - stamps[0]
    assert stamps[2] - stamps[0]


@pytest.mark.parametrize("seed", range(8))
def test_any_order_of_arrival_gives_the_same_bits(expected: FoldResult, seed: int) -> None:
    rng = np.random.default_rng([SEED, 2, seed])
    fold = Fold(SETTINGS, capacity=4096 if seed % 2 else 64)
    events = shuffled(EVENTS, DELAY, rng)
    for event in events:
        assert fold.add(event) is None
        if rng.random() < 0.1:
            fold.take()
    assert fold.latest.tobytes() == expected.states[-1].tobytes()
    kept = len(fold.states)
    assert fold.states.tobytes() == expected.states[-kept:].tobytes()


@pytest.mark.parametrize("kinds", [(Imu,), (Dvl,), (ProcessNoise,), (Initial, Origin)])
def test_one_kind_may_be_later_than_all_others(
    expected: FoldResult, kinds: tuple[type, ...]
) -> None:
    late = round(DELAY * NS)
    order = sorted(EVENTS, key=lambda e: e.stamp_ns + (late if isinstance(e, kinds) else 0))
    fold = Fold(SETTINGS)
    feed(fold, order, every=1)
    assert fold.latest.tobytes() == expected.states[-1].tobytes()


def test_all_samples_of_a_second_may_come_backwards(expected: FoldResult) -> None:
    blocks: dict[int, list[Event]] = {}
    for event in EVENTS:
        blocks.setdefault(event.stamp_ns // (40 * STEP), []).append(event)
    fold = Fold(SETTINGS)
    feed(fold, [e for block in blocks.values() for e in reversed(block)])
    assert fold.latest.tobytes() == expected.states[-1].tobytes()


@pytest.mark.parametrize("seed", range(4))
def test_of_duplicates_the_same_one_counts_in_any_order(seed: int) -> None:
    """Two or three events of one stamp and kind, with different payloads."""
    rng = np.random.default_rng(SEED + 3)
    events = mission(6.0)
    copies: list[Event] = []
    for event in events:
        for _ in range(int(rng.integers(0, 3)) if rng.random() < 0.2 else 0):
            if isinstance(event, Imu):
                copies.append(replace(event, f_b=event.f_b + rng.standard_normal(3)))
            elif isinstance(event, Dvl):
                copies.append(replace(event, v_d=event.v_d + 0.1 * rng.standard_normal(3)))
            elif isinstance(event, ProcessNoise):
                copies.append(replace(event, Q_f=None if rng.random() < 0.5 else np.eye(3)))
    k = next(k for k, e in enumerate(events) if isinstance(e, Initial))
    assert isinstance(events[k], Initial)
    copies += [
        replace(events[k], velocity_frame="nav"),
        replace(events[k], p_o=np.ones(3)),
        replace(events[k], P_v=np.eye(3)),
        replace(events[k], P_psi=np.eye(3)),
    ]
    copies.append(Origin(START + STEP, 0.1, 0.2, 30.0))
    assert len(copies) > 40

    together = [*events, *copies]
    results = []
    for order in (0, seed + 1):
        fold = Fold(SETTINGS)
        arriving = shuffled(together, 0.2, np.random.default_rng([SEED, 4, order]))
        reasons = [fold.add(event) for event in arriving]
        assert reasons.count("duplicate") == len(copies)
        assert set(reasons) == {None, "duplicate"}
        results.append(fold.latest.tobytes())
    assert results[0] == results[1]


@pytest.mark.parametrize(
    "change", [{"velocity_frame": "nav"}, {"once": True}, {"P_v": np.eye(3)}, {"P_p": np.eye(3)}]
)
def test_initials_that_differ_in_their_declaration_only_are_not_the_same(change: dict) -> None:
    start = Initial(START, rotation_from_rpy(np.array([0.0, 0.0, 1.0])), *np.ones((2, 3)), "body")
    states = []
    for events in ([start, replace(start, **change)], [replace(start, **change), start]):
        fold = Fold(modes("set_odometry"))
        for event in [*events, at(0), at(1)]:
            fold.add(event)
        states.append(fold.latest.tobytes())
    assert states[0] == states[1]


def test_an_event_sent_twice_changes_nothing(expected: FoldResult) -> None:
    fold = Fold(SETTINGS)
    feed(fold, [e for event in EVENTS for e in (event, event)])
    assert fold.latest.tobytes() == expected.states[-1].tobytes()


def test_the_adaptive_source_too_depends_on_stamps_alone() -> None:
    settings = replace(
        SETTINGS,
        dvl=DvlParameters(lever_arm=(0.5, 0.0, 0.3)),
        process_noise=ProcessNoiseParameters(source="adaptive", adaptive_window=3),
    )
    events = [e for e in EVENTS if not isinstance(e, ProcessNoise)]
    fold = Fold(settings)
    feed(fold, shuffled(events, DELAY, np.random.default_rng([SEED, 5])), every=3)
    assert fold.latest.tobytes() == offline(settings, events).states[-1].tobytes()


# ------------------------------------------------------------------ what is given out


def test_taking_is_monotonic_and_never_repeats() -> None:
    fold = Fold(SETTINGS)
    taken = feed(fold, shuffled(EVENTS, DELAY, np.random.default_rng([SEED, 6])), every=1)
    stamps = [o.stamp_ns for o in taken if isinstance(o, Odometry)]
    assert len(stamps) > 100  # a sample that comes after a younger one is not given out
    assert np.all(np.diff(stamps) > 0)
    updates = [o.stamp_ns for o in taken if isinstance(o, AppliedUpdate)]
    pings = [e.stamp_ns for e in EVENTS if isinstance(e, Dvl) and e.stamp_ns <= fold.newest_ns]
    assert sorted(updates) == pings  # the one after the newest sample still waits


def test_a_measurement_that_is_replaced_by_its_duplicate_is_given_out_once() -> None:
    fold = Fold(SIMPLE)
    for k in range(20):
        fold.add(at(k))
    stamp = START + 15 * STEP
    pings = sorted((Dvl(stamp, np.full(3, v)) for v in (0.01, 0.02)), key=Dvl.payload)
    fold.add(pings[1])
    assert [o.stamp_ns for o in fold.take() if isinstance(o, AppliedUpdate)] == [stamp]
    assert fold.add(pings[0]) == "duplicate"
    assert fold.take() == []
    assert fold.updates[0].report.innovation[0] == pytest.approx(pings[0].v_d[0], abs=1e-3)


def test_in_order_everything_is_given_out_as_it_comes(expected: FoldResult) -> None:
    """One odometry per sample once there is a state, right away, and never again."""
    fold = Fold(SETTINGS)
    seen: list[Odometry | AppliedUpdate] = []
    for event in EVENTS:
        fold.add(event)
        outputs = fold.take()
        assert fold.take() == []
        if isinstance(event, Imu) and fold.latest is not None:
            assert [o.stamp_ns for o in outputs if isinstance(o, Odometry)] == [event.stamp_ns]
        seen += outputs
    samples = [e.stamp_ns for e in EVENTS if isinstance(e, Imu)]
    # The first is uninitialised: the state begins 3 ns after it.
    assert [o.stamp_ns for o in seen if isinstance(o, Odometry)] == samples[1:]
    assert sum(isinstance(o, AppliedUpdate) for o in seen) == len(expected.updates)


@pytest.mark.parametrize("capacity", [64, 4096])
@pytest.mark.parametrize("every", [1, 23])
def test_with_an_output_delay_the_output_is_the_offline_result(
    expected: FoldResult, capacity: int, every: int
) -> None:
    settings = replace(SETTINGS, output_delay=MAX_DELAY)
    fold = Fold(settings, capacity=capacity)
    events = shuffled(EVENTS, DELAY, np.random.default_rng([SEED, 7]))
    taken = feed(fold, events, every=every)
    outputs = [o for o in taken if isinstance(o, Odometry)]
    until = fold.newest_ns - round(MAX_DELAY * NS)
    states = [
        (k, int(s["nav"]["time_ns"]))
        for k, s in enumerate(expected.states)
        if s["nav"]["initialised"]
    ]
    assert [o.stamp_ns for o in outputs] == [t for _, t in states if t <= until]
    for output, (k, _) in zip(outputs, states, strict=False):
        offline_output = odometry(expected.filter, expected.states, k)
        for name in Odometry.__slots__:
            a, b = getattr(output, name), getattr(offline_output, name)
            assert np.array_equal(a, b), (k, name)

    reports = [o for o in taken if isinstance(o, AppliedUpdate)]
    assert [o.stamp_ns for o in taken] == sorted(o.stamp_ns for o in taken)
    for output, update in zip(reports, expected.updates, strict=False):
        assert output.stamp_ns == update.stamp_ns
        assert output.report.innovation.tobytes() == update.report.innovation.tobytes()
        assert output.report.accepted == update.report.accepted
    assert len(reports) == sum(u.stamp_ns <= until for u in expected.updates)


def test_the_newest_state_and_the_counters_agree_with_a_run(expected: FoldResult) -> None:
    fold = Fold(SETTINGS)
    feed(fold, EVENTS)
    assert fold.counts == expected.counts
    assert fold.newest_ns == max(e.stamp_ns for e in EVENTS if isinstance(e, Imu))


def test_a_reset_forgets_everything(expected: FoldResult) -> None:
    fold = Fold(SETTINGS)
    feed(fold, mission(4.0, SEED + 9))
    fold.reset()
    assert fold.latest is None
    assert fold.take() == []
    feed(fold, EVENTS)
    assert fold.latest.tobytes() == expected.states[-1].tobytes()


# ------------------------------------------------------------------ refusals


def at(k: int, f: float = 0.0) -> Imu:
    return Imu(START + k * STEP, np.array([f, 0.0, -9.8]), np.array([0.0, 0.0, 0.01]))


EQUAL_SAMPLES = ImuParameters(frozen_samples=0)
SIMPLE = FilterParameters(
    frame_convention="ned", max_delay=MAX_DELAY, q_timeout=0.5, imu=EQUAL_SAMPLES, initial=P_0
)


def simple(samples: int = 100, settings: FilterParameters = SIMPLE) -> Fold:
    fold = Fold(settings)
    for k in range(samples):
        assert fold.add(at(k)) is None
    return fold


def everything_at(stamp: int) -> list[Event]:
    return [
        Imu(stamp, np.zeros(3), np.zeros(3)),
        Dvl(stamp, np.zeros(3)),
        ProcessNoise(stamp, np.eye(3), np.eye(3)),
        Initial(stamp, np.eye(3), np.zeros(3), np.zeros(3), "body"),
        Origin(stamp, 0.1, 0.2, 0.3),
    ]


def test_what_is_older_than_max_delay_is_too_late() -> None:
    limit = START + 99 * STEP - round(MAX_DELAY * NS)
    for event in everything_at(limit - 1):
        fold = simple()
        before = fold.latest.tobytes()
        assert fold.add(event) == "too_late"
        assert fold.latest.tobytes() == before
    for event in everything_at(limit + 1):
        assert simple().add(event) is None


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_refused(value: float) -> None:
    stamp = START + 99 * STEP + 1
    wrong_vector, wrong_matrix = np.array([0.0, value, 0.0]), np.full((3, 3), value)
    zeros, one = np.zeros(3), np.eye(3)
    events: list[Event] = [
        Imu(stamp, wrong_vector, zeros),
        Imu(stamp, zeros, wrong_vector),
        Dvl(stamp, wrong_vector),
        Dvl(stamp, zeros, wrong_matrix),
        ProcessNoise(stamp, wrong_matrix, None),
        ProcessNoise(stamp, None, wrong_matrix),
        Initial(stamp, wrong_matrix, zeros, zeros, "body"),
        Initial(stamp, one, wrong_vector, zeros, "body"),
        Initial(stamp, one, zeros, wrong_vector, "body"),
        Initial(stamp, one, zeros, zeros, "body", P_v=wrong_matrix),
        Initial(stamp, one, zeros, zeros, "body", P_psi=wrong_matrix),
        Initial(stamp, one, zeros, zeros, "body", P_p=wrong_matrix),
        Origin(stamp, value, 0.0, 0.0),
        Origin(stamp, 0.0, value, 0.0),
        Origin(stamp, 0.0, 0.0, value),
    ]
    fold = simple()
    before = fold.latest.tobytes()
    for event in events:
        assert fold.add(event) == "not_finite", event
    fold.add(at(100))
    clean = simple(101)
    assert fold.latest.tobytes() == clean.latest.tobytes() != before


def test_the_second_of_two_at_one_stamp_is_a_duplicate() -> None:
    stamp = START + 90 * STEP
    for event in everything_at(stamp):
        fold = simple()
        again = fold.add(event)
        assert again == ("duplicate" if isinstance(event, Imu) else None)
        assert fold.add(event) == "duplicate"


def test_samples_of_a_recording_are_checked() -> None:
    stamps, f, w = np.array([1, 2, 3]), np.zeros((3, 3)), np.zeros((3, 3))
    with pytest.raises(ValueError, match=r"shape \(3, 3\)"):
        fold_arrays(SIMPLE, stamps, f[:2], w, [])
    with pytest.raises(ValueError, match="finite"):
        fold_arrays(SIMPLE, stamps, np.full((3, 3), np.nan), w, [])
    with pytest.raises(ValueError, match="got 2 after 2 at index 2"):
        fold_arrays(SIMPLE, np.array([1, 2, 2]), f, w, [])
    fold = simple(3)
    with pytest.raises(ValueError, match="must be empty, it has 3 samples"):
        fold.add_recording(stamps, f, w, [])


def test_a_run_says_what_it_did_not_use() -> None:
    stamps = START + STEP * np.arange(10)
    ping = Dvl(START + 5 * STEP, np.zeros(3))
    result = fold_arrays(
        SIMPLE,
        stamps,
        np.tile([0.0, 0.0, -9.8], (10, 1)),
        np.zeros((10, 3)),
        [ping, ping, Dvl(START + 6 * STEP, np.full(3, np.nan))],
    )
    assert result.refused == {"duplicate": 1, "not_finite": 1}
    assert len(result.updates) == 1


def test_a_run_uses_as_many_events_as_there_are() -> None:
    """None of them has to wait: the samples are there."""
    count = 3000
    stamps = START + STEP * np.arange(count + 1)
    told = [
        ProcessNoise(int(t) + 1, (1 + k) * 1e-6 * np.eye(3), None) for k, t in enumerate(stamps)
    ]
    f_b = np.tile([0.0, 0.0, -9.8], (count + 1, 1))
    settings = replace(SIMPLE, process_noise=ProcessNoiseParameters(source="external"))
    result = fold_arrays(settings, stamps, f_b, np.zeros((count + 1, 3)), list(told))
    expected = 1e-6 * np.arange(1, count + 1)
    np.testing.assert_allclose(result.states["noise"]["Q_f"][1:, 0, 0], expected, rtol=1e-12)
    assert not result.refused


def test_an_output_delay_beyond_max_delay_is_a_contradiction() -> None:
    with pytest.raises(ParameterError, match=r"output_delay.*max_delay \(0.5 s\), got 0.6"):
        replace(SIMPLE, output_delay=0.6)


# ------------------------------------------------------------------ memory


def test_memory_is_bounded_and_late_events_after_a_trim_still_count() -> None:
    """A long run in a small buffer, with everything out of order all the time."""
    events = mission(30.0, SEED + 10)
    expected = offline(SETTINGS, events)
    fold = Fold(SETTINGS, capacity=64)
    most = entries = 0
    for k, event in enumerate(shuffled(events, DELAY, np.random.default_rng([SEED, 8]))):
        assert fold.add(event) is None
        if k % 5 == 0:
            fold.take()
        most, entries = max(most, len(fold.states)), max(entries, len(fold.updates))
    assert most <= 256  # max_delay and the window that shows a rest are 100 samples
    assert entries <= 12
    assert fold.latest.tobytes() == expected.states[-1].tobytes()


def test_a_long_run_forgets_its_measurements() -> None:
    first, samples = 1_000_000, 1500  # no other test has events of these stamps
    fold = Fold(SIMPLE, capacity=128)
    for k in range(first, first + samples):
        fold.add(at(k))
        if k % 10 == 5:
            fold.add(Dvl(START + k * STEP - 1, np.zeros(3)))
            fold.add(ProcessNoise(START + k * STEP - 2, np.eye(3), np.eye(3)))
        fold.take()
    alive = [e for e in gc.get_objects() if isinstance(e, Dvl | ProcessNoise)]
    alive = [e for e in alive if START + first * STEP <= e.stamp_ns]
    assert 0 < len(alive) <= 2 * 26  # at most 256 samples are kept, with a pair for each ten


@pytest.mark.parametrize("age", [1, 25, 49, 50])
def test_an_event_right_after_a_trim_reaches_back_as_far_as_before(age: int) -> None:
    """Sample 256 trims the buffer of 256."""
    for last in (255, 256, 257):
        late = Dvl(START + (last - age) * STEP, np.array([0.3, 0.2, 0.1]))
        fold = Fold(SIMPLE, capacity=256)
        for k in range(last + 1):
            fold.add(at(k, 0.01 * (k % 7)))
            fold.take()
        assert (len(fold.states) < 110) == (last >= 256)
        assert fold.add(late) is None
        samples = [at(k, 0.01 * (k % 7)) for k in range(last + 1)]
        assert fold.latest.tobytes() == offline(SIMPLE, [*samples, late]).states[-1].tobytes()


def test_the_buffer_grows_when_nothing_may_be_dropped(expected: FoldResult) -> None:
    """Nothing is taken, so everything is kept for a later take."""
    fold = Fold(SETTINGS, capacity=4)
    for event in EVENTS:
        fold.add(event)
    assert fold.states.tobytes() == expected.states.tobytes()
    stamps = [o.stamp_ns for o in fold.take() if isinstance(o, Odometry)]
    assert stamps == [e.stamp_ns for e in EVENTS if isinstance(e, Imu)][1:]


# ------------------------------------------------------------------ process noise in time


def test_a_q_applies_from_its_stamp_on() -> None:
    """Also inside a sample's interval, which it cuts: 30 % of the step has the old Q."""
    stamp = START + 49 * STEP + 3 * STEP // 10
    q = ProcessNoise(stamp, 4.0 * np.eye(3), 9.0 * np.eye(3))
    settings = replace(
        SIMPLE,
        earth_rate=False,
        error_state="ned",
        q_timeout=100.0,
        initial=replace(P_0, tilt_std=0.0, heading_std=0.0, accelerometer_bias_std=0.0),
        process_noise=ProcessNoiseParameters(
            source="external",
            accelerometer_variance=(1.0,) * 3,
            gyroscope_variance=(2.0,) * 3,
            gyroscope_bias_walk=0.0,
        ),
    )
    settings = replace(settings, initial=replace(settings.initial, gyroscope_bias_std=0.0))
    fold = simple(100, settings)
    plain = fold.states.copy()
    fold.add(q)
    states = fold.states
    assert states[:49].tobytes() == plain[:49].tobytes()
    heading = states["nav"]["P"][:, 5, 5]
    steps = np.diff(heading) / (0.01 / 100.0)
    np.testing.assert_allclose(steps[:48], 2.0, rtol=1e-6)
    np.testing.assert_allclose(steps[48], 2.0, rtol=1e-6)
    np.testing.assert_allclose(steps[49], 0.3 * 2.0 + 0.7 * 9.0, rtol=1e-6)
    np.testing.assert_allclose(steps[50:], 9.0, rtol=1e-6)


def test_a_q_that_stops_coming_falls_back_and_comes_back() -> None:
    def told(k: int) -> ProcessNoise:
        return ProcessNoise(START + k * STEP, 0.5 * np.eye(3), 0.25 * np.eye(3))

    settings = replace(SIMPLE, process_noise=ProcessNoiseParameters(source="external"))
    fold = simple(300, settings)
    fold = Fold(settings)
    for k in range(300):
        fold.add(at(k))
        if k in (20, 60, 200):
            fold.add(told(k))
        fold.take()
    # 0.5 s after the second one: the step that begins later than that has the nominal Q again.
    q, nominal = fold.states["noise"]["Q_w"][:, 0, 0], 0.001
    expected = np.full(300, nominal)
    expected[20:112] = expected[200:252] = 0.25
    np.testing.assert_array_equal(q, expected)
    assert fold.counts["q_timeouts"] == 2
    assert fold.states["counters"]["q_timeouts"][[111, 112, 251, 252]].tolist() == [0, 1, 1, 2]


# ------------------------------------------------------------------ initialisation


def modes(mode: str, **initial: object) -> FilterParameters:
    return FilterParameters(
        frame_convention="ned",
        imu=EQUAL_SAMPLES,
        initial=replace(P_0, mode=mode, **initial),  # type: ignore[arg-type]
    )


def pose(k: float, once: bool = False, north: float = 0.0) -> Initial:
    p_o = np.array([north, 0.0, 0.0])
    return Initial(START + round(k * STEP), np.eye(3), p_o, np.zeros(3), "body", once=once)


def test_from_parameters_it_starts_at_the_first_sample() -> None:
    fold = Fold(modes("parameters", position=(7.0, 8.0, 9.0)))
    assert fold.latest is None
    fold.add(at(0))
    assert fold.latest["nav"]["time_ns"] == START
    np.testing.assert_allclose(position(fold.latest["nav"]), [7.0, 8.0, 9.0], atol=1e-8)


@pytest.mark.parametrize("mode", ["topic", "set_odometry"])
def test_until_it_is_told_nothing_is_published(mode: str) -> None:
    fold = Fold(modes(mode))
    for k in range(10):
        fold.add(at(k))
    fold.add(Dvl(START + 5 * STEP, np.full(3, 0.1)))
    outputs = fold.take()
    assert fold.latest is None
    assert [o.report.reason for o in outputs if isinstance(o, AppliedUpdate)] == ["not_initialised"]
    assert len(outputs) == 1
    fold.add(pose(9.5))
    fold.add(at(10))
    assert [o.stamp_ns for o in fold.take()] == [START + 10 * STEP]


def test_a_late_initial_starts_the_past() -> None:
    """It came 5 samples late: the state is as if it had been there in time."""
    events: list[Event] = [at(k, 0.1) for k in range(20)]
    start = pose(12.25, north=3.0)
    fold = Fold(modes("set_odometry"))
    for event in [*events, start]:
        fold.add(event)
    assert (
        fold.latest.tobytes()
        == offline(modes("set_odometry"), [start, *events]).states[-1].tobytes()
    )
    assert fold.states["nav"]["initialised"].tolist() == [0] * 13 + [1] * 7


def test_of_initials_that_apply_once_the_first_counts() -> None:
    """The first by stamp: an earlier one that comes later takes its place."""
    fold = simple(30, modes("topic"))
    fold.add(pose(10.5, once=True, north=1.0))
    fold.add(pose(20.5, once=True, north=2.0))
    assert position(fold.latest["nav"])[0] == pytest.approx(1.0, abs=0.1)
    fold.add(pose(5.5, once=True, north=3.0))
    assert position(fold.latest["nav"])[0] == pytest.approx(3.0, abs=0.1)
    fold.add(pose(25.5, north=4.0))
    assert position(fold.latest["nav"])[0] == pytest.approx(4.0, abs=0.1)


@pytest.mark.parametrize("newest", [99.5, 100.0])
def test_of_those_that_waited_for_the_first_sample_the_newest_counts(newest: float) -> None:
    """The odometry runs before the IMU does: what the vehicle did since its first nobody saw."""
    poses = [pose(k, once=True, north=k) for k in (0.0, 50.0, newest, 101.0)]
    states = []
    for order in (poses, poses[::-1]):
        fold = Fold(modes("topic"))
        for event in [*order, at(100), at(101)]:
            fold.add(event)
        assert fold.counts["gaps"] == 0
        assert position(fold.latest["nav"])[0] == pytest.approx(newest, abs=0.1)
        states.append(fold.latest.tobytes())
    alone = Fold(modes("topic"))
    for event in [poses[2], at(100), at(101)]:
        alone.add(event)
    assert states == [alone.latest.tobytes()] * 2


def test_the_origin_may_come_late_and_the_first_counts() -> None:
    settings = replace(modes("parameters"), origin=OriginParameters(source="topic"))
    fold = simple(30, settings)
    assert fold.latest is None
    fold.add(Origin(START + 20 * STEP, 0.5, 0.6, 70.0))
    assert fold.latest["nav"]["time_ns"] == START + 29 * STEP
    assert fold.states["nav"]["initialised"].tolist() == [0] * 21 + [1] * 9
    fold.add(Origin(START + 10 * STEP, 0.1, 0.2, 30.0))
    assert fold.states["nav"]["initialised"].tolist() == [0] * 11 + [1] * 19
    assert [fold.latest["nav"][name] for name in ("lat_0", "lon_0", "h_0")] == [0.1, 0.2, 30.0]


@pytest.mark.parametrize("yaw", [-2.5, 0.7])
def test_levelling_finds_roll_and_pitch_and_keeps_the_heading(yaw: float) -> None:
    roll, pitch = np.radians([12.0, -7.0])
    C = rotation_from_rpy(np.array([roll, pitch, yaw]))
    rng = np.random.default_rng([SEED, 11])
    fold = Fold(modes("levelling", rpy=(0.0, 0.0, yaw), levelling_time=0.5))
    for k in range(80):
        f_b = C.T @ [0.0, 0.0, -9.8] + 0.01 * rng.standard_normal(3)
        fold.add(Imu(START + k * STEP, f_b, np.zeros(3)))
    assert fold.states["nav"]["initialised"].tolist() == [0] * 50 + [1] * 30
    np.testing.assert_allclose(fold.states["nav"]["C_n_b"][50], C, atol=1e-3)


def test_a_state_that_waits_for_its_imu_knows_that_it_missed_something() -> None:
    """The pose was told 2 s before the first sample: that is a gap."""
    settings = modes("set_odometry")
    fold = Fold(settings)
    fold.add(pose(0.0))
    fold.add(at(200))
    soon = Fold(settings)
    soon.add(pose(0.0))
    soon.add(at(1))
    assert (soon.counts["gaps"], fold.counts["gaps"]) == (0, 1)
    unseen = (settings.imu.gap_acceleration_std * 2.0) ** 2
    assert np.diag(P15(fold.latest))[:3].min() > unseen


# ------------------------------------------------------------------ samples


def test_the_rate_of_the_samples_may_change() -> None:
    """Half the samples carry the mean of two: the state at their stamps is nearly the same."""
    fine = [at(k, 0.2 * np.sin(0.05 * k)) for k in range(0, 401)]
    coarse = fine[:200] + [
        Imu(b.stamp_ns, (a.f_b + b.f_b) / 2, (a.w_ib_b + b.w_ib_b) / 2)
        for a, b in zip(fine[200:400:2], fine[201:401:2], strict=True)
    ]
    ping = Dvl(START + 350 * STEP, np.array([0.1, 0.0, 0.0]))
    settings = modes("parameters")
    a = offline(settings, [*fine[:400], ping]).states[-1]
    b = offline(settings, [*coarse, ping]).states[-1]
    assert a["nav"]["time_ns"] == b["nav"]["time_ns"]
    np.testing.assert_allclose(b["nav"]["v_n"], a["nav"]["v_n"], atol=5e-5)
    np.testing.assert_allclose(position(b["nav"]), position(a["nav"]), atol=1e-4)
    np.testing.assert_allclose(np.diag(P15(b)), np.diag(P15(a)), rtol=2e-3)


def test_gaps_are_counted_and_add_uncertainty() -> None:
    settings = modes("parameters")
    stamps = [*range(100), *range(105, 150), *range(165, 200)]  # of 60 ms, and of 160 ms
    fold = Fold(settings)
    whole = Fold(settings)
    for k in range(200):
        whole.add(at(k))
        if k in stamps:
            fold.add(at(k))
    assert (fold.counts["gaps"], whole.counts["gaps"]) == (1, 0)
    at_end = P15(fold.states[stamps.index(165)]) - P15(whole.states[165])
    assert np.sqrt(at_end[0, 0]) == pytest.approx(0.5 * 0.16, rel=0.05)
    assert np.sqrt(at_end[5, 5]) == pytest.approx(0.05 * 0.16, rel=0.05)
    # The samples that were lost fill the gap when they come after all.
    for k in range(150, 165):
        fold.add(at(k))
    assert fold.counts["gaps"] == 0


def test_a_ping_in_a_gap_cuts_it_and_it_is_still_one_gap() -> None:
    settings = modes("parameters")
    fold = Fold(settings)
    for k in [*range(100), 200]:
        fold.add(at(k))
    P = P15(fold.latest).copy()
    fold.add(Dvl(START + 150 * STEP, np.full(3, 0.1), 1e12 * np.eye(3)))  # tells nothing
    assert fold.counts["gaps"] == 1
    np.testing.assert_allclose(np.diag(P15(fold.latest))[:6], np.diag(P)[:6], rtol=0.1)


# ------------------------------------------------------------------ turn rate


def seen(stamps: np.ndarray) -> np.ndarray:
    return np.ones(len(stamps), dtype=bool)


def test_a_sample_that_is_not_believed_is_not_in_the_line() -> None:
    stamps = np.arange(6, dtype=np.int64) * STEP
    w = 0.1 * np.arange(18.0).reshape(6, 3)
    spoilt, believed = w.copy(), seen(stamps)
    spoilt[3], believed[3] = 100.0, False
    found, expected, share = np.empty(3), np.empty(3), np.empty(3)
    for array, result in ((w, expected), (spoilt, found)):
        at = 5, int(stamps[-1]), 5 * STEP
        rate_at(stamps, array, believed, *at, np.zeros(3), result, share)
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_allclose(found, w[5] + (w[5] - w[4]) / 2, rtol=1e-12)


def test_the_turn_rate_is_that_of_a_line_at_the_stamp() -> None:
    """A rate that changes linearly is met exactly; each sample is its mean over its interval."""
    stamps = np.array([0, 10, 20, 40, 50], dtype=np.int64) * 1_000_000
    at, slope = np.array([0.2, -0.1, 0.4]), np.array([3.0, -2.0, 1.0])
    middles = 1e-9 * (stamps + np.concatenate([[0], stamps[:-1]])) / 2
    for stamp_ns in (42_000_000, 45_000_000, 50_000_000):
        w = at + (middles[:, None] - 1e-9 * stamp_ns) * slope
        found, share = np.empty(3), np.empty(3)
        rate_at(stamps, w, seen(stamps), 4, stamp_ns, 30_000_000, np.zeros(3), found, share)
        assert ((share > 1.0) & (share < 5.0)).all()
        np.testing.assert_allclose(found, at, rtol=1e-12)


def test_the_line_weights_each_sample_by_its_share_of_the_window() -> None:
    stamps = np.array([0, 10, 20, 40, 50], dtype=np.int64)
    w = np.random.default_rng(SEED).standard_normal((5, 3))
    found, share = np.empty(3), np.empty(3)
    # (15, 45]: half of sample 2, all of sample 3, half of sample 4.
    rate_at(stamps, w, seen(stamps), 4, 45, 30, np.zeros(3), found, share)
    line = np.polyfit([15 - 45, 30 - 45, 45 - 45], w[2:5], 1, w=np.sqrt([5, 20, 5]))
    np.testing.assert_allclose(found, line[1], rtol=1e-12)
    units = np.polyfit([15 - 45, 30 - 45, 45 - 45], np.eye(3), 1, w=np.sqrt([5, 20, 5]))[1]
    np.testing.assert_allclose(share, units @ units, rtol=1e-12)


@pytest.mark.parametrize(
    ("q", "least", "most"), [(1e-8, 3.5, 4.1), (1e-3, 1.2, 3.0), (0.1, 1, 1.1)]
)
def test_the_variance_of_the_turn_rate_is_that_of_its_error(
    q: float, least: float, most: float
) -> None:
    """Of N = 25 samples: 4 / N where the gyroscope is quiet, 1 / N where it is noisy."""
    rng = np.random.default_rng([SEED, 13])
    stamps = np.arange(26, dtype=np.int64) * STEP
    found, share, errors = np.empty(3), np.empty(3), []
    middles = (stamps - STEP / 2 - stamps[-1]) / NS
    for _ in range(20_000):
        w = np.sqrt(q) * rng.standard_normal((26, 3))
        w += np.outer(middles, TURN_ACCELERATION * rng.standard_normal(3))
        rate_at(
            stamps, w, seen(stamps), 25, int(stamps[-1]), 25 * STEP, np.full(3, q), found, share
        )
        errors.append(found.copy())
    np.testing.assert_allclose(np.mean(np.square(errors), axis=0), q * share, rtol=0.05)
    assert ((share > least / 25) & (share < most / 25)).all()


def test_one_sample_in_the_window_is_the_turn_rate() -> None:
    stamps = np.array([0, 10, 20, 40, 50], dtype=np.int64)
    w, found, share = np.arange(15.0).reshape(5, 3), np.empty(3), np.empty(3)
    # Before the second sample nothing is known of an interval's length.
    for k, stamp, window in ((3, 40, 20), (2, 15, 0), (0, 0, 30), (1, 10, 30)):
        rate_at(stamps, w, seen(stamps), k, stamp, window, np.ones(3), found, share)
        np.testing.assert_array_equal(share, 1.0)
        np.testing.assert_array_equal(found, w[k])


def test_an_update_uses_the_turn_rate_and_its_noise() -> None:
    """The innovation has w x l of the line at the stamp; S is smaller for the longer window."""
    rng = np.random.default_rng([SEED, 12])
    rates = rng.standard_normal((100, 3))
    S, variances, q = [], [], 0.001
    for window, samples in ((0.0, 1), (0.1, 10), (0.25, 25)):
        arm = np.array([2.0, 1.0, -1.0])
        settings = replace(
            modes("parameters"),
            earth_rate=False,
            dvl=DvlParameters(lever_arm=tuple(arm.tolist()), gyro_average=window),
        )
        events = [
            Imu(START + k * STEP, np.array([0.0, 0.0, -9.8]), 1e-3 * rates[k]) for k in range(100)
        ]
        v_d = np.array([0.1, 0.2, -0.3])
        result = offline(settings, [*events, Dvl(START + 99 * STEP, v_d)])
        before = offline(settings, list(events)).states[-1]
        # A line with the slope 0 +- TURN_ACCELERATION, in units of the noise of a sample.
        t = (np.arange(samples) - samples + 0.5) * STEP / NS
        design = np.vstack([np.column_stack([np.ones(samples), t]), np.zeros(2)])
        design[-1, 1] = np.sqrt(q) / TURN_ACCELERATION
        N = np.linalg.inv(design.T @ design) if samples > 1 else np.diag([1.0, 0.0])
        rate = 1e-3 * (N @ design[:-1].T @ rates[100 - samples :])[0]
        h = before["nav"]["C_n_b"].T @ before["nav"]["v_n"] + np.cross(rate, arm)
        report = result.updates[0].report
        np.testing.assert_allclose(report.innovation, v_d - h, rtol=1e-9, atol=1e-12)
        S.append(np.trace(report.S))
        variances.append(N[0, 0])
    arm_noise = 2 * (arm @ arm) * q
    assert variances[0] > variances[1] > variances[2]
    np.testing.assert_allclose(-np.diff(S), -np.diff(variances) * arm_noise, rtol=1e-6)
