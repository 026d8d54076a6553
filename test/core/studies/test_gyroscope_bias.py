"""The gyroscope's bias that a recording shows, at rest and under way, and what init makes of it.

The IMU of a phone has the noise of a MEMS and a bias of 0.01 rad/s, twenty times the grade's.
"""

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from looked_at import START_NS, raws_of
from recordings import save

from insdvl import cli
from insdvl.arrays import Array
from insdvl.navigation.events import NS, Imu
from insdvl.navigation.geometry.frames import rotation_from_rpy
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.sections import load_section
from insdvl.recordings.base import encode
from insdvl.recordings.messages import twist_message
from insdvl.simulation.grades import GRADES
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.motion import Channel, Ramp, Trajectory, Wave
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.sensors.imu import ImuModel
from insdvl.simulation.trajectories import AUV, BASELINE, LOOP, STATIC
from insdvl.studies.check.bias import BiasLog, GyroscopeBias

PHONE = np.repeat([0.02, 0.002], 3) ** 2
BIAS = 0.01  # rad/s
MEMS = GRADES["mems"].gyroscope_bias
#: Rest for 20 s, then right angles to either side at 9 m/s.
CAR = Trajectory(
    duration=80.0,
    speed=Channel(ramps=(Ramp(23.0, 29.0, 9.0),)),
    heading=Channel(0.7, ramps=(Ramp(40.0, 47.0, math.pi / 2), Ramp(60.0, 67.0, -math.pi / 2))),
    pitch=Channel(ramps=(Ramp(35.0, 40.0, math.radians(3.0)),)),
    h_0=20.0,
)


def phone(trajectory: Trajectory, seconds: float, seed: int, rate: float = 1.0) -> Mission:
    return simulate(
        trajectory,
        constant(PHONE),
        seed=seed,
        duration=seconds,
        imu=ImuModel(accelerometer_bias_std=0.05, gyroscope_bias_std=BIAS),
        dvl=DvlModel(rate=rate, noise_std=(0.05,) * 3),
        start_ns=START_NS,
    )


def shown(
    mission: Mission, v_d: Array | None = None, C_i_b: Array | None = None, axes: int = 3
) -> GyroscopeBias | None:
    """What is shown by the samples, and by the first axes of the velocities."""
    log, C = BiasLog(0.1), np.eye(3) if C_i_b is None else C_i_b
    v_d = mission.v_d if v_d is None else v_d
    measured = (True, axes > 1, axes > 2)
    pings = [
        Dvl(int(stamp_ns), v * measured, measured=measured)
        for stamp_ns, v in zip(mission.dvl_stamps_ns, v_d, strict=True)
    ]
    samples = zip(mission.stamps_ns, mission.f_b @ C.T, mission.w_ib_b @ C.T, strict=True)
    for stamp_ns, f_b, w_ib_b in samples:
        log.add(Imu(int(stamp_ns), f_b, w_ib_b))
        while pings and pings[0].stamp_ns <= stamp_ns:
            log.add_ping(pings.pop(0))
    return log.found(mission.q[0], 0.05)


def across(bias: Array, up: Array) -> Array:
    return bias - up * (up @ bias)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("trajectory", [STATIC, CAR])
def test_at_rest_the_mean_rate_is_the_bias(trajectory: Trajectory, seed: int) -> None:
    mission = phone(trajectory, 60.0, seed)
    found = shown(mission)
    assert found is not None and found.axes == 3 and found.is_usable
    assert np.abs(found.mean - mission.bias[0, 3:]).max() < 4.0 * found.std
    assert found.std < 3e-4 and found.seconds >= 10.0
    assert found.exceeds(MEMS)


@pytest.mark.parametrize("rpy", [(0.0, 0.0, 0.0), (0.3, -0.2, 1.5)])
@pytest.mark.parametrize("trajectory", [LOOP, *BASELINE.values()])
def test_under_way_the_bias_across_gravity_shows(
    trajectory: Trajectory, rpy: tuple[float, ...]
) -> None:
    """Also of an IMU that is mounted aslant, on a steady circle and in a spiral dive."""
    mission, C_i_b = phone(trajectory, 300.0, 2), rotation_from_rpy(np.array(rpy))
    found = shown(mission, C_i_b=C_i_b)
    assert found is not None and found.axes == 2 and found.is_usable
    truth = across(C_i_b @ mission.bias[0, 3:], C_i_b @ [0.0, 0.0, -1.0])
    # The vertical bias leaks into these axes by the tilt of a vehicle that dives.
    leak = abs(mission.bias[0, 5]) * math.sin(math.radians(15.0))
    assert np.abs(found.mean - truth).max() < 4.0 * found.std + leak
    assert found.exceeds(MEMS)


@pytest.mark.parametrize("name", GRADES)
@pytest.mark.parametrize("trajectory", [STATIC, AUV, LOOP, *BASELINE.values()])
def test_a_motion_is_no_bias(name: str, trajectory: Trajectory) -> None:
    grade = GRADES[name]
    for rate in (62.5, 100.0):
        mission = simulate(
            trajectory,
            constant(grade.variances(rate)),
            seed=3,
            duration=200.0,
            imu=replace(grade.imu(), rate=rate),
            dvl=DvlModel(noise_std=(0.02,) * 3),
            start_ns=START_NS,
        )
        found = shown(mission)
        assert found is None or not found.exceeds(grade.gyroscope_bias)


