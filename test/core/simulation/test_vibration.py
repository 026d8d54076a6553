"""Vibration is real motion: truth, readings and pings belong together."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import trapezoid
from test_simulation_trajectories import LIVELY, derivative, inner

from insdvl.navigation.events import Initial
from insdvl.navigation.geometry.earth import radii
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build
from insdvl.simulation.drawn.scenarios import DRAWN
from insdvl.simulation.drawn.vibration import SPEED, TURN, Vibration, drawn_sines
from insdvl.simulation.mission import simulate
from insdvl.simulation.sensors.dvl import DvlModel, ideal_pings, ideal_velocity
from insdvl.simulation.sensors.imu import ideal_imu
from insdvl.simulation.trajectories import AUV
from insdvl.timeline.recorded import fold_arrays

OMEGA = 2.0 * np.pi * np.array([6.0, 17.0, 48.0])
VARIANCES = np.tile([0.05, 0.02, 0.07, 1e-3, 2e-3, 5e-4], (3, 1))
SINES = drawn_sines(OMEGA, VARIANCES, np.random.default_rng(1))
SHAKEN = replace(LIVELY, vibration=SINES)


def test_velocity_acceleration_and_turn_rate_are_the_derivatives():
    t = inner(SHAKEN)
    truth = SHAKEN.truth(t)

    def of(field):
        return lambda times: getattr(SHAKEN.truth(times), field)

    lat, _, h = truth.llh.T
    R_N, R_E = radii(lat)
    metres = np.stack([R_N + h, (R_E + h) * np.cos(lat), -np.ones_like(h)], axis=1)
    v_n = derivative(of("llh"), t) * metres
    vibration = np.abs(truth.v_n - LIVELY.truth(t).v_n).max()
    assert vibration > 0.1
    # The place leaves out its own change with m and with the turn of the body: m' / (m omega) and
    # w_nb_b / omega, with rates of up to 0.4 1/s and omega of 38 rad/s and more.
    np.testing.assert_allclose(v_n, truth.v_n, atol=0.01 * vibration)
    np.testing.assert_allclose(derivative(of("v_n"), t, 1e-4), truth.a_n, atol=1e-6)
    omega = np.einsum("kji,kjl->kil", truth.C_n_b, derivative(of("C_n_b"), t, 1e-4))
    x, y, z = truth.w_nb_b.T
    found = np.stack([omega[:, 2, 1], omega[:, 0, 2], omega[:, 1, 0]])
    np.testing.assert_allclose(found, [x, y, z], atol=1e-6)


def test_the_variances_are_those_at_unit_speed_and_grow_with_speed_and_turn():
    """In the readings of a point on a straight line and on a circle."""
    t = np.arange(20_000) * 1e-3
    for speed, turn, m in ((SPEED, 0.0, 1.0), (2.0 * SPEED, 0.0, 4.0), (SPEED, TURN, 2.0)):
        still = replace(
            LIVELY,
            speed=replace(LIVELY.speed, value=speed, slope=0.0, ramps=(), waves=()),
            heading=replace(LIVELY.heading, slope=turn, ramps=(), waves=()),
            **dict.fromkeys(("pitch", "roll", "sway", "heave"), type(LIVELY.pitch)()),
            bank=0.0,
            pivot=0.0,
        )
        moving = replace(still, vibration=SINES).truth(t)
        quiet = still.truth(t)
        w = moving.w_nb_b - quiet.w_nb_b
        C_b_n = np.swapaxes(quiet.C_n_b, 1, 2)
        a = np.einsum("kij,kj->ki", C_b_n, moving.a_n - quiet.a_n)
        shaken = np.hstack([a, w]).var(axis=0)
        np.testing.assert_allclose(shaken, 3.0 * m**2 * VARIANCES[0], rtol=0.06)


def test_a_filter_that_integrates_the_readings_follows_it():
    """Without noise and DVL, at a rate for which coning and sculling are slow."""
    dt, n = 1e-3, 10_000
    stamps = np.arange(1, n + 1) * dt
    start, truth = SHAKEN.truth([0.0]), SHAKEN.truth(stamps)
    states = flown(SHAKEN, stamps, *ideal_imu(SHAKEN, stamps, dt), start)
    vibration = np.abs(truth.v_n - LIVELY.truth(stamps).v_n).max()
    assert vibration > 0.05
    np.testing.assert_allclose(states["nav"]["v_n"], truth.v_n, atol=0.02 * vibration)


def test_the_vibration_of_the_scenarios_is_harmless_at_100_hz():
    """Coning and sculling within a sample stay below the noise of a good IMU: 0.01 m/s in 60 s."""
    for seed in range(3):
        drawn = DRAWN["vibrating"].draw(60.0, 100.0, np.random.default_rng(seed))
        moved = drawn.moved(AUV)
        stamps = np.arange(1, 6001) * 0.01
        states = flown(moved, stamps, *ideal_imu(moved, stamps, 0.01), moved.truth([0.0]))
        np.testing.assert_allclose(states["nav"]["v_n"], moved.truth(stamps).v_n, atol=0.01)


def flown(trajectory, stamps, f_b, w_ib_b, start):
    """States of a filter that is told the true start and gets nothing but an IMU."""
    parameters = build(
        FilterParameters,
        {
            "initial.mode": "set_odometry",
            "imu.rate": float(1.0 / stamps[0]),
            "origin.latitude_deg": float(np.degrees(trajectory.lat_0)),
            "origin.longitude_deg": float(np.degrees(trajectory.lon_0)),
            "origin.height": trajectory.h_0,
        },
    )
    C = start.C_n_b[0]
    initial = Initial(0, C, np.zeros(3), C.T @ start.v_n[0], "body")
    stamps_ns = np.rint(stamps * 1e9).astype(np.int64)
    return fold_arrays(parameters, stamps_ns, f_b, w_ib_b, [initial]).states


def test_a_ping_is_the_mean_velocity_around_its_stamp():
    model = DvlModel(ping=0.02, lever_arm=(0.5, 0.1, -0.2))
    t = np.array([3.0, 21.7, 40.0])
    fine = np.linspace(-0.01, 0.01, 20_001)
    velocities = (ideal_velocity(SHAKEN.truth(at + fine), model) for at in t)
    expected = [trapezoid(v, fine, axis=0) / 0.02 for v in velocities]
    np.testing.assert_allclose(ideal_pings(SHAKEN, t, model, earth_rate=True), expected, atol=1e-6)
    point = replace(model, ping=0.0)
    np.testing.assert_array_equal(
        ideal_pings(SHAKEN, t, point, earth_rate=True), ideal_velocity(SHAKEN.truth(t), point)
    )


def test_a_mission_without_noise_has_the_readings_of_the_shaken_vehicle():
    scenario = replace(DRAWN["vibrating"], white=(1e-30, 1.0000001e-30))
    mission = simulate(AUV, scenario, seed=3, duration=20.0)
    quiet = AUV.truth(mission.truth.t)
    assert np.abs(mission.truth.v_n - quiet.v_n).max() > 1e-4
    change = np.diff(mission.truth.v_n, axis=0) / 0.01
    f_n = np.einsum("kij,kj->ki", mission.truth.C_n_b[1:], (mission.f_b - mission.bias[:, :3])[1:])
    # The rest is gravity and what the attitude turns within an interval.
    np.testing.assert_allclose((f_n - change)[:, 2], -9.8, atol=0.02)


@pytest.mark.parametrize("rate", [100.0, 50.0])
def test_what_lies_above_half_the_sample_rate_is_noise_and_no_motion(rate):
    for seed in range(5):
        drawn = DRAWN["vibrating"].draw(60.0, rate, np.random.default_rng(seed))
        assert isinstance(drawn.vibration, Vibration)
        assert (drawn.vibration.omega < np.pi * rate).all()
        assert all(0.0 <= line.frequency <= rate / 2.0 for line in drawn.imu.lines)
        assert bool(drawn.imu.lines) == (rate < 96.0)
    full = DRAWN["vibrating"].draw(60.0, 1000.0, np.random.default_rng(seed))
    power = sum(line.variances for line in drawn.imu.lines)
    moved = np.sum(full.vibration.sine**2 + full.vibration.cosine**2, axis=0) / 2.0
    kept = np.sum(drawn.vibration.sine**2 + drawn.vibration.cosine**2, axis=0) / 2.0
    assert (power <= (moved - kept) * (1.0 + 1e-9)).all()
