"""Map and odom: an absolute input moves the estimate in map, and odom stays where it is.

Of odom's covariance docs/explanation/map-odom.md says what it is; here it is compared with errors.
Seeds were chosen before the first run.
"""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from compass import compass, with_compass
from fix import Fix, FixModel, with_fixes
from places import moved
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from insdvl.arrays import Array, Records
from insdvl.navigation import map_to_odom
from insdvl.navigation.channels import ImuParameters
from insdvl.navigation.error_state import POSITION
from insdvl.navigation.events import Event, Imu, Initial, Measurement
from insdvl.navigation.filter import LAYOUT, Filter
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.measurements.heading import Heading
from insdvl.navigation.odometry import Odometry, odometry
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.prediction.kept import Kept
from insdvl.navigation.state.fields import CORE
from insdvl.simulation.grades import GRADES
from insdvl.simulation.mission import Mission
from insdvl.studies.consistency.flights import (
    RATE,
    Case,
    initial_state,
    mission_of,
    parameters,
)
from insdvl.timeline.fold import Fold
from insdvl.timeline.recorded import fold_arrays

SEED = 151_000
MEMS = GRADES["mems"]
ARM = (0.8, -0.3, 0.4)
POSE = [0, 1, 2, 5]  # x, y, z, yaw of the published covariance
PER_SECOND = round(RATE)


def yaw_of(C: Array) -> float:
    return math.atan2(C[1, 0], C[0, 0])


def compass_events(mission: Mission, rng: np.random.Generator, first: float, std: float) -> list:
    C, rows = mission.truth.C_n_b, range(round(first * RATE) - 1, len(mission.stamps_ns), 100)
    return [
        compass(int(mission.stamps_ns[k]), yaw_of(C[k]) + std * rng.standard_normal(), std)
        for k in rows
    ]


@cache
def flight(case: Case, seed: int) -> tuple[Mission, Initial]:
    mission = mission_of(case, seed)
    return mission, initial_state(case, mission.initial, np.random.default_rng([seed, 1]))


def events_of(mission: Mission, until: int) -> list[Event]:
    """Samples and pings of the first seconds of a mission, in the order of stamps."""
    end_ns = int(mission.stamps_ns[until * PER_SECOND - 1])
    samples = zip(mission.stamps_ns, mission.f_b, mission.w_ib_b, strict=True)
    pings = zip(mission.dvl_stamps_ns, mission.v_d, strict=True)
    events: list[Event] = [Imu(int(t), f, w) for t, f, w in samples if t <= end_ns]
    events += [Dvl(int(t), v) for t, v in pings if t <= end_ns]
    return sorted(events, key=lambda e: (e.stamp_ns, e.kind))


def folded(settings: FilterParameters, events: list[Event]) -> Fold:
    fold = Fold(settings)
    for event in events:
        assert fold.add(event) is None
    return fold


def seen_by(filter_: Filter, state: Records) -> Odometry:
    return odometry(filter_, state, 0)


def yaw_in(quaternion: Array) -> float:
    return yaw_of(Rotation.from_quat(quaternion).as_matrix())


# ------------------------------------------------------------------ one update

STATES = {
    "level": [0.05, -0.1, 0.7],
    "pitched": [0.3, -0.6, 2.8],
    "nose down": [0.2, -1.52, 0.4],
}


def far_from_the_start(settings: FilterParameters, rpy: list[float]) -> tuple[Filter, Records]:
    """A state 1.2 km from its start, all of whose errors are correlated."""
    filter_ = Filter(settings)
    state = filter_.empty()
    C = Rotation.from_euler("xyz", rpy).as_matrix()
    initial = Initial(10**9, C, np.array([20.0, -30.0, 5.0]), np.array([1.5, 0.1, 0.0]), "body")
    filter_.initialise(state, initial, 10**9, np.zeros(3))
    nav = state[0]["nav"]
    nav["llh"] = moved(nav["llh"], [900.0, -800.0, 12.0])
    root = np.random.default_rng(SEED).standard_normal((CORE, CORE))
    sigma = np.repeat([0.05, 0.02, 1e-2, 1e-4, 8.0], 3)
    sigma[5] = 0.3
    nav["P"][:CORE, :CORE] = root @ root.T / CORE * np.outer(sigma, sigma)
    return filter_, state


