"""`insdvl init`: the file is read by `insdvl replay`, and holds what the recording tells."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from looked_at import START_NS, flown, raws_of
from recordings import save

from insdvl import cli
from insdvl.messages.convert import FIX
from insdvl.messages.depth import PRESSURE
from insdvl.navigation.events import NS
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import flatten
from insdvl.parameters.sections import load_section
from insdvl.recordings.base import encode, new_message
from insdvl.recordings.messages import twist_message
from insdvl.recordings.parameters import ReplayParameters
from insdvl.simulation.drawn.scenarios import DRAWN
from insdvl.simulation.grades import GRADES
from insdvl.simulation.mission import simulate
from insdvl.simulation.motion import Channel, Wave
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.sensors.imu import ImuModel
from insdvl.simulation.trajectories import AUV, BASELINE
from insdvl.studies.check.findings import CHECK
from insdvl.studies.report.parameter_page import TO_SET

SECONDS = 25.0


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save(tmp_path_factory.mktemp("bags") / "dive", raws_of(flown(SECONDS)))


@pytest.fixture(scope="module")
def written(bag: Path) -> Path:
    path = bag.parent / "my.yaml"
    assert cli.main(["init", str(bag), "-o", str(path)]) == 0
    return path


def test_it_has_the_ten_that_matter_in_some_25_lines(written: Path) -> None:
    text = written.read_text()
    assert 20 <= len(text.splitlines()) <= 30
    assert [name for name in TO_SET if f"    {name}: " not in text] == []
    rows = re.findall(r"^    (\S+: .+)$", text, re.MULTILINE)
    assert [row for row in rows if " # " not in row] == []
    assert "dvl.lever_arm: [0.0, 0.0, 0.0]  " in text
    assert re.search(rf"dvl\.lever_arm: .* # {CHECK}: ", text)


def test_it_is_filled_from_the_recording(written: Path) -> None:
    parameters = load_section(written, "insdvl_filter", FilterParameters)
    values = flatten(parameters)
    tactical = GRADES["tactical"]
    sigma = np.sqrt(tactical.variances())
    np.testing.assert_allclose(
        np.sqrt(values["process_noise.accelerometer_variance"]), sigma[:3], rtol=0.1
    )
    np.testing.assert_allclose(
        np.sqrt(values["process_noise.gyroscope_variance"]), sigma[3:], rtol=0.1
    )
    assert values["initial.gyroscope_bias_std"] == pytest.approx(tactical.gyroscope_bias, rel=0.02)
    assert values["frame_convention"] == "enu"
    assert values["imu.rate"] == 100.0
    assert 0.01 < values["dvl.noise_std"][0] < 0.04
    replay = load_section(written, "insdvl_replay", ReplayParameters)
    assert (replay.imu_topic, replay.dvl_topic) == ("/imu", "/dvl")
    assert replay.ground_truth_topic == "/truth"


def test_a_further_imu_or_dvl_is_to_be_looked_at(tmp_path: Path, bag: Path, written: Path) -> None:
    """Where there is one of each, nothing is to be looked at."""
    assert re.findall(rf"(?:imu|dvl)_topic: .*{CHECK}", written.read_text()) == []
    raws = raws_of(flown(3.0))
    others = {"/imu": "/camera/imu", "/dvl": "/other/dvl"}
    doubled = [
        copy
        for raw in raws
        for copy in (raw, raw._replace(topic=others.get(raw.topic, "")))
        if copy.topic
    ]
    path = tmp_path / "my.yaml"
    assert cli.main(["init", str(save(tmp_path / "two", doubled)), "-o", str(path)]) == 0
    text = path.read_text()
    assert re.search(rf'imu_topic: "/imu" .*# {CHECK}: or /camera/imu; sensor_msgs', text)
    assert re.search(rf'dvl_topic: "/dvl" .*# {CHECK}: or /other/dvl; geometry_msgs', text)


def test_replay_navigates_with_it(bag: Path, written: Path, tmp_path: Path) -> None:
    numbers = tmp_path / "numbers.json"
    arguments = ["replay", str(bag), "--config", str(written), "--json", str(numbers)]
    assert cli.main(arguments) == 0
    document = json.loads(numbers.read_text())
    assert document["dvl_accepted"] >= SECONDS - 2
    assert document["body_velocity_rmse"] < 0.1
    assert document["frames"] == []


def test_what_else_is_in_the_recording_is_set(tmp_path: Path) -> None:
    fix, pressure = new_message(FIX), new_message(PRESSURE)
    fix.latitude, pressure.fluid_pressure = 59.912, 2e5
    for message in (fix, pressure):
        message.header.stamp.sec = START_NS // NS
    others = [encode("/fix", START_NS, fix), encode("/ctd/pressure", START_NS, pressure)]
    bag = save(tmp_path / "dive", [*others, *raws_of(flown(3.0))])
    assert cli.main(["init", str(bag), "-o", str(tmp_path / "my.yaml")]) == 0
    parameters = load_section(tmp_path / "my.yaml", "insdvl_filter", FilterParameters)
    assert parameters.origin.latitude_deg == 59.91
    assert parameters.depth.topic == "ctd/pressure"
    assert "59.91   " in (tmp_path / "my.yaml").read_text()


def test_the_noise_of_a_speed_along_one_axis_is_that_of_its_scatter(tmp_path: Path) -> None:
    mission = flown(SECONDS)
    R = np.diag([0.0, np.inf, np.inf])
    speeds = zip(mission.dvl_stamps_ns.tolist(), mission.v_d[:, 0], strict=True)
    raws = [raw for raw in raws_of(mission) if raw.topic != "/dvl"]
    for stamp_ns, v in speeds:
        raws.append(encode("/dvl", stamp_ns, twist_message(stamp_ns, "dvl", [v, 0.0, 0.0], R)))
    bag = save(tmp_path / "dive", sorted(raws, key=lambda raw: raw.time_ns))
    assert cli.main(["check", str(bag), "--json", str(tmp_path / "seen.json")]) == 0
    assert json.loads((tmp_path / "seen.json").read_text())["dvl"]["scatter"][1:] == [None, None]
    assert cli.main(["init", str(bag), "-o", str(tmp_path / "my.yaml")]) == 0
    sigma = load_section(tmp_path / "my.yaml", "insdvl_filter", FilterParameters).dvl.noise_std
    assert 0.01 < sigma[0] < 0.04


def test_the_noise_of_the_dvl_is_without_its_outliers(tmp_path: Path) -> None:
    """Of the pings 6 % are off by 2 m/s, one in each window of the alignment."""
    mission = flown(125.0)
    rng = np.random.default_rng(3)
    v = mission.v_d.copy()
    v[8::17] += rng.choice([-2.0, 2.0], v[8::17].shape) / np.sqrt(3.0)
    bag = save(tmp_path / "dive", raws_of(replace(mission, v_d=v)))
    assert cli.main(["init", str(bag), "-o", str(tmp_path / "my.yaml")]) == 0
    sigma = load_section(tmp_path / "my.yaml", "insdvl_filter", FilterParameters).dvl.noise_std
    assert sigma[0] == pytest.approx(0.02, rel=0.2)


def test_an_existing_file_is_left_alone(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("mine")
    assert cli.main(["init", str(bag), "-o", str(path)]) == 2
    assert "exists already and is not overwritten" in capsys.readouterr().err
    assert path.read_text() == "mine"


def test_nothing_is_written_of_what_is_not_usable(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = save(tmp_path / "no_dvl", [r for r in raws_of(flown(3.0)) if r.topic != "/dvl"])
    assert cli.main(["init", str(bag), "-o", str(tmp_path / "my.yaml")]) == 1
    assert "No topic has a type of a DVL" in capsys.readouterr().err
    assert not (tmp_path / "my.yaml").exists()


def test_a_simulator_without_noise_gives_parameters_that_a_filter_takes(tmp_path: Path) -> None:
    mission = simulate(
        AUV,
        constant([0.0] * 6),
        seed=1,
        duration=SECONDS,
        imu=ImuModel(accelerometer_bias_walk=0.0, gyroscope_bias_walk=0.0),
        dvl=DvlModel(noise_std=np.zeros(3)),
        start_ns=START_NS,
    )
    path, written = save(tmp_path / "dive", raws_of(mission)), tmp_path / "my.yaml"
    assert cli.main(["init", str(path), "-o", str(written)]) == 0
    parameters = load_section(written, "insdvl_filter", FilterParameters)
    noise = parameters.process_noise
    assert min(parameters.dvl.noise_std) >= 1e-3
    assert min(noise.accelerometer_variance) >= noise.accelerometer_floor
    assert min(noise.gyroscope_variance) >= noise.gyroscope_floor


@pytest.mark.parametrize(
    ("rate", "corner"),
    [
        (62.5, 6.0),
        *(
            pytest.param(*both, marks=pytest.mark.long)
            for both in ((100.0, 8.0), (200.0, 15.0), (1000.0, 50.0))
        ),
    ],
)
def test_an_imu_with_a_low_pass_has_the_noise_below_it_and_accuses_nothing(
    rate: float, corner: float, tmp_path: Path
) -> None:
    """A MEMS IMU, whose differences have a hundredth of what a filter integrates."""
    mems = GRADES["mems"]
    q = mems.variances(rate)
    mission = simulate(
        AUV,
        constant(q),
        seed=77,
        duration=150.0 if rate < 1000.0 else 30.0,
        imu=replace(mems.imu(), rate=rate, bandwidth=corner),
        dvl=DvlModel(rate=4.0, noise_std=(0.02,) * 3),
        start_ns=START_NS,
    )
    path, written = save(tmp_path / "dive", raws_of(mission)), tmp_path / "my.yaml"
    assert cli.main(["init", str(path), "-o", str(written)]) == 0
    assert "at low frequencies, by the model bands" in written.read_text()
    noise = load_section(written, "insdvl_filter", FilterParameters).process_noise
    found = np.array([*noise.accelerometer_variance, *noise.gyroscope_variance])
    assert (found > q / 4.0).all() and (found < 4.0 * q).all()


@pytest.mark.parametrize("frequency", [17.0, 39.6, 45.0])
def test_vibration_is_no_noise_of_a_sample(frequency: float, tmp_path: Path) -> None:
    """A hundred times as strong; at 39.6 Hz differences of all orders show the same."""
    mission = flown(60.0)
    noise = np.sqrt(GRADES["tactical"].variances())
    t = (mission.stamps_ns - START_NS) / NS
    shaken = np.sin(2.0 * np.pi * frequency * t)[:, None] * 10.0 * np.sqrt(2.0) * noise
    raws = raws_of(
        replace(mission, f_b=mission.f_b + shaken[:, :3], w_ib_b=mission.w_ib_b + shaken[:, 3:])
    )
    path, written = save(tmp_path / "dive", raws), tmp_path / "my.yaml"
    assert cli.main(["init", str(path), "-o", str(written)]) == 0
    told = load_section(written, "insdvl_filter", FilterParameters).process_noise
    found = np.array([*told.accelerometer_variance, *told.gyroscope_variance])
    assert (found > noise**2 / 10.0).all() and (found < 10.0 * noise**2).all()
    assert "at low frequencies" in written.read_text()


@pytest.mark.parametrize(
    ("rate", "seed"),
    [
        (100.0, 1),
        pytest.param(100.0, 3, marks=pytest.mark.long),
        pytest.param(200.0, 3, marks=pytest.mark.long),
    ],
)
def test_vibration_is_no_reason_to_believe_a_dvl_more(
    rate: float, seed: int, tmp_path: Path
) -> None:
    """It is in the pings as in the samples, and no noise of the IMU that would explain theirs."""
    fog = GRADES["fog"]
    mission = simulate(
        AUV,
        fog.of_scenario(DRAWN["vibrating"], rate),
        seed=seed,
        duration=160.0,
        imu=fog.imu(rate),
        dvl=DvlModel(noise_std=(0.02,) * 3),
        start_ns=START_NS,
    )
    path, written = save(tmp_path / "dive", raws_of(mission)), tmp_path / "my.yaml"
    assert cli.main(["init", str(path), "-o", str(written)]) == 0
    parameters = load_section(written, "insdvl_filter", FilterParameters)
    assert 0.017 < parameters.dvl.noise_std[0] < 0.025


@pytest.mark.long
def test_the_verdict_does_not_contradict_the_noise_that_it_wrote(tmp_path: Path) -> None:
    """Of a DVL with 3 mm/s from ping to ping, and as much that lasts for 20 s."""
    grade = GRADES["tactical"]
    dvl = DvlModel(rate=5.0, noise_std=(0.003,) * 3, bias_std=0.003, bias_time_constant=20.0)
    variances = constant(grade.variances())
    trajectory = replace(BASELINE["lawn_mower"], speed=Channel(1.6, waves=(Wave(0.3, 11.0),)))
    for seed in (1, 2):
        mission = simulate(
            trajectory,
            variances,
            seed=seed,
            duration=150.0,
            imu=grade.imu(),
            dvl=dvl,
            start_ns=START_NS,
        )
        path, written = save(tmp_path / f"dive{seed}", raws_of(mission)), tmp_path / f"{seed}.yaml"
        assert cli.main(["init", str(path), "-o", str(written)]) == 0
        assert load_section(written, "insdvl_filter", FilterParameters).dvl.noise_std == (0.01,) * 3
        assert " from ping to ping, and at least dvl.noise_floor" in written.read_text()
        numbers = tmp_path / f"{seed}.json"
        assert cli.main(["replay", str(path), "-c", str(written), "--json", str(numbers)]) == 0
        judged = json.loads(numbers.read_text())["verdict"]
        assert 0.002 < judged["dvl_noise"]["shown"] < 0.006
        assert [f["name"] for f in judged["findings"] if f["cautious"]] == []
        assert "dvl_noise" not in [finding["name"] for finding in judged["findings"]]


def test_the_parameters_are_told_as_json(
    bag: Path, written: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "my.yaml"
    capsys.readouterr()
    assert cli.main(["init", str(bag), "-o", str(out), "--json", "-"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert out.read_text() == written.read_text()
    assert (told["bag"], told["file"]) == (str(bag), str(out))
    values = flatten(load_section(out, "insdvl_filter", FilterParameters))
    of_filter = told["parameters"]["insdvl_filter"]
    assert {name: line["value"] for name, line in of_filter.items()} == {
        name: list(values[name]) if isinstance(values[name], tuple) else values[name]
        for name in of_filter
    }
    assert of_filter["dvl.lever_arm"]["why"].startswith(CHECK)
    assert told["parameters"]["insdvl_replay"]["imu_topic"]["value"] == "/imu"


def test_what_is_set_stands_in_the_file(tmp_path: Path) -> None:
    save(tmp_path / "dive", raws_of(flown(12.0)))
    out = tmp_path / "my.yaml"
    given = ["--set", "dvl.max_speed=3", "--set", "dvl.lever_arm=[0.5, 0.0, 0.0]"]
    assert cli.main(["init", str(tmp_path / "dive"), *given, "-o", str(out)]) == 0
    text = out.read_text()
    assert re.search(r"dvl.max_speed: 3(\.0)? +# as set", text)
    assert re.search(r"dvl.lever_arm: \[0.5, 0(\.0)?, 0(\.0)?\] +# as set", text)
