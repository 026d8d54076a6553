"""The ready configurations: each navigates a bag of its driver's types, made by the simulator."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from whole import fold_whole

from insdvl.arrays import Array
from insdvl.messages.convert import TWIST_WITH_COVARIANCE
from insdvl.messages.drivers import DVL_MSGS, MARINE_ACOUSTIC, NUCLEUS_BOTTOM, STONEFISH
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.frames import CONVENTIONS, ENU
from insdvl.navigation.odometry import odometry
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.sections import load_section
from insdvl.recordings.bag_writer import BagWriter
from insdvl.recordings.base import Raw, encode
from insdvl.recordings.drivers import PLAIN, Told, dvl_message, dvl_raw
from insdvl.recordings.messages import imu_message
from insdvl.recordings.parameters import ReplayParameters
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.sensors.imu import ImuModel
from insdvl.simulation.trajectories import AUV
from insdvl.studies.replay.fold import read

ROOT = Path(__file__).parents[3]
CONFIG = ROOT / "ros_insdvl" / "config"
START_NS = 1_700_000_000 * NS
DURATION = 30.0
SETTLED = 12.0  # s, after which the errors are judged


@dataclass(frozen=True)
class Vehicle:
    """What drives through a configuration.

    Attributes:
        name: Of the file.
        kind: Type of the DVL's messages.
        noise: Sigma per sample of specific force [m/s^2], angular rate [rad/s] and DVL [m/s].
        dvl_rate: [Hz].
        told: What the driver tells beside the velocity.
        step: Steps of the IMU's numbers [m/s^2], [rad/s]; 0 for none.
        turns: Whether the world turns.
        z_up: Whether the DVL's axes are turned by a roll of pi against those of its type.
    """

    name: str
    kind: str
    noise: tuple[float, float, float]
    dvl_rate: float = 5.0
    told: Told = PLAIN
    step: tuple[float, float] = (0.0, 0.0)
    turns: bool = True
    z_up: bool = False


NONE = (0.0, 0.0, 0.0)
VEHICLES = (
    # The covariance of the maker's own example, which says nothing of the real error.
    Vehicle(
        "bluerov2",
        MARINE_ACOUSTIC,
        (0.05, 1e-3, 0.02),
        told=Told(sigma=1.55e-4),
        step=(0.00980665, 1e-3),
    ),
    Vehicle("nucleus", NUCLEUS_BOTTOM, (0.05, 1e-3, 0.01), told=Told(sigma=0.01)),
    Vehicle("gazebo", MARINE_ACOUSTIC, NONE, turns=False, z_up=True),
    Vehicle("stonefish", STONEFISH, NONE, turns=False),
    Vehicle("holoocean", DVL_MSGS, (0.01, 0.01, 0.02), told=Told(sigma=0.02), turns=False),
    Vehicle("holoocean", TWIST_WITH_COVARIANCE, NONE, turns=False),
    Vehicle("fog_teledyne", MARINE_ACOUSTIC, (0.03, 1e-5, 0.005), dvl_rate=1.0),
)


def mission_of(vehicle: Vehicle, parameters: FilterParameters) -> Mission:
    force, turn, dvl = vehicle.noise
    axes = CONVENTIONS[parameters.frame_convention]
    mount = parameters.dvl.mount
    model = DvlModel(rate=vehicle.dvl_rate, mount=mount, noise_std=(dvl,) * 3).in_frd(axes)
    if vehicle.z_up:  # the instrument itself looks down
        model = DvlModel(rate=vehicle.dvl_rate, noise_std=(dvl,) * 3)
    return simulate(
        AUV,
        constant(np.repeat([force**2, turn**2], 3)),
        seed=4,
        duration=DURATION,
        imu=ImuModel(rate=parameters.imu.rate, accelerometer_bias_walk=0.0),
        dvl=model,
        earth_rate=vehicle.turns,
        start_ns=START_NS,
    )


def stepped(values: Array, step: float) -> Array:
    return np.rint(values / step) * step if step else values


def raws_of(vehicle: Vehicle, parameters: FilterParameters, mission: Mission) -> Iterator[Raw]:
    """As the vehicle's drivers record them, on the topics of the file."""
    path = CONFIG / f"vehicle_{vehicle.name}.yaml"
    replay = load_section(path, "insdvl_replay", ReplayParameters)
    axes = CONVENTIONS[parameters.frame_convention]
    f = stepped(mission.f_b, vehicle.step[0]) @ axes.body
    w = stepped(mission.w_ib_b, vehicle.step[1]) @ axes.body
    for stamp, force, turn in zip(mission.stamps_ns.tolist(), f, w, strict=True):
        yield encode(replay.imu_topic, stamp, imu_message(stamp, "imu", force, turn))
    for stamp, v in zip(mission.dvl_stamps_ns.tolist(), mission.v_d, strict=True):
        in_type = ENU.body @ v if vehicle.z_up else v
        message = dvl_message(vehicle.kind, stamp, in_type, vehicle.told, convention=axes)
        yield dvl_raw(replay.dvl_topic, stamp, message)


