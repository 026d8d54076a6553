"""The map of the core: it has every room, and its example navigates a recording."""

import inspect
import textwrap
from pathlib import Path

import numpy as np
import pytest
from recordings import record, save
from sources import ROOT

import insdvl
from insdvl.navigation.geometry.frames import ENU
from insdvl.navigation.odometry import Odometry
from insdvl.simulation.mission import mission_of
from insdvl.simulation.parameters import SimulatorParameters

TOPICS = {"/imu": "/imu/data_raw", "/dvl": "/dvl/velocity"}
VEHICLE = """
/**/insdvl_filter:
  ros__parameters:
    origin.height: -5.0
    initial:
      mode: parameters
      rpy: [0.0, 0.0, {yaw}]
      velocity: [1.0, 0.0, 0.0]
      accelerometer_bias_std: 0.001
      gyroscope_bias_std: 1.0e-5
"""


@pytest.mark.parametrize("text", [insdvl.__doc__, "docs/explanation/architecture.md"])
def test_every_room_is_on_the_map(text: str) -> None:
    if text.endswith(".md"):
        text = (ROOT / text).read_text()
    rooms = [path.parent.name for path in (ROOT / "src" / "insdvl").glob("*/__init__.py")]
    assert [room for room in rooms if f"`{room}`" not in text and f"`{room}/`" not in text] == []


def test_the_five_lines_navigate_a_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mission = mission_of(SimulatorParameters(duration=20.0))
    raws = [raw._replace(topic=TOPICS[raw.topic]) for raw in record(mission) if raw.topic in TOPICS]
    save(tmp_path / "dive", raws)
    forward = ENU.attitude(mission.initial.C_n_b[0]) @ [1.0, 0.0, 0.0]
    yaw = float(np.arctan2(forward[1], forward[0]))
    (tmp_path / "vehicle.yaml").write_text(VEHICLE.format(yaw=yaw))
    monkeypatch.chdir(tmp_path)

    _, _, example = inspect.cleandoc(insdvl.__doc__ or "").partition("five lines::\n\n")
    lines = [line for line in example.splitlines() if line.startswith("    ") or not line]
    printed: list[Odometry] = []
    exec(textwrap.dedent("\n".join(lines)), {"print": printed.append})

    (last,) = printed
    assert last.stamp_ns == mission.stamps_ns[-1]
    error = last.position - ENU.nav @ mission.truth.p_o[-1]
    sigma = np.sqrt(np.diag(last.pose_covariance)[:3])
    assert (np.abs(error) < 4 * sigma).all()
    assert (sigma < 3.0).all()
