"""A filter node whose state diverges: it publishes and saves nothing of it, and says so."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros_messages import STEP_NS, dvl_message, odometry_message, stamp_of
from test_filter_node import START_NS, FilterGraph, imu_run, numbers

from insdvl.navigation import filter as core
from ros_insdvl.status.heard import ERROR


@pytest.fixture
def graph(managed: Any) -> Callable[..., FilterGraph]:
    return lambda **parameters: managed(FilterGraph(**parameters))


@pytest.fixture
def poisoned(monkeypatch: pytest.MonkeyPatch) -> None:
    """An update by a DVL spoils the state."""
    update = core.Filter.update

    def spoilt(self: core.Filter, state: Any, *args: Any) -> Any:
        report = update(self, state, *args)
        state[0]["nav"]["v_n"][1] = np.nan
        return report

    monkeypatch.setattr(core.Filter, "update", spoilt)


@pytest.mark.usefixtures("poisoned")
def test_what_has_diverged_is_neither_published_nor_saved(graph: Any, tmp_path: Path) -> None:
    path = tmp_path / "state"
    g = graph(
        **{"initial.mode": "topic", "initial.topic": "start", "max_delay": 0.03},
        state_file=str(path),
        state_period=0.01,
    )
    start = ("start", odometry_message(START_NS, (7.0, 8.0, 9.0)))
    g.send(*imu_run(1, 3), start, *imu_run(3, 6), start, *imu_run(6, 12), start)
    g.until(lambda: g.publishers["start"].get_subscription_count() == 0)
    assert path.exists()
    before = len(g.odometry())
    g.send(("dvl/velocity", dvl_message(START_NS + 12 * STEP_NS, (0.0, 0.0, 0.01))))
    g.send(*imu_run(12, 20))
    assert len(g.odometry()) == before and not path.exists()
    status, values = g.statuses()
    assert status["initialisation"].level == ERROR
    assert "diverged and gave up its state 1 times" in status["initialisation"].message
    assert "waits for a message on start" in status["initialisation"].message
    assert values["diverged"] == "1"

    g.until(lambda: g.publishers["start"].get_subscription_count() > 0)
    g.send(("start", odometry_message(START_NS + 19 * STEP_NS, (1.0, 2.0, 3.0))), *imu_run(20, 24))
    received = g.odometry()
    assert [stamp_of(message) for message in received[before:]] == [
        START_NS + k * STEP_NS for k in range(20, 24)
    ]
    assert all(np.isfinite(numbers(message)).all() for message in received)
    assert received[-1].pose.pose.position.x == pytest.approx(1.0, abs=0.2)
