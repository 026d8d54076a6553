"""The statuses of a node: each cause is told with its number and what to do, and recovers."""

from collections import Counter
from collections.abc import Collection
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from told import TOLD

from insdvl.messages.inputs import Inputs
from insdvl.messages.refusals import Refused
from insdvl.navigation.events import NS, Imu, ProcessNoise, SensorNoise
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build
from insdvl.timeline.fold import Fold
from insdvl.timeline.jumps import TimeJump
from insdvl.timeline.output import AppliedUpdate
from insdvl.watch.sample_count import ExpectedSamples
from ros_insdvl.status.diagnostics import ERROR, OK, WARN, Status, Tally, View
from ros_insdvl.status.filter.measurement import MeasurementCause
from ros_insdvl.status.filter.output import Output
from ros_insdvl.status.filter.watch import FilterWatch
from ros_insdvl.status.reasons import OF_FRAMES, OF_TIME, REMEDIES, remedy_of

START_NS = 1_700_000_000 * NS
PAGE = Path(__file__).parents[2] / "docs" / "reference" / "diagnostics.md"


class Filter:
    """A filter's watch, the fold that it looks at, and a clock."""

    def __init__(self, **parameters: Any) -> None:
        self.parameters = build(FilterParameters, TOLD | parameters)
        self.fold = Fold(self.parameters)
        self.inputs = Inputs(self.parameters)
        self.watch = FilterWatch(self.parameters, self.inputs, self.fold)
        self.received = dict.fromkeys(self.inputs.topics, 0)
        self.sent = Counter({"odometry/filtered": 0, "imu/bias": 0, "dvl/innovation": 0})
        self.rejected: Counter[Refused] = Counter()
        self.silence = dict.fromkeys(self.inputs.topics, inf)
        self.view = View(0.0)
        self.now = 0.0
        self.pings = 0
        self.noise = 1e-7

    def samples(
        self, first: int, last: int, step_ns: int = NS // 100, lost: Collection[int] = ()
    ) -> None:
        for k in range(first, last):
            if k in lost:
                continue
            self.received["imu/data_raw"] += 1
            stamp = START_NS + k * step_ns
            noise = np.full(3, k % 2 * self.noise)
            sample = Imu(stamp, np.array([0.0, 0.0, -9.8]) + noise, noise)
            reason = self.fold.add(sample)
            if reason is None:
                self.watch.took(sample)
            else:
                self.rejected[Refused("imu/data_raw", reason)] += 1
        for output in self.fold.take():
            if isinstance(output, TimeJump):
                self.watch.reset()
                self.watch.jumped(output)
            elif isinstance(output, AppliedUpdate):
                self.watch.updated(output)
                if not output.report.accepted:
                    self.rejected[Refused("dvl", output.report.reason)] += 1
            else:
                self.watch.published(output, output.stamp_ns + 2_000_000)
                self.sent["odometry/filtered"] += 1
        self.silence["imu/data_raw"] = 0.0

    def look(self, seconds: float = 1.0) -> dict[str, Status]:
        """The statuses some seconds later."""
        self.now += seconds
        self.view.look(
            self.now,
            received=self.received,
            sent=self.sent,
            rejected=self.rejected,
            events=self.watch.counts,
            heard={topic: self.now - silence for topic, silence in self.silence.items()},
        )
        return {status.cause: status for status in self.watch.causes(self.view)}

    def dvl(self, stamp_ns: int, speed: float = 0.0, **of: Any) -> None:
        """A measurement, of which no two are the same."""
        self.pings += 1
        v_d = np.array([speed, 0.0, 1e-4 * self.pings])
        ping = Dvl(stamp_ns, v_d, **of)
        assert self.fold.add(ping) is None
        self.watch.took(ping)


def wrong(statuses: dict[str, Status]) -> dict[str, bytes]:
    return {cause: status.level for cause, status in statuses.items() if status.level != OK}


def test_growth_is_over_the_last_seconds_and_survives_a_reset() -> None:
    tally: Tally[str] = Tally(seconds=3.0)
    grown = []
    for now, count in enumerate([5, 5, 7, 7, 7, 0, 1]):
        tally.look(float(now), {"gaps": count})
        assert tally.total["gaps"] == count
        grown.append((tally.step["gaps"], tally.recent["gaps"]))
    assert grown == [(5, 5), (0, 5), (2, 7), (0, 2), (0, 2), (0, 0), (1, 1)]