def absolute_fixes(monkeypatch: pytest.MonkeyPatch, settings: FilterParameters) -> FilterParameters:
    monkeypatch.setattr(FixModel, "absolute", True)
    return with_fixes(settings)


@pytest.mark.parametrize("rpy", STATES.values(), ids=STATES)
@pytest.mark.parametrize("error_state", ["invariant", "ned"])
@pytest.mark.parametrize("input_", ["heading", "position"])
def test_an_absolute_update_does_not_move_odom(
    monkeypatch: pytest.MonkeyPatch, error_state: str, input_: str, rpy: list[float]
) -> None:
    settings = replace(
        parameters(Case(MEMS, 10.0, error_state=error_state)), imu=ImuParameters(lever_arm=ARM)
    )
    if input_ == "heading":
        settings = with_compass(settings)
    else:
        settings = absolute_fixes(monkeypatch, settings)
    filter_, state = far_from_the_start(settings, rpy)
    for k in range(3):
        before = seen_by(filter_, state)
        measurement: Measurement = compass(10**9 + k, rpy[2] + 0.25 + 0.02 * k, 0.05)
        if input_ == "position":
            measurement = Fix(10**9 + k, np.array([950.0 + k, -810.0, 20.0]), 2.0)
        assert filter_.update(state, measurement, np.zeros(3), 1.0).accepted
        after = seen_by(filter_, state)
        assert np.hypot.reduce(after.in_odom.position - before.in_odom.position) < 1e-6
        R = [Rotation.from_quat(o.in_odom.quaternion_xyzw) for o in (before, after)]
        about_up = (R[1] * R[0].inv()).as_matrix()
        if abs(rpy[1]) < 1.0:
            turned = yaw_in(after.in_odom.quaternion_xyzw) - yaw_in(before.in_odom.quaternion_xyzw)
        else:  # where yaw is not defined
            turned = math.atan2(about_up[1, 0] - about_up[0, 1], np.trace(about_up[:2, :2]))
        assert abs(turned) < 1e-9
        moved_by = np.hypot.reduce(after.position - before.position)
        assert k > 0 or moved_by > 1.0
        grown = (after.in_odom.covariance - before.in_odom.covariance)[np.ix_(POSE, POSE)]
        scale = np.sqrt(np.diag(before.in_odom.covariance)[POSE])
        least = np.linalg.eigvalsh(grown / np.outer(scale, scale))[0]
        assert least > -1e-4  # the convergence of the meridians is that of another place in map
        # Roll and pitch are shared, and so is all of the rest.
        tilt = [Rotation.from_quat(q).as_euler("ZYX")[1:] for q in both(after)]
        np.testing.assert_allclose(*tilt, atol=1e-12)
        assert_seen_through(after)


def both(o: Odometry) -> tuple[Array, Array]:
    return o.quaternion_xyzw, o.in_odom.quaternion_xyzw


def assert_seen_through(o: Odometry) -> None:
    """The pose in map is that in odom through map -> odom."""
    *p, yaw = o.map_to_odom
    R = Rotation.from_euler("z", yaw)
    np.testing.assert_allclose(p + R.apply(o.in_odom.position), o.position, atol=1e-8)
    whole = R * Rotation.from_quat(o.in_odom.quaternion_xyzw)
    assert (whole.inv() * Rotation.from_quat(o.quaternion_xyzw)).magnitude() < 1e-9


@pytest.mark.parametrize("convention", ["ned", "enu"])
def test_what_is_seen_in_odom(convention: str) -> None:
    """In the axes of the stream; the other updates move both by the same."""
    settings = with_compass(replace(parameters(Case(MEMS, 10.0)), frame_convention=convention))
    filter_, state = far_from_the_start(settings, STATES["level"])
    filter_.update(state, compass(10**9, 1.1, 0.02), np.zeros(3), 1.0)
    first = seen_by(filter_, state)
    assert_seen_through(first)
    assert abs(first.map_to_odom[3]) > 0.1
    assert filter_.update(
        state, Dvl(10**9, np.array([1.52, 0.05, 0.03])), np.zeros(3), 1.0
    ).accepted
    second = seen_by(filter_, state)
    assert_seen_through(second)
    np.testing.assert_array_equal(first.map_to_odom, second.map_to_odom)
    assert np.hypot.reduce(second.in_odom.position - first.in_odom.position) > 1e-4


