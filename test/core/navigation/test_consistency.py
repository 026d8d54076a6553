"""Is the filter as good as it says? Monte Carlo against chi-square bounds.

Every run draws a new initial error from P_0, new biases and new noise. At a fixed time the runs are
independent, so the sum of their NEES is chi-square; the bounds hold 99.9 % of it. The seeds were
chosen before the first run.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from records import P15
from reset import apply_it_after_every_update
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, norm

from insdvl.navigation.coordinates import body_velocity_jacobian, position_error
from insdvl.navigation.error_state import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    GYROSCOPE_BIAS,
    POSITION,
    VELOCITY,
)
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import (
    DvlParameters,
    FilterParameters,
    GateParameters,
    OriginParameters,
    ProcessNoiseParameters,
)
from insdvl.simulation.initial_errors import P_0, drawn_initial
from insdvl.simulation.mission import ImuModel, simulate
from insdvl.simulation.motion import Truth
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.trajectories import AUV
from insdvl.timeline.recorded import fold_arrays

FIRST_SEED = 31_415
RUNS = 100
TAIL = 0.0005  # on either side: 99.9 % inside

IMU = ImuModel(
    accelerometer_bias_std=0.01,
    gyroscope_bias_std=5e-4,
    accelerometer_bias_walk=1e-7,
    gyroscope_bias_walk=1e-10,
)
DVL_STD, POSITION_STD, TILT_STD = 0.1, 0.5, np.radians(0.5)
LEVER_ARM = (0.4, -0.2, 0.3)
BLOCKS = {"velocity": 3, "attitude": 3, "velocity and attitude": 6, "biases": 6, "position": 3}


@dataclass(frozen=True)
class Case:
    """One declaration of one filter, and how wrong things are.

    The initial velocity is known so well that the heading error is most of what a wrong mapping of
    P_0 would add to it or take from it.
    """

    error_state: str
    velocity_frame: str
    heading_std: float
    velocity_std: float
    gyroscope_variance: float
    duration: float

    @property
    def variances(self) -> list[float]:
        return [0.01] * 3 + [self.gyroscope_variance] * 3

    @property
    def epochs(self) -> list[int]:
        """Samples at a quarter, a half and all of the duration."""
        n = round(self.duration * IMU.rate)
        return [n // 4 - 1, n // 2 - 1, n - 1]


# `ned` is consistent for small errors of the heading only (docs/explanation/error-state.md).
CASES = [
    Case("invariant", "body", np.radians(5.0), 0.02, 1e-3, 120.0),
    Case("invariant", "nav", np.radians(5.0), 0.02, 1e-3, 120.0),
    Case("ned", "body", np.radians(0.5), 0.005, 1e-5, 60.0),
    Case("ned", "nav", np.radians(0.5), 0.005, 1e-5, 60.0),
]
#: The first runs every time, the others with the long tests.
PARAMETERS = [
    pytest.param(case, marks=[pytest.mark.long] if number else [])
    for number, case in enumerate(CASES)
]


def parameters(case: Case) -> FilterParameters:
    return FilterParameters(
        frame_convention="ned",
        error_state=case.error_state,
        dvl=DvlParameters(noise_std=(DVL_STD,) * 3, lever_arm=LEVER_ARM),
        gate=GateParameters(enabled=False),
        process_noise=ProcessNoiseParameters(
            accelerometer_variance=tuple(case.variances[:3]),
            gyroscope_variance=tuple(case.variances[3:]),
            accelerometer_bias_walk=IMU.accelerometer_bias_walk,
            gyroscope_bias_walk=IMU.gyroscope_bias_walk,
        ),
        initial=replace(
            P_0,
            mode="set_odometry",
            velocity_frame=case.velocity_frame,
            velocity_std=case.velocity_std,
            tilt_std=float(TILT_STD),
            heading_std=float(case.heading_std),
            position_std=POSITION_STD,
            accelerometer_bias_std=IMU.accelerometer_bias_std,
            gyroscope_bias_std=IMU.gyroscope_bias_std,
        ),
        origin=OriginParameters(height=float(AUV.h_0)),
    )


@dataclass(frozen=True)
class Study:
    """NEES (RUNS, epochs) of each block, and whitened innovations (RUNS, M, 3)."""

    nees: dict[str, np.ndarray]
    innovations: np.ndarray


@cache
def study(case: Case) -> Study:
    return fly(case)


def fly(case: Case) -> Study:
    settings = parameters(case)
    invariant = case.error_state == "invariant"
    nees = {name: np.empty((RUNS, len(case.epochs))) for name in BLOCKS}
    innovations = []
    for k in range(RUNS):
        seed = FIRST_SEED + k
        mission = simulate(
            AUV,
            constant(case.variances),
            seed=seed,
            duration=case.duration,
            imu=IMU,
            dvl=DvlModel(noise_std=np.full(3, DVL_STD), lever_arm=LEVER_ARM),
        )
        rng = np.random.default_rng([seed, 1])
        initial = drawn_initial(mission.initial, settings.initial, rng)
        pings = zip(mission.dvl_stamps_ns.tolist(), mission.v_d, strict=True)
        result = fold_arrays(
            settings,
            mission.stamps_ns,
            mission.f_b,
            mission.w_ib_b,
            [initial, *(Dvl(stamp, v_d) for stamp, v_d in pings)],
        )
        innovations.append(
            [
                np.linalg.solve(np.linalg.cholesky(u.report.S), u.report.innovation)
                for u in result.updates
            ]
        )
        for j, epoch in enumerate(case.epochs):
            errors = block_errors(
                result.states[epoch], mission.truth, mission.bias, epoch, invariant
            )
            for name, (error, P) in errors.items():
                nees[name][k, j] = error @ np.linalg.solve(P, error)
    return Study(nees, np.array(innovations))


def block_errors(
    s: np.void, truth: Truth, bias: np.ndarray, k: int, invariant: bool
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Error and covariance of each block; the velocity is that in body axes."""
    C_hat, C, P = s["nav"]["C_n_b"], truth.C_n_b[k], P15(s)
    rotation = Rotation.from_matrix(C @ C_hat.T)
    psi = rotation.as_rotvec()
    v_turned = rotation.as_matrix() @ s["nav"]["v_n"] if invariant else s["nav"]["v_n"]
    J = body_velocity_jacobian(C_hat, s["nav"]["v_n"], invariant=invariant, n=len(P))
    db = bias[k] - np.concatenate([s["nav"]["b_f"], s["nav"]["b_w"]])
    both = slice(VELOCITY.start, ATTITUDE.stop)
    biases = slice(ACCELEROMETER_BIAS.start, GYROSCOPE_BIAS.stop)
    return {
        "velocity": (C.T @ truth.v_n[k] - C_hat.T @ s["nav"]["v_n"], J @ P @ J.T),
        "attitude": (psi, P[ATTITUDE, ATTITUDE]),
        "velocity and attitude": (np.concatenate([truth.v_n[k] - v_turned, psi]), P[both, both]),
        "biases": (db, P[biases, biases]),
        "position": (
            position_error(s["nav"], C, truth.llh[k], invariant=invariant),
            P[POSITION, POSITION],
        ),
    }


