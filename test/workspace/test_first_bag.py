"""Every command of the page "My first bag" runs, on a recording of a simulated mission."""

import re
import shlex
from pathlib import Path

import pytest
from recordings import FORM

from insdvl import cli
from insdvl.recordings.bag_writer import BagWriter
from insdvl.recordings.base import encode
from insdvl.recordings.messages import message_of
from insdvl.simulation.messages import mission_messages
from insdvl.simulation.mission import simulate
from insdvl.simulation.noise import SCENARIOS
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.trajectories import BASELINE

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "start" / "my-first-bag.md").read_text(encoding="utf-8")


@pytest.fixture
def at_sea(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with `mission-bag`: IMU and DVL alone, and the page's better.yaml."""
    mission = simulate(
        BASELINE["circle"],
        SCENARIOS["constant-tableI"],
        seed=9,
        duration=60.0,
        dvl=DvlModel(noise_std=(0.02, 0.02, 0.02)),
        start_ns=17 * 10**17,
    )
    with BagWriter(tmp_path / "mission-bag") as bag:
        for timed in mission_messages(mission, message_of, FORM):
            if not timed.topic.startswith("ground_truth"):
                bag.write(encode(f"/{timed.topic}", timed.time_ns, timed.message))
    (block,) = re.findall(r"```\n(/\*\*/insdvl_.*?)```", PAGE, re.DOTALL)
    (tmp_path / "better.yaml").write_text(block)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_every_command_runs(at_sea: Path, capsys: pytest.CaptureFixture[str]) -> None:
    commands = re.findall(r"^insdvl (.*)$", PAGE, re.MULTILINE)
    assert len(commands) == 5
    for command in commands:
        assert cli.main(shlex.split(command)) == 0
    said = capsys.readouterr().out
    assert said.count("Is it right?") == 2
    assert "NOT RIGHT: heading unknown" in said  # of the first run
    for name in re.findall(r"`(second-run/[\w.]+)`", PAGE):
        assert (at_sea / name).is_file()
    assert (at_sea / "first-run" / "report.html").is_file()
    assert (at_sea / "both.html").is_file()