#: Those of the fast tests: a real vehicle, and the two simulators that need the most.
FAST = ("bluerov2", "gazebo", "stonefish")


@pytest.mark.parametrize(
    "vehicle",
    [
        pytest.param(
            vehicle,
            id=f"{vehicle.name}-{vehicle.kind.split('/')[0]}",
            marks=[] if vehicle.name in FAST else pytest.mark.long,
        )
        for vehicle in VEHICLES
    ],
)
def test_a_file_navigates_a_bag_of_its_drivers(tmp_path: Path, vehicle: Vehicle) -> None:
    """No ping is refused, the body velocity's sigma tells its error, no frame is found wrong."""
    path = CONFIG / f"vehicle_{vehicle.name}.yaml"
    parameters = load_section(path, "insdvl_filter", FilterParameters, required=True)
    replay = load_section(path, "insdvl_replay", ReplayParameters, required=True)
    mission = mission_of(vehicle, parameters)
    raws = sorted(raws_of(vehicle, parameters, mission), key=lambda raw: raw.time_ns)
    with BagWriter(tmp_path / "bag") as bag:
        for raw in raws:
            bag.write(raw)
    recording = read(tmp_path / "bag", replay, parameters)
    replayed, states, _ = fold_whole(recording, parameters)

    assert not replayed.refused
    assert not replayed.findings
    reports = [update.report for update in replayed.updates]
    used = [report.accepted for report in reports if report.reason != "not_initialised"]
    assert len(used) > 0.9 * mission.dvl_stamps_ns.size
    # At a probability of 0.999 one in a thousand is refused by chance: of 150, more than two once
    # in two thousand such flights.
    assert len(used) - sum(used) <= 2
    rows = np.flatnonzero(states["nav"]["time_ns"] > START_NS + SETTLED * NS)[::5]
    assert rows.size > 50
    axes = CONVENTIONS[parameters.frame_convention]
    k = np.searchsorted(mission.stamps_ns, states["nav"]["time_ns"][rows])
    true = np.einsum("kji,kj->ki", mission.truth.C_n_b[k], mission.truth.v_n[k]) @ axes.body
    told = [odometry(replayed.fold.filter, states, int(row)) for row in rows]
    error = np.array([state.twist_linear for state in told]) - true
    sigma = np.sqrt([np.diag(state.twist_covariance)[:3] for state in told])
    assert np.mean(np.abs(error) < 3.0 * sigma) > 0.95
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 0.1


def test_every_file_has_its_section_on_the_page() -> None:
    page = (ROOT / "docs" / "how-to" / "drivers.md").read_text()
    files = sorted(path.name for path in CONFIG.glob("vehicle_*.yaml"))
    assert len(files) == 6 and {f"vehicle_{v.name}.yaml" for v in VEHICLES} == set(files)
    for name in files:
        assert f"`{name}`" in page