def show(case: Case, nees: dict[str, np.ndarray]) -> None:
    """The figures of docs/explanation/error-state.md; pytest shows them with -rP."""
    for name, degrees in BLOCKS.items():
        print(f"{case.error_state}, {name}: NEES per dof {nees[name].mean(axis=0) / degrees}")


def inside(total: float, degrees: int) -> bool:
    return bool(chi2.ppf(TAIL, degrees) < total < chi2.isf(TAIL, degrees))


@pytest.mark.parametrize("case", PARAMETERS, ids=lambda c: f"{c.error_state}-{c.velocity_frame}")
@pytest.mark.parametrize("block", BLOCKS)
def test_the_errors_are_as_large_as_their_covariance_says(case: Case, block: str) -> None:
    show(case, study(case).nees)
    nees = study(case).nees[block]
    assert np.isfinite(nees).all()
    assert [inside(total, RUNS * BLOCKS[block]) for total in nees.sum(axis=0)] == [True] * 3, (
        f"NEES per degree of freedom: {nees.mean(axis=0) / BLOCKS[block]}"
    )


@pytest.mark.parametrize("case", PARAMETERS, ids=lambda c: f"{c.error_state}-{c.velocity_frame}")
def test_the_innovations_are_as_large_as_their_covariance_says(case: Case) -> None:
    nu = study(case).innovations
    assert nu.shape == (RUNS, round(case.duration), 3)
    assert inside(float(np.sum(nu**2)), nu.size), f"NIS: {3 * np.mean(nu**2)}"


@pytest.mark.parametrize("case", PARAMETERS, ids=lambda c: f"{c.error_state}-{c.velocity_frame}")
@pytest.mark.parametrize("lag", [1, 2, 5])
def test_the_innovations_are_white(case: Case, lag: int) -> None:
    nu = study(case).innovations
    products = nu[:, lag:] * nu[:, :-lag]
    correlation = float(products.sum() / np.sqrt(products.size))  # standard normal when white
    assert abs(correlation) < norm.isf(TAIL), f"{correlation} sigma"


@pytest.mark.long
def test_with_a_reset_jacobian_the_filter_would_be_too_sure(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    apply_it_after_every_update(monkeypatch)
    nees = fly(CASES[0]).nees
    show(CASES[0], nees)
    assert nees["attitude"][:, -1].sum() > chi2.isf(1e-9, 3 * RUNS)


@pytest.mark.long
def test_at_a_large_heading_error_the_other_error_state_is_too_sure() -> None:
    """Which is why `invariant` is the default."""
    case = replace(CASES[0], error_state="ned")
    nees = fly(case).nees
    show(case, nees)
    assert nees["attitude"][:, -1].sum() > chi2.isf(1e-9, 3 * RUNS)
