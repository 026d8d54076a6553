"""Odometry: covariances of ordinary errors, body axes, conventions, an IMU off base_link."""

from dataclasses import replace

import numpy as np
import pytest
from oracle import skew
from places import moved
from scipy.spatial.transform import Rotation

from insdvl.navigation.coordinates import from_ordinary_errors
from insdvl.navigation.error_state import ATTITUDE, GYROSCOPE_BIAS, POSITION, VELOCITY
from insdvl.navigation.events import NS
from insdvl.navigation.filter import Filter
from insdvl.navigation.geometry import earth, odom
from insdvl.navigation.geometry.earth import displacements
from insdvl.navigation.geometry.frames import CONVENTIONS, ENU
from insdvl.navigation.odometry import biases, odometry
from insdvl.navigation.parameters import (
    FilterParameters,
    ImuParameters,
    OriginParameters,
    ProcessNoiseParameters,
)
from insdvl.simulation.initial_errors import P_0
from insdvl.simulation.trajectories import Channel, Ramp, Trajectory
from insdvl.timeline.recorded import fold_arrays

ORIGIN = np.array([np.radians(60.0), np.radians(-179.9), -5.0])
P_N = np.array([6000.0, -20_000.0, 5.0])  # far enough for odom's axes to differ from north
R_LLH = moved(ORIGIN, [5990.0, -20_009.0, 2.0])  # reference of the position error
ARM, MOUNT = (0.7, -0.3, 0.5), (0.2, -0.1, 1.3)


def filter_of(model, convention="ned", noise="per_sample", variance=0.0):
    """The same vehicle in either convention: arm and mount are given in the stream's axes."""
    arm, mount = np.array(ARM), Rotation.from_euler("xyz", MOUNT).as_matrix()
    if convention == "enu":
        arm, mount = ENU.body @ arm, ENU.body @ mount @ ENU.body
    return Filter(
        FilterParameters(
            frame_convention=convention,
            error_state=model,
            imu=ImuParameters(
                lever_arm=tuple(map(float, arm)),
                mount=tuple(map(float, Rotation.from_matrix(mount).as_euler("xyz"))),
            ),
            process_noise=ProcessNoiseParameters(
                convention=noise, gyroscope_variance=(variance, 2 * variance, 3 * variance)
            ),
        )
    )


def nominal_and_covariance():
    """A state, and a full covariance of ordinary errors with the velocity in NED."""
    rng = np.random.default_rng(80)
    nominal = {
        "C_n_b": Rotation.from_rotvec([0.4, -0.7, 1.9]).as_matrix(),
        "v_n": np.array([1.2, -0.6, 0.3]),
        "llh": moved(ORIGIN, P_N),
        "b_f": np.array([0.01, -0.02, 0.03]),
        "b_w": np.array([1e-3, 2e-3, -1e-3]),
        "w_nb_b": np.array([0.1, -0.2, 0.3]),
    }
    root = rng.standard_normal((15, 15))
    sigma = np.repeat([0.05, 0.02, 1e-2, 1e-3, 0.5], 3)
    return nominal, root @ root.T * np.outer(sigma, sigma)


def states_with(filter_, nominal, P):
    """The record of that state, with P of ordinary errors in the model's coordinates."""
    states = filter_.empty()
    for name, value in nominal.items():
        states[0]["nav"][name] = value
    nav = states[0]["nav"]
    nav["lat_0"], nav["lon_0"], nav["h_0"] = ORIGIN
    nav["llh"], nav["llh_r"] = nominal["llh"], R_LLH
    T = from_ordinary_errors(
        nominal["C_n_b"],
        nominal["v_n"],
        displacements(R_LLH, nominal["llh"]),
        invariant=filter_.vehicle.invariant,
        velocity_frame="nav",
        n=filter_.n,
    )
    states[0]["nav"]["P"][:15, :15] = T @ P @ T.T
    states[0]["nav"]["time_ns"], states[0]["nav"]["initialised"] = 123, 1
    return states


