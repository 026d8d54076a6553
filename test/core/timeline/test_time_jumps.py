"""Stamps that are of another time: one alone changes nothing, a run of them is followed or held."""

from dataclasses import replace

import numpy as np
import pytest
from places import position
from records import P15

from insdvl.navigation.events import NS, Event, Imu, Initial, Origin, ProcessNoise
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.odometry import Odometry
from insdvl.navigation.parameters import (
    FilterParameters,
    OriginParameters,
    ProcessNoiseParameters,
)
from insdvl.parameters.declaration import ParameterError
from insdvl.simulation.initial_errors import P_0
from insdvl.timeline.entries import MAX_WAITING
from insdvl.timeline.fold import Fold
from insdvl.timeline.jumps import JUMP_SAMPLES, MAX_SUSPECTS, TimeJump
from insdvl.timeline.output import AppliedUpdate
from insdvl.timeline.recorded import fold_arrays

SEED = 141_421
STEP = 10_000_000
START = 1_700_000_000 * NS
MAX_DELAY = 0.5
SETTINGS = FilterParameters(
    frame_convention="ned",
    max_delay=MAX_DELAY,
    process_noise=ProcessNoiseParameters(source="external"),
    initial=P_0,
)


def sample(stamp_ns: int) -> Imu:
    """Its readings follow from its stamp, by less than what a vehicle does."""
    rng = np.random.default_rng(stamp_ns % 2**32)
    f_b = np.array([0.0, 0.0, -9.79]) + 0.1 * rng.standard_normal(3)
    return Imu(stamp_ns, f_b, 0.01 * rng.standard_normal(3))


def samples(start_ns: int, count: int, step_ns: int = STEP) -> list[Event]:
    return [sample(start_ns + k * step_ns) for k in range(count)]


def voyage(start_ns: int, seconds: float) -> list[Event]:
    """Samples, a ping between two of them every 0.3 s, and a Q every 0.4 s."""
    count = round(seconds * 100)
    events = samples(start_ns, count)
    for k in range(30, count, 30):
        stamp = start_ns + k * STEP - STEP // 3
        events.append(Dvl(stamp, 0.05 * np.sin([k, k + 1.0, k + 2.0])))
    for k in range(0, count, 40):
        stamp = start_ns + k * STEP + STEP // 7
        events.append(ProcessNoise(stamp, (1 + k) * 1e-4 * np.eye(3), 1e-5 * np.eye(3)))
    return sorted(events, key=lambda e: (e.stamp_ns, e.kind))


def feed(fold: Fold, events: list[Event]) -> list[Odometry | AppliedUpdate | TimeJump]:
    taken = []
    for event in events:
        fold.add(event)
        taken += fold.take()
    return taken


def state_after(events: list[Event], settings: FilterParameters = SETTINGS) -> bytes:
    fold = Fold(settings)
    feed(fold, events)
    return fold.latest.tobytes()


# ------------------------------------------------------------------ one wrong stamp


@pytest.mark.parametrize("seconds", [-1e9, -1000.0, -3.0, -0.6, 0.6, 3.0, 29.0, 101.0, 1e6, 4e8])
def test_one_wrong_stamp_changes_nothing(seconds: float) -> None:
    """Of a sample, of a ping and of a Q; what comes after is used as if they had not come."""
    events = voyage(START, 3.0)
    at = 150
    stamp = events[at].stamp_ns + round(seconds * NS)
    clean, fold = Fold(SETTINGS), Fold(SETTINGS)
    expected = feed(clean, events)
    taken = feed(fold, events[:at])
    reason = "too_late" if seconds < 0.0 else "far_ahead"
    assert fold.add(sample(stamp)) == reason
    if seconds < 0.0 or seconds > 100.0:  # more than MAX_QUEUE samples
        assert fold.add(Dvl(stamp, np.ones(3))) == reason
        assert fold.add(ProcessNoise(stamp, np.eye(3), np.eye(3))) == reason
    taken += feed(fold, events[at:])
    assert fold.latest.tobytes() == clean.latest.tobytes()
    assert [o.stamp_ns for o in taken] == [o.stamp_ns for o in expected]
    assert fold.counts["time_jumps"] == fold.counts["recovered"] == 0


