"""The commands behind `make faults` and `make soak`, in their short forms."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message

from insdvl.events import NS
from insdvl.faults import page
from ros_insdvl.conversions import time_of
from ros_insdvl_sim import faults, process_rows, soak


def test_a_fault_row_of_the_network_is_met(tmp_path: Path) -> None:
    options = faults.parse(["--short", "--parts", "processes", "--out", str(tmp_path)])
    assert faults.run(options) == 0
    document = json.loads((tmp_path / "reliability" / "processes.json").read_text())
    (row,) = document["rows"]
    assert row["met"] and row["lost"] == 0
    assert row["fault"] in (tmp_path / "reliability.md").read_text()


@pytest.mark.parametrize(
    ("published", "lives", "output_delay", "lost"),
    [
        (range(1, 101), (), 0.0, 0),
        (range(1, 91), (), 0.0, 10),  # it died before the end
        (range(1, 91), (), 0.1, 0),  # it holds them back
        ([k for k in range(1, 101) if k != 50], (), 0.0, 1),
        ([*range(1, 31), *range(61, 101)], (0.6,), 0.0, 0),  # nobody was there in between
        ([*range(1, 31), *range(61, 91)], (0.6,), 0.0, 10),
    ],
)
def test_a_sample_without_output_is_lost(
    published: Sequence[int], lives: Sequence[float], output_delay: float, lost: int
) -> None:
    def odometry(k: int) -> tuple[int, bytes]:
        stamp_ns = round(process_rows.START_S * NS) + k * NS // 100
        message = Odometry()
        message.header.stamp = time_of(stamp_ns)
        message.twist.covariance = np.eye(6).ravel()
        return stamp_ns, serialize_message(message)

    outcome = process_rows.Outcome("a fault")
    with process_rows.sea(4.0) as sea:
        sea.truth = dict(map(odometry, range(101)))
        sea.odometry = list(map(odometry, published))
        sea.judge(outcome, 0.0, 0.1, lives=lives, output_delay=output_delay)
    assert outcome.lost == lost
    (check,) = [c for c in outcome.checks if c["expected"] == "no valid message lost"]
    assert check["met"] == (lost == 0)


def test_the_short_form_has_the_rows_that_it_names() -> None:
    assert {row.name for row in faults.short_rows()} == set(faults.SHORT)
    assert sum(in_short for _, in_short, _ in process_rows.ROWS) == 1


def test_legs_of_a_soak_add_up(tmp_path: Path) -> None:
    options = ["--leg", "20", "--rate-factor", "4", "--out", str(tmp_path)]
    assert soak.run(soak.parse([*options, "--hours", "2"])) == 0
    file = tmp_path / "reliability" / "soak.json"
    first = json.loads(file.read_text())["legs"]
    assert [leg["leg"] for leg in first] == [0, 1]
    for leg in first:
        assert page.lost(leg) == 0
        assert {row["sent"] for row in leg["messages"] if row["topic"] == "imu/data_raw"} == {2000}
        assert leg["nis"] < 8.0 and leg["body_velocity_rmse"] < 0.5
        assert leg["memory"]["filter"]["end"] > 10.0
    # What is there is kept, and the page is of it.
    assert soak.run(soak.parse([*options, "--hours", "0"])) == 0
    assert json.loads(file.read_text())["legs"] == first
    found = page.documents(tmp_path / "reliability")
    assert soak.run(soak.parse([*options, "--hours", "0", "--core-hours", "1"])) == 0
    assert (tmp_path / "reliability.md").read_text() != page.markdown(found)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--hours", "-1"], "--hours must be >= 0, got -1"),
        (["--leg", "5"], "--leg must be from 10 to 3600 s, got 5"),
        (["--rate-factor", "nan"], "--rate-factor must be from 0 to 1000, got nan"),
    ],
)
def test_what_the_soak_refuses(
    options: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        soak.parse(options)
    assert sentence in capsys.readouterr().err


def test_what_the_faults_refuse(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        faults.parse(["--parts", "moon"])
    assert "--parts must be of messages,processes, got 'moon'" in capsys.readouterr().err
