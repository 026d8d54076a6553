"""Channels that do not show the motion: saturated, or frozen. The sigma knows what is not seen."""

from dataclasses import replace

import numpy as np
import pytest
from records import P15
from told import TOLD

from insdvl.navigation.coordinates import body_velocity_jacobian
from insdvl.navigation.events import Event, Imu, Initial
from insdvl.navigation.geometry.frames import rotation_from_rpy
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.odometry import odometry
from insdvl.navigation.parameters import (
    DvlParameters,
    FilterParameters,
    ImuParameters,
    OriginParameters,
    ProcessNoiseParameters,
)
from insdvl.parameters.declaration import ParameterError, build
from insdvl.simulation.initial_errors import P_0
from insdvl.simulation.mission import ImuModel, Mission, simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.trajectories import AUV
from insdvl.timeline.fold import Fold
from insdvl.timeline.output import FoldResult
from insdvl.timeline.recorded import fold_arrays

SEED = 173_205
STEP = 10_000_000
FROZEN = 50
SIGMA_F, SIGMA_W = 0.5, 0.05  # gap_acceleration_std, gap_rate_std
RANGE_F, RANGE_W = 20.0, 2.0

SETTINGS = FilterParameters(
    frame_convention="ned",
    earth_rate=False,
    imu=ImuParameters(acceleration_range=RANGE_F, rate_range=RANGE_W, frozen_samples=FROZEN),
    dvl=DvlParameters(lever_arm=(0.5, 0.0, 0.3)),
    process_noise=ProcessNoiseParameters(
        accelerometer_variance=(1e-6,) * 3, gyroscope_variance=(1e-8,) * 3
    ),
    initial=replace(
        P_0,
        velocity_std=0.0,
        tilt_std=0.0,
        heading_std=0.0,
        accelerometer_bias_std=0.0,
        gyroscope_bias_std=0.0,
    ),
)


def readings(count: int) -> np.ndarray:
    """(N, 6) at rest, no two samples alike."""
    noise = np.random.default_rng(SEED).standard_normal((count, 6))
    return np.array([0.0, 0.0, -9.7946, 0.0, 0.0, 0.0]) + 1e-4 * noise


def fold(
    z: np.ndarray, events: list[Event] | None = None, settings: FilterParameters = SETTINGS
) -> FoldResult:
    stamps = STEP * np.arange(1, len(z) + 1)
    return fold_arrays(
        settings,
        stamps,
        np.ascontiguousarray(z[:, :3]),
        np.ascontiguousarray(z[:, 3:]),
        events or [],
    )


def added(z: np.ndarray, k: int, settings: FilterParameters = SETTINGS) -> np.ndarray:
    """(6,) variances of velocity and attitude that the doubt has added until sample k."""
    trusting = replace(settings, imu=ImuParameters(mount=settings.imu.mount, frozen_samples=0))
    P = [P15(fold(z, settings=each).states[k]) for each in (settings, trusting)]
    return np.diag(P[0] - P[1])[:6]


# ------------------------------------------------------------------ what is noticed


@pytest.mark.parametrize("channel", range(6))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_reading_at_the_end_of_the_range_is_saturated(channel: int, sign: float) -> None:
    z = readings(60)
    limit = sign * (20.0 if channel < 3 else 2.0)
    z[20:23, channel] = limit * np.array([1.0, 1.5, 0.999_999])
    assert fold(z).states["counters"]["saturated"][[19, 20, 21, 22, 59]].tolist() == [0, 1, 2, 2, 2]
    undeclared = replace(SETTINGS, imu=ImuParameters())
    assert fold(z, settings=undeclared).counts["saturated"] == 0


@pytest.mark.parametrize("channel", range(6))
def test_equal_readings_in_a_row_are_frozen(channel: int) -> None:
    z = readings(200)
    z[100 : 100 + FROZEN + 9, channel] = z[100, channel]
    frozen = fold(z).states["counters"]["frozen"]
    first = 100 + FROZEN - 1
    assert frozen[[first - 1, first, first + 9, 199]].tolist() == [0, 1, 10, 10]
    assert fold(z[:, ::-1].copy() * 0.01).counts["frozen"] == 10  # whatever the value is
    never = replace(SETTINGS, imu=ImuParameters(frozen_samples=0))
    assert fold(z, settings=never).counts["frozen"] == 0