@pytest.mark.long
def test_a_filter_behind_with_a_long_queue_of_samples_loses_nothing() -> None:
    """All else comes at once, the samples 90 s later: longer than the jump limit."""
    events = voyage(START, 92.0)
    samples_ = [e for e in events if isinstance(e, Imu)]
    others = [e for e in events if not isinstance(e, Imu)]
    near = others[0].stamp_ns + round(2.0 * NS)
    fold = Fold(SETTINGS)
    taken = feed(fold, [e for e in events if e.stamp_ns <= near])
    for event in others:
        if event.stamp_ns > near:
            assert fold.add(event) is None
    taken += feed(fold, [e for e in samples_ if e.stamp_ns > near])
    clean = Fold(SETTINGS)
    expected = feed(clean, events)
    assert fold.latest.tobytes() == clean.latest.tobytes()
    assert [o.stamp_ns for o in taken] == [o.stamp_ns for o in expected]
    assert fold.counts == clean.counts


def test_wrong_stamps_now_and_then_are_no_run() -> None:
    """Ten of them follow each other, but samples of the present time are in between."""
    events = voyage(START, 3.0)
    fold = Fold(SETTINGS)
    for k, event in enumerate(events):
        assert fold.add(event) is None
        if k % 5 == 0:
            assert fold.add(sample(START - 500 * NS + k * STEP)) == "too_late"
    assert fold.latest.tobytes() == state_after(events)
    assert fold.counts["time_jumps"] == 0


# ------------------------------------------------------------------ a time jump


@pytest.mark.parametrize("seconds", [-1e9, -1000.0, -5.0, 40.0, 1000.0, 4e8])
@pytest.mark.parametrize("output_delay", [0.0, 0.3])
def test_after_a_time_jump_nothing_is_lost(seconds: float, output_delay: float) -> None:
    """The new time's state is that of a filter which has seen nothing else; all is published."""
    settings = replace(SETTINGS, output_delay=output_delay)
    old = voyage(START, 2.0)
    new = voyage(START + round((2.0 + seconds) * NS), 2.0)
    fold, fresh = Fold(settings), Fold(settings)
    first = feed(fold, old)
    second = feed(fold, new)
    assert fold.latest.tobytes() == state_after(new, settings)
    assert (fold.counts["time_jumps"], fold.counts["given_up"]) == (1, 0)
    refused = JUMP_SAMPLES - 1 + (not 0.0 < seconds < 100.0)  # the first samples but one, and a Q
    assert fold.counts["recovered"] == refused
    at = next(k for k, output in enumerate(second) if isinstance(output, TimeJump))
    assert second[at] == TimeJump(old[-1].stamp_ns, new[0].stamp_ns)
    before = [o.stamp_ns for o in [*first, *second[:at]] if isinstance(o, Odometry)]
    assert before == [e.stamp_ns for e in old if isinstance(e, Imu)]
    expected = [o.stamp_ns for o in feed(fresh, new)]
    assert [o.stamp_ns for o in second[at + 1 :]] == expected


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("seconds", [-100.0, 100.0])
def test_across_a_jump_too_the_order_of_arrival_does_not_matter(seed: int, seconds: float) -> None:
    """Old and new stamps come interleaved for nearly max_delay."""
    old = voyage(START, 2.0)
    new = voyage(START + round((2.0 + seconds) * NS), 2.0)
    rng = np.random.default_rng([SEED, seed])
    arrival = [e.stamp_ns for e in old] + [e.stamp_ns - round(seconds * NS) for e in new]
    late = rng.uniform(0.0, MAX_DELAY - 0.02, len(arrival)) * NS
    order = np.argsort(np.array(arrival) + late)
    events = [*old, *new]
    fold = Fold(SETTINGS)
    feed(fold, [events[k] for k in order])
    assert fold.counts["time_jumps"] == 1
    assert fold.latest.tobytes() == state_after(new)


