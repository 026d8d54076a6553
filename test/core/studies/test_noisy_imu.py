"""The noise of the IMU, however large, accuses neither the scale of the DVL nor anything else."""

import math

import numpy as np
import pytest
from recordings import record

from insdvl.navigation.events import NS, ProcessNoise
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build
from insdvl.recordings.played import Listed
from insdvl.simulation.drawn.scenarios import DRAWN
from insdvl.simulation.mission import simulate
from insdvl.simulation.noise import SCENARIOS
from insdvl.simulation.trajectories import AUV
from insdvl.studies.judgement.added_noise import told_variances
from insdvl.studies.judgement.mounting import (
    MOUNT_SIGMAS,
    UNKNOWNS,
    Change,
    Sums,
    _changes,
    _improves,
    _without_noise,
)
from insdvl.studies.judgement.verdict import verdict
from insdvl.studies.judgement.withheld import GRAVITY, of_curvature
from insdvl.studies.replay.fold import fold_recording
from insdvl.studies.replay.inputs.learning import Learned
from insdvl.studies.replay.scores import report
from insdvl.tuner.parameters import TunerParameters

TOPICS = {"/imu": "imu/data_raw", "/dvl": "dvl/velocity", "/truth": "ground_truth/odometry"}


# ---------------------------------------------------------------- the scale


def sums_of(velocity: np.ndarray, error: np.ndarray, noise: np.ndarray, scale: float) -> Sums:
    """Of a scale, where the prediction has an error and the measurement noise."""
    g = velocity + error
    nu = velocity / (1.0 + scale) + noise - g
    information = float(g @ g)
    left = nu - float(g @ nu) / information * g
    return Sums(
        np.array([information]),
        np.array([float(g @ nu)]),
        np.array([float(((g * left) ** 2).sum())]),
    )


def sigmas(sums: Sums) -> float:
    return float(-sums.gradient[0] / np.sqrt(sums.variance[0]))


@pytest.mark.parametrize("scale", [0.0, 0.2])
def test_what_noise_makes_of_a_scale_is_found_by_adding_it_once_more(scale: float) -> None:
    rng = np.random.default_rng(1)
    count = 2000
    velocity = 1.0 + 0.2 * rng.standard_normal(count)
    error, noise = 0.5 * rng.standard_normal(count), 0.1 * rng.standard_normal(count)
    sums = sums_of(velocity, error, noise, scale)
    noisy = [
        sums_of(
            velocity,
            error + 0.5 * rng.standard_normal(count),
            noise + 0.1 * rng.standard_normal(count),
            scale,
        )
        for _ in range(8)
    ]
    found = _without_noise(sums, noisy)
    assert sigmas(sums) > MOUNT_SIGMAS  # whatever the scale is
    if scale:
        assert sigmas(found) > MOUNT_SIGMAS
        value = -found.gradient[0] / found.information[0]
        assert value == pytest.approx(1.0 - 1.0 / (1.0 + scale), abs=0.05)
    else:
        assert abs(sigmas(found)) < 3.0


def test_what_may_be_noise_alone_tells_nothing() -> None:
    """Added noise has more information than all that the recording has; or one that varies."""
    sums = Sums(np.array([1.0]), np.array([-20.0]), np.array([1.0]))

    def noisy(*informations: float) -> list[Sums]:
        return [Sums(np.array([i]), sums.gradient, sums.variance) for i in informations]

    for informations, left in (
        ((2.8, 2.6, 3.0), 0.0),
        ((1.5, 1.49, 1.51), 0.0),  # with a sigma 1.5 times as large it is more than all
        ((1.1, 2.0, 0.3), 0.0),
        ((1.1, 1.11, 1.09), 0.9),
    ):
        found = _without_noise(sums, noisy(*informations))
        assert found.information[0] == pytest.approx(left)
        (change,) = _changes(UNKNOWNS[:1], found)
        assert change.matters == bool(left) and math.isinf(change.sigma) != bool(left)


def test_a_step_that_makes_the_innovations_less_probable_is_no_explanation() -> None:
    arm = next(unknown for unknown in UNKNOWNS if unknown.name == "lever_arm_z")
    recorded = Change(arm, -0.2, 0.02)
    for value, improves in ((-0.25, True), (-0.5, False), (0.3, False)):
        assert _improves(Change(arm, value, 0.02), recorded) is improves


def test_the_noise_that_is_added_is_what_the_filter_was_told() -> None:
    stamps_ns = np.array([1, 2, 3, 4]) * NS
    events = [ProcessNoise(2 * NS, 4.0 * np.eye(3), None), ProcessNoise(3 * NS, None, np.eye(3))]
    names = {
        "process_noise.source": "external",
        "process_noise.accelerometer_variance": [0.1] * 3,
        "process_noise.gyroscope_variance": [0.2] * 3,
    }
    told = told_variances(stamps_ns, list(events), build(FilterParameters, names))
    assert told[:, 0].tolist() == [0.1, 0.1, 4.0, 0.1]  # it applies to what follows its stamp
    assert told[:, 3].tolist() == [0.2, 0.2, 0.2, 1.0]
    names |= {"process_noise.source": "constant", "process_noise.convention": "density"}
    told = told_variances(stamps_ns, list(events), build(FilterParameters, names))
    np.testing.assert_allclose(told, [[10.0] * 3 + [20.0] * 3] * 4)


# ---------------------------------------------------------------- long predictions


def test_the_curvature_of_gravity_is_as_large_as_a_tilt_that_walks_makes_it() -> None:
    rng, seconds, steps, runs = np.random.default_rng(2), 30.0, 300, 4000
    dt, q = seconds / steps, 1e-4
    tilt = np.cumsum(rng.standard_normal((runs, steps, 2)) * np.sqrt(q * dt), axis=1)
    level = GRAVITY * tilt.sum(axis=1) * dt
    falls = GRAVITY * (tilt**2 / 2.0).sum(axis=(1, 2)) * dt
    variance = 0.04
    S = np.diag([level.var(), level.var(), variance])
    (expected,) = of_curvature(S[None], seconds)
    assert float(np.mean(falls**2)) / variance == pytest.approx(expected, rel=0.1)
    (little,) = of_curvature(np.diag([0.1**2, 0.1**2, 0.02**2])[None], seconds)
    assert little < 1e-4  # of an IMU as vehicles have it


# ---------------------------------------------------------------- flights


@pytest.mark.long
@pytest.mark.parametrize("scenario", ["constant", "varying", "wide", "vibrating"])
@pytest.mark.parametrize("seed", [9, 10, 11])
def test_sensors_that_tell_the_truth_are_not_accused(scenario: str, seed: int) -> None:
    """By the noise that the tuner learns, with the gate, on the track of the evaluation."""
    mission = simulate(AUV, {**SCENARIOS, **DRAWN}[scenario], seed=seed, start_ns=NS)
    raws = [
        r._replace(topic=TOPICS[r.topic]) for r in record(mission, every=100) if r.topic in TOPICS
    ]
    names = {"initial.mode": "topic", "process_noise.source": "external"}
    parameters = build(FilterParameters, names)
    replayed = fold_recording(Learned(Listed(raws), TunerParameters()), parameters)
    found = verdict(replayed, parameters, report(replayed))
    assert [finding for finding in found.findings if not finding.cautious] == [], found.judgement