def test_status_has_its_worst_complaint_first() -> None:
    status = Status("imu", "100.0 Hz")
    assert (status.level, status.message) == (OK, "100.0 Hz")
    status.complain(WARN, "gaps", "2 gaps")
    status.complain(ERROR, "silent", "no imu")
    message = status.of_node("/auv/insdvl_filter")
    assert (message.level, message.message) == (ERROR, "no imu; 2 gaps")
    assert message.name == "auv/insdvl_filter: imu"
    assert message.hardware_id == "none"
    assert status.of_node("/insdvl_filter").name == "insdvl_filter: imu"


def test_a_filter_that_gets_what_it_needs_has_nothing_to_tell() -> None:
    f = Filter()
    assert wrong(f.look()) == {"imu": WARN, "initialisation": WARN}
    f.dvl(START_NS + 3 * NS)
    f.samples(1, 301)
    assert wrong(f.look()) == {}


def test_what_came_of_gyrocompassing_is_told() -> None:
    """With the default gyroscope nothing, and the filter starts all the same."""
    f = Filter(**{"initial.mode": "gyrocompassing"})
    assert "waits for 60 s of IMU samples at rest" in f.look()["initialisation"].message
    f.dvl(START_NS + 3 * NS)
    f.samples(1, 301)
    status = f.look()["initialisation"]
    assert status.level == WARN
    assert "heading as told, one sigma 1 deg: no gyrocompassing" in status.message
    assert "as they are told its sigma would be" in status.message


def test_an_unknown_heading_is_told_with_what_tells_it() -> None:
    f = Filter(**{"initial.mode": "auto"})
    assert "for a DVL velocity or for motion" in f.look()["initialisation"].message
    f.samples(1, 150)
    assert "not initialised" in f.look()["initialisation"].message  # at rest, without a DVL
    f.dvl(START_NS + 2 * NS)
    f.samples(150, 400)
    for _ in range(3):
        f.silence["imu/data_raw"] = 0.0
        status = f.look()["initialisation"]
        assert status.level == WARN
        assert "heading unknown, one sigma 100 deg" in status.message
        assert "set initial.mode:=topic where initial.topic" in status.message


def test_a_bias_beyond_its_sigma_is_told() -> None:
    f = Filter(**{"initial.accelerometer_bias_std": 1e-6})
    f.samples(1, 100)
    state = f.fold._samples.kept.at(f.fold._samples.count - 1)
    state["nav"]["b_f"][1] = 0.01
    status = f.look()["initialisation"]
    assert status.level == WARN and "accelerometer bias y is 0.01 m/s^2" in status.message


