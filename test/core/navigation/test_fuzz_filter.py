"""Whatever messages the filter is given, it goes on, and what it says could be true."""

from typing import Any

import numpy as np
import pytest
from adversary import Adversary
from records import P15
from told import TOLD

from insdvl.messages.feed import Feed
from insdvl.navigation.events import NS
from insdvl.navigation.odometry import Odometry, biases
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build
from insdvl.timeline.fold import Fold
from insdvl.timeline.jumps import TimeJump
from insdvl.timeline.output import AppliedUpdate

COUNT = 800
SETTINGS: dict[str, dict[str, Any]] = {
    "default": {},
    "parameters": TOLD,
    "all that can be told": {
        "process_noise.source": "external",
        "dvl.bias_model": "gauss_markov",
        "dvl.lever_arm": (1.0, 0.5, -0.2),
        "imu.lever_arm": (0.1, 0.0, 0.3),
        "imu.mount": (0.1, -0.2, 0.3),
    },
    "late output, ned": {"error_state": "ned", "output_delay": 1.5},
    "started by messages": {"initial.mode": "topic", "origin.source": "topic"},
    "levelling": {"initial.mode": "levelling", "process_noise.source": "message"},
    "gyrocompassing": {
        "initial.mode": "gyrocompassing",
        "initial.heading_std": 6.0,
        "initial.levelling_time": 0.1,
        "initial.gyrocompass_time": 1.0,
    },
    "adaptive": {"process_noise.source": "adaptive", "gate.probability": 0.9},
    "variational": {
        "process_noise.source": "adaptive",
        "process_noise.adaptive_form": "variational",
    },
    "sage_husa": {
        "process_noise.source": "adaptive",
        "process_noise.adaptive_form": "sage_husa_r",
        "error_state": "ned",
    },
}


def check(output: Odometry) -> None:
    for values in (
        output.position,
        output.quaternion_xyzw,
        output.pose_covariance,
        output.twist_linear,
        output.twist_angular,
        output.twist_covariance,
    ):
        assert np.isfinite(values).all(), output
    assert np.linalg.norm(output.quaternion_xyzw) == pytest.approx(1.0, abs=1e-9)
    for P in (output.pose_covariance, output.twist_covariance):
        assert np.array_equal(P, P.T)
        assert (np.diag(P) > 0.0).all()


def check_state(fold: Fold) -> None:
    state = fold.latest
    if state is None:
        return
    P = P15(state)
    assert np.isfinite(P).all()
    assert np.array_equal(P, P.T)
    scale = 1.0 / np.sqrt(np.diag(P))
    assert np.linalg.eigvalsh(scale[:, None] * P * scale)[0] > 0.0
    told = biases(fold.filter, state)
    assert np.isfinite(told.accelerometer).all() and np.isfinite(told.gyroscope).all()
    np.testing.assert_allclose(
        state["nav"]["C_n_b"] @ state["nav"]["C_n_b"].T, np.eye(3), atol=1e-9
    )


@pytest.mark.parametrize("odd", [0.02, 0.3])
@pytest.mark.parametrize("name", SETTINGS)
def test_any_messages(name: str, odd: float) -> None:
    parameters = build(FilterParameters, SETTINGS[name])
    feed = Feed(parameters, capacity=64)
    fold = feed.fold
    types = {name: topic.types[0] for name, topic in feed.inputs.topics.items()}
    adversary = Adversary(np.random.default_rng([len(name), round(100 * odd)]), odd=odd)
    newest_ns, outputs = -1, 0
    for k, (topic, message) in enumerate(adversary.messages(types, COUNT)):
        feed.give(topic, message)
        for output in fold.take():
            if isinstance(output, TimeJump):
                newest_ns = -1
            elif isinstance(output, AppliedUpdate):
                assert output.report.reason or output.report.accepted
            else:
                assert output.stamp_ns > newest_ns
                newest_ns = output.stamp_ns
                outputs += 1
                check(output)
        if k % 10 == 0:
            check_state(fold)
    assert outputs > (0.3 if odd < 0.1 else 0.01) * COUNT
    assert newest_ns <= 2**31 * NS
