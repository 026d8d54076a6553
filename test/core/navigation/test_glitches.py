"""Samples of the IMU that say nothing, or something else than their neighbours."""

from dataclasses import replace

import numpy as np
import pytest
from records import P15

from insdvl.navigation.coordinates import body_velocity_jacobian
from insdvl.navigation.events import Imu
from insdvl.navigation.measurements.dvl import Dvl, DvlParameters
from insdvl.navigation.parameters import (
    FilterParameters,
    ImuParameters,
    InitialParameters,
    OriginParameters,
    ProcessNoiseParameters,
)
from insdvl.simulation.initial_errors import P_0, drawn_initial
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.trajectories import AUV
from insdvl.timeline.fold import Fold
from insdvl.timeline.output import FoldResult
from insdvl.timeline.recorded import fold_arrays

SEED = 223_606
VARIANCES = [1e-4] * 3 + [1e-6] * 3  # per sample: 0.01 m/s^2 and 1 mrad/s
AT = 50.003  # s, of the glitch
SETTINGS = FilterParameters(
    frame_convention="ned",
    dvl=DvlParameters(noise_std=(0.02,) * 3, lever_arm=(0.5, 0.0, 0.3)),
    process_noise=ProcessNoiseParameters(
        accelerometer_variance=tuple(VARIANCES[:3]), gyroscope_variance=tuple(VARIANCES[3:])
    ),
    initial=replace(P_0, mode="set_odometry"),
    origin=OriginParameters(height=float(AUV.h_0)),
)


@pytest.fixture(scope="module")
def mission() -> Mission:
    dvl = DvlModel(noise_std=(0.02,) * 3, lever_arm=(0.5, 0.0, 0.3))
    return simulate(AUV, constant(VARIANCES), seed=SEED, duration=90.0, dvl=dvl)


def events_of(mission: Mission) -> list:
    start = drawn_initial(mission.initial, SETTINGS.initial, np.random.default_rng([SEED, 1]))
    pings = zip(mission.dvl_stamps_ns.tolist(), mission.v_d, strict=True)
    return [start, *(Dvl(stamp_ns, v_d) for stamp_ns, v_d in pings)]


def spoilt(mission: Mission, count: int, values: dict[int, float]) -> tuple[np.ndarray, np.ndarray]:
    """Specific force and rates with so many samples of wrong values, by channel."""
    z = np.concatenate([mission.f_b, mission.w_ib_b], axis=1)
    first = int(np.searchsorted(mission.stamps_ns, AT * 1e9))
    for channel, value in values.items():
        z[first : first + count, channel] = value
    return np.ascontiguousarray(z[:, :3]), np.ascontiguousarray(z[:, 3:])


def fly(
    mission: Mission,
    count: int = 0,
    values: dict[int, float] | None = None,
    settings: FilterParameters = SETTINGS,
) -> FoldResult:
    f_b, w_ib_b = spoilt(mission, count, values or {})
    return fold_arrays(settings, mission.stamps_ns, f_b, w_ib_b, events_of(mission))


def error(result: FoldResult, mission: Mission) -> np.ndarray:
    """(N, 3) error of the body velocity."""
    nav, truth = result.states["nav"], mission.truth
    v_b = np.einsum("kji,kj->ki", nav["C_n_b"], nav["v_n"])
    return np.einsum("kji,kj->ki", truth.C_n_b, truth.v_n) - v_b


def sigmas(result: FoldResult) -> np.ndarray:
    nav = result.states["nav"]
    J = body_velocity_jacobian(nav["C_n_b"], nav["v_n"], invariant=True, n=15)
    return np.sqrt(np.einsum("kij,kjl,kil->ki", J, P15(result.states), J))


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(values**2, axis=1))))


ZEROS = dict.fromkeys(range(6), 0.0)
FORCE_ZERO = dict.fromkeys(range(3), 0.0)


@pytest.mark.parametrize(
    ("count", "values"),
    [
        (1, ZEROS),
        (3, ZEROS),
        (20, ZEROS),
        (1, FORCE_ZERO),
        (200, FORCE_ZERO),
        (1, {2: 60.0}),
        (1, {0: 20.0}),
        (1, {1: -1000.0}),
        (3, {1: -1000.0}),
        (1, {5: 10.0}),
        (1, {3: -4.0}),
        (1, {4: 40.0, 0: 300.0}),
    ],
)
def test_it_does_no_harm(mission: Mission, count: int, values: dict[int, float]) -> None:
    clean, result = fly(mission), fly(mission, count, values)
    end = int(np.searchsorted(mission.stamps_ns, AT * 1e9)) + count
    during, after = slice(end - count, end), slice(end + 1000, None)
    refused = [sum(not u.report.accepted for u in each.updates) for each in (clean, result)]
    assert refused[1] <= refused[0] + 1
    assert rms(error(result, mission)[after]) < 1.2 * rms(error(clean, mission)[after])
    assert rms(error(result, mission)[2000:]) < 2.0 * rms(error(clean, mission)[2000:])
    assert np.abs(error(result, mission) / sigmas(result))[during].max() < 5.0
    name = "no_data" if values in (ZEROS, FORCE_ZERO) else "glitches"
    assert result.counts[name] == count
    assert not result.counts["dvl inflations"]


