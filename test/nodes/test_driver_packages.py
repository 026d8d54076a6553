"""The filter with the real classes of drivers' types, from packages that are built here."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from message_packages import build, can_build, write

from insdvl.messages.drivers import (
    DAVE,
    DVL_MSGS,
    MARINE_ACOUSTIC,
    NUCLEUS_BOTTOM,
    NUCLEUS_WATER,
    STONEFISH,
)
from insdvl.recordings.drivers import DEFINITIONS

SUPPORT = Path(__file__).parents[1] / "support"


@pytest.mark.long
@pytest.mark.skipif(not can_build(), reason="needs gcc, g++ and the headers of Python")
def test_each_type_is_received_from_its_own_class(tmp_path: Path) -> None:
    """Ten good pings and ten that are marked as none, for each type."""
    for package in write(tmp_path, dict(DEFINITIONS)):
        build(tmp_path, package)
    environment = os.environ | {
        "LD_LIBRARY_PATH": f"{tmp_path / 'lib'}:{os.environ.get('LD_LIBRARY_PATH', '')}",
        "PYTHONPATH": f"{tmp_path / 'site'}:{SUPPORT}",
    }
    done = subprocess.run(
        [sys.executable, "-m", "live_driver", *DEFINITIONS],
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    said = dict(line.split(": ", 1) for line in done.stdout.splitlines())
    invalid = "10 used, refused invalid 10"
    assert said == {
        MARINE_ACOUSTIC: invalid,
        DVL_MSGS: invalid,
        STONEFISH: invalid,
        DAVE: "10 used, refused through_water 10",  # it has no mark of validity
        NUCLEUS_BOTTOM: invalid,
        NUCLEUS_WATER: "0 used, refused invalid 10, through_water 10",
    }
