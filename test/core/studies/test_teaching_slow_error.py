"""The slow error of the DVL: its likelihood is exact, and what is told of it is true."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import multivariate_normal
from test_teaching import SPOKEN, Q, events_of, lesson

from insdvl.navigation.coordinates import body_velocity_jacobian
from insdvl.navigation.geometry.earth import gravity
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.sections import load_section
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.trajectories import BASELINE, STATIC
from insdvl.studies.evaluation.metrics import nees
from insdvl.studies.teaching.fit import Constant, log_likelihood, slope
from insdvl.studies.teaching.lesson import Lesson, lesson_of
from insdvl.studies.teaching.residuals import Stretch, innovations
from insdvl.studies.teaching.slow_error import SlowError, slow_error_of
from insdvl.studies.teaching.teach import fits_of
from insdvl.timeline.recorded import fold_arrays
from insdvl.tuner.parameters import TunerParameters

STD, TIME_CONSTANT = 0.02, 5.0
SLOW = DvlModel(noise_std=(0.02,) * 3, rate=5.0, bias_std=STD, bias_time_constant=TIME_CONSTANT)
WHITE = replace(SLOW, bias_std=0.0)


def of_known_imu(one: Lesson, variances: float) -> tuple[Stretch, NDArray[np.float64]]:
    """A stretch whose IMU is known but for small variances (12,), and its noise (K, 6)."""
    start = replace(one.stretch.start, variances=np.full(12, variances), walks=np.zeros(6))
    return replace(one.stretch, start=start), np.full((len(one.X), 6), 1e-18)


def test_the_likelihood_of_a_slow_error_is_that_of_its_process() -> None:
    """With a known IMU the pings are a Gauss-Markov process and white noise, of known covariance.

    The axes of the IMU are those of the DVL.
    """
    stretch, q = of_known_imu(lesson(31, 90.0), 1e-20)
    doubted = replace(stretch, noise=np.full_like(stretch.noise, 1e8))
    errors = innovations(doubted, q, 1.0, 0.0, 1.0).nu
    slow, tau = 2.0, 0.5
    found = innovations(stretch, q, 1.0, slow, tau)
    t = np.cumsum(stretch.steps.seconds)[stretch.pings]
    rho = np.exp(-np.abs(t[:, None] - t) / (tau * stretch.time_constant))
    for axis in range(3):
        covariance = (slow * stretch.slow_std[axis]) ** 2 * rho + np.diag(stretch.noise[:, axis])
        expected = multivariate_normal(cov=covariance).logpdf(errors[:, axis])
        of_axis = -0.5 * (
            found.nu[:, axis] ** 2 / found.S[:, axis, axis]
            + np.log(2.0 * np.pi * found.S[:, axis, axis])
        )
        assert of_axis.sum() == pytest.approx(expected, abs=0.01)


def test_an_error_of_the_heading_tilts_with_the_turn_of_the_earth() -> None:
    """At rest the velocity has the sigma g w_ie cos(lat) sigma t^2 / 2 after the time t."""
    flown = simulate(STATIC, constant(Q), seed=32, duration=150.0, dvl=replace(WHITE, rate=1.0))
    samples = np.hstack([flown.f_b, flown.w_ib_b])
    events = events_of(flown, 32)
    unlocked = replace(SPOKEN, dvl=replace(SPOKEN.dvl, lock_check=False))
    one = lesson_of("rest", unlocked, TunerParameters(), flown.stamps_ns, samples, events)
    stretch, q = of_known_imu(one, 1e-20)
    variances = stretch.start.variances.copy()
    variances[5] = 0.01**2
    start = replace(stretch.start, variances=variances)
    doubted = replace(stretch, start=start, noise=np.full_like(stretch.noise, 1e4))
    S = innovations(doubted, q, 1.0, 0.0, 1.0).S[-1]
    t = float(stretch.steps.seconds.sum())
    rate = stretch.start.w_ie_n[0]
    expected = gravity(stretch.start.latitude, 0.0) * rate * 0.01 * t**2 / 2.0
    assert np.sqrt(np.trace(S) - 3e4) == pytest.approx(expected, rel=0.05)


def test_the_gradient_is_that_of_the_likelihood() -> None:
    """Against central differences, for the numbers of the DVL and those of a constant."""
    lessons = [lesson(33, 90.0)]
    family = Constant(lessons)
    numbers = np.array([np.log(2e-3), np.log(3e-8), 0.2, 0.8, -0.4])
    gradient, information = slope(family, lessons, numbers)
    step = 1e-3
    for k in range(len(numbers)):
        moved = step * np.eye(len(numbers))[k]
        up = log_likelihood(family, lessons, numbers + moved)
        down = log_likelihood(family, lessons, numbers - moved)
        assert gradient[k] == pytest.approx((up - down) / (2.0 * step), rel=0.01, abs=0.05)
    assert (np.linalg.eigvalsh(information) > 0.0).all()


def told(**changes: Any) -> SlowError:
    values: dict[str, Any] = {
        "bias_std": np.array([0.012, 0.012, 0.0]),
        "time_constant": 23.4,
        "sigma": np.array([0.1, 0.2]),
        "noise": (0.5, 0.02),
        "gain": np.array([4.0, -1.0, 9.0]),
        "refused": "",
    }
    return SlowError(**{**values, **changes})


def test_its_lines_are_parameters_of_the_filter(tmp_path: Path) -> None:
    lines = told().lines
    file = tmp_path / "learned.yaml"
    file.write_text("\n".join(lines[1:]))
    dvl = load_section([file], "insdvl_filter", FilterParameters, required=True).dvl
    assert dvl.bias_model == "gauss_markov"
    assert dvl.bias_std == (0.012, 0.012, 0.0)
    assert dvl.bias_time_constant == 23.4


def test_a_refusal_has_no_values() -> None:
    refused = told(refused="They do not say.")
    assert refused.lines == ("slow error of the DVL: nothing is told. They do not say.",)
    assert set(refused.card) == {"refused", "left_out_gain"}


def missions(dvl: DvlModel, seed: int, count: int) -> list[Mission]:
    paths = list(BASELINE.values())
    return [
        simulate(paths[k % len(paths)], constant(Q), seed=seed + k, duration=300.0, dvl=dvl)
        for k in range(count)
    ]


def taught(flown: list[Mission], seed: int) -> SlowError:
    lessons = [
        lesson_of(
            f"{k}",
            SPOKEN,
            TunerParameters(),
            mission.stamps_ns,
            np.hstack([mission.f_b, mission.w_ib_b]),
            events_of(mission, seed + k),
        )
        for k, mission in enumerate(flown)
    ]
    return slow_error_of(fits_of(lessons))


def velocity_nees(parameters: FilterParameters, flown: list[Mission], seed: int) -> float:
    """Mean NEES per degree of freedom of the body velocity, after 60 s."""
    values = []
    for k, mission in enumerate(flown):
        samples = mission.stamps_ns, mission.f_b, mission.w_ib_b
        folded = fold_arrays(parameters, *samples, events_of(mission, seed + k), 100)
        late = folded.states["nav"]["time_ns"] > mission.stamps_ns[0] + 60 * 10**9
        s = folded.states[late]
        at = np.searchsorted(mission.stamps_ns, s["nav"]["time_ns"])
        vehicle = folded.filter.vehicle
        J = body_velocity_jacobian(
            s["nav"]["C_n_b"], s["nav"]["v_n"], invariant=vehicle.invariant, n=folded.filter.n
        )
        P = J @ folded.filter.covariance(s) @ np.swapaxes(J, 1, 2)
        v_b = np.einsum("kji,kj->ki", s["nav"]["C_n_b"], s["nav"]["v_n"])
        truth = np.einsum("kji,kj->ki", mission.truth.C_n_b[at], mission.truth.v_n[at])
        values.append(nees(truth - v_b, P).mean() / 3.0)
    return float(np.mean(values))


@pytest.mark.long
def test_a_slow_error_is_learned_and_makes_the_filter_consistent() -> None:
    """Both numbers are within two standard errors; the NEES of other missions is nearer to 1."""
    found = taught(missions(SLOW, 200, 6), 200)
    assert not found.refused
    off = np.log([found.bias_std[0] / STD, found.time_constant / TIME_CONSTANT])
    assert (np.abs(off) < 2.0 * found.sigma).all()
    assert (found.gain > 0.0).all()
    others = missions(SLOW, 300, 4)
    with_it = replace(
        SPOKEN,
        dvl=replace(
            SPOKEN.dvl,
            bias_model="gauss_markov",
            bias_std=tuple(found.bias_std.tolist()),
            bias_time_constant=found.time_constant,
        ),
    )
    without, learned = (velocity_nees(p, others, 300) for p in (SPOKEN, with_it))
    assert abs(np.log(learned)) < abs(np.log(without))


@pytest.mark.long
def test_where_there_is_none_nothing_is_told() -> None:
    found = taught(missions(WHITE, 400, 4), 400)
    assert "no better than without" in found.refused
