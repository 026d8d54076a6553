"""`insdvl import` and `insdvl export`: the page's commands, numbers, axes, units and errors."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from looked_at import flown, raws_of
from recordings import save
from scipy.spatial.transform import Rotation

from insdvl import cli
from insdvl.arrays import Array
from insdvl.messages import dvl
from insdvl.navigation.geometry.frames import ENU
from insdvl.recordings.bag_reader import BagReader
from insdvl.simulation.mission import Mission
from insdvl.studies.exchange.maps import MapError, read_map
from insdvl.studies.exchange.stamps import even_out

PAGE = (Path(__file__).parents[3] / "docs" / "how-to" / "import.md").read_text()
MAPS = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
G = 9.80665
SIMPLE = """
imu: {stamp: t, specific_force: [fx, fy, fz], angular_rate: [wx, wy, wz]}
dvl: {stamp: t, velocity: [vx, vy, vz]}
"""
IMU_CSV = "t,fx,fy,fz,wx,wy,wz\n" + "".join(f"{1 + k / 100:.2f},0,0,9.8,0,0,0\n" for k in range(20))
DVL_CSV = "t,vx,vy,vz\n1.1,1,2,3\n"


@pytest.fixture(scope="module")
def mission() -> Mission:
    return flown(12.0)


def table(path: Path, names: str, stamps_ns: Array, *columns: Array) -> None:
    values = np.concatenate([c.reshape(len(stamps_ns), -1) for c in columns], axis=1)
    rows = [
        ",".join([f"{s // 10**9}.{s % 10**9:09d}", *(f"{v:.15g}" for v in row)])
        for s, row in zip(stamps_ns.tolist(), values.tolist(), strict=True)
    ]
    path.write_text("\n".join([names, *rows]) + "\n")


@pytest.fixture
def at_desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mission: Mission) -> Path:
    """A folder with the files that the page's first map is for."""
    stamps, f, w = mission.stamps_ns, mission.f_b, mission.w_ib_b
    table(tmp_path / "imu.csv", "time,ax,ay,az,gx,gy,gz", stamps, f / G, np.degrees(w))
    pings = mission.dvl_stamps_ns
    std = np.full(len(pings), 20.0)
    table(tmp_path / "dvl.csv", "time,vx,vy,vz,std", pings, 1e3 * mission.v_d, std)
    truth = mission.truth
    rpy = Rotation.from_matrix(truth.C_o_b).as_euler("xyz", degrees=True)
    names = "time,north,east,down,roll,pitch,yaw"
    p = truth.p_o
    table(tmp_path / "truth.csv", names, stamps, p, rpy)
    (tmp_path / "map.yaml").write_text(MAPS[0])
    monkeypatch.chdir(tmp_path)
    return tmp_path


def messages(path: Path, topic: str) -> list:
    with BagReader(path) as bag:
        return [recorded.message for recorded in bag.messages([topic])]


def vectors(path: Path, topic: str, *fields: str) -> Array:
    found = []
    for message in messages(path, topic):
        for field in fields:
            message = getattr(message, field)
        found.append((message.x, message.y, message.z))
    return np.array(found)


