"""The yardstick of the benchmarks does the filter's work. Nothing is timed here."""

import subprocess
import sys

import pytest
from sources import ROOT


@pytest.mark.long
def test_the_c_filter_agrees_with_ours() -> None:
    done = subprocess.run(
        [sys.executable, str(ROOT / "benchmarks" / "speed.py"), "--validate"],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    if "left out" in done.stdout:
        pytest.skip(done.stdout.strip())
