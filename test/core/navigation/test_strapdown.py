"""Mechanisation: an hour without errors, its order in the step, and python-ins on one mission."""

import dataclasses
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from oracle import skew, wgs84
from places import position, put
from pyins import strapdown as pyins_strapdown
from pyins import transform
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from insdvl.navigation.events import NS
from insdvl.navigation.filter import Filter
from insdvl.navigation.parameters import (
    FilterParameters,
    ImuParameters,
    OriginParameters,
)
from insdvl.navigation.prediction.kept import Kept
from insdvl.simulation.initial_errors import P_0
from insdvl.simulation.sensors.imu import ideal_imu
from insdvl.simulation.trajectories import AUV, LOOP, STATIC, Channel, Ramp, Trajectory, Wave
from insdvl.timeline.recorded import fold_arrays

# Strong motion in every axis, faster than any vehicle here.
VIGOROUS = Trajectory(
    duration=20.0,
    speed=Channel(3.0, waves=(Wave(1.0, 3.0),)),
    heading=Channel(0.5, slope=0.3, ramps=(Ramp(5.0, 8.0, -2.0, 0.5),), waves=(Wave(0.2, 2.5),)),
    pitch=Channel(0.1, waves=(Wave(0.3, 2.0, 1.0),)),
    roll=Channel(0.2, waves=(Wave(0.4, 1.7),)),
    pivot=0.5,
)


EQUAL_SAMPLES = ImuParameters(frozen_samples=0)


def filter_on(trajectory):
    return Filter(
        FilterParameters(
            frame_convention="ned",
            imu=EQUAL_SAMPLES,
            origin=OriginParameters(
                latitude_deg=float(np.degrees(trajectory.lat_0)),
                longitude_deg=float(np.degrees(trajectory.lon_0)),
                height=trajectory.h_0,
            ),
        )
    )


def navigate(filter_, C_n_b, v_n, f_b, w_ib_b, dt, visit, chunk=1000):
    """Predict from p = 0 over the samples; ``visit(first, states)`` sees each chunk of states."""
    state = filter_.empty()
    s = state[0]
    s["nav"]["C_n_b"], s["nav"]["v_n"] = C_n_b, v_n
    put(s["nav"], np.zeros(3))
    s["nav"]["P"][..., :15, :15], s["nav"]["time_ns"], s["nav"]["initialised"] = (
        np.eye(filter_.n),
        0,
        1,
    )
    stamps_ns = np.rint(np.arange(1, len(f_b) + 1) * dt * NS).astype(np.int64)
    kept = Kept(chunk, state.dtype)
    for first in range(0, len(f_b), chunk):
        part = slice(first, first + chunk)
        count = len(f_b[part])
        samples = f_b[part], w_ib_b[part], np.hstack([f_b[part], w_ib_b[part]])
        filter_.predict_samples(state, stamps_ns[part], *samples, 0, count, kept)
        visit(first, kept.states[:count])


def attitude_errors(C, C_true):
    """Angle (N,) between rotations (N, 3, 3) [rad], also where it is below the rounding of 1."""
    turn = np.einsum("kij,klj->kil", C, C_true)
    vector = np.stack(
        [
            turn[:, 2, 1] - turn[:, 1, 2],
            turn[:, 0, 2] - turn[:, 2, 0],
            turn[:, 1, 0] - turn[:, 0, 1],
        ]
    )
    return np.linalg.norm(vector, axis=0) / 2


def largest_errors(trajectory, dt):
    """Largest position [m], velocity [m/s] and attitude [rad] error on the whole trajectory."""
    start = trajectory.truth([0.0])
    worst = np.zeros(3)

    def visit(first, states):
        truth = trajectory.truth(t[first : first + len(states)])
        errors = (
            np.linalg.norm(position(states["nav"]) - truth.p_o, axis=1),
            np.linalg.norm(states["nav"]["v_n"] - truth.v_n, axis=1),
            attitude_errors(states["nav"]["C_n_b"], truth.C_n_b),
        )
        np.maximum(worst, [error.max() for error in errors], out=worst)

    t = np.arange(1, round(trajectory.duration / dt) + 1) * dt
    t[-1] = trajectory.duration
    f_b, w_ib_b = ideal_imu(trajectory, t, dt)
    navigate(filter_on(trajectory), start.C_n_b[0], start.v_n[0], f_b, w_ib_b, dt, visit)
    return worst