def test_every_command_of_the_page_runs(
    at_desk: Path, mission: Mission, capsys: pytest.CaptureFixture[str]
) -> None:
    for command in re.findall(r"^insdvl (.*)$", PAGE, re.MULTILINE):
        assert cli.main(shlex.split(command)) == 0, capsys.readouterr()
    said = capsys.readouterr().out
    assert "imu.csv: 1200 rows in 11.99 s, 100 Hz" in said
    rows = np.loadtxt(at_desk / "track.tum")
    assert rows.shape[1] == 8 and len(rows) == len(np.loadtxt(at_desk / "track.csv", str)) - 1
    samples = np.loadtxt(at_desk / "samples.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(samples[:, 1:4], mission.f_b @ ENU.body, atol=1e-9)


def test_what_was_taken_and_given_is_told_as_json(
    at_desk: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call = "import imu.csv dvl.csv truth.csv --map map.yaml --out a --json -"
    assert cli.main(shlex.split(call)) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["bag"] == "a"
    imu, dvl, truth = told["files"]
    assert (imu["file"], imu["sensor"], imu["rows"]) == ("imu.csv", "imu", 1200)
    assert imu["rate"] == pytest.approx(100.0) and imu["duration"] == pytest.approx(11.99)
    assert (dvl["sensor"], truth["sensor"], dvl["lines_left_out"]) == ("dvl", "truth", [])
    call = "export a --topic /imu/data_raw -o samples.csv --json -"
    assert cli.main(shlex.split(call)) == 0
    assert json.loads(capsys.readouterr().out) == {
        "bag": "a",
        "topic": "/imu/data_raw",
        "type": "sensor_msgs/msg/Imu",
        "file": "samples.csv",
        "rows": 1200,
    }
    assert cli.main(shlex.split("export a -o b.csv --topic /no --json -")) == 2
    assert capsys.readouterr().out == ""
    # A place that cannot be written is told before anything is.
    call = "import imu.csv dvl.csv --map map.yaml --out c --json no/c.json"
    assert cli.main(shlex.split(call)) == 2
    assert "--json no/c.json: no is not a folder" in capsys.readouterr().err
    assert not Path("c").exists()


def test_axes_and_units_become_those_of_ros(at_desk: Path, mission: Mission) -> None:
    """What is imported is what the simulator's own recording has."""
    assert cli.main(shlex.split("import imu.csv dvl.csv truth.csv --map map.yaml --out a")) == 0
    save(at_desk / "b", raws_of(mission))
    for ours, theirs, *fields in (
        ("/imu/data_raw", "/imu", "linear_acceleration"),
        ("/imu/data_raw", "/imu", "angular_velocity"),
    ):
        found, expected = (
            vectors(at_desk / "a", ours, *fields),
            vectors(at_desk / "b", theirs, *fields),
        )
        np.testing.assert_allclose(found, expected, atol=1e-9)
    found = vectors(at_desk / "a", "/dvl/velocity_cov", "twist", "twist", "linear")
    np.testing.assert_allclose(found, vectors(at_desk / "b", "/dvl", "twist", "linear"), atol=1e-9)
    sigma = messages(at_desk / "a", "/dvl/velocity_cov")[0].twist.covariance
    np.testing.assert_allclose(np.diag(sigma.reshape(6, 6)), [4e-4] * 3 + [0.0] * 3)
    truth, reference = (
        messages(at_desk / name, topic)
        for name, topic in (("a", "/ground_truth/odometry"), ("b", "/truth"))
    )
    by_stamp = {(m.header.stamp.sec, m.header.stamp.nanosec): m for m in truth}
    for m in reference[1:]:
        ours = by_stamp[m.header.stamp.sec, m.header.stamp.nanosec]
        for one, other in ((ours.pose.pose, m.pose.pose),):
            p, q = one.position, one.orientation
            assert (p.x, p.y, p.z) == pytest.approx(
                (other.position.x, other.position.y, other.position.z), abs=1e-9
            )
            same = other.orientation
            cosine = q.x * same.x + q.y * same.y + q.z * same.z + q.w * same.w
            assert abs(cosine) == pytest.approx(1.0, abs=1e-12)
        v, u = ours.twist.twist.linear, m.twist.twist.linear
        assert (v.x, v.y, v.z) == pytest.approx((u.x, u.y, u.z), abs=1e-3)  # of differences


def test_every_map_of_the_page_is_valid(tmp_path: Path) -> None:
    assert len(MAPS) == 3
    for text in MAPS:
        (tmp_path / "map.yaml").write_text(text)
        assert {"imu", "dvl"} <= read_map(tmp_path / "map.yaml").sources.keys()


def imported(folder: Path, map_: str, imu: str = IMU_CSV, dvl_text: str = DVL_CSV) -> Path:
    """The recording of files with these texts."""
    for name, text in (("map.yaml", map_), ("imu.csv", imu), ("dvl.csv", dvl_text)):
        (folder / name).write_text(text)
    files = [str(folder / name) for name in ("imu.csv", "dvl.csv")]
    code = cli.main(["import", *files, "--map", f"{folder}/map.yaml", "--out", f"{folder}/bag"])
    assert (code == 0) == (folder / "bag").exists()
    return folder / "bag"


def test_increments_become_rates(tmp_path: Path) -> None:
    rows = [f"{1 + 0.01 * k:.2f} 0 0 0.098 0.02 0 0" for k in range(20) if k != 7]
    bag = imported(tmp_path, MAPS[1], "\n".join(rows), "1.1;1;2;3\n")
    f = vectors(bag, "/imu/data_raw", "linear_acceleration")
    np.testing.assert_allclose(f[:, 2], 9.8, rtol=1e-12)
    w = vectors(bag, "/imu/data_raw", "angular_velocity")
    np.testing.assert_allclose(w[:, 0], np.radians(2.0), rtol=1e-12)


def test_a_single_axis_measures_nothing_else(tmp_path: Path) -> None:
    imu = IMU_CSV.replace("t,", "t,", 1)
    bag = imported(tmp_path, MAPS[2], imu, "t,v\n0.5,7.2\n")
    (message,) = messages(bag, "/dvl/velocity_cov")
    assert message.header.stamp.sec == 1 and message.header.stamp.nanosec == 5 * 10**8
    event = dvl.dvl(message, ENU)
    assert event.measured == (True, False, False)
    assert event.v_d[0] == pytest.approx(2.0) and event.R is None


def test_rows_without_a_number_are_left_out_and_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = imported(tmp_path, SIMPLE, dvl_text="t,vx,vy,vz\n1.0,nan,1,1\n1.1,1,2,3\n1.2,,,\n")
    assert len(messages(bag, "/dvl/velocity")) == 1
    assert "2 without a number left out (lines 2, 4)" in capsys.readouterr().out


def test_stamps_keep_their_nanoseconds(tmp_path: Path) -> None:
    bag = imported(tmp_path, SIMPLE, dvl_text="t,vx,vy,vz\n1700000000.123456789,1,2,3\n")
    (message,) = messages(bag, "/dvl/velocity")
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1700000000, 123456789)


def test_stamps_of_arrival_are_evened_out() -> None:
    """Bursts of ten messages, random delays, and a gap in which nothing was sampled."""
    rng = np.random.default_rng(5)
    true = np.concatenate([np.arange(1000), np.arange(1000) + 1500.25]) * 0.01 + 100.0
    burst = np.repeat(np.maximum.reduceat(true, np.arange(0, 2000, 10)), 10)
    arrivals = np.maximum.accumulate(burst + rng.exponential(0.004, 2000))
    evened = even_out(np.round(arrivals * 1e9).astype(np.int64))
    error = evened.stamps_ns * 1e-9 - true
    assert evened.rate == pytest.approx(100.0, rel=1e-3)  # a sample in each run
    for run in (error[:1000], error[1000:]):  # a delay that all have stays
        assert run.std() < 1e-3
        assert 0.0 <= run.mean() < 0.02
    assert (evened.delays >= 0.0).all()


def test_a_stream_with_missing_samples_is_not_evened_out() -> None:
    regular = np.arange(3000) * 10**7
    stamps = np.concatenate([regular[:1000], regular[1000:2000:4], regular[2000:]])
    with pytest.raises(ValueError, match="samples are missing"):
        even_out(stamps)
    with pytest.raises(ValueError, match="too few"):
        even_out(regular[:3])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("specific_force:", "specific_forse:"), "unknown key imu.specific_forse; did you mean"),
        (("velocity:", "speed:"), "dvl.speed must be a column"),
        (("stamp: t, velocity", "stamp: t, axes: [x, y, -z], velocity"), "right-handed"),
        (("stamp: t, velocity", "stamp: t, axes: [x, -y, q], velocity"), "such as [x, -y, -z]"),
        (("stamp: t, velocity", "stamp_unit: h, stamp: t, velocity"), "stamp_unit must be one of"),
        (("stamp: t, velocity", "velocity_unit: knots, stamp: t, velocity"), "cm/s, mm/s, km/h"),
        (("stamp: t, velocity", "velocity"), "dvl.stamp must be the name or the number"),
        (("[vx, vy, vz]", "[vx, vy]"), "dvl.velocity must be 3 columns"),
        (("[vx, vy, vz]", "[vx, vy, vzz]"), "has no column 'vzz'; did you mean"),
        (("[vx, vy, vz]", "[1, 2, 9]"), "line 2 has 4 columns, column 9 is needed"),
        (("dvl:", "dlv:"), "unknown key dlv; did you mean dvl?"),
        (("imu:", "stamp_offset: soon\nimu:"), "stamp_offset must be a number"),
        (("imu:", "stamp_offset: -2\nimu:"), "stamps must be above 0: set stamp_offset"),
        (("imu:", "stamp_offset: 3.0e9\nimu:"), "at most 2147483647 s is possible"),
        (("{stamp: t, velocity: [vx, vy, vz]}", "4"), "dvl must be a section"),
        (("imu:", "imu"), "map.yaml"),
    ],
)
def test_a_wrong_map_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: tuple[str, str], message: str
) -> None:
    assert not imported(tmp_path, SIMPLE.replace(*change)).exists()
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,vx,vy,vz\n1.1,1,2,fast\n", "dvl.csv line 2: 'fast' is not a number"),
        ("t,vx,vy,vz\nsoon,1,2,3\n", "dvl.csv line 2: 'soon' is not a stamp"),
        ("t,vx,vy,vz\n0,1,2,3\n", "has the stamp 0 s"),
        ("t,vx,vy,vz\n", "has no row with numbers"),
        ("", "dvl.csv is empty"),
        ("# nothing but a comment\n", "dvl.csv is empty"),
        ("t,vx,vy,vz\n1.1,1,2\n", "line 2 has 3 columns"),
    ],
)
def test_a_wrong_file_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, message: str
) -> None:
    assert not imported(tmp_path, SIMPLE, dvl_text=text).exists()
    assert message in capsys.readouterr().err