def test_readings_that_merely_come_back_are_not() -> None:
    z = readings(400)
    z[::2] = z[0]
    assert fold(z).counts["frozen"] == 0


def test_a_gap_does_not_thaw() -> None:
    """Fewer than it takes on either side of it, but all equal."""
    z = readings(200)
    z[20:160, 4] = z[20, 4]
    stamps = STEP * np.arange(1, 201)
    kept = np.r_[0:60, 120:200]
    f, w = (np.ascontiguousarray(z[kept][:, part]) for part in (slice(0, 3), slice(3, 6)))
    result = fold_arrays(SETTINGS, stamps[kept], f, w, [])
    assert result.counts["gaps"] == 1
    assert result.counts["frozen"] == 40 + 40 - FROZEN + 1


# ------------------------------------------------------------------ what it costs


@pytest.mark.parametrize("channel", range(6))
def test_a_saturated_channel_adds_what_its_range_may_hide(channel: int) -> None:
    """(range T)^2 after T, on that axis, in all while it lasts, nothing before and after."""
    z = readings(160)
    z[40:80, channel] = 25.0
    T = 0.01 * np.arange(1, 41)
    sigma = RANGE_F if channel < 3 else RANGE_W
    own = channel
    assert added(z, 39)[own] == 0.0
    for k in (0, 9, 39):
        assert added(z, 40 + k)[own] == pytest.approx((sigma * T[k]) ** 2, rel=1e-3)
    assert added(z, 80)[own] == pytest.approx((sigma * T[-1]) ** 2, rel=0.05)
    if channel < 3:
        assert np.delete(added(z, 79), own) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("channel", range(6))
def test_a_frozen_channel_adds_what_grew_unnoticed_as_well(channel: int) -> None:
    z = readings(300)
    z[100:220, channel] = z[100, channel]
    sigma = SIGMA_F if channel < 3 else SIGMA_W
    noticed = 100 + FROZEN - 1
    assert added(z, noticed - 1)[channel] == 0.0
    for k in (noticed, noticed + 1, 219):
        T = 0.01 * (k - 100)
        assert added(z, k)[channel] == pytest.approx((sigma * T) ** 2, rel=1e-3)


def test_the_axis_is_that_of_the_imu() -> None:
    """A turned IMU: the frozen channel is one of its own, which is none of base_link's."""
    mount = (0.4, -0.7, 2.0)
    C_b_i = rotation_from_rpy(np.array(mount))
    settings = replace(SETTINGS, imu=replace(SETTINGS.imu, mount=mount))
    z = readings(150)
    z[:, :3], z[:, 3:] = z[:, :3] @ C_b_i, z[:, 3:] @ C_b_i
    z[50:, 1] = z[50, 1]
    trusting = replace(settings, imu=ImuParameters(mount=mount, frozen_samples=0))
    P = [fold(z, settings=each).states[-1]["nav"]["P"][:3, :3] for each in (settings, trusting)]
    axis = C_b_i[:, 1]
    expected = np.outer(axis, axis) * (SIGMA_F * 0.99) ** 2
    np.testing.assert_allclose(P[0] - P[1], expected, rtol=1e-3, atol=1e-5)


def test_cuts_do_not_change_what_is_added() -> None:
    """Pings that tell nothing, at stamps between the samples."""
    z = readings(200)
    z[50:150, 5] = z[50, 5]
    events: list[Event] = [
        Dvl(k * STEP + 3_000_000, np.full(3, 0.01 + 1e-6 * k), 1e12 * np.eye(3))
        for k in range(60, 140, 3)
    ]
    whole, cut = fold(z).states, fold(z, events).states
    np.testing.assert_allclose(cut["nav"]["P"][:, 5, 5], whole["nav"]["P"][:, 5, 5], rtol=1e-6)


def test_an_accepted_velocity_makes_the_specific_force_begin_again() -> None:
    """Between two pings a second apart the velocity is lost by what a second can do."""
    z = readings(600)
    z[50:, 0] = z[50, 0]
    noise = 0.02 * np.random.default_rng(SEED).standard_normal((6, 3))
    events: list[Event] = [Dvl(k * 100 * STEP, noise[k]) for k in range(1, 6)]
    P = P15(fold(z, events).states)
    for ping in (200, 300, 400, 500):
        gained = P[ping + 98, 0, 0] - P[ping - 1, 0, 0]
        assert gained == pytest.approx((SIGMA_F * 0.99) ** 2, rel=0.05)


