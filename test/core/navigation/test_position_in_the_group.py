"""The path travelled turns with the heading: positions are as good as they say, whatever it was.

Statistics of `insdvl.studies.consistency.flights`; the short forms have fewer and shorter runs.
Seeds were chosen before the first run.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from fix import Fix, with_fixes
from places import moved, position, put
from scipy.spatial.transform import Rotation

from insdvl.navigation import coordinates, kalman
from insdvl.navigation.coordinates import position_error
from insdvl.navigation.error_state import ATTITUDE, POSITION, VELOCITY
from insdvl.navigation.events import Initial
from insdvl.navigation.filter import Filter
from insdvl.navigation.geometry.earth import displacements
from insdvl.navigation.geometry.rotation import cross_matrix
from insdvl.navigation.measurements.base import Turn
from insdvl.simulation.grades import GRADES
from insdvl.simulation.mission import Mission
from insdvl.studies.consistency.flights import Case, EventSource, Flight, fly, parameters

FOG, MEMS = GRADES["fog"], GRADES["mems"]
SEED = 91_000
RUNS, SHORT_RUNS, SHORT = 100, 6, 300.0
NO_TURN = Turn(np.zeros(3), np.zeros((3, 3)))
UNKNOWN_START = Case(FOG, 60.0, position_std=1000.0)


def fixes(*seconds: int) -> EventSource:
    """Positions of 1 m, told at these times."""

    def events(mission: Mission, rng: np.random.Generator) -> list[Fix]:
        rows = [100 * s - 1 for s in seconds]
        noise = rng.standard_normal((len(rows), 3))
        return [
            Fix(int(mission.stamps_ns[k]), mission.truth.p_o[k] + e, 1.0)
            for k, e in zip(rows, noise, strict=True)
        ]

    return events


@cache
def flights(case: Case, runs: int, seconds: tuple[int, ...] = ()) -> list[Flight]:
    settings = with_fixes(parameters(case)) if seconds else None
    events = fixes(*seconds) if seconds else None
    return [fly(case, SEED + k, settings=settings, events=events) for k in range(runs)]


def mean_nees(found: list[Flight], first: int) -> float:
    """Per degree of freedom, over all runs and the seconds from one on."""
    return float(np.mean([flight.nees[first - 1 :] for flight in found]))


def end_errors(found: list[Flight]) -> np.ndarray:
    return np.array([flight.error[-1] for flight in found])


# ------------------------------------------------------------------ short forms


@pytest.mark.parametrize("heading_std_deg", [1.0, 60.0])
@pytest.mark.parametrize(
    "start", [(4000.0, 3000.0, 0.0), pytest.param((0.0, 0.0, 0.0), marks=pytest.mark.long)]
)
def test_the_position_is_as_good_as_it_says(
    heading_std_deg: float, start: tuple[float, float, float]
) -> None:
    """Where the path does not turn with the heading, the NEES of 60 deg is above 1000."""
    case = Case(FOG, heading_std_deg, start=start, duration=SHORT)
    assert 0.4 < mean_nees(flights(case, SHORT_RUNS), 150) < 2.5


def test_a_large_heading_error_costs_no_position() -> None:
    small, large = (
        end_errors(flights(Case(FOG, std, duration=SHORT), SHORT_RUNS)) for std in (1.0, 60.0)
    )
    assert np.sqrt(np.mean(large**2)) < 2.0 * np.sqrt(np.mean(small**2))


def test_a_position_that_is_told_late_is_not_turned() -> None:
    """A start unknown to 1 km: the reference moves to where the position was told first."""
    case = replace(UNKNOWN_START, grade=MEMS, heading_std_deg=30.0, duration=SHORT)
    found = flights(case, SHORT_RUNS, (150, 200, 250))
    assert np.mean([flight.nees[0] for flight in found]) < 3.0
    assert 0.3 < mean_nees(found, 251) < 2.5
    assert max(end_errors(found)) < 30.0


# ------------------------------------------------------------------ 100 runs of 600 s


@pytest.mark.long
@pytest.mark.parametrize(
    "case",
    [
        *(Case(FOG, std) for std in (1.0, 5.0, 30.0, 60.0)),
        Case(FOG, 100.0, uniform_heading=True),
        Case(MEMS, 5.0),
        Case(FOG, 60.0, start=(4000.0, 3000.0, 0.0)),
    ],
    ids=["1", "5", "30", "60", "100", "MEMS", "far"],
)
def test_nees_and_ellipse(case: Case) -> None:
    """A run's positions go along with each other, so 100 runs tell the share inside to 2 % only."""
    found = flights(case, RUNS)
    nees = mean_nees(found, 300)
    shares = np.array([np.mean(flight.inside[299:]) for flight in found])
    inside, error = shares.mean(), shares.std(ddof=1) / np.sqrt(RUNS)
    end = np.sqrt(np.mean(end_errors(found) ** 2))
    print(f"NEES {nees:.2f}, inside {inside:.3f} +- {error:.3f}, end {end:.2f} m")
    assert 0.75 < nees < 1.3
    assert inside + 2.0 * error >= 0.93