def test_static_hour_from_first_principles():
    """At rest at 32 deg an IMU feels -g and the turn of the Earth; an hour later nothing has moved.

    The readings owe nothing to the code under test: a wrong sign of g, of the Earth rate or of
    Coriolis's term moves the vehicle by kilometres.
    """
    g_n, w_ie_n, *_ = wgs84(np.radians(32.0), 0.0)
    C_n_b = Rotation.from_euler("ZYX", [120.0, 7.0, -4.0], degrees=True).as_matrix()
    f_b, w_ib_b = np.tile(-C_n_b.T @ g_n, (360_000, 1)), np.tile(C_n_b.T @ w_ie_n, (360_000, 1))
    last = []

    def visit(first, states):
        last[:] = [states[-1].copy()]

    filter_ = filter_on(dataclasses.replace(STATIC, h_0=0.0))
    navigate(filter_, C_n_b, np.zeros(3), f_b, w_ib_b, 0.01, visit)
    (s,) = last
    assert abs(position(s["nav"])).max() < 1e-3
    assert abs(s["nav"]["v_n"]).max() < 1e-6
    np.testing.assert_allclose(s["nav"]["C_n_b"], C_n_b, atol=1e-9)


@pytest.mark.long
def test_noiseless_hour_at_rest():
    """Position [m], velocity [m/s] and attitude [rad] at every sample of an hour at 100 Hz."""
    errors = largest_errors(STATIC, 0.01)
    assert (errors < (1e-3, 1e-6, 1e-9)).all(), errors


def test_noiseless_hour_on_a_loop():
    """In a turn the Earth rate cones, eps = w^2 w_ie dt^2 / 12 = 1.7e-12 rad/s.

    Mean rates alone would drift by that: through Schuler's oscillation by 2 R eps = 2e-5 m/s and
    R eps T = 4e-2 m in an hour. What is left falls with the square of the step.
    """
    coarse, fine = largest_errors(LOOP, 0.02), largest_errors(LOOP, 0.01)
    assert (fine < (1e-3, 1e-6, 1e-9)).all(), fine
    assert (np.log2(coarse / fine) > 1.8).all(), (coarse, fine)


def test_errors_fall_with_the_square_of_the_step():
    steps = (0.04, 0.02, 0.01, 0.005)
    errors = np.array([largest_errors(VIGOROUS, dt) for dt in steps])
    orders = np.log2(errors[:-1] / errors[1:])
    assert (orders > 1.8).all(), (orders, errors)
    assert (errors[2] < (0.1, 0.02, 1e-3)).all(), errors


def test_constant_rates_are_integrated_exactly_in_the_body():
    """Without Earth rate and over one long step: attitude and velocity of a helix, to rounding."""
    settings = FilterParameters(frame_convention="ned", earth_rate=False, imu=EQUAL_SAMPLES)
    filter_ = Filter(settings)
    f_b, w_ib_b, dt = np.array([1.0, -2.0, -9.0]), np.array([0.3, -0.2, 1.1]), 0.05
    C_n_b = Rotation.from_euler("ZYX", [1.0, 0.2, -0.3]).as_matrix()
    v_n, kept = np.array([1.0, 2.0, 3.0]), []
    navigate(
        filter_, C_n_b, v_n, f_b[None], w_ib_b[None], dt, lambda _, states: kept.append(states[0])
    )
    block = np.zeros((4, 4))
    block[:3, :3], block[:3, 3] = skew(w_ib_b), f_b
    moved = expm(block * dt)  # [[exp(W t), int exp(W s) f ds], [0, 1]]
    (s,) = kept
    np.testing.assert_allclose(s["nav"]["C_n_b"], C_n_b @ expm(skew(w_ib_b) * dt), atol=1e-14)
    gravity = np.array([0.0, 0.0, 9.7949])
    np.testing.assert_allclose(
        s["nav"]["v_n"], v_n + C_n_b @ moved[:3, 3] + gravity * dt, atol=1e-5
    )


CONE, SPIN = np.radians(1.0), 2.0 * np.pi  # rad, rad/s


def coning_samples(seconds, dt):
    """Mean rates (N, 3) of a body whose axis x moves on a cone, and its attitude at the end.

    With the quaternion (cos a/2, 0, sin a/2 cos st, sin a/2 sin st), a the angle of the cone, the
    rate is (-2 s sin^2 a/2, -s sin a sin st, s sin a cos st).
    """
    t = np.arange(round(seconds / dt) + 1) * dt
    angle = SPIN * t
    integral = np.sin(CONE) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rates = np.hstack([0.0 * t[1:, None], np.diff(integral, axis=0) / dt])
    rates[:, 0] = -2.0 * SPIN * np.sin(CONE / 2.0) ** 2
    return rates, Rotation.from_rotvec(CONE * np.array([0.0, np.cos(angle[-1]), np.sin(angle[-1])]))