def test_one_sample_less_is_no_jump() -> None:
    fold = Fold(SETTINGS)
    feed(fold, samples(START, 50))
    before = fold.latest.tobytes()
    elsewhere = samples(START - 100 * NS, JUMP_SAMPLES)
    assert [fold.add(e) for e in elsewhere[:-1]] == ["too_late"] * (JUMP_SAMPLES - 1)
    assert fold.latest.tobytes() == before
    assert fold.add(elsewhere[-1]) is None
    assert fold.newest_ns == elsewhere[-1].stamp_ns


@pytest.mark.parametrize("step", [0, -STEP, 3 * NS])
def test_samples_that_do_not_follow_each_other_are_no_run(step: int) -> None:
    """The same stamp over and over; backwards; seconds apart."""
    fold = Fold(SETTINGS)
    feed(fold, samples(START, 50))
    for event in samples(START - 1000 * NS, 30, step):
        assert fold.add(event) == "too_late"
    assert fold.counts["time_jumps"] == 0


def test_what_came_just_before_the_run_is_used() -> None:
    """A recording begins again with its set_odometry and its fix, then come the samples."""
    settings = replace(
        SETTINGS,
        initial=replace(P_0, mode="set_odometry"),
        origin=OriginParameters(source="topic"),
    )
    start = Initial(START + 1, np.eye(3), np.array([1.0, 2.0, 3.0]), np.zeros(3), "body")
    loop = [Origin(START, 0.5, 0.6, 7.0), start, *voyage(START + 2, 3.0)]
    fold, once = Fold(settings), Fold(settings)
    feed(once, loop)
    for _ in range(3):
        feed(fold, loop)
    assert fold.counts["time_jumps"] == 2
    assert fold.latest.tobytes() == once.latest.tobytes()


def test_where_odom_lies_does_not_depend_on_the_time() -> None:
    """A fix that is sent only once holds after a clock was set, too."""
    settings = replace(SETTINGS, origin=OriginParameters(source="topic"))
    fold = Fold(settings)
    feed(fold, [Origin(START, 0.5, 0.6, 7.0), *samples(START, 50)])
    feed(fold, samples(START + 3600 * NS, 50))
    assert [fold.latest["nav"][name] for name in ("lat_0", "lon_0", "h_0")] == [0.5, 0.6, 7.0]


def test_where_odom_lies_stays_known_over_a_reset() -> None:
    """Under water no other fix comes; one that still waits for its sample holds as well."""
    settings = replace(SETTINGS, origin=OriginParameters(source="topic"))
    for told in (0, 49, 50):
        fold = Fold(settings)
        assert fold.add(Origin(START + told * STEP, 0.5, 0.6, 7.0)) is None
        feed(fold, samples(START, 50))
        for _ in range(2):
            fold.reset()
            assert fold.latest is None
        feed(fold, samples(START + 60 * STEP, 5))
        assert [fold.latest["nav"][name] for name in ("lat_0", "lon_0", "h_0")] == [0.5, 0.6, 7.0]
        assert fold.states["nav"]["initialised"].all()


def test_a_reset_needs_nothing_of_a_fold_that_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*arguments: object) -> None:
        raise RuntimeError("a bug")

    fold = Fold(replace(SETTINGS, origin=OriginParameters(source="topic")))
    feed(fold, [Origin(START, 0.5, 0.6, 7.0), *samples(START, 50)])
    with monkeypatch.context() as broken:
        broken.setattr(fold.filter, "update", fail)
        fold.add(Dvl(START + 40 * STEP, np.full(3, 0.1)))
        with pytest.raises(RuntimeError, match="a bug"):
            fold.take()
        fold.reset()
    feed(fold, samples(START + 60 * STEP, 5))
    assert [fold.latest["nav"][name] for name in ("lat_0", "lon_0", "h_0")] == [0.5, 0.6, 7.0]


def test_counters_go_on_through_a_jump_and_end_at_a_reset() -> None:
    fold = Fold(SETTINGS)
    gap = [*samples(START, 20), *samples(START + 50 * STEP, 20)]
    feed(fold, gap)
    feed(fold, [replace(e, stamp_ns=e.stamp_ns + 100 * NS) for e in gap])
    assert (fold.counts["gaps"], fold.counts["time_jumps"]) == (2, 1)
    resets = fold.counts["odom_resets"]
    assert resets == 1
    fold.reset()
    counts = fold.counts
    assert counts.pop("odom_resets") == resets + 1  # whoever looks at it must see the reset
    assert not any(counts.values())


