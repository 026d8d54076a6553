"""Wrong axes are named while the vehicle moves, and right ones are never accused."""

from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from recordings import record
from watched import events

from insdvl.navigation.events import NS, Event, Imu
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build
from insdvl.simulation.grades import GRADES
from insdvl.simulation.mission import ImuModel, Mission, simulate
from insdvl.simulation.noise import SCENARIOS, constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.trajectories import AUV, BASELINE, LOOP, STATIC
from insdvl.studies.replay.fold import fold_recording
from insdvl.studies.replay.scores import report
from insdvl.watch.alignment import check as alignment
from insdvl.watch.alignment.check import AlignmentCheck
from insdvl.watch.alignment.outliers import outliers

Array = NDArray[np.float64]

#: Forward-left-up in forward-right-down, and the other way round.
FLU = np.diag([1.0, -1.0, -1.0])
SAME = np.eye(3)
TOPICS = {
    "/imu": "imu/data_raw",
    "/dvl": "dvl/velocity",
    "/truth": "ground_truth/odometry",
    "/true_q": "ground_truth/process_noise",
}
GOOD_DVL = DvlModel(noise_std=np.full(3, 0.02))


def reversed_axis(axis: str) -> Array:
    return np.diag([-1.0 if name == axis else 1.0 for name in "xyz"])


def check(found: Iterable[Event], **parameters: Any) -> list[str]:
    watch = AlignmentCheck(build(FilterParameters, parameters))
    watch.add_events(found)
    return watch.findings()


@pytest.fixture(scope="module")
def mission() -> Mission:
    """Two minutes that turn and pitch."""
    return simulate(AUV, SCENARIOS["constant-tableI"], seed=1, duration=125.0, dvl=GOOD_DVL)


# ---------------------------------------------------------------- noise of the DVL


@pytest.mark.parametrize(
    ("rate", "probability", "within"), [(1.0, 0.0, 0.15), (1.0, 0.05, 0.15), (5.0, 0.1, 0.06)]
)
def test_the_noise_from_ping_to_ping_is_without_outliers(
    rate: float, probability: float, within: float
) -> None:
    """Of metres, in nearly all windows: with them it is 4 to 5 times as large."""
    dvl = DvlModel(
        noise_std=np.full(3, 0.1), rate=rate, outlier_probability=probability, outlier_size=3.0
    )
    flown = simulate(AUV, constant(GRADES["tactical"].variances()), seed=1, duration=125.0, dvl=dvl)
    watch = AlignmentCheck(FilterParameters(frame_convention="ned"), thinks=False)
    watch.add_events(events(flown))
    found = watch.ping_noise()
    assert found is not None
    assert found[0] == pytest.approx(0.1, rel=within)


def test_outliers_are_found_and_normal_noise_has_none() -> None:
    """About a line and a slow curve, which errors of a mount make; windows of unlike length."""
    rng = np.random.default_rng(7)
    lines, expected = [], []
    for k in range(40):
        t = np.cumsum(rng.uniform(0.8, 1.2, 8 + k))
        y = np.outer(t, [0.0, 0.3, 9.8]) + 0.5 * np.sin(t / 10.0)[:, None]
        y += 0.05 * rng.standard_normal(y.shape)
        lines.append((t, y))
        expected.append(np.zeros(len(t), bool))
    assert sum(found.sum() for found in outliers(lines, 1e-3)) == 0
    for (_, y), is_outlier in zip(lines, expected, strict=True):
        is_outlier[rng.integers(3, len(y) - 3)] = True
        y[is_outlier, rng.integers(3)] += 1.0
    for found, is_outlier in zip(outliers(lines, 1e-3), expected, strict=True):
        assert found[is_outlier].all()
        assert not found[3:-3][~is_outlier[3:-3]].any()


# ---------------------------------------------------------------- gravity