def test_an_accepted_velocity_tells_the_tilt_again_but_never_the_heading() -> None:
    noise = 0.02 * np.random.default_rng(SEED).standard_normal((6, 3))
    events: list[Event] = [Dvl(k * 100 * STEP, noise[k]) for k in range(1, 6)]
    for channel, limit in ((3, 2 * SIGMA_W), (5, np.inf)):
        z = readings(600)
        z[50:, channel] = z[50, channel]
        sigma = np.sqrt(fold(z, events).states["nav"]["P"][-1, channel, channel])
        assert sigma < limit
        if channel == 5:
            assert sigma == pytest.approx(SIGMA_W * 5.49, rel=0.02)


def test_what_a_frozen_channel_last_said_is_not_used() -> None:
    """It froze in a turn and a climb that have long ended: neither drives the state."""
    z = readings(400)
    z[50:, [0, 5]] = 3.0, 0.4
    s = fold(z).states
    noticed = 50 + FROZEN - 1
    assert np.abs(np.diff(s["nav"]["v_n"][noticed:], axis=0)[:, :2]).max() < 0.01 * 0.05
    assert np.abs(s["nav"]["w_nb_b"][noticed:, 2]).max() < 1e-12
    assert s["nav"]["w_nb_b"][noticed - 1, 2] == pytest.approx(0.4)


def test_a_doubtful_imu_cannot_refuse_the_dvl_for_long() -> None:
    """A velocity that does not fit is refused once, then it is the IMU that was wrong."""
    z = readings(800)
    z[50:, 0] = z[50, 0]
    v = np.array([3.0, 0.0, 0.0])
    pings = [Dvl(k * 100 * STEP, (k >= 4) * v + 0.01 * k) for k in range(1, 8)]
    reasons = [u.report.reason for u in fold(z, list(pings)).updates]
    assert reasons == ["", "", "", "gate", "", "", ""]


def test_a_told_state_makes_all_begin_again() -> None:
    z = readings(400)
    z[50:, [0, 4]] = z[50, [0, 4]]
    start = Initial(
        300 * STEP, np.eye(3), np.zeros(3), np.zeros(3), "body", *(1e-12 * np.eye(3),) * 3
    )
    P = P15(fold(z, [start]).states[-1])
    assert P[0, 0] == pytest.approx(SIGMA_F**2, rel=0.3)
    assert P[4, 4] == pytest.approx(SIGMA_W**2, rel=0.02)


def test_the_turn_rate_of_a_frozen_gyroscope_is_not_known() -> None:
    """In the output, and in the lever arm of the DVL."""
    z = readings(200)
    ping = Dvl(200 * STEP, np.full(3, 0.01))
    variances, S = [], []
    for frozen in (False, True):
        if frozen:
            z[50:, 4] = z[50, 4]
        result = fold(z, [ping])
        out = odometry(result.filter, result.states, 199)
        variances.append(np.diag(out.twist_covariance)[3:])
        s = fold(z[:199]).states[-1]
        S.append(result.updates[0].report.S)
        J = body_velocity_jacobian(s["nav"]["C_n_b"], s["nav"]["v_n"], invariant=True, n=15)
        S[-1] = S[-1] - J @ P15(result.states[198]) @ J.T
    difference = variances[1] - variances[0]
    assert difference[1] == pytest.approx(SIGMA_W**2, rel=1e-6)
    assert difference[[0, 2]] == pytest.approx(0.0, abs=1e-12)
    # l = (0.5, 0, 0.3) turns about y: 0.3 along x and -0.5 along z.
    arm = S[1] - S[0]
    assert arm[0, 0] > 0.8 * (0.3 * SIGMA_W) ** 2
    assert arm[2, 2] > 0.8 * (0.5 * SIGMA_W) ** 2


@pytest.mark.parametrize("frozen_samples", [0, FROZEN])
def test_the_heading_is_covered_in_a_turn_beyond_the_range_and_when_stuck_there(
    frozen_samples: int,
) -> None:
    """Two seconds at the end of the range: the vehicle turns a third faster, or not at all."""
    settings = replace(SETTINGS, imu=replace(SETTINGS.imu, frozen_samples=frozen_samples))
    z = readings(300)
    z[50:250, 5] = RANGE_W
    s = fold(z, settings=settings).states[-1]
    heading = np.arctan2(s["nav"]["C_n_b"][1, 0], s["nav"]["C_n_b"][0, 0])
    for truth in (4.0 / 3.0 * RANGE_W * 2.0, 0.0):
        error = (heading - truth + np.pi) % (2.0 * np.pi) - np.pi
        assert abs(error) < 2.0 * np.sqrt(s["nav"]["P"][5, 5])
    assert np.sqrt(s["nav"]["P"][5, 5]) == pytest.approx(RANGE_W * 2.0, rel=0.01)


