"""The demo as its user runs it: processes, counts, results, refusals and no orphans."""

import json
import os
import signal
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from ament_index_python.packages import get_package_prefix
from graphs import Graph, children_of, runs
from sensor_msgs.msg import Imu

from insdvl.messages.convert import imu, process_noise, stamp_ns
from insdvl.messages.dvl import dvl
from insdvl.navigation.events import Imu as Sample
from insdvl.navigation.geometry.frames import ENU
from insdvl.navigation.odometry import odometry
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.sections import load_section
from insdvl.recordings.bag_reader import BagReader
from insdvl.simulation.initial_errors import P_0
from insdvl.studies.evaluation.metrics import Scores
from insdvl.timeline.recorded import fold_arrays
from ros_insdvl_sim.trials import demo
from ros_insdvl_sim.trials.demo_graph import (
    CONSUMER_NODES,
    CONSUMERS,
    OUTPUT_DELAY,
    RECORDED,
    initial_parameters,
)
from ros_insdvl_sim.trials.demo_result import print_scores

DEADLINE = 300.0  # s; only a hang takes so long
DURATION = 6.0
NODES = {*CONSUMER_NODES, "/insdvl_simulator"}


def command(out: Path, *arguments: str) -> list[str]:
    executable = Path(get_package_prefix("ros_insdvl_sim")) / "lib/ros_insdvl_sim/demo"
    return [str(executable), "--out", str(out), "--rate-factor", "2", *arguments]