def test_gravity_of_the_wrong_sign_is_told(mission: Mission) -> None:
    (finding,) = check(events(mission, f=-np.eye(3)))
    assert finding.startswith("gravity has the wrong sign along z")
    assert "-9.6" in finding
    assert "must be +9.81 when upright with frame_convention 'enu'" in finding


@pytest.mark.parametrize(("convention", "other"), [("enu", "ned"), ("ned", "enu")])
def test_a_stream_of_the_other_convention_is_told(
    mission: Mission, convention: str, other: str
) -> None:
    """All sensors are of the other one: they agree, and gravity does not."""
    swapped = events(mission, FLU, FLU, FLU)
    (finding,) = check(swapped, frame_convention=convention)
    assert f"frame_convention '{other}' would fit" in finding
    assert ("-9.6" if convention == "enu" else "+9.6") in finding


def test_a_mount_that_is_rolled_by_pi_is_told(mission: Mission) -> None:
    for mount in [np.pi, 0.0, 0.0], [-np.pi, 0.0, 1.0]:
        (finding,) = check(events(mission), **{"imu.mount": mount})
        assert "gravity has the wrong sign along z" in finding
        assert "imu.mount" in finding
    # The IMU is mounted that way, and its mount is told.
    assert not check(events(mission, FLU, FLU), **{"imu.mount": [np.pi, 0.0, 0.0]})


@pytest.mark.parametrize(
    ("mount", "axis"), [([np.pi / 2, 0.0, 0.0], "y"), ([0.0, np.pi / 2, 0.0], "x")]
)
def test_gravity_along_another_axis_is_told(
    mission: Mission, mount: list[float], axis: str
) -> None:
    (finding,) = check(events(mission), **{"imu.mount": mount})
    assert f"gravity is along {axis} of base_link" in finding


@pytest.mark.parametrize("factor", [1 / 9.81, 0.0, 100.0])
def test_a_specific_force_without_gravity_or_in_another_unit_is_told(
    mission: Mission, factor: float
) -> None:
    (finding,) = check(events(mission, f=factor * np.eye(3)))
    assert "gravity alone is 9.81: wrong unit, or gravity was removed" in finding


def test_gravity_is_told_within_half_a_minute(mission: Mission) -> None:
    early = [event for event in events(mission, FLU, FLU, FLU) if event.stamp_ns <= 25 * NS]
    assert check(early)


# ---------------------------------------------------------------- motion


@pytest.mark.parametrize("axis", "xyz")
def test_a_reversed_gyroscope_is_named(mission: Mission, axis: str) -> None:
    (finding,) = check(events(mission, w=reversed_axis(axis)))
    assert finding.startswith(f"gyroscope {axis} has the wrong sign")


@pytest.mark.parametrize(
    "axis", ["x", *(pytest.param(axis, marks=pytest.mark.long) for axis in "yz")]
)
def test_where_noise_hides_which_one_it_is_all_that_fit_are_named(axis: str) -> None:
    mission = simulate(AUV, SCENARIOS["varying"], seed=2, duration=305.0)
    (finding,) = check(events(mission, w=reversed_axis(axis)))
    accused = finding.split("; or ")
    assert any(text.startswith(f"gyroscope {axis} has the wrong sign") for text in accused)
    assert len(accused) <= 3


@pytest.mark.parametrize("axis", "xyz")
def test_a_reversed_axis_of_the_dvl_is_named_when_it_measures_motion(axis: str) -> None:
    """Mounted so that the axis looks along the vehicle's, and so has something to measure."""
    mount = {"x": [0.0, 0.0, 0.0], "y": [0.0, 0.0, -np.pi / 2], "z": [0.0, np.pi / 2, 0.0]}[axis]
    model = DvlModel(mount=tuple(mount), noise_std=np.full(3, 0.01))
    trajectory = BASELINE["straight"]
    mission = simulate(trajectory, SCENARIOS["constant-tableI"], seed=3, duration=125.0, dvl=model)
    options = {"dvl.mount": mount, "frame_convention": "ned"}
    assert not check(events(mission), **options)
    (finding,) = check(events(mission, d=reversed_axis(axis)), **options)
    assert f"DVL {axis} has the wrong sign" in finding


