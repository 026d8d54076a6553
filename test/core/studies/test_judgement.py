"""The rules of the verdict: their probabilities, and what each says of made-up numbers."""

import math
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from recordings import record
from scipy import stats

from insdvl.arrays import Array
from insdvl.messages.topics import DEPTH, HEADING
from insdvl.navigation.events import NS, Imu, ProcessNoise
from insdvl.navigation.filter import Filter
from insdvl.navigation.geometry.frames import rotation_from_vector
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.measurements.report import UpdateReport
from insdvl.navigation.parameters import SENSORS, FilterParameters
from insdvl.parameters.declaration import build
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.motion import Channel, Trajectory, Wave
from insdvl.simulation.noise import SCENARIOS, constant
from insdvl.simulation.sensors.depth import DepthModel
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.sensors.heading import HeadingModel
from insdvl.simulation.trajectories import BASELINE
from insdvl.studies.judgement import innovations, refusals, verdict, withheld
from insdvl.studies.judgement.mounting import DEPTH_OFFSET, UNKNOWNS, Change, mounting
from insdvl.studies.judgement.noise import DvlNoise, imu_variances
from insdvl.studies.judgement.verdict import Verdict
from insdvl.studies.replay.fold import Replayed, fold_recording
from insdvl.studies.replay.scores import report
from insdvl.studies.replay.taken import Taken

#: A lawn mower whose speed changes by 0.3 m/s within 11 s.
TRAJECTORY = replace(BASELINE["lawn_mower"], speed=Channel(1.6, waves=(Wave(0.3, 11.0),)))
DVL = DvlModel(noise_std=(0.02, 0.02, 0.02))
RIGHT = {
    "initial.mode": "topic",
    "initial.accelerometer_bias_std": 1e-3,
    "initial.gyroscope_bias_std": 1e-5,
    "dvl.noise_std": (0.02, 0.02, 0.02),
    "process_noise.accelerometer_variance": (1e-4, 1e-4, 1e-4),
    "process_noise.gyroscope_variance": (1e-6, 1e-6, 1e-6),
}
SAME = np.eye(3)
TURNED = {axis: [math.radians(2.0) * (name == axis) for name in "xyz"] for axis in "xyz"}
TOPICS = {
    "/imu": "imu/data_raw",
    "/dvl": "dvl/velocity",
    "/truth": "ground_truth/odometry",
    "/true_q": "ground_truth/process_noise",
    f"/{DEPTH}": DEPTH,
    f"/{HEADING}": HEADING,
}


def flown(seed: int, *, dvl: DvlModel = DVL, duration: float | None = None) -> Mission:
    noise = SCENARIOS["constant-tableI"]
    trajectory: Trajectory = TRAJECTORY
    return simulate(trajectory, noise, seed=seed, dvl=dvl, duration=duration, start_ns=NS)


def judged(mission: Mission, **changes: Any) -> tuple[Verdict, Replayed]:
    names = {name.replace("__", "."): value for name, value in changes.items()}
    parameters = build(FilterParameters, RIGHT | names)
    recording = [raw._replace(topic=TOPICS[raw.topic]) for raw in record(mission, every=100)]
    replayed = fold_recording(recording, parameters)
    return verdict.verdict(replayed, parameters, report(replayed)), replayed


def reports(nu: Array, S: Array) -> list[UpdateReport]:
    nis = np.einsum("ki,ij,kj->k", nu, np.linalg.inv(S), nu)
    return [UpdateReport("dvl", n, S, float(x), True, "") for n, x in zip(nu, nis, strict=True)]


# ---------------------------------------------------------------- probabilities


@pytest.mark.parametrize(("rows", "count"), [(3, 40), (3, 2000), (1, 300)])
def test_the_bounds_of_nis_are_exceeded_once_in_a_thousand(rows: int, count: int) -> None:
    low, high = innovations.mean_nis_bounds(rows, count)
    chance = stats.chi2.cdf(low * count, rows * count) + stats.chi2.sf(high * count, rows * count)
    assert chance == pytest.approx(innovations.CHANCE, rel=1e-6)


