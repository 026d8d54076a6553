"""P_0 in the model's coordinates against a sample of true errors, through the exact definitions."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from places import position
from scipy.spatial.transform import Rotation

from insdvl.navigation.coordinates import from_reference
from insdvl.navigation.error_state import ATTITUDE, VELOCITY
from insdvl.navigation.events import Imu, Initial
from insdvl.navigation.geometry.frames import rotation_from_rpy
from insdvl.navigation.parameters import (
    DvlParameters,
    FilterParameters,
    ImuParameters,
    ProcessNoiseParameters,
)
from insdvl.simulation.initial_errors import P_0
from insdvl.timeline.fold import Fold
from insdvl.timeline.recorded import fold_arrays

SEED = 2718
SAMPLES = 200_000
FIVE_SIGMA = 5.0 * np.sqrt(2.0 / SAMPLES)  # of an element of a whitened sample covariance

# Errors so small that their squares drown in the sampling error. The velocity is known so well that
# the part of the attitude error (1.9 m/s times 3 mrad) dominates.
STD = {"velocity": 2e-3, "tilt": 1e-3, "heading": 3e-3, "f": 1e-3, "w": 2e-3, "position": 5e-3}
GYROSCOPE_VARIANCE = (1e-6, 2e-6, 3e-6)
C_HAT = rotation_from_rpy(np.array([0.2, -0.3, 2.1]))
V_BODY = np.array([1.8, -0.5, 0.3])
W_IB_B = np.array([0.1, -0.2, 0.4])
IMU_ARM = np.array([0.8, -0.5, 1.2])


def parameters(error_state: str, velocity_frame: str, arm: np.ndarray) -> FilterParameters:
    return FilterParameters(
        frame_convention="ned",
        error_state=error_state,
        imu=ImuParameters(lever_arm=tuple(arm.tolist())),
        dvl=DvlParameters(bias_model="gauss_markov", bias_std=(0.02, 0.03, 0.04)),
        process_noise=ProcessNoiseParameters(gyroscope_variance=GYROSCOPE_VARIANCE),
        initial=replace(
            P_0,
            mode="set_odometry",
            velocity_frame=velocity_frame,
            velocity_std=STD["velocity"],
            tilt_std=STD["tilt"],
            heading_std=STD["heading"],
            accelerometer_bias_std=STD["f"],
            gyroscope_bias_std=STD["w"],
            position_std=STD["position"],
        ),
    )


def initialised(settings: FilterParameters, **covariances: np.ndarray) -> np.void:
    """The filter's state right at the initialisation, which falls on the stamp of a sample."""
    in_body = settings.initial.velocity_frame == "body"
    event = Initial(
        stamp_ns=10_000_000,
        C_o_b=C_HAT,
        p_o=np.array([3.0, -2.0, 1.0]),
        v=V_BODY if in_body else C_HAT @ V_BODY,
        velocity_frame=settings.initial.velocity_frame,
        **covariances,
    )
    fold = Fold(settings)
    fold.add(Imu(10_000_000, np.array([0.1, 0.2, -9.8]), W_IB_B))
    fold.add(event)
    return fold.latest


def sampled_covariance(settings: FilterParameters, s: np.void, **P: np.ndarray) -> np.ndarray:
    """Covariance of the model's errors at the IMU, from draws of the declared errors."""
    rng = np.random.default_rng(SEED)
    invariant = settings.error_state == "invariant"
    in_body = settings.initial.velocity_frame == "body"

    def draw(name: str, std: list[float]) -> np.ndarray:
        root = np.linalg.cholesky(P[name]) if name in P else np.diag(std)
        return rng.standard_normal((SAMPLES, 3)) @ root.T

    dv = draw("P_v", [STD["velocity"]] * 3)
    psi = draw("P_psi", [STD["tilt"], STD["tilt"], STD["heading"]])
    dp = draw("P_p", [STD["position"]] * 3)
    db_f = draw("f", [STD["f"]] * 3)
    db_w = draw("w", [STD["w"]] * 3)
    b_d = draw("d", settings.dvl.bias_std)

    turn = Rotation.from_rotvec(psi).as_matrix()
    C = turn @ C_HAT
    arm = np.array(settings.imu.lever_arm)
    noise = rng.standard_normal((SAMPLES, 3)) * np.sqrt(GYROSCOPE_VARIANCE)
    v_arm = np.cross(W_IB_B - db_w - noise, arm)  # the IMU moves against base_link as it turns
    v = np.einsum("kij,kj->ki", C, V_BODY + dv) if in_body else C_HAT @ V_BODY + dv
    v = v + np.einsum("kij,kj->ki", C, v_arm)
    p = np.array([3.0, -2.0, 1.0]) + dp + C @ arm
    v_hat, p_hat = s["nav"]["v_n"], position(s["nav"])
    if invariant:
        x_n = from_reference(s["nav"])
        v_hat, p_hat = turn @ v_hat, p_hat + turn @ x_n - x_n
    errors = np.concatenate([v - v_hat, psi, db_f, db_w, p - p_hat, b_d], axis=1)
    return np.cov(errors.T)