def test_the_covariance_in_odom_is_that_in_map_where_map_is_odom() -> None:
    """With nothing corrected, the way through odom gives the covariance of map: one formula."""
    settings = replace(parameters(Case(MEMS, 10.0)), imu=ImuParameters(lever_arm=ARM))
    for error_state in ("invariant", "ned"):
        filter_, state = far_from_the_start(
            replace(settings, error_state=error_state), STATES["pitched"]
        )
        in_map = seen_by(filter_, state).pose_covariance
        map_to_odom.before(state[0], filter_.vehicle, absolute=True)
        state[0]["odom"]["P"][2, 2] = 1e-30  # as good as nothing
        in_odom = seen_by(filter_, state).in_odom.covariance
        np.testing.assert_allclose(in_odom, in_map, rtol=1e-7, atol=1e-9 * np.abs(in_map).max())


# ------------------------------------------------------------------ the fold


def test_without_an_absolute_input_odom_is_map_to_the_bit() -> None:
    """DVL, and a depth that nothing tells against the Earth's heading, move both."""
    mission, initial = flight(Case(MEMS, 5.0, duration=30.0), SEED)
    fold = folded(parameters(Case(MEMS, 5.0)), [initial, *events_of(mission, 30)])
    states = fold.states
    for name in ("p", "yaw", "P"):
        assert not states["odom"][name].any()
    for k in range(0, len(states), 200):
        o = odometry(fold.filter, states, k)
        for of_map, of_odom in zip(
            (o.position, o.quaternion_xyzw, o.pose_covariance),
            (o.in_odom.position, o.in_odom.quaternion_xyzw, o.in_odom.covariance),
            strict=True,
        ):
            assert of_map.tobytes() == of_odom.tobytes()


def with_headings(seconds: int) -> tuple[FilterParameters, list[Event]]:
    case = Case(MEMS, 10.0, duration=float(seconds))
    mission, initial = flight(case, SEED)
    headings = compass_events(mission, np.random.default_rng([SEED, 2]), seconds / 2.0, 0.02)
    events = [initial, *events_of(mission, seconds), *headings]
    settings = replace(with_compass(parameters(case)), max_delay=1.0)
    return settings, sorted(events, key=lambda e: (e.stamp_ns, e.kind))


def test_any_order_of_arrival_gives_the_same_bits() -> None:
    settings, events = with_headings(20)
    whole = folded(settings, events)
    assert whole.states[-1]["odom"]["yaw"] != 0.0
    rng = np.random.default_rng(SEED)
    late = rng.uniform(0.0, 0.9e9, len(events))
    order = sorted(range(len(events)), key=lambda i: events[i].stamp_ns + late[i])
    mixed = Fold(settings)
    for i in order:
        mixed.add(events[i])
        mixed.take()
    assert mixed.states[-1].tobytes() == whole.states[-1].tobytes()


def test_a_state_that_goes_on_keeps_map_to_odom() -> None:
    settings, events = with_headings(20)
    whole = folded(settings, events)
    at = 1500
    first = Fold(settings)
    second = Fold(settings)
    for event in events:
        if event.stamp_ns <= int(whole.states[at]["channels"]["imu_ns"]):
            first.add(event)
    second.resume(first.states[-1:].copy())
    for event in events:
        if event.stamp_ns > int(whole.states[at]["channels"]["imu_ns"]):
            second.add(event)
    kept, through = (fold.states[-1]["odom"] for fold in (second, whole))
    assert kept.tobytes() == through.tobytes()


def test_a_start_makes_odom_map_and_counts_as_a_reset() -> None:
    settings, events = with_headings(20)
    events = [event for event in events if event.stamp_ns < events[-1].stamp_ns]
    fold = folded(settings, events)
    assert fold.counts["odom_resets"] == 0 and fold.states[-1]["odom"]["yaw"] != 0.0
    assert not fold.reset()  # with initial.mode set_odometry nothing is kept
    assert fold.counts["odom_resets"] == 1
    for event in events:
        fold.add(event)
    fold.states  # noqa: B018
    stamp_ns = events[-1].stamp_ns
    start = next(event for event in events if isinstance(event, Initial))
    fold.add(replace(start, stamp_ns=stamp_ns))
    latest = fold.latest
    assert latest is not None and not latest["odom"]["yaw"] and not latest["odom"]["P"].any()
    assert fold.counts["odom_resets"] == 2
    for event in events:  # another time
        moved_on = replace(event, stamp_ns=event.stamp_ns + 10**13)
        fold.add(moved_on)
    assert fold.counts["time_jumps"] == 1 and fold.counts["odom_resets"] == 3


