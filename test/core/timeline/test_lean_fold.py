"""A recording of which only every so many states are kept: the same bits, and the track of all."""

import numpy as np
import pytest
from records import fields
from test_fold import SETTINGS, mission

from insdvl.navigation.events import NS, Imu
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.prediction.kept import TRACK
from insdvl.timeline.fold import Fold

EVENTS = mission(6.0)
SAMPLES = [event for event in EVENTS if isinstance(event, Imu)]
OTHERS = [event for event in EVENTS if not isinstance(event, Imu)]


def folded(every: int, others: list = OTHERS) -> Fold:
    fold = Fold(SETTINGS, len(SAMPLES), every)
    stamps = np.array([sample.stamp_ns for sample in SAMPLES])
    f_b = np.array([sample.f_b for sample in SAMPLES])
    w_b = np.array([sample.w_ib_b for sample in SAMPLES])
    assert fold.add_recording(stamps, f_b, w_b, others) == {}
    return fold


@pytest.mark.parametrize("every", [2, 25, 64, len(SAMPLES)])
def test_the_states_that_are_kept_are_the_same(every: int) -> None:
    whole, lean = folded(1), folded(every)
    assert len(lean.states) == len(SAMPLES) // every
    expected = whole.states[every - 1 :: every]
    for (name, found), (_, value) in zip(fields(lean.states), fields(expected), strict=True):
        np.testing.assert_array_equal(found, value, err_msg=name)
    assert lean.counts == whole.counts
    for name in TRACK.names:
        np.testing.assert_array_equal(lean.track[name], whole.states["nav"][name], err_msg=name)


def test_an_event_that_comes_late_changes_what_is_kept() -> None:
    newest_ns = SAMPLES[-1].stamp_ns
    late = Dvl(newest_ns - NS // 3, np.array([1.0, 0.1, -0.1]))
    lean, whole = folded(25), folded(1)
    before = lean.track.copy()
    assert lean.add(late) is whole.add(late) is None
    assert (lean.track["v_n"][-1] != before["v_n"][-1]).any()
    for name in TRACK.names:
        np.testing.assert_array_equal(lean.track[name], whole.states["nav"][name], err_msg=name)