def with_arc(J, P, nominal, nav):
    """Covariance (6, 6) of the pose by its derivatives J (6, 15), on an arc: for `invariant`.

    The base lies at R_h x instead of x + h e_D x x, and so by -(1 - cos h) x short of it.
    """
    arm, slope = nominal["C_n_b"] @ ARM, np.empty(2)
    base = moved(nominal["llh"], -arm)
    jacobian, _ = odom.jacobian(base, ORIGIN)
    odom.convergence_slope(slope, base, ORIGIN)

    def pose(d_n):
        return np.concatenate([nav @ jacobian @ d_n, nav[:, 2] * (slope @ d_n[:2])])

    path = (displacements(R_LLH, nominal["llh"]) - arm) * [1.0, 1.0, 0.0]
    beside = np.cross([0.0, 0.0, 1.0], path)
    h = np.sqrt(P[5, 5]) * np.linspace(-8.0, 8.0, 4001)
    weights = np.exp(-(h**2) / P[5, 5] / 2.0)
    weights /= weights.sum()
    line = weights @ (h * np.sin(h)) / P[5, 5]
    J = J.copy()
    J[:, 5] -= (1.0 - line) * pose(beside)
    return (
        J @ P @ J.T
        + weights @ (np.sin(h) - line * h) ** 2 * np.outer(pose(beside), pose(beside))
        + weights @ (1.0 - np.cos(h)) ** 2 * np.outer(pose(path), pose(path))
    )


def perturbed(nominal, x):
    turn = Rotation.from_rotvec(x[ATTITUDE]).as_matrix()
    return {
        "C_n_b": turn @ nominal["C_n_b"],
        "v_n": nominal["v_n"] + x[VELOCITY],
        "llh": moved(nominal["llh"], x[POSITION]),
        "w_nb_b": nominal["w_nb_b"] - x[GYROSCOPE_BIAS],
    }


def rotation_of(out):
    return Rotation.from_quat(out.quaternion_xyzw).as_matrix()


@pytest.mark.parametrize("convention", ["enu", "ned"])
@pytest.mark.parametrize("model", ["invariant", "ned"])
def test_covariances_are_of_the_numbers_published(model, convention):
    """Derivatives of the published pose and twist by ordinary errors, whichever model runs."""
    filter_ = filter_of(model, convention)
    nominal, P = nominal_and_covariance()
    out = odometry(filter_, states_with(filter_, nominal, P), 0)

    def published(x):
        other = odometry(filter_, states_with(filter_, perturbed(nominal, x), P), 0)
        turn = Rotation.from_matrix(rotation_of(other) @ rotation_of(out).T).as_rotvec()
        return np.concatenate([other.position, turn, other.twist_linear, other.twist_angular])

    J = np.zeros((12, 15))
    for i in range(15):
        x, step = np.zeros(15), 1.0 if i >= POSITION.start else 1e-3  # longitude is good to 1e-9 m
        x[i] = step
        J[:, i] = (published(x) - published(-x)) / (2.0 * step)
    # The turn rate of the record is that of the last sample, minus the bias.
    expected = J @ P @ J.T
    if model == "invariant":
        expected[:6, :6] = with_arc(J[:6], P, nominal, CONVENTIONS[convention].nav)
    np.testing.assert_allclose(out.pose_covariance, expected[:6, :6], rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(out.twist_covariance, expected[6:, 6:], rtol=1e-5, atol=1e-9)
    for covariance in (out.pose_covariance, out.twist_covariance):
        np.testing.assert_array_equal(covariance, covariance.T)


@pytest.mark.parametrize("heading_std_deg", [5.0, 60.0])
def test_the_position_covariance_is_the_second_moment_of_a_cloud(heading_std_deg):
    """Errors of heading, tilt and dp_i through the definition, about the published position.

    Each moment is within five of its standard errors, a few percent of it.
    """
    rng, draws = np.random.default_rng(81), 100_000
    sigma = np.array([0.02, 0.02, np.radians(heading_std_deg), 3.0, 3.0, 1.0])
    filter_ = filter_of("invariant", "ned")
    nominal, _ = nominal_and_covariance()
    nominal["llh"] = moved(R_LLH, [800.0, -600.0, 20.0])
    states = states_with(filter_, nominal, np.zeros((15, 15)))
    errors = np.r_[ATTITUDE, POSITION]
    states[0]["nav"]["P"][errors, errors] = sigma**2
    out = odometry(filter_, states, 0)

    base = moved(nominal["llh"], -nominal["C_n_b"] @ ARM)
    x_n = displacements(R_LLH, base)
    draw = sigma * rng.standard_normal((draws, 6))
    tilt, heading = draw[:, :3] * [1.0, 1.0, 0.0], draw[:, :3] * [0.0, 0.0, 1.0]
    d_n = Rotation.from_rotvec(tilt).apply(x_n) + draw[:, 3:]
    d_n = Rotation.from_rotvec(heading).apply(d_n) - x_n
    error = odom.in_odom(np.array([moved(base, d) for d in d_n]), ORIGIN)[0] - out.position
    of_pose = np.column_stack([error, draw[:, 2]])
    products = of_pose[:, :, None] * of_pose[:, None, :]
    found = out.pose_covariance[np.ix_([0, 1, 2, 5], [0, 1, 2, 5])]
    standard_error = products.std(axis=0) / np.sqrt(draws)
    assert (abs(products.mean(axis=0) - found) < 5.0 * standard_error).all()
    assert (standard_error[:2, :2].max() / products[:, :2, :2].mean(axis=0).max()) < 0.02


@pytest.mark.parametrize("convention", ["enu", "ned"])
def test_both_models_publish_the_same(convention):
    """As long as the heading is so certain that an arc is a line."""
    nominal, P = nominal_and_covariance()
    outputs = []
    for model in ("invariant", "ned"):
        filter_ = filter_of(model, convention, variance=1e-4)
        outputs.append(odometry(filter_, states_with(filter_, nominal, 1e-8 * P), 0))
    one, other = outputs
    np.testing.assert_array_equal(one.twist_linear, other.twist_linear)
    for name in ("pose_covariance", "twist_covariance"):
        found, expected = getattr(one, name), getattr(other, name)
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-9 * abs(expected).max())


