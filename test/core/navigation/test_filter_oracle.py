"""The filter against a dense one, and properties of its covariance over whole missions."""

import dataclasses
from dataclasses import replace
from itertools import product

import numpy as np
import oracle
import pytest
from records import P15
from scipy.spatial.transform import Rotation

from insdvl.navigation.events import NS, ProcessNoise
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import (
    DvlParameters,
    FilterParameters,
    GateParameters,
    ImuParameters,
    OriginParameters,
    ProcessNoiseParameters,
)
from insdvl.simulation.initial_errors import P_0
from insdvl.simulation.sensors.imu import ideal_imu
from insdvl.simulation.trajectories import Channel, Ramp, Trajectory, Wave
from insdvl.studies.faults.soak import steps
from insdvl.timeline.recorded import fold_arrays

# Motion in every axis, somewhere in the south.
TRAJECTORY = Trajectory(
    duration=30.0,
    speed=Channel(1.5, waves=(Wave(0.5, 9.0),)),
    heading=Channel(0.5, slope=0.05, ramps=(Ramp(8.0, 12.0, 1.5),), waves=(Wave(0.1, 4.0),)),
    pitch=Channel(0.1, waves=(Wave(0.2, 7.0, 1.0),)),
    roll=Channel(-0.1, waves=(Wave(0.15, 5.0),)),
    pivot=0.4,
    lat_0=np.radians(-41.0),
    h_0=-30.0,
)
IMU_MOUNT, IMU_ARM = (0.1, -0.4, 2.0), (0.4, -0.1, 0.2)
DVL_MOUNT, DVL_ARM = (0.05, 0.1, -0.8), (-0.9, 0.3, 0.6)


def matrix(rpy):
    return Rotation.from_euler("xyz", rpy).as_matrix()


def parameters_of(model, convention, bias_model, *, rate=100.0, arms=True, **changes):
    start = TRAJECTORY.truth([0.0])
    roll_pitch_yaw = Rotation.from_matrix(start.C_n_b[0]).as_euler("xyz")
    roll_pitch_yaw += (0.004, -0.006, 0.02)
    values = {
        "frame_convention": "ned",
        "error_state": model,
        "imu": ImuParameters(rate=rate, mount=IMU_MOUNT, lever_arm=IMU_ARM)
        if arms
        else ImuParameters(rate=rate),
        "dvl": DvlParameters(
            mount=DVL_MOUNT if arms else (0.0, 0.0, 0.0),
            lever_arm=DVL_ARM if arms else (0.0, 0.0, 0.0),
            noise_std=(0.05, 0.06, 0.07),
            bias_model=bias_model,
            bias_std=(0.03, 0.04, 0.05),
            bias_time_constant=7.0,
        ),
        "process_noise": ProcessNoiseParameters(
            source="oracle",
            convention=convention,
            accelerometer_bias_walk=1e-6,
            gyroscope_bias_walk=1e-9,
        ),
        "initial": replace(
            P_0,
            rpy=tuple(map(float, roll_pitch_yaw)),
            velocity=(1.6, 0.1, -0.05),
            velocity_std=0.1,
            accelerometer_bias_std=0.02,
            gyroscope_bias_std=1e-3,
        ),
        "origin": OriginParameters(latitude_deg=-41.0, longitude_deg=34.0, height=-30.0),
        "q_timeout": 60.0,
    }
    return FilterParameters(**{**values, **changes})