@pytest.mark.long
def test_the_end_of_60_deg_is_that_of_1_deg() -> None:
    """Ratio of rms over paired runs, upper end of its bootstrap interval."""
    small, large = (end_errors(flights(Case(FOG, std), RUNS)) ** 2 for std in (1.0, 60.0))
    draws = np.random.default_rng(SEED).integers(RUNS, size=(10_000, RUNS))
    ratios = np.sqrt(large[draws].mean(axis=1) / small[draws].mean(axis=1))
    print(f"ratio {np.sqrt(large.mean() / small.mean()):.2f} {np.quantile(ratios, [0.025, 0.975])}")
    assert np.quantile(ratios, 0.975) <= 1.2


@pytest.mark.long
def test_a_position_that_is_told_after_300_s() -> None:
    nees = mean_nees(flights(UNKNOWN_START, RUNS, (300,)), 301)
    print(f"NEES {nees:.2f}")
    assert 0.75 < nees < 1.3


# ------------------------------------------------------------------ the matrices


def state_at(filter_: Filter, x: np.ndarray) -> np.ndarray:
    """A record whose truth differs by the error x from a nominal state."""
    state = filter_.empty()
    nav = state[0]["nav"]
    tilt = Rotation.from_rotvec(x[ATTITUDE] * [1.0, 1.0, 0.0]).as_matrix()
    heading = Rotation.from_rotvec(x[ATTITUDE] * [0.0, 0.0, 1.0]).as_matrix()
    nav["C_n_b"] = heading @ tilt @ Rotation.from_rotvec([0.3, -0.5, 1.1]).as_matrix()
    nav["v_n"] = heading @ (tilt @ np.array([1.0, -0.4, 0.2]) + x[VELOCITY])
    put(nav, [50.0, -20.0, 12.0], [10.0, 30.0, 1.0])
    x_n = coordinates.from_reference(nav)
    nav["llh"] = moved(nav["llh"], heading @ (tilt @ x_n + x[POSITION]) - x_n)
    nav["initialised"] = 1
    return state


def test_the_jacobian_of_a_position_is_the_derivative() -> None:
    filter_ = Filter(with_fixes(parameters(Case(FOG, 1.0))))
    model, there = filter_.models["depth"], Fix(1, np.array([50.0, -20.0, 12.0]), 1.0)

    def linearised(x: np.ndarray):  # type: ignore[no-untyped-def]
        return model.linearise(state_at(filter_, x), there, NO_TURN)

    measured = np.empty((3, 15))
    for i in range(15):
        x = np.zeros(15)
        x[i] = 1e-3
        measured[:, i] = (linearised(-x).z_minus_h - linearised(x).z_minus_h) / 2e-3
    np.testing.assert_allclose(linearised(np.zeros(15)).H, measured, atol=1e-5)


def test_the_exact_error_of_the_position_is_that_of_the_injection() -> None:
    filter_ = Filter(parameters(Case(FOG, 1.0)))
    x = np.random.default_rng(SEED).uniform(-0.5, 0.5, 15)
    nominal, true = state_at(filter_, np.zeros(15)), state_at(filter_, x)
    nav = true[0]["nav"]
    found = position_error(nominal[0]["nav"], nav["C_n_b"], nav["llh"], invariant=True)
    np.testing.assert_allclose(found, x[POSITION], atol=1e-8)
    coordinates.inject(nominal[0], filter_.constants[0], x)
    np.testing.assert_allclose(displacements(nominal[0]["nav"]["llh"], nav["llh"]), 0.0, atol=1e-8)


def test_a_told_position_is_known_whatever_the_heading_is() -> None:
    """1 km of correction with a heading of 60 deg: in metres the position is as good as the fix."""
    filter_ = Filter(with_fixes(parameters(UNKNOWN_START)))
    state = filter_.empty()
    initial = Initial(0, np.eye(3), np.zeros(3), np.array([1.8, 0.0, 0.0]), "body")
    filter_.initialise(state, initial, 0, np.zeros(3))
    state[0]["nav"]["llh"] = moved(state[0]["nav"]["llh"], [300.0, 0.0, 0.0])  # the way
    fix = Fix(1, np.array([-400.0, 800.0, 30.0]), 1.0)
    assert filter_.update(state, fix, np.zeros(3), 1).accepted
    nav, P = state[0]["nav"], state[0]["nav"]["P"][:15, :15]
    J = np.zeros((3, 15))
    J[:, POSITION] = np.eye(3)
    J[:, ATTITUDE] = -cross_matrix(coordinates.from_reference(nav))
    np.testing.assert_allclose(J @ P @ J.T, np.eye(3), atol=0.01)
    # No heading that is found later turns it: the reference is where it was told, nearly.
    left = np.linalg.norm(coordinates.from_reference(nav))
    assert left < 0.1 * np.linalg.norm(position(nav))
    heading = np.zeros(15)
    heading[5] = 1.0
    gain = P @ heading / P[5, 5]
    coordinates.inject(state[0], filter_.constants[0], gain * np.radians(60.0))
    np.testing.assert_allclose(position(nav), fix.p_o, atol=30.0)


def test_a_covariance_of_which_the_rounding_leaves_nothing_is_refused() -> None:
    """S of one direction only, 1e12 times the rest: its inverse would be rounding."""
    ones = np.array([1.0, -1.0, -1.0])
    P, R = 1e-3 * np.eye(15), 1e12 * np.outer(ones, ones)
    H = np.zeros((3, 15))
    H[:, VELOCITY] = np.eye(3)
    assert np.isnan(kalman.innovate(P, np.zeros(3), H, R).nis)
    assert np.isfinite(kalman.innovate(P, np.zeros(3), H, np.diag([1e12, 1.0, 1.0])).nis)