def flat_filter():
    return Filter(FilterParameters(frame_convention="ned", earth_rate=False, imu=EQUAL_SAMPLES))


def coning_drift(seconds=60.0, dt=0.01):
    """Drift [deg/h] of the attitude under coning."""
    w_ib_b, end = coning_samples(seconds, dt)
    f_b, last = np.tile([0.0, 0.0, -9.8], (len(w_ib_b), 1)), []
    start = Rotation.from_rotvec([0.0, CONE, 0.0]).as_matrix()
    navigate(
        flat_filter(),
        start,
        np.zeros(3),
        f_b,
        w_ib_b,
        dt,
        lambda _, states: last.append(states[-1].copy()),
    )
    error = attitude_errors(last[-1]["nav"]["C_n_b"][None], end.as_matrix()[None])
    return np.degrees(error[0]) / seconds * 3600.0


def test_coning_of_a_degree_at_one_hertz_does_not_drift():
    """By pi f a^2 (2 pi f dt)^4 / 30, and what the first sample, which has none before it, leaves.

    That is 0.00012 deg/h. Mean rates alone drift by pi f a^2 (2 pi f dt)^2 / 6 = 0.13 deg/h, a FOG
    by 0.01.
    """
    turn = SPIN * 0.01
    left = np.pi * CONE**2 * (turn**4 / 30.0 + turn**2 / 6.0 * 0.01 / 60.0)
    assert coning_drift() == pytest.approx(np.degrees(left) * 3600.0, rel=0.02)
    assert coning_drift() == pytest.approx(0.00012, abs=0.00001)


def test_mean_rates_alone_drift_under_coning():
    """The readings of that test, integrated as if the axis stood still in each sample."""
    expected = np.degrees(np.pi * CONE**2 * (SPIN * 0.01) ** 2 / 6.0) * 3600.0
    w_ib_b, end = coning_samples(60.0, 0.01)
    C = Rotation.from_rotvec([0.0, CONE, 0.0])
    for w in w_ib_b:
        C = C * Rotation.from_rotvec(w * 0.01)
    drift = np.degrees((C * end.inv()).magnitude()) * 60.0
    assert drift == pytest.approx(expected, rel=0.01) == pytest.approx(0.13, abs=0.005)


