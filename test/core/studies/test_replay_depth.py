"""A recording with a depth sensor whose stamps are late, and what its time offset makes of it."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recordings import REPLAY, record, save
from records import fields
from told import TOLD
from whole import Whole, fold_whole

from insdvl.messages.topics import DEPTH, HEADING
from insdvl.navigation.events import NS
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.motion import Channel, Trajectory, Wave
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.depth import DepthModel
from insdvl.simulation.sensors.heading import HeadingModel
from insdvl.studies.replay.fold import read

#: Down and up again by 0.4 m/s.
DIVES = Trajectory(
    duration=60.0, speed=Channel(1.5), pitch=Channel(waves=(Wave(math.radians(15.0), 40.0),))
)
LATE = 0.5
VARIANCES = [1e-4] * 3 + [1e-6] * 3


@pytest.fixture(scope="module")
def mission() -> Mission:
    return simulate(
        DIVES,
        constant(VARIANCES),
        seed=7,
        depth=DepthModel(rate=5.0),
        heading=HeadingModel(rate=5.0),
        start_ns=NS,
    )


def settings(**changes: Any) -> FilterParameters:
    values: dict[str, Any] = {
        "depth.topic": DEPTH,
        "depth.surface_std": 0.0,
        "initial.mode": "topic",
        "origin.height": float(DIVES.h_0),
        "process_noise.accelerometer_variance": tuple(VARIANCES[:3]),
        "process_noise.gyroscope_variance": tuple(VARIANCES[3:]),
    }
    names = {name.replace("__", "."): value for name, value in changes.items()}
    return build(FilterParameters, TOLD | values | names)


def folded(path: Path, mission: Mission, **changes: Any) -> Whole:
    parameters = settings(**changes)
    return fold_whole(read(save(path, record(mission)), REPLAY, parameters), parameters)


@pytest.mark.parametrize("sensor", ["depth", "heading"])
def test_a_known_offset_makes_late_stamps_as_clean_as_right_ones(
    mission: Mission, tmp_path: Path, sensor: str
) -> None:
    """Told, they are the same mission to the bit."""
    name = f"{sensor}_stamps_ns"
    late = replace(mission, **{name: getattr(mission, name) + round(LATE * NS)})
    both = {"heading__topic": HEADING}
    right = folded(tmp_path / "right", mission, **both)
    moved = folded(tmp_path / "moved", late, **both, **{f"{sensor}__time_offset": -LATE})
    for (field, expected), (_, found) in zip(
        fields(right.states), fields(moved.states), strict=True
    ):
        np.testing.assert_array_equal(found, expected, err_msg=field)
    of_sensor = [u for u in moved.replayed.updates if u.report.measurement == sensor]
    assert len(of_sensor) >= 100
    assert {u.stamp_ns for u in of_sensor} <= set(getattr(mission, name).tolist())


def test_the_offset_of_a_late_depth_takes_its_error_out_of_the_height(
    mission: Mission, tmp_path: Path
) -> None:
    """Half a second at 0.4 m/s of a dive, to 0.2 m; without an error it is centimetres."""
    late = replace(mission, depth_stamps_ns=mission.depth_stamps_ns + round(LATE * NS))
    worst = {}
    for offset in (0.0, -LATE):
        path = tmp_path / f"offset{offset}"
        states = folded(path, late, depth__time_offset=offset).states["nav"]
        at = np.searchsorted(mission.stamps_ns, states["time_ns"])
        error = states["llh"][:, 2] - mission.truth.llh[at, 2]
        worst[offset] = np.abs(error[len(error) // 4 :]).max()
    assert worst[0.0] > 0.1
    assert worst[-LATE] < 0.03