def test_gyrocompassing_turns_odom_and_counts_resets() -> None:
    """A FOG whose heading is unknown: DVL and the Earth's rotation tell it, within minutes."""
    case = Case(GRADES["fog"], 60.0, duration=150.0)
    mission, initial = flight(case, SEED)
    wrong = Rotation.from_euler("z", -0.8).as_matrix() @ mission.initial.C_n_b[0]
    start = replace(initial, C_o_b=wrong)
    pings = [Dvl(int(t), v) for t, v in zip(mission.dvl_stamps_ns, mission.v_d, strict=True)]
    arrays = mission.stamps_ns, mission.f_b, mission.w_ib_b
    state = fold_arrays(parameters(case), *arrays, [start, *pings]).states[-1]
    heading = math.sqrt(state["nav"]["P"][5, 5])
    assert heading < math.radians(10.0)
    error = yaw_of(state["nav"]["C_n_b"]) - yaw_of(mission.truth.C_n_b[-1])
    assert abs(math.remainder(error, 2.0 * math.pi)) < 4.0 * heading
    by_updates = state["odom"]["turned"]
    assert by_updates == pytest.approx(0.8, abs=4.0 * heading) and not state["odom"]["yaw"]
    assert state["counters"]["odom_resets"] >= by_updates // map_to_odom.RESET_TURN


# ------------------------------------------------------------------ covariance and errors

CLONES = 4
HEADINGS, BEGIN, WINDOW = 40, 60, 60  # s: first heading, first window, length of a window
HEADING_STD = 0.02


class Flown:
    """A flight through a filter, step by step, which keeps what an increment needs.

    The pose at the begin of a window is cloned into states that nothing drives, so the covariance
    of the pose at its end with that at its begin is a block of P. An absolute update takes from
    that block what it takes of the error of the estimate; odom does not get it.
    """

    def __init__(self, case: Case, seed: int) -> None:
        mission, initial = flight(case, seed)
        self.mission = mission
        settings = with_compass(parameters(case), CLONES)
        self.filter = Filter(settings)
        assert LAYOUT.size >= CORE + CLONES
        rng = np.random.default_rng([seed, 2])
        self.events: dict[int, list[Measurement]] = {}
        for t, v in zip(mission.dvl_stamps_ns, mission.v_d, strict=True):
            self.events.setdefault(int(t), []).append(Dvl(int(t), v))
        for event in compass_events(mission, rng, HEADINGS, HEADING_STD):
            self.events.setdefault(event.stamp_ns, []).append(event)
        self.readings = np.hstack([mission.f_b, mission.w_ib_b])
        self.kept = Kept(len(mission.stamps_ns), LAYOUT.dtype)
        self.k = BEGIN * PER_SECOND - 1
        end_ns = mission.stamps_ns[self.k]
        measured = [e for events in self.events.values() for e in events if e.stamp_ns <= end_ns]
        arrays = (x[: self.k + 1] for x in (mission.stamps_ns, mission.f_b, mission.w_ib_b))
        self.state = fold_arrays(settings, *arrays, [initial, *measured]).states[-1:].copy()

    def odometry(self) -> Odometry:
        return odometry(self.filter, self.state, 0)

    def pose_error(self) -> Array:
        """True less estimated (4,): position and yaw, in odom, which was map at the start."""
        truth, o = self.mission.truth, self.odometry().in_odom
        yaw = yaw_of(truth.C_n_b[self.k]) - yaw_in(o.quaternion_xyzw)
        return np.array([*(truth.p_o[self.k] - o.position), math.remainder(yaw, 2.0 * math.pi)])

    def _rows(self) -> tuple[Array, Array]:
        """J (4, n) of the pose in odom without the turn about the reference; b in odom's axes."""
        s, vehicle = self.state[0], self.filter.vehicle
        yaw = float(s["odom"]["yaw"])
        A = map_to_odom._to_odom(s, yaw)
        b = self.odometry().in_odom.position - s["odom"]["reference"]
        J = np.zeros((4, self.filter.n))
        J[:3, POSITION] = A
        tilt = -np.cross(np.eye(3)[:2], A.T @ b).T @ np.eye(2)  # -[b x] of north and east
        J[:3, 3:5] = A @ -tilt
        J[3, 5] = 1.0
        assert vehicle.invariant
        return J, b

    def covariance(self) -> Array:
        """Of the pose's error without the turn about the reference (4, 4)."""
        J, _ = self._rows()
        n = self.filter.n
        return J @ self.state[0]["nav"]["P"][:n, :n] @ J.T + self.state[0]["odom"]["P"]

    def cross(self) -> Array:
        J, _ = self._rows()
        n = self.filter.n
        return J @ self.state[0]["nav"]["P"][:n, n - CLONES : n]

    def clone(self) -> None:
        J, _ = self._rows()
        P, n = self.state[0]["nav"]["P"], self.filter.n
        core = slice(0, n - CLONES)
        at = slice(n - CLONES, n)
        P[at, :], P[:, at] = 0.0, 0.0
        P[at, core] = J[:, core] @ P[core, core]
        P[core, at] = P[at, core].T
        P[at, at] = J[:, core] @ P[core, core] @ J[:, core].T

    def fly_on(self) -> Array:
        """Fly a window; returns what absolute updates have taken from `cross` (4, CLONES)."""
        m, taken = self.mission, np.zeros((4, CLONES))
        for _ in range(WINDOW * PER_SECOND):
            self.k += 1
            arrays = m.stamps_ns, m.f_b, m.w_ib_b, self.readings
            self.filter.predict_samples(self.state, *arrays, self.k, self.k + 1, self.kept)
            for event in self.events.get(int(m.stamps_ns[self.k]), []):
                before = self.cross() if isinstance(event, Heading) else None
                self.filter.update(self.state, event, m.w_ib_b[self.k], 1.0)
                if before is not None:
                    taken += before - self.cross()
        return taken