@pytest.mark.parametrize(("count", "values"), [(5, {1: 3.0}), (2, {5: 10.0}), (4, {3: 2.0})])
def test_wrong_samples_that_agree_are_blamed_by_the_next_measurement(
    mission: Mission, count: int, values: dict[int, float]
) -> None:
    """They are believed. The DVL is used all the same, and the state is right two seconds later."""
    clean, result = fly(mission), fly(mission, count, values)
    first = int(np.searchsorted(mission.stamps_ns, AT * 1e9))
    assert result.states["channels"]["step_ns"][-1].max() >= mission.stamps_ns[first + 1]
    refused = [sum(not u.report.accepted for u in each.updates) for each in (clean, result)]
    assert refused[1] <= refused[0]
    assert result.counts["dvl inflations"] == 1
    assert np.abs(error(result, mission)[first + 300 :]).max() < 0.15


def test_a_turn_that_was_measured_wrongly_is_taken_back(mission: Mission) -> None:
    """The heading turns by 0.2 rad in two samples; the lateral velocity tells it."""
    clean, result = fly(mission), fly(mission, 2, {5: 10.0})
    off = []
    for each in (clean, result):
        C = mission.truth.C_n_b[-1] @ each.states["nav"]["C_n_b"][-1].T
        off.append(np.arctan2(C[1, 0], C[0, 0]))
    sigma = np.sqrt(result.states["nav"]["P"][-1, 5, 5])
    assert abs(off[1] - off[0]) < 0.1
    assert abs(off[1]) < 3.0 * sigma


# ------------------------------------------------------------------ what is no glitch


def readings(count: int, sigma: float = 0.01) -> np.ndarray:
    """(N, 6) at rest."""
    noise = np.random.default_rng(SEED).standard_normal((count, 6)) * (
        [sigma] * 3 + [0.1 * sigma] * 3
    )
    return np.array([0.0, 0.0, -9.7946, 0.0, 0.0, 0.0]) + noise


def fold(z: np.ndarray, **imu: float) -> FoldResult:
    settings = replace(
        SETTINGS, imu=ImuParameters(**imu), initial=InitialParameters(mode="parameters")
    )
    stamps = 10_000_000 * np.arange(1, len(z) + 1)
    f_b, w_ib_b = (np.ascontiguousarray(part) for part in (z[:, :3], z[:, 3:]))
    return fold_arrays(settings, stamps, f_b, w_ib_b, [])


def test_white_noise_has_none() -> None:
    """Of 600,000 readings whose smallest changes count as well."""
    settings = {"gap_acceleration_std": 0.0, "gap_rate_std": 0.0}
    assert fold(readings(100_000), **settings).counts["glitches"] == 0


@pytest.mark.parametrize("channel", [0, 5])
def test_a_real_step_loses_nothing(channel: int) -> None:
    """The channel changes for good: the state is that of a filter that never doubts."""
    z = readings(600)
    z[300:, channel] += 3.0
    doubting, believing = fold(z), fold(z, gap_acceleration_std=100.0, gap_rate_std=100.0)
    assert doubting.counts["glitches"] == 1 and believing.counts["glitches"] == 0
    for name in ("v_n", "C_n_b"):
        ends = [each.states["nav"][name] for each in (doubting, believing)]
        # One sample later than the step, at second order of 3 rad/s for a hundredth of a second.
        np.testing.assert_allclose(ends[0][305], ends[1][305], atol=2e-3)
        np.testing.assert_allclose(ends[0][-1], ends[1][-1], rtol=1e-3, atol=2e-3)


def test_a_noise_that_rises_is_believed_after_a_few_samples() -> None:
    z = np.concatenate([readings(500, 0.05), readings(500, 1.0)])
    glitches = fold(z).states["counters"]["glitches"]
    assert 1 <= glitches[519] <= 15
    assert glitches[-1] == glitches[519]


def test_beyond_its_range_a_channel_agrees_with_nothing() -> None:
    """A reading of -1000 that stays: nothing of it is believed."""
    z = readings(400)
    z[300:320, 1] = -1000.0
    result = fold(z)
    assert result.counts["glitches"] == 20
    assert np.abs(result.states["nav"]["v_n"][320]).max() < 0.5
    assert np.sqrt(result.states["nav"]["P"][320, 1, 1]) > 10.0


def test_the_first_samples_may_be_zeros() -> None:
    z = readings(100)
    z[:5] = 0.0
    result = fold(z)
    assert result.counts["no_data"] == 5
    assert np.abs(result.states["nav"]["v_n"][-1]).max() < 0.05


# ------------------------------------------------------------------ order


def test_the_order_of_arrival_does_not_matter(mission: Mission) -> None:
    """A glitch with measurements inside its interval and that of the next one, to the bit."""
    f_b, w_ib_b = spoilt(mission, 1, {2: 60.0, 3: 5.0})
    at = int(np.searchsorted(mission.stamps_ns, AT * 1e9))
    stamps_ns = mission.stamps_ns[at - 300 : at + 100]
    samples = [
        Imu(int(t), f, w)
        for t, f, w in zip(
            stamps_ns, f_b[at - 300 : at + 100], w_ib_b[at - 300 : at + 100], strict=True
        )
    ]
    start = replace(
        drawn_initial(mission.initial, SETTINGS.initial, np.random.default_rng(1)),
        stamp_ns=int(stamps_ns[0]),
    )
    k = 300
    pings = [Dvl(int(stamps_ns[k + j]) - 4_000_000, np.ones(3)) for j in (0, 1, 2)]
    results = []
    for order in (range(400), [*range(k - 1), k + 1, k, k - 1, *range(k + 2, 400)]):
        each = Fold(SETTINGS)
        each.add(start)
        for n, j in enumerate(order):
            assert each.add(samples[j]) is None
            if n == k + 5:
                for ping in pings:
                    each.add(ping)
        results.append(each.states["nav"].tobytes() + each.states["channels"].tobytes())
    assert results[0] == results[1]