def test_twist_is_of_base_link_in_body_axes():
    filter_ = filter_of("invariant")
    nominal, P = nominal_and_covariance()
    out = odometry(filter_, states_with(filter_, nominal, P), 0)
    C, w_nb_b = nominal["C_n_b"], nominal["w_nb_b"]
    np.testing.assert_allclose(out.twist_linear, C.T @ nominal["v_n"] - np.cross(w_nb_b, ARM))
    np.testing.assert_allclose(out.twist_angular, w_nb_b)
    base = moved(nominal["llh"], -C @ ARM)
    position, gamma = odom.in_odom(base, ORIGIN)
    np.testing.assert_array_equal(out.place, base)
    np.testing.assert_allclose(out.position, position, rtol=1e-12)
    np.testing.assert_allclose(rotation_of(out), odom.turned(C, gamma), atol=1e-15)
    assert out.stamp_ns == 123


def test_conventions_are_the_same_state():
    nominal, P = nominal_and_covariance()
    out = {}
    for convention in ("enu", "ned"):
        filter_ = filter_of("invariant", convention, variance=1e-4)
        out[convention] = odometry(filter_, states_with(filter_, nominal, P), 0)
    enu, ned, nav, body = out["enu"], out["ned"], ENU.nav, ENU.body
    np.testing.assert_allclose(enu.position, nav @ ned.position)
    np.testing.assert_allclose(rotation_of(enu), nav @ rotation_of(ned) @ body, atol=1e-15)
    np.testing.assert_allclose(enu.twist_linear, body @ ned.twist_linear)
    np.testing.assert_allclose(enu.twist_angular, body @ ned.twist_angular)
    both_nav, both_body = np.kron(np.eye(2), nav), np.kron(np.eye(2), body)
    np.testing.assert_allclose(
        enu.pose_covariance, both_nav @ ned.pose_covariance @ both_nav.T, rtol=1e-9, atol=1e-15
    )
    np.testing.assert_allclose(
        enu.twist_covariance, both_body @ ned.twist_covariance @ both_body.T, rtol=1e-9, atol=1e-15
    )


def test_the_turn_rate_has_the_noise_of_its_sample():
    """Per sample q; as a density q, 100 Hz make it 100 q. The arm carries it into the velocity."""
    nominal, P = nominal_and_covariance()
    C_b_i = Rotation.from_euler("xyz", MOUNT).as_matrix()
    Q_w = C_b_i @ np.diag([1e-4, 2e-4, 3e-4]) @ C_b_i.T
    arm = skew(np.array(ARM))
    for noise, factor in (("per_sample", 1.0), ("density", 100.0)):
        without = filter_of("invariant", noise=noise)
        with_noise = filter_of("invariant", noise=noise, variance=1e-4)
        quiet = odometry(without, states_with(without, nominal, P), 0).twist_covariance
        loud = odometry(with_noise, states_with(with_noise, nominal, P), 0).twist_covariance
        added = loud - quiet
        np.testing.assert_allclose(added[3:, 3:], factor * Q_w, atol=1e-12)
        np.testing.assert_allclose(added[:3, :3], factor * arm @ Q_w @ arm.T, atol=1e-12)


