"""The script that puts a bad link made by the kernel between simulator and filter."""

import re
import subprocess
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix

SCRIPT = Path(__file__).parents[2] / "tools" / "network_namespaces.sh"
NOT_HERE = 77


def test_it_counts_what_the_filter_made_of_what_was_sent() -> None:
    prefix = Path(get_package_prefix("ros_insdvl"))
    if not (prefix / "bin" / "python").exists():
        pytest.skip(f"{prefix} is not an environment that make has built")
    done = subprocess.run(
        [SCRIPT, prefix, "duplicate", "1%"],  # nothing is lost
        capture_output=True,
        text=True,
        timeout=300.0,
        check=False,
    )
    if done.returncode == NOT_HERE:
        assert re.fullmatch(r"skipped: .+\n", done.stderr)
        pytest.skip(done.stderr.strip())
    assert done.returncode == 0, done.stderr
    assert "sent: imu/data_raw 3000, dvl/velocity 30" in done.stdout
    counts = re.search(r"filter: received imu/data_raw (\d+), .*/filtered (\d+),", done.stdout)
    assert counts is not None, done.stdout
    received, made = map(int, counts.groups())
    assert 0 < made <= received <= 3000
