"""A filter that does not know where on the Earth it is has no gravity, and must not start."""

from dataclasses import replace

import numpy as np

from insdvl.navigation.events import Imu, Initial, Origin
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters, OriginParameters
from insdvl.simulation.initial_errors import P_0
from insdvl.timeline.fold import Fold

STEP = 10_000_000
START = 1_000_000_000


def sample(k: int) -> Imu:
    return Imu(START + k * STEP, np.array([0.0, 0.0, -9.795]), np.zeros(3))


def initial(stamp_ns: int, *, once: bool) -> Initial:
    return Initial(stamp_ns, np.eye(3), np.zeros(3), np.zeros(3), "body", once=once)


def settings(mode: str, origin: str) -> FilterParameters:
    return FilterParameters(initial=replace(P_0, mode=mode), origin=OriginParameters(source=origin))


def test_an_initial_state_before_the_origin_is_counted_and_left() -> None:
    fold = Fold(settings("set_odometry", "topic"))
    fold.add(initial(START + STEP, once=False))
    for k in range(5):
        fold.add(sample(k))
    assert fold.take() == []
    assert fold.counts["without_origin"] == 1

    fold.add(Origin(START + 5 * STEP, 0.5, 0.6, 0.0))
    fold.add(initial(START + 6 * STEP, once=False))
    for k in range(5, 10):
        fold.add(sample(k))
    outputs = fold.take()
    assert [output.stamp_ns for output in outputs] == [START + k * STEP for k in range(6, 10)]
    assert np.isfinite(outputs[-1].twist_linear).all()


def test_further_messages_of_the_initial_topic_leave_the_state_alone() -> None:
    """They do not even cut a sample, which would change the last bits."""
    states = []
    for further in ([], [initial(START + 2 * STEP + 3, once=True)]):
        fold = Fold(settings("topic", "parameters"))
        for event in (initial(START + 3, once=True), *further):
            fold.add(event)
        for k in range(5):
            fold.add(sample(k))
        fold.add(Dvl(START + 4 * STEP, np.array([0.1, 0.0, 0.0])))
        states.append(fold.latest.tobytes())
    assert states[0] == states[1]
