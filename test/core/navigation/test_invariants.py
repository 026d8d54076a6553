"""What no input may break: finite numbers, symmetric positive covariances, rotations.

Hypothesis searches for parameters and streams, extreme ones among them, whose fold breaks it.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from insdvl.navigation.events import NS, Event, Initial, ProcessNoise
from insdvl.navigation.geometry.frames import rotation_from_rpy
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.odometry import Odometry
from insdvl.navigation.parameters import (
    DvlParameters,
    FilterParameters,
    GateParameters,
    ImuParameters,
    OriginParameters,
    ProcessNoiseParameters,
)
from insdvl.simulation.initial_errors import P_0
from insdvl.timeline.fold import Fold

Array = NDArray[np.float64]

#: Smallest eigenvalue of a covariance that is scaled to ones on its diagonal: as negative as the
#: rounding of sums of so many products.
ROUNDING = 1e-9
EPS_C = 1e-12  # |C^T C - I|

START_NS = 1_700_000_000 * NS


def is_covariance(P: Array) -> bool:
    """Symmetric to the bit, and positive semidefinite but for rounding, at any scale."""
    if not (np.isfinite(P).all() and (np.swapaxes(P, -1, -2) == P).all()):
        return False
    variances = np.diagonal(P, axis1=-2, axis2=-1)
    if not (variances >= 0.0).all():
        return False
    sigma = np.sqrt(np.where(variances > 0.0, variances, 1.0))
    scaled = P / (sigma[..., :, None] * sigma[..., None, :])
    return bool((np.linalg.eigvalsh(scaled) >= -ROUNDING).all())


def check(fold: Fold) -> None:
    """The invariants, on all states that are kept and all that is published."""
    s = fold.states
    s = s[s["nav"]["initialised"] == 1]
    for name in ("v_n", "llh", "b_f", "b_w", "optional", "w_nb_b", "P"):
        assert np.isfinite(s["nav"][name]).all(), name
    for name in ("Q_f", "Q_w"):
        assert np.isfinite(s["noise"][name]).all(), name
    C = s["nav"]["C_n_b"]
    assert np.abs(np.swapaxes(C, 1, 2) @ C - np.eye(3)).max(initial=0.0) < EPS_C
    assert is_covariance(fold.filter.covariance(s))
    stamps = []
    for output in fold.take():
        stamps.append(output.stamp_ns)
        if isinstance(output, Odometry):
            assert np.linalg.norm(output.quaternion_xyzw) == pytest.approx(1.0, abs=1e-12)
            assert is_covariance(output.pose_covariance)
            assert is_covariance(output.twist_covariance)
            for value in (output.position, output.twist_linear, output.twist_angular):
                assert np.isfinite(value).all()
        elif output.report.accepted:
            assert output.report.nis >= 0.0
            assert is_covariance(output.report.S)
    assert stamps == sorted(stamps)


@dataclass(frozen=True)
class Stream:
    """An IMU that feels anything that it may, and a DVL that says anything."""

    parameters: FilterParameters
    initial: Initial
    seed: int
    rate_of_turn: float
    force: float
    jitter: float
    outliers: float

    def fold(self, samples: int = 300) -> Fold:
        p = self.parameters
        rng = np.random.default_rng(self.seed)
        steps = np.where(
            rng.random(samples) < self.jitter, rng.uniform(0.1, 30.0, samples), 1.0
        ) * (NS / p.imu.rate)
        stamps = START_NS + np.cumsum(np.maximum(steps, 1.0)).astype(np.int64)
        axis = rng.standard_normal(3)
        axis /= np.linalg.norm(axis)
        w = self.rate_of_turn * axis + 0.01 * rng.standard_normal((samples, 3))
        f = [0.0, 0.0, -9.8] + self.force * rng.standard_normal((samples, 3))
        events: list[Event] = [self.initial]
        for stamp in stamps[:: max(samples // 10, 1)].tolist():
            v = 0.1 * rng.standard_normal(3) + self.initial.v
            if rng.random() < self.outliers:
                v = v + 10.0 ** rng.uniform(-3, 3) * rng.standard_normal(3)
            events.append(Dvl(stamp + int(rng.integers(-NS // 200, NS // 200)), v))
            if rng.random() < 0.5:
                Q = 10.0 ** rng.uniform(-14, 2, 6)
                events.append(ProcessNoise(stamp, np.diag(Q[:3]), np.diag(Q[3:])))
        fold = Fold(p)
        for event in events:
            fold.add(event)
        fold.add_recording(stamps, f, w, [])
        return fold


variances = st.sampled_from([0.0, 1e-14, 1e-8, 1e-3, 1.0])
walks = st.sampled_from([0.0, 1e-13, 1e-9, 1e-3])


@st.composite
def streams(draw: st.DrawFn) -> Stream:
    angle = st.sampled_from([-np.pi / 2, 0.0, np.pi / 2]) | st.floats(-np.pi, np.pi)
    lever = st.floats(-5.0, 5.0)
    parameters = FilterParameters(
        frame_convention="ned",
        error_state=draw(st.sampled_from(["invariant", "ned"])),
        imu=ImuParameters(rate=draw(st.sampled_from([50.0, 100.0, 200.0, 1000.0]))),
        dvl=DvlParameters(
            noise_std=(draw(st.sampled_from([1e-6, 1e-3, 0.1, 10.0])),) * 3,
            lever_arm=(draw(lever), draw(lever), draw(lever)),
            mount=(draw(angle), draw(angle), draw(angle)),
            bias_model=draw(st.sampled_from(["none", "gauss_markov"])),
        ),
        gate=GateParameters(enabled=draw(st.booleans())),
        process_noise=ProcessNoiseParameters(
            source=draw(st.sampled_from(["constant", "external"])),
            convention=draw(st.sampled_from(["per_sample", "density"])),
            accelerometer_variance=(draw(variances),) * 3,
            gyroscope_variance=(draw(variances),) * 3,
            accelerometer_bias_walk=draw(walks),
            gyroscope_bias_walk=draw(walks),
            accelerometer_floor=0.0,
            gyroscope_floor=0.0,
        ),
        initial=replace(
            P_0,
            mode="set_odometry",
            velocity_std=draw(st.sampled_from([0.0, 0.1, 10.0])),
            tilt_std=draw(st.sampled_from([0.0, 1e-6, 0.01, 0.5])),
            heading_std=draw(st.sampled_from([0.0, 1e-6, 0.02, 3.0])),
        ),
        origin=OriginParameters(
            latitude_deg=draw(st.sampled_from([0.0, 32.0, -60.0, 89.99, -89.99])),
            height=draw(st.sampled_from([-11_000.0, 0.0])),
        ),
    )
    speed = draw(st.sampled_from([0.0, 1.0, 20.0]))
    initial = Initial(
        START_NS,
        rotation_from_rpy(np.array([draw(angle), draw(angle), draw(angle)])),
        np.zeros(3),
        np.array([speed, 0.0, 0.0]),
        "body",
    )
    return Stream(
        parameters,
        initial,
        seed=draw(st.integers(0, 2**32 - 1)),
        rate_of_turn=draw(st.sampled_from([0.0, 0.1, np.radians(400.0)])),
        force=draw(st.sampled_from([0.0, 0.1, 10.0, 160.0])),
        jitter=draw(st.sampled_from([0.0, 0.05])),
        outliers=draw(st.sampled_from([0.0, 0.3])),
    )


@given(stream=streams())
@settings(max_examples=40)
def test_no_stream_breaks_an_invariant(stream: Stream) -> None:
    check(stream.fold())