def test_a_ping_that_waited_for_the_old_time_may_be_of_the_new_one() -> None:
    """The IMU is away for 31 s, the DVL is not."""
    new = voyage(START + 32 * NS, 2.0)
    waiting = [Dvl(START + 30 * NS + k, np.full(3, 0.1)) for k in (0, 2 * NS - 1)]
    fold = Fold(SETTINGS)
    feed(fold, [*samples(START, 100), *waiting[:1]])
    feed(fold, [*waiting[1:], *new])
    assert fold.latest.tobytes() == state_after([waiting[1], *new])
    assert fold.counts["given_up"] == 1


# ------------------------------------------------------------------ hold


def test_hold_stays_where_it_is_until_it_is_reset() -> None:
    fold = Fold(replace(SETTINGS, jump_action="hold"))
    feed(fold, voyage(START, 2.0))
    before, newest_ns = fold.latest.tobytes(), fold.newest_ns
    elsewhere = voyage(START - 1000 * NS, 3.0)
    assert all(fold.add(event) == "too_late" for event in elsewhere)
    assert fold.take() == []
    assert fold.latest.tobytes() == before
    assert fold.held == TimeJump(newest_ns, elsewhere[0].stamp_ns)
    fold.reset()
    assert fold.held is None
    feed(fold, elsewhere)
    assert fold.latest.tobytes() == state_after(elsewhere)


def test_hold_ends_when_the_clock_comes_back() -> None:
    """A clock that was set back by 3 s: after 2.5 s its stamps are late by no more than 0.5 s."""
    fold = Fold(replace(SETTINGS, jump_action="hold"))
    feed(fold, voyage(START, 4.0))
    feed(fold, samples(START + NS, 200))
    assert fold.held is not None
    taken = feed(fold, samples(START + 3 * NS + 60 * STEP, 100))
    assert fold.held is None
    assert taken[-1].stamp_ns == START + 4 * NS + 59 * STEP
    assert np.isfinite(P15(fold.latest)).all()


# ------------------------------------------------------------------ long gaps


