"""What is drawn in the scenarios whose noise is not white, and what a filter is told of it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import welch
from scipy.stats import kstest, uniform

from insdvl.simulation.drawn import dvl_errors, waves
from insdvl.simulation.drawn.imu_errors import ImuErrors, Line
from insdvl.simulation.drawn.scenarios import (
    BAND,
    COLOURED,
    DRAWN,
    GYROSCOPE,
    TIME_CONSTANT,
    Disturbances,
)
from insdvl.simulation.mission import simulate
from insdvl.simulation.noise import NoiseProfile
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.sensors.imu import ideal_imu
from insdvl.simulation.trajectories import AUV

NONE = ImuErrors(
    coloured=None,
    time_constants=np.ones(6),
    flicker=np.zeros(6),
    counts=np.zeros(6),
    lines=(),
    force=np.zeros((3, 3)),
    rate=np.zeros((3, 3)),
)
DT = 0.01
LEVEL = NoiseProfile(np.zeros(1), np.full((1, 6), 0.02))


def noise(errors, n=400_000, seed=2):
    return errors.noise(np.arange(n) * DT, DT, np.random.default_rng(seed))


@pytest.mark.parametrize("name", DRAWN)
def test_one_seed_is_one_mission_and_another_is_another_vehicle(name):
    one, again, other = (simulate(AUV, DRAWN[name], seed=s, duration=20.0) for s in (4, 4, 5))
    for field in ("f_b", "w_ib_b", "q", "v_d", "r"):
        np.testing.assert_array_equal(getattr(one, field), getattr(again, field))
    assert not np.array_equal(one.f_b, other.f_b)
    assert np.isfinite(one.q).all()
    assert (one.q > 0.0).all()


@pytest.mark.parametrize("name", ["vibrating", "waves", "coloured"])
def test_a_longer_mission_begins_as_the_shorter_one(name):
    short, long = (simulate(AUV, DRAWN[name], seed=9, duration=d) for d in (30.0, 60.0))
    n = short.stamps_ns.size
    for field in ("f_b", "w_ib_b"):
        np.testing.assert_array_equal(getattr(short, field), getattr(long, field)[:n])
    np.testing.assert_array_equal(short.v_d, long.v_d[:30])
    np.testing.assert_allclose(short.q[:, :5], long.q[:n, :5], rtol=1e-9)


@pytest.mark.parametrize("name", ["vibrating", "waves"])
def test_motion_is_not_in_the_effective_noise(name):
    """It is that of the white noise alone, which is drawn from the same stream without motion."""
    moving = simulate(AUV, DRAWN[name], seed=7, duration=60.0)
    still = simulate(AUV, DRAWN[name].profile(), seed=7, duration=60.0)
    np.testing.assert_allclose(moving.q, still.q, rtol=1e-8)
    assert np.abs(moving.truth.v_n - still.truth.v_n).max() > 1e-4
    sigma = np.sqrt(still.q)
    assert ((moving.f_b - still.f_b).std(axis=0) > sigma[:, :3].mean(axis=0) * 0.05).any()


@pytest.mark.parametrize(("gyroscope", "accelerometer"), [(3, 1), (4, 0), (5, None)])
def test_a_gyroscope_changes_the_effective_noise_of_the_axis_it_tilts(gyroscope, accelerometer):
    """The gain of the velocity depends on it; a turn about x tilts y, and about z neither."""
    level = NoiseProfile(np.zeros(1), 0.02 * np.repeat([[1.0, 1e-5]], 3, axis=1))
    flicker = np.zeros(6)
    flicker[gyroscope] = 1e-7
    quiet, loud = (
        Disturbances(replace(NONE, coloured=level, flicker=own)).effective(
            level, np.ones(1), DvlModel(), 100.0, 300.0
        )
        for own in (np.zeros(6), flicker)
    )
    changed = np.flatnonzero(np.abs(loud[0].variances / quiet[0].variances - 1.0)[0] > 1e-3)
    assert set(changed) == {gyroscope, accelerometer} - {None}


def test_coloured_noise_has_its_density_and_time_constant():
    tau = np.array([0.3, 0.5, 1.0, 1.5, 2.0, 3.0])
    x = noise(replace(NONE, coloured=LEVEL, time_constants=tau))
    np.testing.assert_allclose(x.var(axis=0), 0.02 * DT / (2.0 * tau), rtol=0.15)
    lag = round(0.3 / DT)
    correlation = np.mean(x[lag:] * x[:-lag], axis=0) / x.var(axis=0)
    np.testing.assert_allclose(correlation, np.exp(-0.3 / tau), atol=0.06)
    (spectrum, *_) = replace(NONE, coloured=LEVEL, time_constants=tau).spectra(0.0, np.zeros(6), DT)
    assert spectrum.mean_density(1e9) == pytest.approx(0.02 * DT, rel=1e-6)


def test_flicker_has_the_density_of_its_bias_instability():
    h = 1e-6
    x = noise(replace(NONE, flicker=np.full(6, h)))
    f, density = welch(x, 1.0 / DT, nperseg=40_000, axis=0)
    inside = (f > 0.02) & (f < 0.5)
    measured = 0.5 * density[inside].mean(axis=1) * f[inside]  # two-sided
    assert np.mean(measured) == pytest.approx(h, rel=0.1)


def test_lines_have_their_variance_and_frequency():
    x = noise(replace(NONE, lines=(Line(7.0, np.full(6, 2e-3)),)), n=100_000)
    np.testing.assert_allclose(x.var(axis=0), 2e-3, rtol=1e-3)
    power = np.abs(np.fft.rfft(x[:, 0])) ** 2
    assert np.argmax(power) / (100_000 * DT) == pytest.approx(7.0, abs=1e-3)


def test_counts_lose_nothing_of_the_integral():
    errors = replace(NONE, counts=np.array([2e-4] * 3 + [2e-6] * 3))
    readings = np.random.default_rng(3).standard_normal((5000, 6))
    counted = errors.counted(readings, DT)
    gap = np.cumsum(counted - readings, axis=0) * DT
    assert (np.abs(gap) <= 0.5 * errors.counts * (1.0 + 1e-6)).all()
    np.testing.assert_allclose(gap.var(axis=0), errors.counts**2 / 12.0, rtol=0.05)
    whole = counted * DT / errors.counts
    np.testing.assert_allclose(whole, np.rint(whole), atol=1e-6)


def test_scale_and_alignment_errors_turn_with_the_vehicle():
    force, rate = np.diag([1e-3, 0.0, 0.0]), np.zeros((3, 3))
    rate[0, 2] = 1e-3
    f_b, w_ib_b = ideal_imu(AUV, np.arange(1, 1001) * 0.1 + 20.0, 0.1)
    readings = np.hstack([f_b, w_ib_b])
    error = replace(NONE, force=force, rate=rate).distorted(readings) - readings
    expected = np.zeros_like(error)
    expected[:, 0], expected[:, 3] = 1e-3 * f_b[:, 0], 1e-3 * w_ib_b[:, 2]
    np.testing.assert_allclose(error, expected, atol=1e-15)


def test_the_draws_cover_their_ranges():
    rngs = [np.random.default_rng(k) for k in range(300)]
    drawn = [DRAWN["realistic"].draw(60.0, 100.0, rng) for rng in rngs]
    low, high = np.log(TIME_CONSTANT)
    taus = np.log([d.imu.time_constants for d in drawn]).ravel()
    assert kstest(taus, uniform(low, high - low).cdf).pvalue > 1e-3
    lines = np.array([d.vibration.omega.size for d in drawn]) - 48
    assert set(lines) == {0, 1, 2, 3}
    frequencies = np.concatenate([d.vibration.omega for d in drawn]) / (2.0 * np.pi)
    assert BAND[0] <= frequencies.min() < 6.1
    assert 47.9 < frequencies.max() <= BAND[1]
    coloured = np.concatenate([d.imu.coloured.variances for d in drawn])
    for channel, scale in zip(coloured.T, [1.0] * 3 + [GYROSCOPE] * 3, strict=True):
        assert COLOURED[0] <= channel.min() / scale
        assert channel.max() / scale <= COLOURED[1]
    waved = [wave for d in drawn for waves_ in d.sea.added.values() for wave in waves_]
    periods = 1.0 / np.array([wave.period for wave in waved])
    assert waves.PEAK[0] * (1.0 - 1e-9) <= periods.min()
    assert 2.9 < periods.max() <= waves.STEERING_FREQUENCY[1] * (1.0 + 1e-9)


def test_steering_has_its_rate_of_turn():
    sea = waves.drawn_sea(np.random.default_rng(1))
    fast = [wave for wave in sea.added["pitch"] if wave.period < 1.0 / waves.PEAK[1] - 1e-9]
    rate = sum((2.0 * np.pi * wave.amplitude / wave.period) ** 2 / 2.0 for wave in fast)
    assert np.sqrt(rate) == pytest.approx(waves.STEERING["pitch"])


def test_a_dvl_has_the_noise_that_is_told_of_it():
    """White noise of each ping's own sigma; the effective one is larger by the slow part."""
    scenario, dvl = DRAWN["realistic"], DvlModel(rate=5.0, noise_std=(0.05,) * 3)
    mission = simulate(AUV, scenario, seed=5, duration=60.0, dvl=dvl)
    sigma = np.sqrt(mission.r)
    assert sigma.max() / sigma.min() > 1.1
    model = DvlModel(noise_std=(0.05,) * 3)
    factors = np.repeat([0.5, 2.0], 5000)
    errors, _ = model.errors(np.arange(10_000.0), np.random.default_rng(1), factors)
    np.testing.assert_allclose(errors[:5000].std(axis=0), 0.025, rtol=0.05)
    np.testing.assert_allclose(errors[5000:].std(axis=0), 0.1, rtol=0.05)
    drawn = [dvl_errors.drawn_dvl_errors(330.0, np.random.default_rng(k)) for k in range(40)]
    truth = AUV.truth(np.arange(1.0, 330.0))
    of_all = 0.02 * np.concatenate([d.factors(truth) for d in drawn])
    # Of a DVL of 0.02 m/s: what is found in the field, some 5 to 100 mm/s.
    assert 0.003 < of_all.min() < 0.006
    assert 0.04 < of_all.max() < 0.1
