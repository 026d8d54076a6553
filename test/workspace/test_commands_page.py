"""Every command on the page of commands is run, on a simulated recording."""

import re
import shlex
from pathlib import Path

import pytest
from looked_at import flown, raws_of
from recordings import save
from sources import ROOT

from insdvl.cli import main
from insdvl.commands import COMMANDS, parser_of

PAGE = (ROOT / "docs" / "reference" / "commands.md").read_text()
#: These compile everything or fly hundreds of missions: their calls are parsed, and tests of their
#: own run them.
LONG = {"warm", "train", "evaluate", "results", "consistency"}
#: Of what `insdvl export` writes.
MAP = """
imu:
  stamp: stamp
  specific_force: [specific_force_x, specific_force_y, specific_force_z]
  angular_rate: [angular_rate_x, angular_rate_y, angular_rate_z]
dvl: {stamp: stamp, velocity: [velocity_x, velocity_y, velocity_z]}
"""


def calls() -> list[list[str]]:
    blocks = re.findall(r"^```\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    return [shlex.split(line)[1:] for block in blocks for line in block.splitlines()]


def test_every_command_is_on_the_page() -> None:
    assert {words[0] for words in calls()} == COMMANDS.keys()
    rows = re.findall(r"^\| \[(\w+)\]\(#[\w-]+\) \| (.*?) \|", PAGE, re.MULTILINE)
    assert {name for name, _ in rows} == COMMANDS.keys()


def test_every_call_on_the_page_works(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("shtab")
    monkeypatch.chdir(tmp_path)
    save(tmp_path / "dive", raws_of(flown(12.0)))
    assert main(["init", "dive", "-o", "vehicle.yaml"]) == 0
    (tmp_path / "further.yaml").write_text("/**: {ros__parameters: {dvl.max_speed: 5.0}}\n")
    (tmp_path / "map.yaml").write_text(MAP)
    for words in calls():
        if words[0] in LONG:
            parser_of(words[0]).parse_args(words[1:])
        else:
            assert main(words) == 0, words
    made = {path.name for path in tmp_path.iterdir()}
    assert made >= {"my.yaml", "check.json", "numbers.json", "run1", "track.tum", "imported"}