def test_a_short_motion_shows_nothing() -> None:
    assert shown(phone(AUV, 100.0, 1)) is None
    assert shown(phone(STATIC, 4.0, 1)) is None


def test_a_vehicle_that_rolls_over_shows_nothing() -> None:
    rolling = replace(AUV, roll=Channel(slope=0.05))
    assert shown(phone(rolling, 300.0, 1)) is None


def test_zeros_without_lock_are_no_rest() -> None:
    """On a steady circle the samples are as steady as at rest; a log along one axis has no lock."""
    mission = phone(LOOP, 200.0, 1)
    found = shown(mission, v_d=np.zeros_like(mission.v_d))
    assert found is None or found.axes == 2
    still = phone(STATIC, 30.0, 1)
    found = shown(still, v_d=np.zeros_like(still.v_d), axes=1)
    assert found is not None and found.axes == 3


def test_without_a_speed_nothing_is_a_rest() -> None:
    mission = phone(STATIC, 60.0, 1)
    assert (
        shown(replace(mission, dvl_stamps_ns=mission.dvl_stamps_ns[:0]), v_d=np.empty((0, 3)))
        is None
    )


def test_a_bias_exceeds_a_sigma_that_makes_it_improbable() -> None:
    bias = GyroscopeBias(np.array([2e-3, 0.0, 0.0]), 2e-4, 3, 20.0, is_usable=True)
    assert bias.exceeds(4e-4) and not bias.exceeds(6e-4)  # 4 sigma of 3 axes
    assert not replace(bias, std=1e-3).exceeds(0.0)


# ---------------------------------------------------------------- insdvl init


def recorded(path: Path, mission: Mission) -> Path:
    """With a speed along x only."""
    R = np.diag([0.0, np.inf, np.inf])
    raws = [raw for raw in raws_of(mission) if raw.topic != "/dvl"]
    for stamp_ns, v in zip(mission.dvl_stamps_ns.tolist(), mission.v_d[:, 0], strict=True):
        raws.append(encode("/dvl", stamp_ns, twist_message(stamp_ns, "dvl", [v, 0.0, 0.0], R)))
    return save(path, sorted(raws, key=lambda raw: raw.time_ns))


def written(bag: Path) -> tuple[float, str]:
    """The sigma that init writes, and why."""
    path = bag.parent / "my.yaml"
    assert cli.main(["init", str(bag), "-o", str(path)]) == 0
    value = load_section(path, "insdvl_filter", FilterParameters).initial.gyroscope_bias_std
    line = re.search(r"initial\.gyroscope_bias_std: .* # (.*)", path.read_text())
    assert line is not None
    return value, line[1]


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])
def test_a_car_with_the_imu_of_a_phone_keeps_its_track(
    seed: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mission = phone(CAR, 80.0, seed, rate=10.0)
    bag = recorded(tmp_path / "drive", mission)
    size = float(np.linalg.norm(mission.bias[0, 3:]))
    value, why = written(bag)
    assert value == pytest.approx(size, rel=0.1)
    assert re.fullmatch(r"by the mean rate of \d+ s at rest; by its grade 0.00048", why)
    numbers = tmp_path / "numbers.json"
    told = ["initial.heading=parameters", f"initial.rpy=[0.0, 0.0, {math.pi / 2 - 0.7}]"]
    arguments = ["replay", str(bag), "-c", f"{tmp_path}/my.yaml", "--json", str(numbers)]
    assert cli.main([*arguments, "--set", told[0], "--set", told[1]]) == 0
    document = json.loads(numbers.read_text())
    # 4 sigma of what a second at rest leaves of the bias, over a minute, and of levelling.
    assert document["heading_rmse_deg"] < math.degrees(4.0 * 2.8e-4 * 60.0)
    assert document["tilt_rmse_deg"] < 4.0 * 0.5
    capsys.readouterr()
    assert cli.main(["check", str(bag)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert f"initial.gyroscope_bias_std: {value:g}" in said
    assert "levelling and gyroscope biases are taken from the rest" in said


def test_a_speed_along_one_axis_needs_a_rest(tmp_path: Path) -> None:
    """A larger sigma would lose the roll, which only the sideways velocity shows."""
    value, why = written(recorded(tmp_path / "drive", phone(BASELINE["straight"], 200.0, 1)))
    assert value == pytest.approx(MEMS, rel=0.02)
    assert why.endswith("s under way: record a rest of 10 s at the start")


@pytest.mark.long
def test_a_large_bias_accuses_neither_scale_nor_mount(tmp_path: Path) -> None:
    """Within a window of 20 s it turns by 20 deg."""
    trajectory = replace(BASELINE["lawn_mower"], speed=Channel(1.6, waves=(Wave(0.3, 11.0),)))
    mission = phone(trajectory, 250.0, 1, rate=2.0)
    value, why = written(save(tmp_path / "dive", raws_of(mission)))
    level = across(mission.bias[0, 3:], np.array([0.0, 0.0, -1.0]))
    assert value == pytest.approx(float(np.linalg.norm(level)), rel=0.1)
    assert why.startswith("by the mean rate across gravity of ")
    assert mission.stamps_ns[-1] - START_NS == 250 * NS