# ------------------------------------------------------------------ on a mission


def frozen_mission(seed: int, channel: int, rate: float = 100.0) -> Mission:
    variances = [1e-4] * 3 + [1e-6] * 3
    m = simulate(
        AUV,
        constant(variances),
        seed=seed,
        duration=120.0,
        imu=ImuModel(rate=rate),
        dvl=DvlModel(noise_std=np.full(3, 0.05)),
    )
    z = np.hstack([m.f_b, m.w_ib_b])
    first, last = round(40 * rate), round(80 * rate)
    z[first:last, channel] = z[first, channel]
    return replace(m, f_b=np.ascontiguousarray(z[:, :3]), w_ib_b=np.ascontiguousarray(z[:, 3:]))


@pytest.mark.parametrize(
    ("rate", "channel"), [*((50.0, channel) for channel in range(6)), (200.0, 5), (1000.0, 4)]
)
def test_the_velocity_is_covered_while_a_channel_is_frozen(rate: float, channel: int) -> None:
    """40 s of a mission that turns and dives; the IMU at low and at high rates."""
    m = frozen_mission(SEED + channel, channel, rate)
    settings = FilterParameters(
        frame_convention="ned",
        imu=ImuParameters(rate=rate),
        dvl=DvlParameters(noise_std=(0.05,) * 3),
        process_noise=ProcessNoiseParameters(
            accelerometer_variance=(1e-4,) * 3, gyroscope_variance=(1e-6,) * 3
        ),
        initial=replace(P_0, mode="set_odometry", velocity_std=0.02),
        origin=OriginParameters(height=float(AUV.h_0)),
    )
    C = m.initial.C_n_b[0]
    events: list[Event] = [
        Initial(0, C, m.initial.p_o[0], C.T @ m.initial.v_n[0], "body"),
        *(Dvl(t, v) for t, v in zip(m.dvl_stamps_ns.tolist(), m.v_d, strict=True)),
    ]
    result = fold_arrays(settings, m.stamps_ns, m.f_b, m.w_ib_b, events)
    s = result.states
    assert result.counts["frozen"] == round(40 * rate) - 99
    J = body_velocity_jacobian(s["nav"]["C_n_b"], s["nav"]["v_n"], invariant=True, n=15)
    sigma = np.sqrt(np.einsum("kij,kjl,kil->ki", J, P15(s), J))
    v_b = np.einsum("kji,kj->ki", s["nav"]["C_n_b"], s["nav"]["v_n"])
    error = np.einsum("kji,kj->ki", m.truth.C_n_b, m.truth.v_n) - v_b
    assert np.abs(error / sigma).max() < 5.0
    assert np.linalg.eigvalsh(s["nav"]["P"][-1, :15, :15])[0] > 0.0
    # It comes back: as good as before, ten seconds after the channel works again.
    assert np.abs(error[round(90 * rate) :]).max() < 0.25


@pytest.mark.parametrize(("name", "most"), [("acceleration_range", 10000), ("rate_range", 1000)])
def test_a_range_is_not_negative(name: str, most: int) -> None:
    with pytest.raises(ParameterError, match=f"'imu.{name}' must be >= 0 and <= {most}, got -1.0"):
        build(FilterParameters, TOLD | {f"imu.{name}": -1.0})


def test_a_duplicate_that_wins_brings_its_reading() -> None:
    """Whether a channel is frozen does not depend on which of two samples came first."""
    z = readings(120)
    z[10:, 2] = z[10, 2]
    samples = [Imu(STEP * (k + 1), row[:3].copy(), row[3:].copy()) for k, row in enumerate(z)]
    other = replace(samples[30], f_b=samples[30].f_b + np.array([0.0, 0.0, 0.5]))
    states = []
    for first, second in ((samples[30], other), (other, samples[30])):
        each = Fold(SETTINGS)
        for event in [*samples[:30], first, second, *samples[31:]]:
            each.add(event)
        states.append(each.latest.tobytes())
    assert states[0] == states[1]