@pytest.mark.parametrize(("rows", "count"), [(3, 400), (1, 1600)])
def test_the_bounds_of_the_median_are_those_of_a_sample_quantile(rows: int, count: int) -> None:
    """Against the binomial: as many values below the bound as above, or more."""
    for bound in innovations.median_nis_bounds(rows, count):
        below = stats.chi2.cdf(bound, rows)
        tail = min(
            stats.binom.cdf(count // 2, count, below), stats.binom.sf(count // 2, count, below)
        )
        assert tail == pytest.approx(innovations.CHANCE / 2.0, rel=0.25)


def test_innovations_as_they_should_be_are_within_all_bounds_and_others_are_not() -> None:
    rng = np.random.default_rng(3)
    S = np.diag([0.04, 0.01, 0.09])
    nu = rng.normal(size=(2000, 3)) * np.sqrt(np.diag(S))
    found = innovations.statistics(reports(nu, S))
    assert found is not None
    assert found["nis_bounds"][0] < found["nis_mean"] < found["nis_bounds"][1]
    assert found["nis_median_bounds"][0] < found["nis_median"] < found["nis_median_bounds"][1]
    assert abs(found["autocorrelation"]) < found["autocorrelation_bound"]
    assert max(np.abs(found["mean_in_standard_errors"])) < innovations.SIGMAS
    # A tenth of the covariance, a mean, and neighbours that are alike.
    told = innovations.statistics(reports(nu, S / 10.0))
    assert told is not None and told["nis_mean"] > 9.0 * told["nis_bounds"][1] / 1.2 / 3.0
    off = innovations.statistics(reports(nu + np.array([0.1, 0.0, 0.0]), S))
    assert off is not None and off["mean_in_standard_errors"][0] > 10.0
    alike = innovations.statistics(reports((nu[1:] + nu[:-1]) / math.sqrt(2.0), S))
    assert alike is not None and alike["autocorrelation"] == pytest.approx(0.5, abs=0.05)


def test_a_few_outliers_move_the_mean_and_not_the_median() -> None:
    rng = np.random.default_rng(4)
    nu = rng.normal(size=(1000, 3))
    nu[::100] = 50.0
    found = innovations.statistics(reports(nu, np.eye(3)))
    assert found is not None and found["nis_mean"] > 50.0
    low, high = found["nis_median_bounds"]
    assert low < found["nis_median"] < high
    assert abs(found["autocorrelation"]) < found["autocorrelation_bound"]


def test_too_few_innovations_say_nothing() -> None:
    nu = np.zeros((innovations.FEWEST - 1, 3))
    assert innovations.statistics(reports(nu, np.eye(3))) is None


# ---------------------------------------------------------------- parts


def samples(count: int) -> Taken:
    rng = np.random.default_rng(5)
    taken = Taken()
    for k in range(count):
        taken.add(Imu((k + 1) * NS // 100, rng.normal(size=3), rng.normal(size=3)))
    return taken


def test_averaged_samples_keep_the_integral_and_the_density() -> None:
    taken = samples(1000)
    taken.add(ProcessNoise(5 * NS, np.eye(3), None))
    parameters = build(FilterParameters, RIGHT)
    part, told = taken.averaged(parameters, 0.05)
    stamps_ns, readings = part.samples
    assert len(stamps_ns) == 200
    _, before = taken.samples
    np.testing.assert_allclose(readings.mean(axis=0), before.mean(axis=0), rtol=0, atol=1e-12)
    assert stamps_ns[-1] == 10 * NS
    assert told.imu.rate == 20.0
    for name in ("accelerometer_variance", "gyroscope_variance"):
        was, now = (getattr(p.process_noise, name)[0] / p.imu.rate for p in (parameters, told))
        assert now == pytest.approx(was)
    (event,) = part.events
    assert isinstance(event, ProcessNoise) and event.Q_f is not None and event.Q_w is None
    np.testing.assert_allclose(event.Q_f, np.eye(3) / 5.0)


def test_the_noise_of_the_samples_is_that_of_their_differences() -> None:
    taken = samples(4000)
    of_f, of_w = imu_variances(taken)
    assert of_f == pytest.approx(1.0, rel=0.1) and of_w == pytest.approx(1.0, rel=0.1)


def test_windows_are_withheld_and_the_first_good_ping_after_each_is_predicted() -> None:
    pings = [Dvl(k * NS, np.ones(3)) for k in range(1, 101)]
    used = {event.stamp_ns for event in pings if event.stamp_ns != 32 * NS}
    given, predicted = withheld._chosen(list(pings), used, 10.0)
    assert sorted(t // NS for t in predicted) == [33, 64, 95]
    left = {event.stamp_ns // NS for event in pings} - {event.stamp_ns // NS for event in given}
    assert left == {*range(22, 33), *range(54, 64), *range(85, 95)}


NOISE = DvlNoise(shown=0.02, shown_std=0.0005, told=0.02, by_messages=False)


def test_noise_that_is_told_rightly_is_no_finding_and_other_noise_has_its_value() -> None:
    parameters = build(FilterParameters, RIGHT)
    assert not list(verdict._of_dvl_noise(NOISE, parameters))
    # Within the factor, or not known well enough.
    assert not list(verdict._of_dvl_noise(replace(NOISE, told=0.025), parameters))
    assert not list(verdict._of_dvl_noise(replace(NOISE, told=0.2, shown_std=0.1), parameters))
    (large,) = verdict._of_dvl_noise(replace(NOISE, told=0.2), parameters)
    assert "10.0 times too large" in large.text and "0.0200" in large.remedy
    told = replace(NOISE, told=0.002, by_messages=True)
    (small,) = verdict._of_dvl_noise(told, parameters)
    assert "10.0 times too small" in small.text
    assert "or somewhat more" not in small.remedy
    assert "dvl.covariance to 'parameters'" in small.remedy


def test_the_mount_is_accused_only_beyond_chance_and_beyond_careful_installation() -> None:
    parameters = build(FilterParameters, RIGHT)
    by_name = {unknown.name: unknown for unknown in UNKNOWNS}

    def found(**values: tuple[float, float]) -> list[verdict.Finding]:
        changes = [Change(u, *values.get(name, (0.0, 1.0))) for name, u in by_name.items()]
        return list(verdict._of_mount(tuple(changes), parameters))

    assert not found()
    assert not found(mount_z=(0.05, 0.02))  # 2.5 sigmas
    assert not found(mount_z=(0.01, 0.001))  # less than a degree
    (one,) = found(mount_z=(0.05, 0.01))
    assert "+2.9 deg about z" in one.text and "[0.0000, 0.0000, 0.0500] rad" in one.remedy
    (two,) = found(mount_z=(0.05, 0.01), time_offset=(-0.1, 0.0201))
    assert "; or the stamps of the DVL are 0.10 s late" in two.text


def test_a_lever_arm_that_no_vehicle_has_is_not_advised() -> None:
    parameters = build(FilterParameters, RIGHT)
    for value, count in ((-3.0, 1), (-23.09, 0)):
        mount = tuple(
            Change(u, *((value, 0.2) if u.name == "lever_arm_z" else (0.0, 1.0))) for u in UNKNOWNS
        )
        assert len(list(verdict._of_mount(mount, parameters))) == count


def test_noise_up_to_the_floor_is_no_finding() -> None:
    """4 mm/s from ping to ping say nothing of errors that last, for which 10 mm/s are told."""
    parameters = build(FilterParameters, RIGHT)
    white = replace(NOISE, shown=0.004, shown_std=0.0001)
    for told in (0.004, 0.0087, 0.01, 0.0149):
        assert not list(verdict._of_dvl_noise(replace(white, told=told), parameters)), told
    (large,) = verdict._of_dvl_noise(replace(white, told=0.05), parameters)
    assert large.cautious and "5.0 times too large" in large.text
    assert "[0.0100, 0.0100, 0.0100] m/s, which is dvl.noise_floor" in large.remedy
    (small,) = verdict._of_dvl_noise(replace(white, told=0.001), parameters)
    assert not small.cautious and "4.0 times too small" in small.text
    assert "[0.0100, 0.0100, 0.0100]" in small.remedy
    # A floor of zero: what the pings show is all there is.
    without = build(FilterParameters, RIGHT | {"dvl.noise_floor": 0.0})
    (large,) = verdict._of_dvl_noise(replace(white, told=0.0087), without)
    assert "2.2 times too large" in large.text and "[0.0040," in large.remedy


def test_noise_that_is_told_for_lasting_errors_is_not_called_that_of_the_prediction() -> None:
    """It makes NIS small, and neighbours alike; a NIS that is too large stays a finding."""
    parameters = build(FilterParameters, RIGHT)
    told = replace(NOISE, shown=0.004, shown_std=0.0001, told=0.01)
    nu = np.random.default_rng(6).normal(size=(1000, 3))
    alike = (nu[1:] + nu[:-1]) / math.sqrt(2.0)
    for factor, names in ((0.4, []), (1.0, []), (3.0, ["prediction"])):
        found = innovations.statistics(reports(factor * alike, np.eye(3)))
        findings = [
            *verdict._of_prediction(found, told, [], parameters, (1e-4, 1e-6)),
            *verdict._of_whiteness(found, told),
        ]
        assert [finding.name for finding in findings] == names
        line = verdict._judgement([], found, None, told, {})
        assert "NIS is small, as the noise of the DVL is told with errors that last" in line


def test_the_line_is_of_what_makes_it_not_right() -> None:
    cautious = verdict.Finding("dvl_noise", "told too large", "lower it", cautious=True)
    wrong = verdict.Finding("mount", "turned", "set it")

    def line(*findings: verdict.Finding) -> str:
        return verdict._judgement(list(findings), None, None, None, {})

    assert line(cautious) == "TOO CAUTIOUS: told too large: lower it"
    assert line(cautious, wrong) == "NOT RIGHT: turned: set it (1 more above)"


def test_the_variance_that_the_samples_contradict_is_not_to_be_changed() -> None:
    parameters = build(FilterParameters, RIGHT)  # 1e-4 and 1e-6
    lower = verdict._variances(parameters, (1e-5, 1e-5), large=False)
    assert lower.startswith("lower process_noise.accelerometer_variance (told 0.0001,")
    assert "gyroscope" not in lower
    higher = verdict._variances(parameters, (1e-5, 1e-5), large=True)
    assert higher.startswith("raise process_noise.gyroscope_variance (told 1e-06,")
    both = verdict._variances(parameters, (1e-5, 1e-7), large=True)  # neither: vibration, or motion
    assert "accelerometer_variance" in both and " and process_noise.gyroscope_variance" in both


def test_what_could_be_twice_as_far_off_as_care_allows_without_a_finding_is_not_shown() -> None:
    def hidden(**factors: float) -> str:
        sigmas = {u.name: factors.get(u.name, 0.4) * u.careful for u in UNKNOWNS}
        changes = tuple(Change(u, 0.0, sigmas[u.name]) for u in UNKNOWNS)
        return ", ".join(verdict._not_shown(changes))

    assert hidden() == ""
    assert hidden(mount_x=2.0) == "the roll of the DVL (sigma 2 deg)"
    assert hidden(mount_y=0.7) == "its pitch (sigma 0.7 deg)"
    assert hidden(lever_arm_x=1.0, lever_arm_z=3.0) == "its lever arm (sigma 0.3 m)"
    assert hidden(time_offset=6.0) == "its time offset (sigma 0.12 s)"
    assert hidden(scale=0.6) == "its scale (sigma 0.6 %)"


def test_refusals_by_name_are_told_with_their_remedy() -> None:
    filter_ = Filter(build(FilterParameters, RIGHT))
    document = {
        "dvl_rejected": 50,
        "dvl_accepted": 50,
        "dvl_rejected_by_reason": {"no_lock": 48, "gate": 2},
    }
    (finding,) = refusals.of_claims(document, filter_)
    assert finding.text.startswith("48 % of the DVL was refused (no_lock 48)")
    assert "bottom lock" in finding.remedy
    assert not list(refusals.of_gate(document, None, filter_))
    document["dvl_rejected_by_reason"] = {"gate": 50}
    assert not list(refusals.of_claims(document, filter_))
    (finding,) = refusals.of_gate(document, None, filter_)
    assert finding.text == "50 % of the DVL was refused (gate 50)"
    assert "contradict each other" in finding.remedy
    fits = {"nis_median": 2.4, "nis_median_expected": 2.37}
    (finding,) = refusals.of_gate(document, fits, filter_)
    assert "outliers" in finding.remedy


# ---------------------------------------------------------------- recordings


@pytest.fixture(scope="module")
def short() -> tuple[Verdict, Replayed]:
    return judged(flown(11, duration=110.0))


def test_a_right_configuration_fits(short: tuple[Verdict, Replayed]) -> None:
    found, _ = short
    assert found.findings == [], found.judgement
    assert found.judgement.startswith("FITS")
    assert found.numbers["dvl_noise"]["shown"] == pytest.approx(0.02, rel=0.15)
    assert [w["seconds"] for w in found.numbers["withheld"]] == [10.0, 30.0, 60.0]
    assert found.numbers["position"]["depth_sigma"] > 0.0


def test_the_estimates_are_as_uncertain_as_they_say(short: tuple[Verdict, Replayed]) -> None:
    found, _ = short
    z = [c["change"] / c["sigma"] for c in found.numbers["mounting"].values()]
    assert len(z) == len(UNKNOWNS)
    assert 0.05 < float(np.mean(np.square(z))) < 3.3  # chi-square with 8 dof, 1 in 1000 above


@pytest.mark.parametrize("gyroscope_variance", [1e-5, 1e-4])
def test_where_noise_may_be_all_that_turns_the_vehicle_no_lever_arm_is_advised(
    gyroscope_variance: float,
) -> None:
    """A gyroscope that is told to be far noisier than it is: added noise hides the turns."""
    mission = simulate(
        TRAJECTORY,
        constant([1e-6] * 3 + [1e-8] * 3),
        seed=21,
        dvl=replace(DVL, noise_std=(0.005,) * 3, lever_arm=(0.0, 1.0, -1.0)),
        duration=90.0,
        start_ns=NS,
    )
    names = {
        "process_noise.accelerometer_variance": (1e-6,) * 3,
        "process_noise.gyroscope_variance": (gyroscope_variance,) * 3,
        "dvl.noise_std": (0.01,) * 3,
    }
    parameters = build(FilterParameters, RIGHT | names)
    recording = [raw._replace(topic=TOPICS[raw.topic]) for raw in record(mission, every=100)]
    replayed = fold_recording(recording, parameters)
    used = {u.stamp_ns for u in replayed.updates if u.report.corrected}
    found = mounting(replayed.taken, parameters, used, np.random.default_rng(0))
    assert found is not None
    by_name = {change.unknown.name: change for change in found}
    y, z = by_name["lever_arm_y"], by_name["lever_arm_z"]
    assert math.isinf(z.sigma) and not z.matters
    if gyroscope_variance < 1e-4:  # the slow turns of the course are left
        assert y.matters and y.value == pytest.approx(-1.0, abs=0.3)
    else:
        assert math.isinf(y.sigma) and not y.matters
    assert "its lever arm" in list(verdict._not_shown(found))


CASES: dict[str, tuple[dict[str, Any], dict[str, Any], str]] = {
    "mount yaw": ({"dvl": replace(DVL, mount=tuple(TURNED["z"]))}, {}, r"-\d\.\d deg about z"),
    "mount pitch": ({"dvl": replace(DVL, mount=tuple(TURNED["y"]))}, {}, r"deg about y"),
    "stamps late": ({"late": 0.1}, {}, r"stamps of the DVL are 0\.(09|10|11|12) s late"),
    "stamps early": ({"late": -0.1}, {}, r"stamps of the DVL are 0\.(09|10|11|12) s early"),
    "scale 3 %": ({"v": 0.97 * np.eye(3)}, {}, r"velocities are -[23]\.\d % wrong"),
    "knots": ({"v": np.eye(3) / 0.514444}, {}, r"the DVL is in knots"),
    "deg/s": ({"w": np.eye(3) * math.degrees(1.0)}, {}, r"gyroscope is in deg/s"),
    "IMU axes": ({"f": np.eye(3)[[1, 0, 2]], "w": np.eye(3)[[1, 0, 2]]}, {}, "axes are exchanged"),
    # On a level course exchanged axes are also a turn by half a circle about the line between them.
    "DVL axes": (
        {"v": np.eye(3)[[1, 0, 2]]},
        {},
        r"DVL is turned about (z by \+(89|90)\.\d deg|x by -12\d\.\d deg, y by \+12\d\.\d deg)",
    ),
    "R too large": ({}, {"dvl__noise_std": (0.0632,) * 3}, r"told 3\.\d times too large"),
    "R too small": ({}, {"dvl__noise_std": (0.00632,) * 3}, r"told 3\.\d times too small"),
    "Q too small": (
        {},
        {
            "process_noise__accelerometer_variance": (1e-6,) * 3,
            "process_noise__gyroscope_variance": (1e-8,) * 3,
        },
        "raise process_noise.accelerometer_variance",
    ),
}


def changed(
    seed: int,
    dvl: DvlModel = DVL,
    late: float = 0.0,
    f: Array = SAME,
    w: Array = SAME,
    v: Array = SAME,
) -> Mission:
    mission = flown(seed, dvl=dvl)
    return replace(
        mission,
        f_b=mission.f_b @ f.T,
        w_ib_b=mission.w_ib_b @ w.T,
        v_d=mission.v_d @ v.T,
        dvl_stamps_ns=mission.dvl_stamps_ns + round(late * NS),
    )


@pytest.mark.long
@pytest.mark.parametrize("seed", [21, 22])
def test_a_q_that_is_too_large_is_not_called_wrong(seed: int) -> None:
    """It makes the filter cautious, which the innovations of a good DVL may not show."""
    found, _ = judged(changed(seed), process_noise__accelerometer_variance=(1e-2,) * 3)
    assert found.judgement.startswith(("TOO CAUTIOUS", "FITS")), found.judgement


@pytest.mark.long
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("seed", [21, 22])
def test_the_line_names_what_is_wrong_and_what_to_set(case: str, seed: int) -> None:
    mission, parameters, expected = CASES[case]
    found, _ = judged(changed(seed, **mission), **parameters)
    kind = "TOO CAUTIOUS" if case.endswith("too large") else "NOT RIGHT"
    assert found.judgement.startswith(kind), found.judgement
    assert re.search(expected, found.judgement), found.judgement
    if case in ("knots", "deg/s", "IMU axes", "DVL axes"):
        assert {finding.name for finding in found.findings} <= {"axes", "refused"}


@pytest.mark.long
@pytest.mark.parametrize("seed", range(21, 27))
def test_right_configurations_have_no_finding(seed: int) -> None:
    found, _ = judged(flown(seed))
    assert found.findings == [], found.judgement


# ---------------------------------------------------------------- a sensor that contradicts the DVL

#: The same, down and up by 0.4 m/s.
DIVING = replace(TRAJECTORY, pitch=Channel(waves=(Wave(math.radians(15.0), 40.0),)))
WITH_SENSORS = {
    "origin.height": float(TRAJECTORY.h_0),
    "depth.topic": DEPTH,
    "heading.topic": HEADING,
}
PASCAL_PER_M = 1025.0 * 9.80665


@pytest.fixture(scope="module")
def dive() -> Mission:
    sensors = {"depth": DepthModel(rate=5.0), "heading": HeadingModel(rate=5.0)}
    noise = SCENARIOS["constant-tableI"]
    return simulate(DIVING, noise, seed=11, dvl=DVL, duration=110.0, start_ns=NS, **sensors)


def past_steel(mission: Mission) -> Mission:
    """The compass turns smoothly by 30 deg and back within 20 s."""
    t = np.clip((mission.heading_stamps_ns / NS - 41.0) / 20.0, 0.0, 1.0)
    turns = np.zeros((t.size, 3))
    turns[:, 2] = math.radians(30.0) * np.sin(math.pi * t) ** 2
    return replace(mission, attitude=rotation_from_vector(turns) @ mission.attitude)


def drifting(mission: Mission) -> Mission:
    """The depth drifts by 5 cm/s from half a minute on."""
    metres = 0.05 * np.clip(mission.depth_stamps_ns / NS - 31.0, 0.0, None)
    return replace(mission, pressure=mission.pressure + PASCAL_PER_M * metres)


def late_depth(mission: Mission) -> Mission:
    return replace(mission, depth_stamps_ns=mission.depth_stamps_ns + NS // 2)


def low_passed(mission: Mission) -> Mission:
    """A low-pass of first order, 0.5 s, at the 5 Hz of the sensor."""
    pressure = mission.pressure.copy()
    for k in range(1, pressure.size):
        pressure[k] += math.exp(-0.2 / 0.5) * (pressure[k - 1] - pressure[k])
    return replace(mission, pressure=pressure)


def glitching(mission: Mission) -> Mission:
    """Three samples in a row move the height by metres: no fault of the depth that tells it."""
    f_b = mission.f_b.copy()
    f_b[5000:5003, 2] += 80.0
    return replace(mission, f_b=f_b)


def accused(found: Verdict) -> set[str]:
    """Names of the findings that are of a sensor beside the DVL."""
    return {finding.name for finding in found.findings if finding.name.endswith("_sensor")}


@pytest.mark.parametrize(
    ("change", "name", "remedy"),
    [
        (past_steel, "heading", "steel"),
        (drifting, "depth", "drift"),
        (late_depth, "depth", "depth.time_offset"),
        (lambda mission: past_steel(glitching(mission)), "heading", "steel"),
    ],
)
def test_the_sensor_that_contradicts_filter_and_dvl_is_named_first(
    dive: Mission, change: Callable[[Mission], Mission], name: str, remedy: str
) -> None:
    found, _ = judged(change(dive), **WITH_SENSORS)
    first = found.findings[0]
    assert first.name == f"{name}_sensor", found.judgement
    assert f"{name} sensor contradicts the filter, and the DVL does not" in first.text
    assert remedy in first.remedy
    assert accused(found) == {first.name}


def test_a_compass_that_the_gate_refuses_is_named_with_the_share(dive: Mission) -> None:
    turn = rotation_from_vector(np.array([0.0, 0.0, 0.5]))
    off = (dive.heading_stamps_ns // NS > 40) & (dive.heading_stamps_ns // NS < 70)
    jumped = replace(
        dive, attitude=np.where(off[:, None, None], turn @ dive.attitude, dive.attitude)
    )
    (finding,) = judged(jumped, **WITH_SENSORS)[0].findings
    assert re.search(r"its gate refused 4\d of 1\d\d \(inflations 0, restarts 0\)", finding.text)


@pytest.mark.parametrize("change", [lambda mission: mission, glitching])
def test_no_sensor_is_named_that_is_right(
    dive: Mission, change: Callable[[Mission], Mission]
) -> None:
    found, replayed = judged(change(dive), **WITH_SENSORS)
    assert not accused(found)
    assert change is not glitching or replayed.fold.counts["depth inflations"]


def test_a_dvl_whose_own_gate_complains_does_not_speak_for_itself(dive: Mission) -> None:
    """Turned by 5 deg in pitch it pulls the filter off a right depth."""
    turned = replace(dive, v_d=dive.v_d @ rotation_from_vector(np.array([0.0, 0.087, 0.0])).T)
    found, replayed = judged(turned, **WITH_SENSORS)
    counts = replayed.fold.counts
    assert counts["dvl inflations"] and counts["depth inflations"]
    assert not accused(found)


@pytest.mark.parametrize(("change", "most"), [(late_depth, 0.6), (low_passed, 0.55)])
def test_a_depth_that_lags_is_no_lever_arm_of_the_dvl(
    dive: Mission, change: Callable[[Mission], Mission], most: float
) -> None:
    """The gate need not complain of it: the filter follows the depth, and the DVL does not."""
    found, _ = judged(change(dive), **WITH_SENSORS)
    (finding,) = [finding for finding in found.findings if finding.name == "mount"]
    assert "lever arm" not in finding.text
    assert re.search(r"stamps of the depth sensor are 0\.\d\d s late", finding.text)
    (offset,) = re.findall(r"set depth.time_offset to (-0\.\d+) s", finding.remedy)
    assert 0.3 < -float(offset) < most


def test_a_lever_arm_of_the_dvl_is_no_lag_of_the_depth(dive: Mission) -> None:
    arm = np.array([1.0, 0.0, 0.0])
    at = np.searchsorted(dive.stamps_ns, dive.dvl_stamps_ns)
    moved = replace(dive, v_d=dive.v_d + np.cross(dive.w_ib_b[at], arm))
    found, _ = judged(moved, **WITH_SENSORS)
    (finding,) = [finding for finding in found.findings if finding.name == "mount"]
    assert "lever arm of the DVL" in finding.text and "depth" not in finding.text


def test_the_offset_of_the_depth_is_added_to_what_is_told() -> None:
    told = build(FilterParameters, RIGHT | {"depth.topic": DEPTH, "depth.time_offset": -0.2})
    change = Change(DEPTH_OFFSET, -0.3, 0.03)
    assert verdict._change(change, told) == (
        "the stamps of the depth sensor are 0.30 s late (sigma 0.03)",
        "set depth.time_offset to -0.500 s",
    )


def test_every_sensor_but_the_dvl_has_something_to_look_at() -> None:
    assert {*refusals.LOOK_AT, "dvl"} == set(SENSORS)