def dense_filter(parameters, w_ib_b):
    """The oracle at the first sample, whose turn rate is given in base_link axes."""
    initial, invariant = parameters.initial, parameters.error_state == "invariant"
    n = 15 if parameters.dvl.bias_model == "none" else 18
    assert not np.any(initial.position)
    where = parameters.origin
    angles = np.radians([where.latitude_deg, where.longitude_deg])
    origin = np.array([*angles, where.height])
    C, l_imu = matrix(initial.rpy), np.array(parameters.imu.lever_arm)
    dense = oracle.DenseFilter(
        invariant=invariant,
        C=C,
        v=np.zeros(3),
        p=oracle.gone(origin, C @ l_imu),
        r=origin,
        P=np.zeros((n, n)),
        eps_f=parameters.process_noise.accelerometer_bias_walk,
        eps_w=parameters.process_noise.gyroscope_bias_walk,
        C_b_d=matrix(parameters.dvl.mount),
        l_b=np.array(parameters.dvl.lever_arm) - l_imu,
        dvl_std=np.array(parameters.dvl.bias_std),
        dvl_time_constant=parameters.dvl.bias_time_constant,
        gate_probability=parameters.gate.probability,
    )
    # The arm moves at the rate of the first sample, with its bias and noise.
    dense.v = C @ np.array(initial.velocity)
    _, w_ie, W_v = dense.earth()
    w_nb = w_ib_b - C.T @ (w_ie + W_v @ dense.v)
    dense.v = dense.v + C @ np.cross(w_nb, l_imu)
    sigmas = np.concatenate(
        [
            np.full(3, initial.velocity_std),
            [initial.tilt_std, initial.tilt_std, initial.heading_std],
            np.full(3, initial.accelerometer_bias_std),
            np.full(3, initial.gyroscope_bias_std),
            np.full(3, initial.position_std),
            parameters.dvl.bias_std[: n - 15],
        ]
    )
    T = np.eye(n)  # v = C v_b: dv = C dv_b - [v x] psi, and p_imu = p + C l
    T[oracle.V, oracle.V], T[oracle.V, oracle.A] = C, -oracle.skew(dense.v)
    T[oracle.P, oracle.A] = -oracle.skew(C @ l_imu)
    T[oracle.V, oracle.W] = C @ oracle.skew(l_imu)
    T = dense.coordinates(dense.v, oracle.metres(dense.r, dense.p)) @ T
    dense.P = T @ np.diag(sigmas**2) @ T.T
    noise = parameters.process_noise
    variance = np.array(noise.gyroscope_variance) * (
        1.0 if noise.convention == "per_sample" else parameters.imu.rate
    )
    C_b_i, arm = matrix(parameters.imu.mount), T[oracle.V, oracle.W]
    dense.P[oracle.V, oracle.V] += arm @ C_b_i @ np.diag(variance) @ C_b_i.T @ arm.T
    return dense