@pytest.fixture
def peer(managed: Any) -> Graph:
    """A node of this process that looks at the demo's graph."""
    return managed(Graph())


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Output folder and printed text of a short demo with a recording."""
    out = tmp_path_factory.mktemp("demo")
    arguments = ("--duration", str(DURATION), "--seed", "4", "--record", str(out / "bag"))
    result = subprocess.run(command(out, *arguments), capture_output=True, text=True)
    assert result.returncode == 0, result.stdout + result.stderr
    return out, result.stdout


def test_every_message_arrives_and_is_counted(flown: tuple[Path, str]) -> None:
    out, printed = flown
    summary = json.loads((out / "summary.json").read_text())
    counts = {(m["consumer"], m["topic"]): m for m in summary["messages"]}
    for count in counts.values():
        assert count["sent"] == count["received"]
    for consumer in ("tuner", "/constant filter", "/learned filter"):
        assert counts[consumer, "imu/data_raw"]["received"] == 100 * DURATION
    assert counts["/learned filter", "dvl/velocity"]["received"] == DURATION
    assert counts["/learned filter", "process_noise"]["received"] == DURATION - 1
    published = 100 * (DURATION - OUTPUT_DELAY)
    assert counts["demo", "/constant/odometry/filtered"]["received"] == published
    assert counts["recording", "/imu/data_raw"]["received"] == 100 * DURATION
    with BagReader(out / "bag") as bag:
        for topic in RECORDED:
            assert counts["recording", topic]["received"] == bag.topics[topic].size
    assert set(summary["exit_codes"].values()) == {0}
    assert summary["rejected"] == {"constant": 0, "learned": 0}
    assert "DIFFER" not in printed


def test_summary_begins_with_the_body_velocity(flown: tuple[Path, str]) -> None:
    out, printed = flown
    summary = json.loads((out / "summary.json").read_text())
    assert set(summary["filters"]) == {"constant", "learned"}
    for scores in summary["filters"].values():
        assert 0.0 < scores["body_velocity_rmse"] < 1.0
        assert 0.0 < scores["srmse"] < 1.0
        assert 0.0 < scores["heading_rmse_deg"] < 30.0
    order = [printed.index(text) for text in ("body velocity RMSE", "SRMSE [m/s]", "SMAE")]
    assert order == sorted(order)
    assert (out / "mission.png").read_bytes().startswith(b"\x89PNG")
    for line in ("ros2 topic echo /process_noise", "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"):
        assert line in printed


@pytest.mark.parametrize("name", ["constant", "learned"])
def test_recording_replays_to_the_same_states(flown: tuple[Path, str], name: str) -> None:
    out, _ = flown
    convert = {"/imu/data_raw": imu, "/dvl/velocity": dvl}
    if name == "learned":
        convert["/process_noise"] = process_noise
    topic = f"/{name}/odometry/filtered"
    with BagReader(out / "bag") as bag:
        recorded = list(bag.messages([*convert, topic]))
    published = [r.message for r in recorded if r.topic == topic]
    events = [convert[r.topic](r.message, ENU) for r in recorded if r.topic in convert]
    samples = [event for event in events if isinstance(event, Sample)]
    result = fold_arrays(
        load_section(out / f"{name}.yaml", "insdvl_filter", FilterParameters),
        np.array([sample.stamp_ns for sample in samples]),
        np.array([sample.f_b for sample in samples]),
        np.array([sample.w_ib_b for sample in samples]),
        [event for event in events if not isinstance(event, Sample)],
    )
    assert len(result.updates) == DURATION
    assert len(published) == 100 * (DURATION - OUTPUT_DELAY)
    for k, message in enumerate(published):
        offline = odometry(result.filter, result.states, k)
        assert stamp_ns(message.header) == offline.stamp_ns
        assert message.pose.covariance.tolist() == offline.pose_covariance.ravel().tolist()
        assert message.twist.covariance.tolist() == offline.twist_covariance.ravel().tolist()
        assert message.pose.pose.position.x == offline.position[0]
        assert message.twist.twist.linear.z == offline.twist_linear[2]


def test_both_filters_start_with_the_same_wrong_state(flown: tuple[Path, str]) -> None:
    out, _ = flown
    sections = [
        yaml.safe_load((out / f"{name}.yaml").read_text())["/**/insdvl_filter"]["ros__parameters"]
        for name in ("constant", "learned")
    ]
    assert sections[0]["initial"] == sections[1]["initial"]
    initial = sections[0]["initial"]
    assert initial["velocity"] != pytest.approx([1.0, 0.0, 0.0], abs=1e-3)
    assert initial == initial_parameters(4)["initial"]
    assert initial != initial_parameters(5)["initial"]


def test_initial_errors_are_drawn_from_the_initial_covariance() -> None:
    drawn = [initial_parameters(seed)["initial"] for seed in range(400)]
    velocity = np.array([d["velocity"] for d in drawn])
    rpy = np.array([d["rpy"] for d in drawn])
    sigma = P_0
    np.testing.assert_allclose(velocity.std(axis=0), sigma.velocity_std, rtol=0.15)
    np.testing.assert_allclose(rpy[:, :2].std(axis=0), sigma.tilt_std, rtol=0.15)
    np.testing.assert_allclose(rpy[:, 2].std(), sigma.heading_std, rtol=0.15)


def test_refuses_to_start_beside_another_publisher(peer: Graph, tmp_path: Path) -> None:
    peer.peer.create_publisher(Imu, "/imu/data_raw", 10)
    result = subprocess.run(command(tmp_path), capture_output=True, text=True)
    assert result.returncode == 1
    assert "/imu/data_raw already has a publisher" in result.stderr
    peer.until(lambda: not NODES & peer.node_names())


@pytest.mark.long
@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_it_leaves_no_process(
    peer: Graph, tmp_path: Path, kind: signal.Signals
) -> None:
    """Interrupted twice: in flight, or while its processes start."""
    with (tmp_path / "log").open("wb") as log:
        process = subprocess.Popen(command(tmp_path / "out"), stdout=log, stderr=log)
    try:
        if kind == signal.SIGINT:
            peer.until(lambda: peer.node_names() >= NODES)
        else:
            peer.until(lambda: len(children_of(process.pid)) == len(CONSUMERS))
        children = children_of(process.pid)
        process.send_signal(kind)
        process.send_signal(kind)
        assert process.wait(DEADLINE) == 130
    finally:
        process.kill()
    peer.until(lambda: not any(map(runs, children)))
    assert b"Traceback" not in (tmp_path / "log").read_bytes()


def test_dead_process_ends_the_demo_with_its_name(peer: Graph, tmp_path: Path) -> None:
    process = subprocess.Popen(command(tmp_path), stderr=subprocess.PIPE, stdout=subprocess.DEVNULL)
    try:
        peer.until(lambda: peer.node_names() >= NODES)
        children = children_of(process.pid)
        (tuner,) = (c for c, text in children.items() if "ros_insdvl/tuner" in text)
        os.kill(tuner, signal.SIGKILL)
        _, errors = process.communicate(timeout=DEADLINE)
    finally:
        process.kill()
    assert process.returncode == 1
    assert b"tuner ended with exit code -9" in errors
    peer.until(lambda: not any(map(runs, children)))


@pytest.mark.parametrize(
    ("option", "value", "allowed"),
    [
        ("--duration", "1.5", "0 or from 4 to 330 s"),
        ("--duration", "nan", "0 or from 4 to 330 s"),
        ("--rate-factor", "-1", "0 or above"),
        ("--rate-factor", "inf", "0 or above"),
        ("--seed", "-1", "0 or above"),
    ],
)
def test_option_out_of_range_is_named(
    capsys: pytest.CaptureFixture[str], option: str, value: str, allowed: str
) -> None:
    with pytest.raises(SystemExit) as ended:
        demo.parse([option, value])
    assert ended.value.code == 2
    error = capsys.readouterr().err
    assert f"{option} must be {allowed}, got {value}" in error


@pytest.mark.parametrize(("learned", "word"), [(0.09, "10.0 % better"), (0.11, "10.0 % WORSE")])
def test_it_says_plainly_which_filter_is_better(
    capsys: pytest.CaptureFixture[str], learned: float, word: str
) -> None:
    rest = {name: 1.0 for name in Scores.__dataclass_fields__ if name != "body_velocity_rmse"}
    print_scores(
        {
            "constant": Scores(body_velocity_rmse=0.1, **rest),
            "learned": Scores(body_velocity_rmse=learned, **rest),
        }
    )
    assert word in capsys.readouterr().out