def test_a_cut_sample_turns_as_the_whole_one():
    """The parts share the coning: a cut changes the attitude by rounding."""
    w_ib_b, _ = coning_samples(1.0, 0.01)
    f_b = np.tile([0.0, 0.0, -9.8], (len(w_ib_b), 1))
    readings = np.hstack([f_b, 40.0 * w_ib_b])
    w_ib_b = 40.0 * w_ib_b
    filter_ = flat_filter()
    whole = filter_.empty()
    kept = Kept(len(w_ib_b), whole.dtype)
    whole[0]["nav"]["time_ns"], whole[0]["nav"]["initialised"] = 0, 1
    whole[0]["nav"]["C_n_b"] = np.eye(3)
    cut = whole.copy()
    stamps_ns = np.arange(1, len(w_ib_b) + 1) * (NS // 100)
    for k, stamp in enumerate(stamps_ns):
        arrays = stamps_ns, f_b, w_ib_b, readings, k, k + 1, kept
        filter_.predict_samples(whole, *arrays)
        for at in (stamp - 7_654_321, stamp - 1_000_000):
            filter_.predict_part(cut, stamp, f_b[k], w_ib_b[k], readings[k], at)
        filter_.predict_samples(cut, *arrays)
    np.testing.assert_allclose(cut[0]["nav"]["C_n_b"], whole[0]["nav"]["C_n_b"], atol=1e-14)


def test_a_gap_has_no_coning():
    """What the axis did in between is not known."""
    filter_, w = flat_filter(), np.array([[0.3, 0.0, 0.0], [0.0, 0.3, 0.0]])
    f_b = np.tile([0.0, 0.0, -9.8], (2, 1))
    for interval_ns, coned in ((NS // 100, True), (NS // 5, False)):
        state = filter_.empty()
        kept = Kept(2, state.dtype)
        state[0]["nav"]["time_ns"], state[0]["nav"]["initialised"] = 0, 1
        state[0]["nav"]["C_n_b"] = np.eye(3)
        stamps_ns = np.array([NS // 100, NS // 100 + interval_ns])
        filter_.predict_samples(state, stamps_ns, f_b, w, np.hstack([f_b, w]), 0, 2, kept)
        dt = interval_ns / NS
        turn = Rotation.from_matrix(kept.at(0)["nav"]["C_n_b"].T @ kept.at(1)["nav"]["C_n_b"])
        expected = w[1] * dt + coned * np.cross(w[0], w[1]) * dt**2 / 12.0
        np.testing.assert_allclose(turn.as_rotvec(), expected, atol=1e-14)


def test_turn_rate_of_the_state_is_against_the_navigation_frame():
    trajectory, dt = VIGOROUS, 0.005
    start = trajectory.truth([0.0])
    t = np.arange(1, 1001) * dt
    f_b, w_ib_b = ideal_imu(trajectory, t, dt)

    def visit(first, states):
        middle = trajectory.truth(t[first : first + len(states)] - dt / 2)
        np.testing.assert_allclose(states["nav"]["w_nb_b"], middle.w_nb_b, atol=1e-4)

    navigate(filter_on(trajectory), start.C_n_b[0], start.v_n[0], f_b, w_ib_b, dt, visit)


def test_turn_rate_leaves_out_the_earth():
    """At rest it is zero to 1e-9, a hundred-thousandth of the Earth rate."""
    start = STATIC.truth([0.0])
    f_b, w_ib_b = ideal_imu(STATIC, np.arange(1, 101) * 0.01, 0.01)

    def visit(first, states):
        assert abs(states["nav"]["w_nb_b"]).max() < 1e-9

    navigate(filter_on(STATIC), start.C_n_b[0], start.v_n[0], f_b, w_ib_b, 0.01, visit)


def pyins_navigation(trajectory, t, f_b, w_ib_b, dt):
    """python-ins from the truth at t[0] on: velocity, attitude and (lat, lon, alt) at t[1:]."""
    start = trajectory.truth(t[:1])
    R = transform.perturb_lla(
        np.array([np.degrees(trajectory.lat_0), np.degrees(trajectory.lon_0), trajectory.h_0]),
        start.p_o[0],
    )
    heading, pitch, roll = Rotation.from_matrix(start.C_n_b[0]).as_euler("ZYX", degrees=True)
    pva = pd.Series(
        [*R, *start.v_n[0], roll, pitch, heading],
        index=["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"],
    )
    imu = pd.DataFrame(
        np.hstack([w_ib_b, f_b]) * dt,
        index=t,
        columns=["gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z"],
    )
    increments = pyins_strapdown.compute_increments_from_imu(imu, "increment")
    return pyins_strapdown.Integrator(pva).integrate(increments).iloc[1:]


def test_against_python_ins_on_the_auv_mission():
    """Same readings, two programs. python-ins corrects for coning: readings are at 200 Hz."""
    dt = 0.005
    trajectory = dataclasses.replace(AUV, h_0=0.0)  # their gravity gradient leaves out flattening
    t = np.arange(1, round(330 / dt) + 1) * dt
    t[-1] = 330.0
    f_b, w_ib_b = ideal_imu(trajectory, t, dt)
    theirs = pyins_navigation(trajectory, t, f_b, w_ib_b, dt)
    start = trajectory.truth(t[:1])
    parameters = dataclasses.replace(
        filter_on(trajectory).parameters,
        initial=replace(
            P_0,
            position=tuple(map(float, start.p_o[0])),
            velocity=tuple(map(float, start.v_n[0])),
            velocity_frame="nav",
            rpy=tuple(map(float, Rotation.from_matrix(start.C_n_b[0]).as_euler("xyz"))),
        ),
    )
    every = 200
    n = 20_000  # 100 s, which bounds the memory
    stamps_ns = np.rint(t[:n] * NS).astype(np.int64)
    result = fold_arrays(parameters, stamps_ns, f_b[:n], w_ib_b[:n], [])
    ours, theirs = result.states[1:][::every], theirs.iloc[: n - 1 : every]
    np.testing.assert_allclose(ours["nav"]["v_n"], theirs[["VN", "VE", "VD"]], atol=1e-4)
    C = Rotation.from_euler("ZYX", theirs[["heading", "pitch", "roll"]], degrees=True).as_matrix()
    assert attitude_errors(ours["nav"]["C_n_b"], C).max() < 1e-6
    origin = [np.degrees(trajectory.lat_0), np.degrees(trajectory.lon_0), trajectory.h_0]
    p_n = transform.lla_to_ned(theirs[["lat", "lon", "alt"]], origin)
    np.testing.assert_allclose(position(ours["nav"])[:, :2], np.asarray(p_n)[:, :2], atol=1e-2)
    np.testing.assert_allclose(ours["nav"]["llh"][:, 2], theirs["alt"], atol=1e-2)
