"""Exact zeros of a DVL: used at rest, refused after a lost lock."""

from collections.abc import Sequence

import numpy as np
import pytest

from insdvl.navigation.events import NS, Event, Initial, ProcessNoise
from insdvl.navigation.geometry.earth import EARTH_RATE, gravity
from insdvl.navigation.geometry.frames import rotation_from_rpy
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.start.zero_velocity import window_ns
from insdvl.parameters.declaration import build
from insdvl.simulation.grades import GRADES
from insdvl.timeline.output import FoldResult
from insdvl.timeline.recorded import fold_arrays

SEED = 95_200  # chosen before the first run
MEMS = GRADES["mems"]
RATE, LAT = 50, np.radians(32.0)
G_N = np.array([0.0, 0.0, gravity(LAT, 0.0)])
W_IE_N = EARTH_RATE * np.array([np.cos(LAT), 0.0, -np.sin(LAT)])
C_N_B = rotation_from_rpy(np.array([0.02, -0.03, 0.7]))


def flown(
    seconds: int,
    *,
    speed: float = 0.0,
    velocity_std: float = 0.02,
    lock_until: int = 0,
    vibration: float = 0.0,
    rate: int = RATE,
    without_data: Sequence[int] = (),
    learned: float = 0.0,
) -> FoldResult:
    """Level and straight at a speed; the DVL shows zeros, but before a time [s] the speed.

    Samples of these indices have no data, zeros. A learned Q, if any, is this factor of the
    variance of the samples.
    """
    rng = np.random.default_rng(SEED)
    n = seconds * rate
    bias = np.repeat([MEMS.accelerometer_bias, MEMS.gyroscope_bias], 3) * rng.standard_normal(6)
    error = bias + rng.standard_normal((n, 6)) * np.sqrt(MEMS.variances(float(rate)))
    error[:, 0] += vibration * rng.standard_normal(n)
    stamps_ns = NS + np.arange(n) * (NS // rate)
    v_b = np.array([speed, 0.0, 0.0])
    events: list[Event] = [Initial(int(stamps_ns[0]), C_N_B, np.zeros(3), v_b, "body")]
    for second in range(1, seconds):
        v_d = v_b + 0.01 * rng.standard_normal(3) if second < lock_until else np.zeros(3)
        events.append(Dvl(NS + second * NS, v_d))
    variances = MEMS.variances(float(rate)).tolist()
    if learned:
        Q = learned * np.diag(variances)
        events += [ProcessNoise(NS + k * NS, Q[:3, :3], Q[3:, 3:]) for k in range(seconds)]
    parameters = build(
        FilterParameters,
        {
            "frame_convention": "ned",
            "imu.rate": float(rate),
            "imu.max_gap": max(0.1, 2.0 / rate),
            "dvl.noise_std": (0.01,) * 3,
            "initial.mode": "set_odometry",
            "initial.velocity_std": velocity_std,
            "initial.tilt_std": 0.005,
            "process_noise.source": "external" if learned else "constant",
            "process_noise.accelerometer_variance": tuple(variances[:3]),
            "process_noise.gyroscope_variance": tuple(variances[3:]),
        },
    )
    f_b, w_ib_b = -C_N_B.T @ G_N + error[:, :3], C_N_B.T @ W_IE_N + error[:, 3:]
    at = list(without_data)
    f_b[at], w_ib_b[at] = 0.0, 0.0
    return fold_arrays(parameters, stamps_ns, f_b, w_ib_b, events)


def reasons(result: FoldResult) -> list[str]:
    return [update.report.reason for update in result.updates]


def test_parked_with_exact_zeros_it_stays_where_it_is() -> None:
    """900 s of a MEMS. Each of the four tests for rest fails with 1e-3: 3.6 pings, 4 sigma 11.2."""
    result = flown(900)
    assert reasons(result).count("no_lock") < 12
    last = result.states[-1]["nav"]
    assert abs(last["llh"][2]) < 1.0
    assert np.abs(last["v_n"]).max() < 0.02


def test_zeros_after_a_lost_lock_at_1_m_s_are_refused() -> None:
    result = flown(60, speed=1.0, lock_until=20)
    assert set(reasons(result)[:19]) == {""}
    assert set(reasons(result)[19:]) == {"no_lock"}


def test_zeros_after_a_lost_lock_at_a_crawl_are_refused() -> None:
    """At 0.2 m/s the sigma may grow until zero is within three of it, and is still no rest."""
    result = flown(90, speed=0.2, lock_until=20)
    assert set(reasons(result)[19:]) == {"no_lock"}


def test_a_velocity_that_is_not_known_does_not_take_zeros() -> None:
    assert set(reasons(flown(20, velocity_std=0.15))) == {"no_lock"}


@pytest.mark.parametrize(("vibration", "taken"), [(0.0, True), (0.3, False)])
def test_an_imu_that_shows_motion_does_not_take_zeros(vibration: float, taken: bool) -> None:
    """Three times the noise that is told."""
    found = reasons(flown(5, vibration=vibration))
    assert (set(found) == {""}) is taken
    assert (set(found) == {"no_lock"}) is not taken


@pytest.mark.parametrize("learned", [0.3, 1.0, 2.0])
def test_a_learned_noise_that_is_a_factor_off_does_not_hide_a_rest(learned: float) -> None:
    """Fewer than one ping in twenty fails one of the four tests by chance."""
    found = reasons(flown(60, learned=learned))
    assert found.count("no_lock") < 3
    assert set(reasons(flown(60, speed=1.0, lock_until=20, learned=learned))[19:]) == {"no_lock"}


@pytest.mark.parametrize("rate", [10, 15])
def test_a_slow_imu_shows_rest_as_well(rate: int) -> None:
    """Each half of the window has five samples also where 0.5 s have fewer than ten."""
    assert set(reasons(flown(15, rate=rate, lock_until=5))) == {""}


def test_a_sample_without_data_does_not_hide_a_rest() -> None:
    """One of zeros 0.2 s before each ping."""
    without_data = [second * RATE - RATE // 5 for second in range(1, 10)]
    assert set(reasons(flown(10, without_data=without_data))) == {""}


@pytest.mark.parametrize(("rate", "seconds"), [(100.0, 0.5), (24.0, 0.5), (10.0, 1.2), (1.0, 3.0)])
def test_the_window_has_twelve_samples_within_its_bounds(rate: float, seconds: float) -> None:
    assert window_ns(rate) == round(seconds * NS)
