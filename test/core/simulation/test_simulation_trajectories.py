"""The truth against finite differences, quadrature, and formulas written in another way."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial.transform import Rotation

from insdvl.navigation.geometry.earth import radii
from insdvl.simulation.trajectories import (
    AUV,
    BASELINE,
    LOOP,
    NAMES,
    STATIC,
    Channel,
    Ramp,
    Trajectory,
    Wave,
    trajectory_named,
)

MOVING = {**BASELINE, "auv": AUV, "loop": LOOP}

# A motion with everything in it, so that no term can hide behind a zero.
LIVELY = Trajectory(
    duration=60.0,
    speed=Channel(1.5, slope=0.01, ramps=(Ramp(10.0, 14.0, 1.0),), waves=(Wave(0.2, 7.0),)),
    heading=Channel(0.3, slope=0.05, ramps=(Ramp(20.0, 30.0, 2.0, 1.5),), waves=(Wave(0.1, 9.0),)),
    pitch=Channel(0.1, ramps=(Ramp(15.0, 20.0, -0.4),), waves=(Wave(0.05, 8.0, 1.0),)),
    roll=Channel(-0.1, waves=(Wave(0.2, 6.0, 2.0),)),
    sway=Channel(0.1, waves=(Wave(0.3, 11.0, 0.5),)),
    heave=Channel(-0.2, waves=(Wave(0.25, 10.0, 1.5),)),
    bank=0.5,
    pivot=0.6,
    lat_0=math.radians(-41.0),
    h_0=-30.0,
)


def derivative(function, t, h=1e-3):
    """Central differences of the fourth order."""
    near = function(t + h) - function(t - h)
    far = function(t + 2 * h) - function(t - 2 * h)
    return (8.0 * near - far) / (12.0 * h)


def inner(trajectory):
    return np.linspace(0.1, min(trajectory.duration, 400.0) - 0.1, 701)


@pytest.mark.parametrize("name", [*MOVING, "lively"])
def test_velocity_acceleration_and_turn_rate_are_the_derivatives(name):
    trajectory = MOVING.get(name, LIVELY)
    t = inner(trajectory)
    truth = trajectory.truth(t)

    def of(field):
        return lambda times: getattr(trajectory.truth(times), field)

    lat, _, h = truth.llh.T
    R_N, R_E = radii(lat)
    metres = np.stack([R_N + h, (R_E + h) * np.cos(lat), -np.ones_like(h)], axis=1)
    v_n = derivative(of("llh"), t, 0.05) * metres
    np.testing.assert_allclose(v_n, truth.v_n, atol=3e-7)
    np.testing.assert_allclose(derivative(of("v_n"), t), truth.a_n, atol=1e-9)
    omega = np.einsum("kji,kjl->kil", truth.C_n_b, derivative(of("C_n_b"), t))
    expected = np.zeros_like(omega)
    x, y, z = truth.w_nb_b.T
    expected[:, 0, 1], expected[:, 0, 2], expected[:, 1, 2] = -z, y, -x
    expected[:, 1, 0], expected[:, 2, 0], expected[:, 2, 1] = z, -y, x
    np.testing.assert_allclose(omega, expected, atol=1e-9)


def test_attitude_is_yaw_pitch_roll():
    t = inner(LIVELY)
    at = {}
    for name in ("heading", "pitch", "roll"):
        channel = getattr(LIVELY, name)
        value, rate = channel.value + channel.slope * t, channel.slope + 0.0 * t
        for ramp in channel.ramps:
            slope, tau = ramp.change / (ramp.end - ramp.start), ramp.softness
            for knot, sign in ((ramp.start, slope), (ramp.end, -slope)):
                value = value + sign * tau * (
                    np.logaddexp(0.0, (t - knot) / tau) - np.logaddexp(0.0, -knot / tau)
                )
                rate = rate + sign / (1.0 + np.exp(-(t - knot) / tau))
        for wave in channel.waves:
            omega = 2.0 * np.pi / wave.period
            value = value + wave.amplitude * np.sin(omega * t + wave.phase)
            rate = rate + wave.amplitude * omega * np.cos(omega * t + wave.phase)
        at[name] = value, rate
    roll = at["roll"][0] + LIVELY.bank * at["heading"][1]
    angles = np.stack([at["heading"][0], at["pitch"][0], roll], axis=1)
    expected = Rotation.from_euler("ZYX", angles).as_matrix()
    np.testing.assert_allclose(LIVELY.truth(t).C_n_b, expected, atol=1e-13)


def test_height_is_the_integral_of_velocity():
    """Latitude and longitude against another integration: test_geodesy.py."""
    exact, _ = quad(
        lambda t: LIVELY.truth([t]).v_n[0, 2], 0.0, 47.3, epsabs=1e-12, epsrel=1e-12, limit=500
    )
    truth = LIVELY.truth([47.3])
    assert truth.p_o[0, 2] == pytest.approx(exact, abs=1e-10)
    assert truth.llh[0, 2] == pytest.approx(LIVELY.h_0 - exact, abs=1e-10)


def test_position_starts_at_zero_and_has_no_steps_between_segments():
    t = np.arange(1.0, 329.0)
    before, after = AUV.truth(t - 1e-9), AUV.truth(t + 1e-9)
    steps = after.p_o - before.p_o - 1e-9 * (after.v_n + before.v_n)
    assert np.abs(steps).max() < 3e-9  # the rounding of an angle
    assert np.abs(AUV.truth([0.0]).p_o).max() < 1e-9


def test_loop_is_a_circle_for_an_hour():
    t = np.linspace(0.0, 3600.0, 5001)
    rate, speed = 2.0 * np.pi / 120.0, 1.5
    circle = np.stack([np.sin(rate * t), 1.0 - np.cos(rate * t), np.zeros_like(t)], axis=1) * (
        speed / rate
    )
    # Axes that turn by tan(lat) / R per metre east do not close it: each of the 30 rounds ends
    # pi r^2 tan(lat) / R = 2.5e-4 m from where it began.
    np.testing.assert_allclose(LOOP.truth(t).p_o, circle, atol=30 * 2.6e-4)


@pytest.mark.parametrize("earth_rate", [True, False])
def test_specific_force_at_rest_holds_gravity_and_the_gyro_sees_the_earth(earth_rate):
    truth = STATIC.truth([0.0, 1800.0], earth_rate=earth_rate)
    # WGS-84 normal gravity at 32 deg by the closed formula, 5 m below the ellipsoid.
    lat = math.radians(32.0)
    gravity = (
        9.7803253359
        * (1.0 + 0.00193185265241 * math.sin(lat) ** 2)
        / math.sqrt(1.0 - 0.00669437999014 * math.sin(lat) ** 2)
        + 5.0 * 3.086e-6
    )
    np.testing.assert_allclose(truth.f_b, [[0.0, 0.0, -gravity]] * 2, atol=1e-8)
    heading = math.radians(30.0)
    north, down = 7.292115e-5 * math.cos(lat), -7.292115e-5 * math.sin(lat)
    expected = np.array([north * math.cos(heading), -north * math.sin(heading), down])
    np.testing.assert_allclose(truth.w_ib_b, [expected * earth_rate] * 2, atol=1e-18)


@pytest.mark.parametrize("earth_rate", [True, False])
def test_inertial_readings_against_newton_in_the_inertial_frame(earth_rate):
    """f = R'' - g with R the position in inertial axes, on a sphere of the local radii.

    On the equator the meridian is symmetric; eastward motion there is a circle in the inertial
    frame, so the whole of Coriolis, transport rate and centrifugal part of gravity is known.
    """
    speed = 20.0
    trajectory = Trajectory(
        duration=10.0, speed=Channel(speed), heading=Channel(math.pi / 2), lat_0=0.0, h_0=0.0
    )
    truth = trajectory.truth([3.0], earth_rate=earth_rate)
    a, w_ie, g_equator = 6378137.0, 7.292115e-5, 9.7803253359
    attraction = g_equator + w_ie**2 * a
    up = attraction - a * (w_ie + speed / a) ** 2 if earth_rate else g_equator
    np.testing.assert_allclose(truth.f_b[0], [0.0, 0.0, -up], atol=1e-9)
    turn = w_ie + speed / a if earth_rate else 0.0  # about north, which is to the left
    np.testing.assert_allclose(truth.w_ib_b[0], [0.0, -turn, 0.0], atol=1e-15)


def test_specific_force_and_rate_of_a_general_motion():
    """The equations once more, with numpy and from the other fields of the truth."""
    t = inner(LIVELY)
    truth = LIVELY.truth(t)
    flat = LIVELY.truth(t, earth_rate=False)
    e2 = 0.0066943799901413165
    lat, _, h = truth.llh.T
    s = 1.0 - e2 * np.sin(lat) ** 2
    R_E = 6378137.0 / np.sqrt(s)
    R_N = R_E * (1.0 - e2) / s
    zero = np.zeros_like(lat)
    w_ie = 7.292115e-5 * np.stack([np.cos(lat), zero, -np.sin(lat)], axis=1)
    north, east, _ = truth.v_n.T
    w_en = np.stack([east / (R_E + h), -north / (R_N + h), -east * np.tan(lat) / (R_E + h)], axis=1)
    coriolis = np.einsum("kji,kj->ki", truth.C_n_b, np.cross(2.0 * w_ie + w_en, truth.v_n))
    w_in = np.einsum("kji,kj->ki", truth.C_n_b, w_ie + w_en)
    assert np.abs(coriolis).max() > 1e-4
    np.testing.assert_allclose(truth.f_b - flat.f_b, coriolis, atol=1e-13)
    np.testing.assert_allclose(truth.w_ib_b - truth.w_nb_b, w_in, atol=1e-15)
    np.testing.assert_array_equal(flat.w_ib_b, truth.w_nb_b)
    # Without the Earth's rotation, what is left is acceleration and gravity along down.
    gravity = truth.a_n - np.einsum("kij,kj->ki", truth.C_n_b, flat.f_b)
    np.testing.assert_allclose(gravity[:, :2], 0.0, atol=1e-14)
    assert gravity[:, 2] == pytest.approx(9.8027, abs=2e-3)
    assert np.polyfit(h, gravity[:, 2], 1)[0] == pytest.approx(-3.086e-6, rel=0.01)


@pytest.mark.parametrize("name", [*BASELINE, "auv"])
def test_trajectories_are_those_of_an_auv(name):
    trajectory = trajectory_named(name)
    t = np.arange(0.0, trajectory.duration, 0.05)
    truth = trajectory.truth(t)
    speed = np.linalg.norm(truth.v_n, axis=1)
    pitch = np.arcsin(-truth.C_n_b[:, 2, 0])
    roll = np.arctan2(truth.C_n_b[:, 2, 1], truth.C_n_b[:, 2, 2])
    assert speed.min() > 0.5
    assert speed.max() < 3.0
    assert np.degrees(np.abs(truth.w_nb_b)).max() < 20.0
    assert np.degrees(np.abs(pitch)).max() < 35.0
    assert np.degrees(np.abs(roll)).max() < 10.0
    assert np.abs(truth.a_n).max() < 0.5
    assert (trajectory.h_0 - truth.p_o[:, 2]).max() < -1.0  # under water


def test_four_baselines_of_at_least_400_s():
    assert list(BASELINE) == ["straight", "circle", "lawn_mower", "spiral_dive"]
    assert min(trajectory.duration for trajectory in BASELINE.values()) >= 400.0


def test_auv_starts_as_published_and_moves_in_all_axes():
    truth = AUV.truth(np.arange(0.0, 330.0, 0.1))
    assert (AUV.duration, AUV.h_0) == (330.0, -5.0)
    assert np.degrees([AUV.lat_0, AUV.lon_0]) == pytest.approx([32.0, 34.0])
    np.testing.assert_allclose(truth.v_n[0], [1.0, 0.0, 0.0], atol=1e-12)
    speed = np.linalg.norm(truth.v_n, axis=1)
    assert np.median(speed) == pytest.approx(1.0, abs=1e-3)
    assert np.ptp(truth.p_o, axis=0).min() > 10.0
    assert np.ptp(np.unwrap(np.arctan2(truth.v_n[:, 1], truth.v_n[:, 0]))) > np.pi


def test_smoothness_of_the_readings():
    """Between 100 Hz samples the readings of the steepest manoeuvre change by very little."""
    for trajectory in MOVING.values():
        truth = trajectory.truth(np.arange(0.0, min(trajectory.duration, 420.0), 0.01))
        assert np.abs(np.diff(truth.f_b, axis=0)).max() < 0.02
        assert np.abs(np.diff(truth.w_ib_b, n=2, axis=0)).max() < 1e-4


def test_names():
    assert set(NAMES) == {*BASELINE, "auv", "static", "loop"}
    with pytest.raises(ValueError, match=r"unknown trajectory 'square'; known: straight, circle"):
        trajectory_named("square")


@pytest.mark.parametrize("t", [-0.1, 330.1, math.nan])
def test_time_outside_the_trajectory_is_refused(t):
    with pytest.raises(ValueError, match=r"time must be within 0 to 330 s, got"):
        AUV.truth([1.0, t])


def test_truth_accepts_a_read_only_time_and_keeps_its_own():
    t = np.array([1.0, 2.0])
    t.setflags(write=False)
    truth = AUV.truth(t)
    assert truth.t is not t
    assert {field.name for field in dataclasses.fields(truth)} >= {"llh", "p_o", "v_n", "C_n_b"}