def test_two_reversed_axes_are_named(mission: Mission) -> None:
    """A gyroscope of the other convention than its accelerometer."""
    (finding,) = check(events(mission, w=FLU))
    assert finding.startswith("gyroscope y and z has the wrong sign")


# ---------------------------------------------------------------- no false alarm


@pytest.mark.parametrize(
    ("trajectory", "scenario"),
    [
        (AUV, "varying"),
        pytest.param(STATIC, "wide", marks=pytest.mark.long),
        pytest.param(LOOP, "wide", marks=pytest.mark.long),
        *(pytest.param(AUV, name, marks=pytest.mark.long) for name in SCENARIOS),
        *(pytest.param(motion, "wide", marks=pytest.mark.long) for motion in BASELINE.values()),
    ],
)
def test_a_right_mission_is_never_accused(trajectory: Any, scenario: str) -> None:
    mission = simulate(trajectory, SCENARIOS[scenario], seed=4, duration=300.0)
    watch, found = AlignmentCheck(FilterParameters()), events(mission)
    for first in range(0, len(found), 500):
        watch.add_events(found[first : first + 500])
        assert watch.findings() == []
    assert len(watch._motions) == 14


def test_errors_of_the_sensors_are_no_wrong_axes() -> None:
    """Large biases, DVL errors, outliers and outages, a long lever arm that is told."""
    lever_arm = [1.5, 0.3, 0.5]
    mission = simulate(
        BASELINE["spiral_dive"],
        SCENARIOS["varying"],
        seed=5,
        duration=300.0,
        imu=ImuModel(accelerometer_bias_std=0.1, gyroscope_bias_std=2e-3),
        dvl=DvlModel(
            lever_arm=tuple(np.array(lever_arm) * [1.0, -1.0, -1.0]),
            noise_std=np.full(3, 0.02),
            bias_std=0.1,
            bias_time_constant=100.0,
            outages=(60.0, 90.0),
            outlier_probability=0.05,
        ),
    )
    declared = {
        "dvl.lever_arm": lever_arm,
        "initial.accelerometer_bias_std": 0.1,
        "initial.gyroscope_bias_std": 2e-3,
    }
    watch, found = AlignmentCheck(build(FilterParameters, declared)), events(mission)
    for first in range(0, len(found), 50):
        watch.add_events(found[first : first + 50])
        assert not watch.findings()  # a finding takes 10 s of samples
    assert 8 <= len(watch._motions) <= 12


@pytest.mark.parametrize(
    ("trajectory", "seed"),
    [
        pytest.param(trajectory, seed, marks=[] if first else [pytest.mark.long])
        for number, trajectory in enumerate((BASELINE["lawn_mower"], AUV, *BASELINE.values()))
        for seed in (1, 2, 3)
        for first in [number == 0 and seed == 1]
    ],
)
def test_an_error_of_the_dvl_that_lasts_is_no_wrong_axis(trajectory: Any, seed: int) -> None:
    """Of a good DVL: 3 mm/s of white noise, and 10 mm/s, its floor, over 20 s."""
    grade = GRADES["tactical"]
    dvl = DvlModel(rate=5.0, noise_std=(0.003,) * 3, bias_std=0.01, bias_time_constant=20.0)
    noise = constant(grade.variances())
    mission = simulate(trajectory, noise, seed=seed, duration=150.0, imu=grade.imu(), dvl=dvl)
    assert not check(events(mission))


def test_sensors_without_any_noise_are_not_accused_of_rounding() -> None:
    perfect = ImuModel(100.0, 0.0, 0.0, 0.0, 0.0)
    for trajectory in (STATIC, AUV):
        mission = simulate(
            trajectory,
            constant([0.0] * 6),
            seed=8,
            duration=125.0,
            imu=perfect,
            dvl=DvlModel(noise_std=np.zeros(3)),
        )
        assert not check(events(mission))


