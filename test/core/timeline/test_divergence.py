"""A filter that diverges gives up its state before anybody sees it, and starts again."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from insdvl.arrays import Records
from insdvl.navigation.events import NS, Event, Imu, Origin
from insdvl.navigation.filter import Filter
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.odometry import Odometry
from insdvl.navigation.parameters import FilterParameters, OriginParameters
from insdvl.navigation.state.layout import counters
from insdvl.parameters.declaration import build
from insdvl.simulation.mission import simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.trajectories import AUV
from insdvl.timeline.fold import Fold
from insdvl.timeline.output import AppliedUpdate
from insdvl.timeline.recorded import fold_arrays

#: A bias that walks so fast, as no parameter file may say, has no finite variance within seconds.
WALK = 1e21
NED = build(FilterParameters, {"frame_convention": "ned"})
DIVERGING = replace(NED, process_noise=replace(NED.process_noise, accelerometer_bias_walk=WALK))
MISSION = simulate(AUV, constant(np.full(6, 1e-4)), seed=1, duration=10.0, start_ns=NS)
PINGS: list[Event] = [
    Dvl(int(stamp_ns), v_d)
    for stamp_ns, v_d in zip(MISSION.dvl_stamps_ns, MISSION.v_d, strict=True)
]
SAMPLES: list[Event] = [
    Imu(int(stamp_ns), f_b, w_ib_b)
    for stamp_ns, f_b, w_ib_b in zip(MISSION.stamps_ns, MISSION.f_b, MISSION.w_ib_b, strict=True)
]
EVENTS = sorted([*SAMPLES, *PINGS], key=lambda event: event.stamp_ns)


def folded(parameters: FilterParameters) -> Any:
    return fold_arrays(parameters, MISSION.stamps_ns, MISSION.f_b, MISSION.w_ib_b, PINGS)


def rises(states: Records, name: str) -> np.ndarray:
    return np.flatnonzero(np.diff(states["counters"][name], prepend=0))


def test_it_starts_again_and_says_how_often() -> None:
    result = folded(DIVERGING)
    known = result.states["nav"]["initialised"] == 1
    given_up = np.flatnonzero(known[:-1] & ~known[1:]) + 1
    assert len(given_up) >= 2 and known[given_up[0] :].any()
    assert result.counts["diverged"] == len(given_up)
    np.testing.assert_array_equal(rises(result.states, "diverged"), given_up)
    assert set(given_up) <= set(rises(result.states, "odom_resets"))
    for name in ("v_n", "llh", "C_n_b", "P", "b_f", "b_w"):
        assert np.isfinite(result.states["nav"][name]).all()


def test_what_does_not_come_from_the_state_stays() -> None:
    parameters = replace(DIVERGING, origin=OriginParameters(source="topic"))
    origin = Origin(int(MISSION.stamps_ns[0]), 0.6, 0.2, -3.0)
    result = fold_arrays(
        parameters, MISSION.stamps_ns, MISSION.f_b, MISSION.w_ib_b, [origin, *PINGS]
    )
    last = result.states[-1]["nav"]
    assert result.counts["diverged"] > 0
    assert (last["lat_0"], last["lon_0"], last["h_0"]) == (0.6, 0.2, -3.0)
    for name in counters(result.states[0]):
        values = [counters(s)[name][0][counters(s)[name][1]] for s in result.states[::10]]
        assert (np.diff(values) >= 0).all(), name
    assert (result.states["channels"]["imu_ns"] == MISSION.stamps_ns).all()


def test_nothing_of_it_is_published() -> None:
    fold, outputs = Fold(DIVERGING), []
    for event in EVENTS:
        fold.add(event)
        outputs += fold.take()
    published = [output for output in outputs if isinstance(output, Odometry)]
    assert fold.counts["diverged"] > 0 and len(published) > 100
    for output in published:
        for name in ("position", "quaternion_xyzw", "twist_linear", "twist_angular"):
            assert np.isfinite(getattr(output, name)).all()
        for name in ("pose_covariance", "odom_covariance", "twist_covariance"):
            covariance = getattr(output, name)
            assert np.isfinite(covariance.astype(np.float32)).all()  # as recordings have it
            assert (np.diagonal(covariance) >= 0.0).all()
    known = folded(DIVERGING).states["nav"]
    stamps = known["time_ns"][known["initialised"] == 1].tolist()
    assert [output.stamp_ns for output in published] == stamps


def test_the_order_of_arrival_does_not_matter() -> None:
    """Late events fold it again, from states before and behind the one that was given up."""
    whole, rng = folded(DIVERGING), np.random.default_rng(2)
    arrival = [event.stamp_ns + rng.uniform(0.0, 1.0) * NS for event in EVENTS]
    fold = Fold(DIVERGING, capacity=len(SAMPLES) + 1)
    for at in np.argsort(arrival):
        fold.add(EVENTS[at])
        if rng.random() < 0.05:
            fold.take()
    assert fold.states.tobytes() == whole.states.tobytes()
    thin = fold_arrays(DIVERGING, MISSION.stamps_ns, MISSION.f_b, MISSION.w_ib_b, PINGS, every=50)
    assert thin.states.tobytes() == whole.states[49::50].tobytes()
    assert thin.track.tobytes() == whole.track.tobytes()


@pytest.mark.parametrize("fault", ["covariance", "singular"])
def test_a_gate_that_cannot_judge_is_given_up(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its covariance of untold noise has run away, or a matrix has no inverse: no event is refused
    for ever."""
    parameters = build(FilterParameters, {"frame_convention": "ned", "initial.mode": "parameters"})
    update, at_ns = Filter.update, int(MISSION.dvl_stamps_ns[4])

    def poisoned(self: Filter, state: Records, event: Dvl, *args: Any) -> Any:
        if event.stamp_ns == at_ns:
            if fault == "singular":
                raise np.linalg.LinAlgError("Singular matrix")
            state[0]["noise"]["excess"][0, 0] = 1e30
        return update(self, state, event, *args)

    monkeypatch.setattr(Filter, "update", poisoned)
    result = folded(parameters)
    assert result.counts["diverged"] == 1
    assert result.states["nav"]["initialised"][-1] == 1
    assert len(result.updates) >= len(PINGS) - 1
    assert result.updates[-1].report.accepted