def test_several_faults_of_a_map_are_told_at_once(tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text("imu: {stamp: true}\nfoo: 1\n")
    with pytest.raises(MapError) as caught:
        read_map(tmp_path / "map.yaml")
    assert len(str(caught.value).splitlines()) == 5


def test_wrong_exports_are_told(
    tmp_path: Path, mission: Mission, capsys: pytest.CaptureFixture[str]
) -> None:
    save(tmp_path / "b", raws_of(mission)[:50])
    for options, message in (
        (["-o", f"{tmp_path}/a.txt"], "must end in .csv or .tum"),
        (["-o", f"{tmp_path}/a.tum", "--topic", "/imu"], "TUM needs nav_msgs/msg/Odometry"),
        (["-o", f"{tmp_path}/a.csv", "--topic", "/there"], "is not in"),
        (["-o", f"{tmp_path}/no/a.csv"], "is not a folder"),
    ):
        assert cli.main(["export", str(tmp_path / "b"), *options]) == 2
        assert message in capsys.readouterr().err
    assert not list(tmp_path.glob("a.*"))


@pytest.mark.parametrize(
    "head",
    [
        "# A logger's name, version 3\n# 2024-01-01\nt,fx,fy,fz,wx,wy,wz\n",
        "# A logger's name, version 3\n# t, fx, fy, fz, wx, wy, wz\n# units: SI\n",
    ],
)
def test_comments_before_the_names_and_names_in_a_comment_are_read(
    tmp_path: Path, head: str
) -> None:
    bag = imported(tmp_path, SIMPLE, imu=head + IMU_CSV.partition("\n")[2])
    assert len(messages(bag, "/imu/data_raw")) == 20