def test_what_does_not_move_tells_nothing_of_a_reversed_axis() -> None:
    mission = simulate(STATIC, SCENARIOS["varying"], seed=6, duration=125.0)
    for axis in "xyz":
        assert not check(events(mission, w=reversed_axis(axis)))


# ---------------------------------------------------------------- streams as they come


def test_the_order_of_arrival_does_not_matter_much(mission: Mission) -> None:
    """A DVL that is a second late, and samples that are lost, say the same."""
    wrong = events(mission, w=reversed_axis("z"))
    late = sorted(wrong, key=lambda e: e.stamp_ns + (NS if isinstance(e, Dvl) else 0))
    (in_turn,), (delayed,) = check(wrong), check(late)
    assert in_turn == delayed
    rng = np.random.default_rng(0)
    (holes,) = check([event for event in wrong if rng.random() > 0.05])
    assert holes.startswith("gyroscope z has the wrong sign")


def test_events_together_say_what_they_say_one_by_one(mission: Mission) -> None:
    """Also with samples that come late."""
    wrong = events(mission, w=reversed_axis("z"))
    rng = np.random.default_rng(1)
    wrong = sorted(wrong, key=lambda e: e.stamp_ns + int(rng.integers(0, NS // 50)))
    together, one_by_one = (AlignmentCheck(build(FilterParameters, {})) for _ in range(2))
    for first in range(0, len(wrong), 50):
        together.add_events(wrong[first : first + 50])
    for event in wrong:
        one_by_one.add(event)
    (finding,) = together.findings()
    assert one_by_one.findings() == [finding]


def test_a_gap_begins_a_new_window(mission: Mission) -> None:
    watch = AlignmentCheck(FilterParameters())
    for event in events(mission):
        if isinstance(event, Imu) and event.stamp_ns % (15 * NS) < 2 * NS:
            continue
        watch.add(event)
    assert len(watch._motions) == 0  # none is as long as 20 s
    assert not watch.findings()


def test_memory_is_bounded() -> None:
    """Of DVL measurements that wait for ever, come too often, and of samples without any."""
    watch = AlignmentCheck(FilterParameters())
    f, v = np.array([0.0, 0.0, -9.8]), np.array([1.0, 0.0, 0.0])
    for k in range(2000):
        watch.add(Dvl(k, v))
    assert len(watch._waiting) <= alignment._WAITING
    for k in range(12_000):
        watch.add(Imu(k * 10_000_000, f, np.zeros(3)))
        if k > 5000:
            watch.add(Dvl(k * 10_000_000, v))
            watch.add(Dvl(k * 10_000_000 - 1, v))
        assert len(watch._pings) <= 102
        assert len(watch._waiting) <= alignment._WAITING
        assert watch._size <= alignment._STEPS
    assert 3 <= len(watch._motions) <= alignment.WINDOWS


# ---------------------------------------------------------------- replay


def test_a_replay_tells_what_it_found() -> None:
    mission = simulate(AUV, SCENARIOS["constant-tableI"], seed=7, duration=25.0)
    recording = [raw._replace(topic=TOPICS[raw.topic]) for raw in record(mission, every=100)]
    for convention, found in ("enu", 0), ("ned", 1):
        parameters = build(FilterParameters, {"frame_convention": convention})
        replayed = fold_recording(recording, parameters)
        assert len(replayed.findings) == found
        assert report(replayed)["frames"] == replayed.findings


def test_a_recording_is_explained_at_its_end_as_by_one_who_watches_it(mission: Mission) -> None:
    wrong = events(mission, w=reversed_axis("x"))
    parameters = build(FilterParameters, {"frame_convention": "ned"})
    found = []
    for thinks in True, False:
        watch = AlignmentCheck(parameters, thinks=thinks)
        watch.add_events(wrong)
        assert bool(watch.findings()) == thinks
        watch.finish()
        found.append(watch.findings())
    assert len(found[0]) == 1
    assert found[1] == found[0]