def assert_same_covariance(P: np.ndarray, sampled: np.ndarray) -> None:
    root = np.linalg.cholesky(P)
    whitened = np.linalg.solve(root, np.linalg.solve(root, sampled).T)
    np.testing.assert_allclose(whitened, np.eye(len(P)), atol=FIVE_SIGMA)


ALL = list(product(["invariant", "ned"], ["body", "nav"]))


@pytest.mark.parametrize(("error_state", "velocity_frame"), ALL)
@pytest.mark.parametrize("arm", [np.zeros(3), IMU_ARM], ids=["at base_link", "with a lever arm"])
def test_the_covariance_is_that_of_the_errors(
    error_state: str, velocity_frame: str, arm: np.ndarray
) -> None:
    settings = parameters(error_state, velocity_frame, arm)
    s = initialised(settings)
    P = s["nav"]["P"][:18, :18]
    assert_same_covariance(P, sampled_covariance(settings, s))


@pytest.mark.parametrize(("error_state", "velocity_frame"), ALL)
def test_told_covariances_replace_the_sigmas(error_state: str, velocity_frame: str) -> None:
    rng = np.random.default_rng(SEED + 1)
    settings = parameters(error_state, velocity_frame, np.zeros(3))
    told = {}
    for name, scale in (("P_v", 3e-3), ("P_psi", 2e-3), ("P_p", 1e-2)):
        A = scale * rng.standard_normal((3, 3))
        told[name] = A @ A.T + 0.1 * scale**2 * np.eye(3)
    s = initialised(settings, **told)
    P = s["nav"]["P"][:18, :18]
    assert_same_covariance(P, sampled_covariance(settings, s, **told))


def test_what_is_independent_depends_on_the_declaration() -> None:
    """A body velocity is independent of heading as dv_i, a velocity in NED as dv_ned."""
    for error_state, velocity_frame in ALL:
        s = initialised(parameters(error_state, velocity_frame, np.zeros(3)))
        independent = (error_state == "invariant") == (velocity_frame == "body")
        assert (not s["nav"]["P"][VELOCITY, ATTITUDE].any()) == independent


def test_initial_values_are_used() -> None:
    """Biases of the parameters, in the axes of a mounted IMU; the IMU's place and velocity."""
    mount = (0.3, -0.2, 1.0)
    settings = FilterParameters(
        frame_convention="ned",
        earth_rate=False,
        imu=ImuParameters(mount=mount, lever_arm=tuple(IMU_ARM.tolist())),
        dvl=DvlParameters(bias_model="gauss_markov"),
        initial=replace(
            P_0,
            position=(1.0, 2.0, 3.0),
            rpy=(0.1, 0.2, -2.0),
            velocity=(1.5, 0.1, -0.2),
            accelerometer_bias=(0.1, 0.2, 0.3),
            gyroscope_bias=(0.01, 0.02, 0.03),
        ),
    )
    C_b_i = rotation_from_rpy(np.array(mount))
    C = rotation_from_rpy(np.array([0.1, 0.2, -2.0]))
    w_b = W_IB_B
    result = fold_arrays(
        settings,
        np.array([10_000_000]),
        np.array([[0.0, 0.0, -9.8]]),
        (C_b_i.T @ w_b)[None],
        [],
    )
    s = result.states[0]
    b_w = C_b_i @ [0.01, 0.02, 0.03]
    np.testing.assert_allclose(s["nav"]["b_f"], C_b_i @ [0.1, 0.2, 0.3], rtol=1e-12)
    np.testing.assert_allclose(s["nav"]["b_w"], b_w, rtol=1e-12)
    np.testing.assert_allclose(position(s["nav"]), [1.0, 2.0, 3.0] + C @ IMU_ARM, atol=1e-6)
    v_b = np.array([1.5, 0.1, -0.2]) + np.cross(w_b - b_w, IMU_ARM)
    # Two metres east of the origin, north is 2e-7 rad off the x axis of odom.
    np.testing.assert_allclose(s["nav"]["v_n"], C @ v_b, atol=1e-6)
    assert not s["nav"]["optional"].any()
    np.testing.assert_allclose(s["nav"]["P"][15:18, 15:18], 1e-4 * np.eye(3), rtol=1e-12)