@pytest.mark.parametrize("gap", [0.01, 0.1, 1.0, 5.0, 10.0, 29.0])
def test_a_gap_up_to_the_limit_is_bridged(gap: float) -> None:
    """As offline, in whatever order the samples after it come; the sigma covers the unseen."""
    resume = START + 99 * STEP + round(gap * NS)
    events = [*samples(START, 100), Dvl(resume - STEP // 2, np.full(3, 0.02))]
    events += samples(resume, 100)
    imu = [e for e in events if isinstance(e, Imu)]
    expected = fold_arrays(
        SETTINGS,
        np.array([e.stamp_ns for e in imu]),
        np.array([e.f_b for e in imu]),
        np.array([e.w_ib_b for e in imu]),
        [e for e in events if not isinstance(e, Imu)],
    )
    for seed in range(3):
        late = np.random.default_rng([SEED, 7, seed]).uniform(0.0, 0.4 * NS, len(events))
        order = np.argsort([e.stamp_ns + d for e, d in zip(events, late, strict=True)])
        fold = Fold(SETTINGS)
        feed(fold, [events[k] for k in order])
        assert fold.latest.tobytes() == expected.states[-1].tobytes()
        assert fold.counts["gaps"] == (gap > 0.1)
        assert fold.counts["time_jumps"] == 0
    s = expected.states
    before, after = (np.sqrt(s["nav"]["P"][k, 0, 0]) for k in (99, 100))
    unseen = 0.5 * gap if gap > 0.1 else 0.0
    noise = 0.1  # of one ping, that came at the end of the gap
    assert after > min(unseen, 0.9 * noise) and after < before + unseen + 2 * noise


def test_a_recording_for_a_run_is_of_one_time() -> None:
    stamps = np.array([START, START + STEP, START + 31 * NS])
    with pytest.raises(ValueError, match=r"more than jump_limit \(30 s\), got .* at index 2"):
        fold_arrays(SETTINGS, stamps, np.zeros((3, 3)), np.zeros((3, 3)), [])


@pytest.mark.parametrize("change", [{"max_delay": 40.0}, {"jump_limit": 1.0, "max_delay": 2.0}])
def test_a_jump_limit_below_max_delay_is_a_contradiction(change: dict) -> None:
    with pytest.raises(ParameterError, match=r"'jump_limit' must be at least max_delay"):
        replace(SETTINGS, **change)


# ------------------------------------------------------------------ memory


def test_suspects_are_bounded() -> None:
    fold = Fold(SETTINGS)
    feed(fold, samples(START, 50))
    for k in range(3 * MAX_SUSPECTS):
        assert fold.add(Dvl(START + 3600 * NS + k * STEP, np.ones(3))) == "far_ahead"
        assert fold.add(sample(START - 3600 * NS - 5 * k * NS)) == "too_late"
    assert len(fold._suspects.events) == MAX_SUSPECTS
    assert fold.counts["time_jumps"] == 0
    # Those of long ago are forgotten as the present goes on.
    feed(fold, samples(START + 50 * STEP, 60))
    assert len(fold._suspects.events) == 0


def test_what_waits_for_the_first_sample_is_bounded() -> None:
    """Hours without an IMU: the fix of the beginning and the last odometry are what counts."""
    settings = replace(
        SETTINGS,
        initial=replace(P_0, mode="set_odometry"),
        origin=OriginParameters(source="topic"),
    )
    fold = Fold(settings)
    count = MAX_WAITING + 500
    for k in range(count):
        stamp = START + k * NS
        fold.add(Origin(stamp, 0.5, 0.6, float(k)))
        fold.add(Dvl(stamp, np.ones(3)))
        fold.add(ProcessNoise(stamp, np.eye(3), np.eye(3)))
        fold.add(Initial(stamp, np.eye(3), np.full(3, float(k)), np.zeros(3), "body"))
    assert len(fold._entries.ordered) == 4 * MAX_WAITING
    assert fold.counts["given_up"] == 4 * 500
    feed(fold, samples(START + count * NS, 10))
    assert fold.latest["nav"]["h_0"] == 0.0
    assert position(fold.latest["nav"])[0] == pytest.approx(count - 1, abs=0.5)


def test_an_initial_state_from_long_ago_is_not_used() -> None:
    """Where the vehicle has been since, nobody knows: it waits for another one."""
    settings = replace(SETTINGS, initial=replace(P_0, mode="set_odometry"))
    for seconds, starts in ((29.0, True), (31.0, False), (1.7e9, False)):
        fold = Fold(settings)
        stamp = START - round(seconds * NS)
        fold.add(Initial(stamp, np.eye(3), np.zeros(3), np.zeros(3), "body"))
        feed(fold, samples(START, 10))
        assert (fold.latest is not None) == starts
        assert fold.counts["too_old"] == (not starts)
        fold.add(Initial(START + 5 * STEP, np.eye(3), np.zeros(3), np.zeros(3), "body"))
        assert fold.latest is not None


# ------------------------------------------------------------------ large stamps


def test_no_precision_is_lost_near_the_end_of_the_stamps() -> None:
    """2^31 s is the last second that a stamp can tell; a start at zero gives the same bits."""

    def shifted(event: Event) -> Event:
        return replace(event, stamp_ns=event.stamp_ns + 2**31 * NS - 4 * NS)

    events = [e for e in voyage(0, 3.0) if e.stamp_ns >= 0]
    folds = Fold(SETTINGS), Fold(SETTINGS)
    feed(folds[0], events)
    feed(folds[1], [shifted(e) for e in events])
    early, late = (fold.latest for fold in folds)
    assert late["nav"]["time_ns"] - early["nav"]["time_ns"] == (2**31 - 4) * NS
    for name in ("C_n_b", "v_n", "llh", "b_f", "b_w", "P"):
        assert early["nav"][name].tobytes() == late["nav"][name].tobytes()
    for name in ("Q_f", "Q_w"):
        assert early["noise"][name].tobytes() == late["noise"][name].tobytes()