@pytest.mark.parametrize("convention", ["enu", "ned"])
def test_biases_are_in_the_axes_of_the_sensor(convention):
    filter_ = filter_of("invariant", convention)
    nominal, P = nominal_and_covariance()
    out = biases(filter_, states_with(filter_, nominal, P)[0])
    to_sensor = Rotation.from_euler("xyz", MOUNT).as_matrix().T
    if convention == "enu":
        to_sensor = ENU.body @ to_sensor
    np.testing.assert_allclose(out.accelerometer, to_sensor @ nominal["b_f"])
    np.testing.assert_allclose(out.gyroscope, to_sensor @ nominal["b_w"])
    np.testing.assert_allclose(
        out.accelerometer_covariance, to_sensor @ P[6:9, 6:9] @ to_sensor.T, atol=1e-15
    )
    np.testing.assert_allclose(
        out.gyroscope_covariance, to_sensor @ P[9:12, 9:12] @ to_sensor.T, atol=1e-15
    )


# It turns from the start, at a constant rate there; then in all axes.
TURNING = Trajectory(
    duration=40.0,
    speed=Channel(1.5, ramps=(Ramp(15.0, 18.0, 0.6),)),
    heading=Channel(0.4, slope=0.2, ramps=(Ramp(12.0, 25.0, -3.0),)),
    pitch=Channel(ramps=(Ramp(14.0, 17.0, 0.3), Ramp(25.0, 30.0, -0.5))),
    roll=Channel(0.1, ramps=(Ramp(16.0, 20.0, -0.4),)),
)


def readings(t, dt, arm, mount):
    """Mean readings, in IMU axes, of an IMU at a place of the vehicle: rigid-body kinematics."""
    nodes, weights = np.polynomial.legendre.leggauss(3)
    times = (t[:, None] + dt / 2 * (nodes - 1.0)).ravel()
    truth = TURNING.truth(times)
    h = 1e-3
    later, earlier = (TURNING.truth(times + s * h).w_ib_b for s in (1.0, -1.0))
    w_dot, w = (later - earlier) / (2 * h), truth.w_ib_b
    f_b = truth.f_b + np.cross(w_dot, arm) + np.cross(w, np.cross(w, arm))
    down = truth.C_n_b @ arm  # gravity is stronger where the IMU is deeper
    for k in range(len(times)):
        lat, _, height = truth.llh[k]
        change = earth.gravity(lat, height - down[k, 2]) - earth.gravity(lat, height)
        f_b[k] -= truth.C_n_b[k, 2] * change

    def mean(values):
        return np.einsum("j,ijk->ik", weights / 2, values.reshape(-1, 3, 3)) @ mount

    return mean(f_b), mean(w)


def navigated(arm, mount_rpy, t, dt):
    mount = Rotation.from_euler("xyz", mount_rpy).as_matrix()
    f_i, w_i = readings(t, dt, np.array(arm), mount)
    start = TURNING.truth(t[:1])
    parameters = FilterParameters(
        frame_convention="ned",
        imu=ImuParameters(lever_arm=arm, mount=mount_rpy),
        initial=replace(
            P_0,
            position=tuple(map(float, start.p_o[0])),
            rpy=tuple(map(float, Rotation.from_matrix(start.C_n_b[0]).as_euler("xyz"))),
            velocity=tuple(map(float, start.C_n_b[0].T @ start.v_n[0])),
        ),
        origin=OriginParameters(latitude_deg=32.0, height=TURNING.h_0),
    )
    result = fold_arrays(parameters, np.rint(t * NS).astype(np.int64), f_i, w_i, [])
    return [odometry(result.filter, result.states, k) for k in range(0, len(t), 50)]


def test_an_imu_off_base_link_navigates_base_link():
    """Turned and 0.9 m away, without noise: the odometry of an IMU at base_link.

    The start knows the arm's velocity from a rate that has the Earth's in it, 7e-5 rad/s. North and
    down are those of the IMU's place, 0.9 m / R = 1.4e-7 rad from those of base_link.
    """
    dt = 0.01
    t = np.arange(1, 3951) * dt
    there = navigated((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), t, dt)
    here = navigated(ARM, MOUNT, t, dt)
    truth = TURNING.truth(t[::50])
    for k, (one, other) in enumerate(zip(there, here, strict=True)):
        np.testing.assert_allclose(one.position, truth.p_o[k], atol=5e-3)
        np.testing.assert_allclose(other.position, one.position, atol=5e-3)
        np.testing.assert_allclose(other.twist_linear, one.twist_linear, atol=5e-4)
        np.testing.assert_allclose(other.quaternion_xyzw, one.quaternion_xyzw, atol=5e-7)
        if k:
            np.testing.assert_allclose(other.twist_angular, one.twist_angular, atol=1e-6)