def increment(run: Flown) -> float:
    """NEES (of 4) of the increment over the next window, seen from the pose at its begin."""
    before, P_0, D_0 = run.pose_error(), run.covariance(), run.state[0]["odom"]["P"].copy()
    p_0, yaw_0 = run.odometry().in_odom.position, before[3]
    run.clone()
    taken = run.fly_on()
    after, (_, b) = run.pose_error(), run._rows()
    X = run.cross() + taken + D_0
    P = run.covariance() + P_0 - X - X.T
    e_D = np.array([0.0, 0.0, 1.0])
    T = np.eye(4)
    T[:3, 3] = np.cross(e_D, b)
    P = T @ P @ T.T
    error = after - before
    path = run.odometry().in_odom.position - p_0
    turned = Rotation.from_euler("z", yaw_0).inv().apply(path + error[:3])
    error = np.array([*(turned - path), math.remainder(error[3], 2.0 * math.pi)])
    return float(error @ np.linalg.solve(P, error))


def nees(error: Array, P: Array) -> float:
    return float(error @ np.linalg.solve(P, error)) / len(error)


def of_flights(flights: int, windows: int) -> tuple[float, float]:
    """NEES of odom's pose at the end of flights, and of its increments over each window."""
    poses, increments = [], []
    for k in range(flights):
        run = Flown(Case(MEMS, 3.0, duration=BEGIN + windows * WINDOW), SEED + k)
        increments += [increment(run) / 4.0 for _ in range(windows)]
        P = run.odometry().in_odom.covariance[np.ix_(POSE, POSE)]
        poses.append(nees(run.pose_error(), P))
    print(f"NEES of the pose {np.mean(poses):.2f}, of its increments {np.mean(increments):.2f}")
    return float(np.mean(poses)), float(np.mean(increments))


def band(squares: int) -> tuple[float, float]:
    """Where a mean of so many squares is but once in 1000 times."""
    low, high = chi2.ppf([0.0005, 0.9995], squares) / squares
    return float(low), float(high)


def test_odom_and_its_increments_are_as_good_as_they_say() -> None:
    pose, increments = of_flights(4, 1)
    low, high = band(16)
    assert low < pose < high and low < increments < high


@pytest.mark.long
def test_odom_and_its_increments_over_many_windows() -> None:
    """40 flights, 4 numbers each; 160 windows, whose NEES is told to 6 %."""
    pose, increments = of_flights(40, 4)
    low, high = band(160)
    assert low < pose < high
    assert 0.8 < increments < 1.25