@pytest.mark.parametrize("late_ns", [0, 5_000_000])
def test_an_update_that_is_not_finite_is_given_up(
    late_ns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At the stamp of a sample, and between two."""
    parameters = build(FilterParameters, {"frame_convention": "ned", "initial.mode": "parameters"})
    update, at_ns = Filter.update, int(MISSION.stamps_ns[499]) + late_ns

    def poisoned(self: Filter, state: Records, event: Dvl, *args: Any) -> Any:
        report = update(self, state, event, *args)
        if event.stamp_ns == at_ns:
            state[0]["nav"]["v_n"][1] = np.nan
        return report

    monkeypatch.setattr(Filter, "update", poisoned)
    fold = Fold(parameters)
    for event in (*SAMPLES[:600], Dvl(at_ns, np.array([1.0, 0.0, 0.0]))):
        fold.add(event)
    known = fold.states["nav"]["initialised"] == 1
    assert np.flatnonzero(~known).tolist() == [499 + (late_ns > 0)]
    assert fold.counts["diverged"] == 1
    outputs = fold.take()
    assert sum(isinstance(output, Odometry) for output in outputs) == 599
    assert sum(isinstance(output, AppliedUpdate) for output in outputs) == 1


def test_an_ordinary_filter_keeps_its_state() -> None:
    result = folded(NED)
    known = result.states["nav"]["initialised"] == 1
    assert result.counts["diverged"] == 0 and known[int(np.argmax(known)) :].all()