def recording():
    """Stamps, samples in IMU axes and events of a mission with everything in it."""
    rng, rate = np.random.default_rng(50), 100.0
    t = np.arange(1, round(TRAJECTORY.duration * rate) + 1) / rate
    stamps_ns = np.rint(t * NS).astype(np.int64)
    t[-1] = TRAJECTORY.duration
    f_b, w_ib_b = ideal_imu(TRAJECTORY, t, 1.0 / rate)
    f_b = f_b + rng.normal(0.02, 0.05, f_b.shape)
    w_ib_b = w_ib_b + rng.normal(1e-3, 0.005, w_ib_b.shape)
    C_b_i, C_b_d = matrix(IMU_MOUNT), matrix(DVL_MOUNT)
    # Pings between the stamps of the samples and on them, and one outlier.
    ping_ns = np.sort(np.r_[np.arange(1, 30) * NS + 3_700_000, np.arange(1, 6) * 5 * NS + NS // 2])
    truth = TRAJECTORY.truth(ping_ns / NS)
    v_b = np.einsum("kji,kj->ki", truth.C_n_b, truth.v_n) + np.cross(truth.w_nb_b, DVL_ARM)
    v_d = v_b @ C_b_d + rng.normal(0.0, 0.06, v_b.shape)
    v_d[12] += (2.0, -1.0, 0.5)
    Q_f, Q_w = np.diag([4e-3, 1e-3, 2e-3]), np.diag([3e-5, 1e-5, 2e-5])
    Q_f[0, 1] = Q_f[1, 0] = 1.5e-3
    Q_w[1, 2] = Q_w[2, 1] = -0.9e-5
    R = np.array([[4e-3, 1e-3, 0.0], [1e-3, 5e-3, -5e-4], [0.0, -5e-4, 3e-3]])
    events = [
        ProcessNoise(int(stamps_ns[0]), Q_f, Q_w),
        ProcessNoise(11 * NS + 1_234_567, 3.0 * Q_f, 2.0 * Q_w),
        *(
            Dvl(int(ns), v, R if k % 2 else None)
            for k, (ns, v) in enumerate(zip(ping_ns, v_d, strict=True))
        ),
    ]
    return stamps_ns, f_b @ C_b_i, w_ib_b @ C_b_i, sorted(events, key=lambda e: e.stamp_ns)


def run_dense(dense, parameters, stamps_ns, f_i, w_i, events):
    C_b_i = matrix(parameters.imu.mount)
    R_default = np.diag(np.square(parameters.dvl.noise_std))

    def translate(event):
        if isinstance(event, Dvl):
            return event.stamp_ns, "dvl", event.v_d, R_default if event.R is None else event.R
        return event.stamp_ns, "Q", C_b_i @ event.Q_f @ C_b_i.T, C_b_i @ event.Q_w @ C_b_i.T

    per_sample = parameters.process_noise.convention == "per_sample"
    return oracle.run(
        dense,
        stamps_ns,
        f_i @ C_b_i.T,
        w_i @ C_b_i.T,
        [translate(event) for event in events],
        round(parameters.dvl.gyro_average * NS),
        1.0 / parameters.imu.rate if per_sample else 1.0,
        parameters.imu.rate,
    )


@pytest.mark.parametrize(
    ("model", "convention", "bias_model"),
    [
        # Each pair of settings is in one of the four that run every time.
        pytest.param(*settings, marks=[] if number in (1, 2, 4, 7) else [pytest.mark.long])
        for number, settings in enumerate(
            product(("invariant", "ned"), ("per_sample", "density"), ("none", "gauss_markov"))
        )
    ],
)
def test_mission_through_the_dense_filter(model, convention, bias_model):
    """Every state and covariance of the mission, with all arms, mounts and a full Q."""
    parameters = parameters_of(model, convention, bias_model)
    stamps_ns, f_i, w_i, events = recording()
    result = fold_arrays(parameters, stamps_ns, f_i, w_i, events)
    assert not result.refused
    dense = dense_filter(parameters, matrix(IMU_MOUNT) @ w_i[0])
    expected, reports = run_dense(dense, parameters, stamps_ns, f_i, w_i, events)

    for name, values in zip(
        ("C_n_b", "v_n", "llh", "b_f", "b_w", "optional"), zip(*expected, strict=True), strict=False
    ):
        found, values = result.states["nav"][name], np.array(values)
        if name == "llh":  # in metres
            found, values = (x * (6.4e6, 6.4e6, 1.0) for x in (found, values))
        if name == "optional":
            found = found[:, :3]
        np.testing.assert_allclose(found, values, atol=1e-9, err_msg=name)
    P, n = np.array([state[-1] for state in expected]), dense.n
    sigma = np.sqrt(np.einsum("kii->ki", P))
    scale = sigma[:, :, None] * sigma[:, None, :]
    np.testing.assert_allclose(result.states["nav"]["P"][:, :n, :n] / scale, P / scale, atol=1e-9)

    assert len(result.updates) == len(reports)
    for update, (innovation, S, nis, accepted) in zip(result.updates, reports, strict=True):
        np.testing.assert_allclose(update.report.innovation, innovation, atol=1e-9)
        np.testing.assert_allclose(update.report.S, S, rtol=1e-9, atol=1e-12)
        assert update.report.nis == pytest.approx(nis, rel=1e-7)
        assert update.report.accepted == accepted
    rejected = [update for update in result.updates if not update.report.accepted]
    assert [update.report.reason for update in rejected] == ["gate"]


@pytest.mark.parametrize("model", ["invariant", "ned"])
def test_covariance_against_matrix_exponentials(model):
    """Phi and Q_d without approximation differ by the second order of 0.01 s only."""
    parameters = parameters_of(model, "per_sample", "gauss_markov")
    stamps_ns, f_i, w_i, events = recording()
    stamps_ns, f_i, w_i = stamps_ns[:600], f_i[:600], w_i[:600]
    events = [event for event in events if event.stamp_ns <= stamps_ns[-1]]
    result = fold_arrays(parameters, stamps_ns, f_i, w_i, events)
    dense = dense_filter(parameters, matrix(IMU_MOUNT) @ w_i[0])
    dense.exact = True
    run_dense(dense, parameters, stamps_ns, f_i, w_i, events)
    sigma = np.sqrt(np.diagonal(dense.P))
    scale = np.outer(sigma, sigma)
    np.testing.assert_allclose(
        result.filter.covariance(result.states)[-1] / scale, dense.P / scale, atol=1e-4
    )


@pytest.mark.parametrize(
    ("model", "convention"), list(product(("invariant", "ned"), ("per_sample", "density")))
)
def test_halving_the_step_at_fixed_density_leaves_the_covariance(model, convention):
    """A sample at twice the rate has twice the variance; P then differs by the second order."""
    start_ns, pings = NS // 25, np.arange(1, 30)  # a stamp of all four rates
    start = TRAJECTORY.truth([start_ns / NS])
    truth = TRAJECTORY.truth(pings.astype(float))
    v_b = np.einsum("kji,kj->ki", truth.C_n_b, truth.v_n)
    sigmas = []
    for rate in (25.0, 50.0, 100.0, 200.0):
        parameters = parameters_of(model, convention, "gauss_markov", rate=rate, arms=False)
        initial = dataclasses.replace(
            parameters.initial,
            rpy=tuple(map(float, Rotation.from_matrix(start.C_n_b[0]).as_euler("xyz"))),
            velocity=tuple(map(float, start.C_n_b[0].T @ start.v_n[0])),
        )
        factor = rate / 100.0 if convention == "per_sample" else 0.01
        Q = ProcessNoise(start_ns, factor * 4e-3 * np.eye(3), factor * 1e-4 * np.eye(3))
        t = np.arange(round(rate * start_ns / NS), round(rate * TRAJECTORY.duration) + 1) / rate
        f_b, w_ib_b = ideal_imu(TRAJECTORY, np.minimum(t, TRAJECTORY.duration), 1.0 / rate)
        result = fold_arrays(
            dataclasses.replace(parameters, initial=initial),
            np.rint(t * NS).astype(np.int64),
            f_b,
            w_ib_b,
            [Q, *(Dvl(int(t) * NS, v) for t, v in zip(pings, v_b, strict=True))],
        )
        sigmas.append(np.sqrt(np.diagonal(result.states["nav"]["P"][-1, :15, :15])))
    changes = abs(np.diff(sigmas, axis=0) / sigmas[-1])
    assert changes[-1].max() < 1e-4, changes
    largest = changes.max(axis=1)
    assert (np.log2(largest[:-1] / largest[1:]) > 1.8).all(), largest


def test_conventions_agree_where_they_mean_the_same():
    """A variance q per sample at 100 Hz is the density q / 100."""
    stamps_ns, f_i, w_i, events = recording()
    per_sample = parameters_of("invariant", "per_sample", "none", arms=False)
    density = parameters_of("invariant", "density", "none", arms=False)
    scaled = [
        dataclasses.replace(e, Q_f=e.Q_f / 100.0, Q_w=e.Q_w / 100.0)
        if isinstance(e, ProcessNoise)
        else e
        for e in events
    ]
    one = fold_arrays(per_sample, stamps_ns, f_i, w_i, events).states[-1]
    other = fold_arrays(density, stamps_ns, f_i, w_i, scaled).states[-1]
    np.testing.assert_allclose(P15(one), P15(other), rtol=1e-9, atol=1e-18)


@pytest.mark.parametrize(
    ("model", "bias_model"),
    [("invariant", "gauss_markov"), pytest.param("ned", "none", marks=pytest.mark.long)],
)
def test_a_million_steps(model, bias_model):
    """P stays symmetric and positive, C orthonormal: 10^6 predictions with 1000 updates."""
    parameters = parameters_of(model, "per_sample", bias_model, gate=GateParameters(enabled=False))
    (health,) = steps(parameters, 1, seed=60)
    assert health.asymmetry == 0.0
    assert health.smallest_eigenvalue > 0.0
    assert health.orthonormality < 2e-15