def test_a_motion_that_ended_gyrocompassing_is_told_until_the_reset() -> None:
    parameters = {
        "initial.mode": "gyrocompassing",
        "initial.heading_std": 1.0,
        "process_noise.accelerometer_variance": (0.01,) * 3,
        "process_noise.gyroscope_variance": (1e-6,) * 3,
    }
    f = Filter(**parameters)
    f.noise = 0.1
    f.samples(1, 202, NS // 100)
    f.noise = 0.5
    f.samples(202, 401)
    for seconds in (1.0, 60.0):
        f.silence["imu/data_raw"] = 0.0
        assert "keep it still and call ~/reset" in f.look(seconds)["initialisation"].message


def test_the_mean_nis_of_each_measurement_has_a_key_of_its_own() -> None:
    f = Filter()
    for second in (1, 2):
        f.dvl(START_NS + second * NS)
    f.samples(1, 301)
    keys = [key for key in f.look()["dvl"].values if key.startswith("NIS")]
    assert keys == ["NIS dvl, mean of 2"]  # which the monitor looks for


def test_message_and_level_of_the_nis_are_of_its_median() -> None:
    """A few outliers carry the mean away, and are no reason to change the noise."""
    f = Filter()
    f.dvl(START_NS + 3 * NS)
    f.samples(1, 301)
    causes = (cause for cause in f.watch._causes if isinstance(cause, MeasurementCause))
    nis = next(cause for cause in causes if cause._name == "dvl")._nis
    nis.extend([2.0] * 60 + [50.0] * 40)
    status = f.look()["dvl"]
    assert (status.level, status.message) == (OK, "median NIS 2.00 (2.37 is expected)")
    assert status.values["NIS dvl, mean of 100"] == "21.200"
    nis.extend([6.0] * 100)
    status = f.look()["dvl"]
    assert status.level == WARN
    assert "the median NIS of 100 measurements is 6.0, 2.37 is expected" in status.message


@pytest.mark.parametrize(
    ("count", "nis", "said"),
    [
        (4, 3.0, "median NIS 3.00 (2.37 is expected)"),
        (4, 8.44, "4 measurements, too few to judge their NIS"),
        (30, 4.6, "median NIS 4.60 (2.37 is expected)"),
        (20, 8.44, "the median NIS of 20 measurements is 8.4, 2.37 is expected"),
    ],
)
def test_a_nis_that_is_too_large_is_never_called_ok(count: int, nis: float, said: str) -> None:
    """Of few measurements it is told where it is beyond chance, else it is not judged."""
    f = Filter()
    f.samples(1, 101)
    causes = (cause for cause in f.watch._causes if isinstance(cause, MeasurementCause))
    next(cause for cause in causes if cause._name == "dvl")._nis.extend([nis] * count)
    status = f.look()["dvl"]
    assert said in status.message
    assert status.level == (WARN if "the median" in said else OK)


REFUSALS = [
    ("imu/data_raw", "not_finite", "imu"),
    ("imu/data_raw", "no_data", "imu"),
    ("imu/data_raw", "duplicate", "imu"),
    ("imu/data_raw", "too_late", "time"),
    ("imu/data_raw", "far_ahead", "time"),
    ("imu/data_raw", "no_stamp", "time"),
    ("imu/data_raw", "bad_stamp", "time"),
    ("imu/data_raw", "wrong_frame", "frames"),
    ("dvl/velocity", "not_finite", "dvl"),
    ("dvl/velocity_cov", "bad_covariance", "dvl"),
    ("dvl/velocity", "too_late", "time"),
    ("dvl/velocity", "wrong_frame", "frames"),
    ("dvl", "no_lock", "dvl"),
    ("dvl", "repeated", "dvl"),
    ("dvl", "too_fast", "dvl"),
    ("process_noise", "bad_covariance", "process noise"),
    ("process_noise", "too_late", "time"),
    ("measurement_noise", "bad_covariance", "measurement noise"),
    ("measurement_noise", "no_data", "measurement noise"),
    ("measurement_noise", "too_late", "time"),
    ("set_odometry", "bad_quaternion", "initialisation"),
    ("set_odometry", "out_of_range", "initialisation"),
]


@pytest.mark.parametrize(("topic", "reason", "cause"), REFUSALS)
def test_a_refused_message_is_told_once_with_what_to_do(
    topic: str, reason: str, cause: str
) -> None:
    f = Filter(**{"process_noise.source": "external", "dvl.noise_source": "learned"})
    f.samples(1, 21)
    f.fold.add(ProcessNoise(START_NS + NS // 5, np.eye(3), np.eye(3)))
    assert wrong(f.look()) == {}
    f.rejected[Refused(topic, reason)] += 3
    statuses = f.look()
    assert wrong(statuses) == {cause: WARN}
    assert f"refused on {topic} in the last 10 s: 3 {reason}" in statuses[cause].message
    assert str(remedy_of(topic, reason)) in statuses[cause].message
    f.samples(21, 22)
    statuses = f.look(10.0)
    assert wrong(statuses) == {}
    assert statuses[cause].values[f"rejected {topic}: {reason}"] == 3


def test_a_factor_at_the_end_of_its_range_is_told() -> None:
    f = Filter(**{"process_noise.adaptive_factor": True})
    f.samples(1, 21)
    status = f.look()["process noise"]
    assert status.level == OK and status.values["Q factor"] == "1"
    assert status.message.endswith(", times 1 by the innovations")
    state = f.fold.latest
    assert state is not None
    state["q_factor"]["factor"] = 16.0
    status = f.look()["process noise"]
    assert status.level == WARN
    assert "factor on Q is 16, the largest that is possible" in status.message


def test_the_noise_of_the_dvl_in_force_is_told_with_its_origin_and_age() -> None:
    parameters = {"dvl.noise_source": "learned", "dvl.noise_std": (0.02,) * 3, "q_timeout": 1.0}
    f = Filter(**parameters)
    f.samples(1, 6)
    status = f.look()["measurement noise"]
    assert (status.level, status.message) == (OK, "learned, R is 1 times nominal: nominal")
    assert status.values["R age [s]"] == "none received"
    f.fold.add(SensorNoise(START_NS + NS // 10, "dvl", 9.0 * 0.02**2 * np.eye(3)))
    f.dvl(START_NS + NS // 5)
    f.samples(6, 61)
    status = f.look()["measurement noise"]
    assert (status.level, status.message) == (OK, "learned, R is 9 times nominal: received")
    assert status.values["R age [s]"] == "0.500"
    assert [status.values[f"R sigma {axis} [m/s]"] for axis in "xyz"] == ["0.06"] * 3
    assert [status.values[f"R nominal sigma {axis} [m/s]"] for axis in "xyz"] == ["0.02"] * 3
    for k in range(10, 30):
        f.dvl(START_NS + k * NS // 10)
    f.samples(61, 311)
    status = f.look()["measurement noise"]
    assert status.level == WARN and status.values["R origin"] == "own window"
    assert "measurement_noise is 3.0 s old, more than the 1 s of q_timeout" in status.message


def test_a_true_noise_of_the_dvl_that_does_not_come_is_told() -> None:
    f = Filter(**{"dvl.noise_source": "oracle"})
    f.samples(1, 21)
    assert "no ground_truth/measurement_noise received" in f.look()["measurement noise"].message


def test_every_counted_reason_has_a_remedy() -> None:
    assert {reason for _, reason, _ in REFUSALS} <= REMEDIES.keys()
    assert {*OF_TIME, *OF_FRAMES} <= REMEDIES.keys()


def test_one_rejection_by_the_gate_is_chance_and_two_are_told() -> None:
    f = Filter()
    f.dvl(START_NS + NS // 20)
    f.dvl(START_NS + NS)
    f.dvl(START_NS + NS + NS // 10, 9.0)
    f.samples(1, 121)
    assert wrong(f.look()) == {}
    f.dvl(START_NS + NS + NS // 5, 9.0)
    f.samples(121, 122)
    statuses = f.look()
    assert wrong(statuses) == {"dvl": WARN}
    assert "2 gate" in statuses["dvl"].message
    assert statuses["dvl"].values["DVL updates rejected"] == 2


def test_a_dvl_in_another_unit_is_told() -> None:
    f = Filter()
    f.samples(1, 21)
    for k in range(1, 10):
        f.dvl(START_NS + NS // 5 + k * NS // 100, 100.0)
    f.samples(21, 41)
    statuses = f.look()
    assert wrong(statuses) == {"dvl": WARN}
    message = statuses["dvl"].message
    assert "9 too_fast" in message
    assert "cm/s or mm/s" in message and "dvl.max_speed is too small" in message


def test_what_a_dvl_did_not_measure_is_counted() -> None:
    f = Filter()
    f.samples(1, 21)
    f.dvl(START_NS + NS // 20)
    f.dvl(START_NS + NS // 10, measured=(True, False, True))
    f.samples(21, 31)
    status = f.look()["dvl"]
    assert status.level == OK
    assert status.values["DVL updates without y"] == 1
    assert "DVL updates without x" not in status.values


def test_a_dvl_outage_is_told_with_its_length_and_sigma_and_ends() -> None:
    f = Filter(**{"imu.rate": 10.0, "imu.max_gap": 0.2, "imu.frozen_samples": 0})

    def at(k: int) -> int:
        return START_NS + k * NS // 10

    f.samples(1, 53, NS // 10)
    assert wrong(f.look()) == {"dvl": WARN}  # none from the start on
    f.dvl(at(52))
    f.samples(53, 54, NS // 10)
    assert wrong(f.look()) == {}
    f.samples(54, 123, NS // 10)
    statuses = f.look()
    assert wrong(statuses) == {"dvl": WARN}
    message = statuses["dvl"].message
    assert "no DVL measurement used for 7 s: none is received" in message
    sigma = float(message.rsplit("sigma is ")[1].split()[0])
    assert sigma == pytest.approx(np.sqrt(f.fold.latest["nav"]["P"][0, 0]), rel=0.1)  # type: ignore[index]
    f.dvl(at(122), 9.0)  # not used: the outage goes on
    f.samples(123, 124, NS // 10)
    assert wrong(f.look()) == {"dvl": WARN}
    f.samples(124, 700, NS // 10)
    assert wrong(f.look()) == {"dvl": ERROR}
    f.dvl(at(699))
    f.samples(700, 701, NS // 10)
    assert wrong(f.look(10.0)) == {}  # the rejection had made the velocity uncertain


def test_an_outage_of_a_silent_dvl_is_told_as_silence_and_not_as_refusals() -> None:
    f = Filter(**{"imu.rate": 10.0, "imu.max_gap": 0.2, "imu.frozen_samples": 0})

    def ping(k: int, silence: float = 0.0) -> None:
        f.received["dvl/velocity"] += 1
        f.silence["dvl/velocity"] = silence
        f.dvl(START_NS + k * NS // 10)

    for k in range(10, 60, 10):  # all are used
        ping(k)
    f.samples(1, 52, NS // 10)
    assert wrong(f.look()) == {}
    f.silence["dvl/velocity"] = 5.4
    f.samples(52, 106, NS // 10)
    message = f.look()["dvl"].message
    assert "used for 6 s: none came for 5 s, check the DVL's driver, its topic and" in message
    assert "refused" not in message
    for _ in range(2):  # it comes again, and is refused before the filter
        f.received["dvl/velocity"] += 1
        f.rejected[Refused("dvl/velocity", "no_bottom")] += 1
    f.silence["dvl/velocity"] = 0.5
    f.samples(106, 130, NS // 10)
    message = f.look()["dvl"].message
    assert "2 came since the last one that was used, see which were refused" in message
    f.silence["dvl/velocity"] = 20.0
    assert "none came for 20 s" in f.look(20.0)["dvl"].message


def test_nothing_is_an_error_before_a_driver_can_be_up() -> None:
    f = Filter()
    for _ in range(29):
        assert wrong(f.look()) == {"imu": WARN, "initialisation": WARN}
    assert "waits for imu/data_raw: check the IMU's driver" in f.look(0.5)["imu"].message
    statuses = f.look()
    assert wrong(statuses) == {"imu": ERROR, "initialisation": WARN}
    assert "no imu/data_raw received" in statuses["imu"].message


def test_an_imu_that_stops_is_an_error_also_at_the_start() -> None:
    f = Filter()
    f.samples(1, 21)
    f.silence["imu/data_raw"] = 4.2
    assert wrong(f.look()) == {"imu": ERROR}


def test_recoveries_are_told_with_the_measurement_that_they_are_of() -> None:
    f = Filter(**{"depth.topic": "depth"})
    f.samples(1, 21)
    assert f.look()["dvl"].level == OK
    state = f.fold._samples.kept.at(f.fold._samples.count - 1)
    state["gate"]["depth"]["inflations"] += 2
    state["gate"]["dvl"]["restarts"] += 1
    statuses = f.look()
    assert "inflated after rejections, 2 times" in statuses["depth"].message
    assert "restarted" not in statuses["depth"].message
    assert "restarted from a measurement after rejections, 1 times" in statuses["dvl"].message
    assert "inflated" not in statuses["dvl"].message
    assert statuses["depth"].values["depth inflations"] == 2
    assert statuses["dvl"].values["dvl restarts"] == 1


def test_a_silent_imu_is_an_error_until_it_comes_back() -> None:
    f = Filter()
    f.samples(1, 21)
    f.silence["imu/data_raw"] = 4.2
    statuses = f.look()
    assert wrong(statuses) == {"imu": ERROR}
    assert "no imu/data_raw for 4 s" in statuses["imu"].message
    f.samples(21, 22)
    assert wrong(f.look()) == {}


def expected_and_arrived(stamps: Any, **parameters: Any) -> tuple[int, int]:
    """What is counted of stamps in steps of 10 ms, in the order in which they arrive."""
    samples = ExpectedSamples(build(FilterParameters, TOLD | parameters))
    for stamp in stamps:
        samples.add(START_NS + round(float(stamp) * NS / 100))
    return samples.expected, samples.arrived


def test_only_what_is_lost_for_good_is_missing() -> None:
    lost = {50, 51, 300}
    kept = [k for k in range(1001) if k not in lost]
    # The samples of the last max_delay may still be late; the first one opens the count.
    assert expected_and_arrived(kept) == (799, 796)
    late = sorted(kept, key=lambda k: k + (150 if k % 7 == 0 else 0))
    assert expected_and_arrived(late) == (799, 796)
    gap = [k for k in range(1001) if not 400 < k < 500]
    assert expected_and_arrived(gap) == (699, 699)  # it is told as a gap


@pytest.mark.parametrize(("rate", "jitter"), [(1.0, 0.3), (1.04, 0.0), (0.96, 0.0)])
def test_jitter_and_a_clock_of_another_speed_lose_nothing(rate: float, jitter: float) -> None:
    rng = np.random.default_rng(5)
    stamps = np.arange(3000) / rate + jitter * rng.uniform(-1.0, 1.0, 3000)
    expected, arrived = expected_and_arrived(stamps)
    assert arrived > 2500
    assert abs(expected - arrived) <= 1  # the last one may be before or behind its point
    kept = rng.random(3000) > 0.1
    expected, arrived = expected_and_arrived(stamps[kept])
    due = np.arange(3000)[kept]
    assert abs(expected - (due[arrived] - due[0])) <= 1


@pytest.mark.parametrize("every", [100, 10])
def test_lost_samples_are_told_with_their_share_until_none_is_lost(every: int) -> None:
    f = Filter()
    f.dvl(START_NS + NS)
    f.dvl(START_NS + 5 * NS)
    f.samples(1, 603, lost=range(every // 2, 600, every))  # the last 2 s may still come
    statuses = f.look()
    assert wrong(statuses) == {"imu": WARN}
    missing = 400 // every
    assert f"{100 / every:.1f} % of the samples are missing" in statuses["imu"].message
    assert f"{missing} of 400 in the last 10 s" in statuses["imu"].message
    f.dvl(START_NS + 10 * NS)
    f.samples(603, 1103)
    assert wrong(f.look(5.0)) == {"imu": WARN}
    f.samples(1103, 1104)
    statuses = f.look(10.0)
    assert wrong(statuses) == {}
    assert statuses["imu"].values["samples missing"] >= missing


def test_lost_samples_are_counted_on_when_the_clock_is_set_back() -> None:
    f = Filter()
    f.samples(1, 601, lost=[100])
    for k in range(-90_000, -89_400):  # as the node takes them, one by one
        f.samples(k, k + 1, lost=[-89_800])
    statuses = f.look()
    assert f.fold.counts["time_jumps"] == 1
    assert statuses["imu"].values["samples missing"] == 2


@pytest.mark.parametrize("step_ns", [NS // 50, NS // 200])
def test_an_imu_of_another_rate_is_told_as_such_and_not_as_lost_samples(step_ns: int) -> None:
    f = Filter()
    f.samples(1, 601, step_ns)
    (complaint,) = f.look()["imu"].complaints
    assert complaint.text.startswith(f"imu.rate is 100 Hz, the stamps have {NS / step_ns:.1f} Hz")


def test_channels_that_are_not_believed_are_told_until_they_move_again() -> None:
    f = Filter()
    f.noise = 0.0
    f.samples(1, 121)
    statuses = f.look()
    assert wrong(statuses) == {"imu": WARN}
    assert "had a frozen channel" in statuses["imu"].message
    f.noise = 1e-7
    f.samples(121, 130)
    assert wrong(f.look(10.0)) == {}


def test_an_output_that_stops_is_an_error() -> None:
    f = Filter()
    f.samples(1, 21)
    f.look()
    for _ in range(10):
        f.received["imu/data_raw"] += 100  # that lead to nothing
        statuses = f.look()
    assert wrong(statuses) == {"output": ERROR}
    f.samples(21, 22)
    assert wrong(f.look()) == {}


def test_a_filter_that_diverges_is_an_error() -> None:
    """With the largest walks that may be told, and no DVL."""
    f = Filter(
        **{
            "process_noise.gyroscope_bias_walk": 1e6,
            "process_noise.accelerometer_bias_walk": 1e8,
        }
    )
    first = 1
    while not f.fold.counts["diverged"]:
        f.look()
        f.samples(first, first + 100)
        first += 100
        assert first < 10_000
    statuses = f.look()
    assert wrong(statuses)["initialisation"] == ERROR
    assert "diverged and gave up its state 1 times" in statuses["initialisation"].message
    assert statuses["initialisation"].values["diverged"] == 1
    assert "diverged" not in f.look(10.0)["initialisation"].message


def test_late_output_is_told_where_the_clocks_agree() -> None:
    for delay_ns, expected in ((2 * NS, {"output": WARN}), (-60 * NS, {}), (NS // 2, {})):
        f = Filter()
        f.samples(1, 21)
        f.look()
        f.samples(21, 22)
        (output,) = (cause for cause in f.watch._causes if isinstance(cause, Output))
        output._latencies_ns.clear()
        last = f.watch._published.last
        assert last is not None
        f.watch.published(last, last.stamp_ns + delay_ns)
        statuses = f.look()
        assert wrong(statuses) == expected
        if expected:
            assert "in the navigator, the tuner takes too long" in statuses["output"].message


def test_a_time_jump_is_told_with_both_stamps() -> None:
    f = Filter()
    f.samples(1, 101)
    f.look()
    f.samples(100_001, 100_101)
    statuses = f.look()
    assert wrong(statuses) == {"time": WARN}
    assert "went from 1700000001.000 to 1700001000.010 s" in statuses["time"].message
    assert wrong(f.look(10.0)) == {}


@pytest.mark.parametrize(("first", "reason"), [(-99_999, "too_late"), (100_001, "far_ahead")])
def test_what_a_jump_has_recovered_is_not_told_as_refused(first: int, reason: str) -> None:
    """Nine samples are refused until the tenth says that they are of another time."""
    f = Filter()
    f.samples(1, 101)
    f.look()
    f.samples(first, first + 9)
    status = f.look()["time"]
    assert f"refused on imu/data_raw in the last 10 s: 9 {reason}" in status.message
    assert "check the IMU's clock" in status.message
    assert "shorten the delay" not in status.message
    f.samples(first + 9, first + 100)
    status = f.look()["time"]
    assert "refused on" not in status.message
    assert status.message.endswith("; 9 messages that were refused at first are used")
    assert status.values[f"rejected imu/data_raw: {reason}"] == status.values["recovered"] == 9
    f.rejected[Refused("dvl/velocity", "too_late")] += 1  # used by nobody
    assert "1 too_late (they arrive more than max_delay after" in f.look()["time"].message


def test_a_sample_behind_a_gap_is_not_told_as_refused() -> None:
    f = Filter()
    f.samples(1, 101)
    f.samples(401, 501)
    assert f.rejected.total() == f.fold.counts["recovered"] == 1
    statuses = f.look()
    assert wrong(statuses) == {"imu": WARN} and "1 gaps" in statuses["imu"].message


def test_a_jump_that_is_held_is_an_error_until_the_old_time_comes_again() -> None:
    f = Filter(jump_action="hold")
    f.samples(1, 101)
    f.look()
    f.samples(100_001, 100_101)
    statuses = f.look()
    assert wrong(statuses) == {"time": ERROR}
    assert "call ~/reset" in statuses["time"].message
    f.samples(101, 102)
    assert wrong(f.look()) == {"time": WARN}  # what came meanwhile was refused for good
    assert wrong(f.look(10.0)) == {}


def test_a_changing_frame_is_told() -> None:
    f = Filter()
    f.samples(1, 21)
    f.inputs.frame_ids["imu/data_raw"] = "imu_link"
    f.inputs.frame_changes["imu/data_raw"] = 2
    statuses = f.look()
    assert wrong(statuses) == {"frames": WARN}
    assert "imu/data_raw changed 2 times" in statuses["frames"].message
    f.samples(21, 22)
    assert wrong(f.look(10.0)) == {}


def test_wrong_axes_are_an_error_until_the_time_begins_again() -> None:
    f = Filter()
    for k in range(2500):
        f.watch.took(Imu(k * NS // 100, np.array([0.0, 0.0, 9.8]), np.zeros(3)))
    statuses = f.look()
    assert wrong(statuses)["frames"] == ERROR
    assert "gravity has the wrong sign along z" in statuses["frames"].message
    f.watch.reset()
    assert "frames" not in wrong(f.look())


def test_the_page_has_every_status_and_every_reason() -> None:
    page = PAGE.read_text(encoding="utf-8")
    learning = Filter(**{"dvl.noise_source": "learned"})
    for cause in (*learning.look(), "connections", "unexpected errors", "mission", "recording"):
        assert f"`{cause}`" in page, cause
    for reason in REMEDIES:
        assert f"`{reason}`" in page, reason
