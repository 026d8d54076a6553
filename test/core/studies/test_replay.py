"""`insdvl replay`: a recording folds into the state of the direct run, and is measured rightly."""

import json
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from places import position
from recordings import REPLAY, record, save
from records import fields
from whole import States, Whole, fold_whole

from insdvl import cli
from insdvl.arrays import Array, Stamps
from insdvl.messages.refusals import Refused
from insdvl.messages.topics import DVL, IMU
from insdvl.navigation import coordinates
from insdvl.navigation.error_state import ATTITUDE, POSITION
from insdvl.navigation.events import NS, Event, Imu, Initial, ProcessNoise, SensorNoise
from insdvl.navigation.geometry.frames import ENU, rpy_from_rotation
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.odometry import odometry as odometry_of
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build
from insdvl.recordings.bag_reader import BagReader
from insdvl.recordings.base import BagError, Raw, decode, encode
from insdvl.recordings.messages import imu_message, twist_message
from insdvl.recordings.parameters import ReplayParameters
from insdvl.recordings.played import Listed
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.noise import SCENARIOS, constant
from insdvl.simulation.trajectories import BASELINE
from insdvl.studies.evaluation.metrics import Track, autocorrelation, normalised_innovations
from insdvl.studies.judgement.incidents import incidents_of
from insdvl.studies.replay import fold as replay
from insdvl.studies.replay.fold import fold_recording, read
from insdvl.studies.replay.inputs.injection import Injected, Injection
from insdvl.studies.replay.inputs.learning import Learned, LearnedOfDvl
from insdvl.studies.replay.reference import Reference
from insdvl.studies.replay.result import Output
from insdvl.studies.replay.scores import report
from insdvl.timeline.output import FoldResult
from insdvl.timeline.recorded import fold_arrays
from insdvl.tuner.measurement_noise import DvlTuner
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.tuner import Tuner

DURATION = 20.0
START_NS = 1_700_000_000_000_000_000
TRAJECTORY = BASELINE["circle"]


@pytest.fixture(scope="module")
def mission() -> Mission:
    return simulate(TRAJECTORY, SCENARIOS["varying"], seed=5, duration=DURATION, start_ns=START_NS)


def filter_parameters(**values: Any) -> FilterParameters:
    truth = TRAJECTORY.truth(np.zeros(1))
    given = {
        "initial.velocity_frame": "nav",
        "initial.velocity": tuple((ENU.nav @ truth.v_n[0]).tolist()),
        "initial.rpy": tuple(rpy_from_rotation(ENU.attitude(truth.C_n_b[0])).tolist()),
        "initial.position": tuple((ENU.nav @ truth.p_o[0]).tolist()),
        "origin.latitude_deg": float(np.degrees(TRAJECTORY.lat_0)),
        "origin.height": float(TRAJECTORY.h_0),
    }
    names = {name.replace("__", "."): value for name, value in values.items()}
    return build(FilterParameters, {"initial.mode": "parameters"} | given | names)


@pytest.fixture(scope="module")
def bag(mission: Mission, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save(tmp_path_factory.mktemp("bags") / "mission", record(mission))


@pytest.fixture(scope="module")
def recording(bag: Path) -> list[Raw]:
    return list(read(bag, REPLAY))


@pytest.fixture(scope="module")
def whole(recording: list[Raw]) -> Whole:
    """With the parameters as they are."""
    return fold_whole(recording, filter_parameters())


def dvl_events(mission: Mission) -> list[Event]:
    return [Dvl(int(stamp), v) for stamp, v in zip(mission.dvl_stamps_ns, mission.v_d, strict=True)]


def assert_same_states(states: NDArray[np.void], expected: NDArray[np.void]) -> None:
    assert states.dtype == expected.dtype
    for (name, found), (_, value) in zip(fields(states), fields(expected), strict=True):
        np.testing.assert_array_equal(found, value, err_msg=name)


# ---------------------------------------------------------------- the state


@pytest.mark.parametrize("error_state", ["invariant", "ned"])
def test_a_recording_folds_into_the_state_of_the_direct_run(
    recording: list[Raw], mission: Mission, error_state: str
) -> None:
    parameters = filter_parameters(error_state=error_state)
    replayed, states, _ = fold_whole(recording, parameters)
    direct = fold_arrays(
        parameters, mission.stamps_ns, mission.f_b, mission.w_ib_b, dvl_events(mission)
    )
    assert_same_states(states, direct.states)
    assert len(replayed.updates) == len(direct.updates) == int(DURATION)
    assert not replayed.refused


def test_known_time_offsets_make_late_stamps_as_clean_as_right_ones(
    mission: Mission, tmp_path: Path
) -> None:
    """DVL stamps 0.19 s late, IMU stamps 0.03 s: told, they are the same mission to the bit."""
    late = replace(
        mission,
        stamps_ns=mission.stamps_ns + 30_000_000,
        dvl_stamps_ns=mission.dvl_stamps_ns + 190_000_000,
    )
    recording = read(save(tmp_path / "late", record(late)), REPLAY)
    parameters = filter_parameters(dvl__time_offset=-0.19, imu__time_offset=-0.03)
    replayed, states, _ = fold_whole(recording, parameters)
    direct = fold_arrays(
        parameters, mission.stamps_ns, mission.f_b, mission.w_ib_b, dvl_events(mission)
    )
    assert_same_states(states, direct.states)
    assert [u.stamp_ns for u in replayed.updates] == mission.dvl_stamps_ns.tolist()
    assert not replayed.refused
    # The output has the corrected stamps, so it meets the truth where that is stamped right.
    assert states["nav"]["time_ns"].tolist() == mission.stamps_ns.tolist()


def test_the_oracle_uses_the_true_process_noise(
    recording: list[Raw], whole: Whole, mission: Mission
) -> None:
    parameters = filter_parameters(process_noise__source="oracle")
    states = fold_whole(recording, parameters).states
    true = [
        ProcessNoise(int(stamp), np.diag(q[:3]), np.diag(q[3:]))
        for stamp, q in zip(*mission.process_noise(), strict=True)
    ]
    events = dvl_events(mission) + true
    direct = fold_arrays(parameters, mission.stamps_ns, mission.f_b, mission.w_ib_b, events)
    assert_same_states(states, direct.states)
    assert (whole.states["nav"]["P"][-1] != states["nav"]["P"][-1]).any()


def test_without_recorded_process_noise_the_tuner_learns_it(
    recording: list[Raw], mission: Mission
) -> None:
    learned = list(Learned(Listed(recording), TunerParameters()))
    tuner = Tuner(TunerParameters())
    samples = zip(mission.stamps_ns, mission.f_b, mission.w_ib_b, strict=True)
    expected = [
        tuned
        for stamp, f, w in samples
        if (tuned := tuner.add(int(stamp), np.concatenate([ENU.body @ f, ENU.body @ w])))
    ]
    found = [decode(raw).message for raw in learned if raw.topic == "process_noise"]
    assert len(found) == len(expected) > 15
    for message, tuned in zip(found, expected, strict=True):
        Q_f = np.reshape(message.linear_acceleration_covariance, (3, 3))
        Q_w = np.reshape(message.angular_velocity_covariance, (3, 3))
        np.testing.assert_array_equal(Q_f, np.diag(tuned.variances[:3]))
        np.testing.assert_array_equal(Q_w, np.diag(tuned.variances[3:]))
        assert message.header.stamp.sec * NS + message.header.stamp.nanosec == tuned.stamp_ns
    assert [raw for raw in learned if raw.topic != "process_noise"] == recording

    parameters = filter_parameters(process_noise__source="external")
    told = [
        ProcessNoise(tuned.stamp_ns, np.diag(tuned.variances[:3]), np.diag(tuned.variances[3:]))
        for tuned in expected
    ]
    events = dvl_events(mission) + told
    direct = fold_arrays(parameters, mission.stamps_ns, mission.f_b, mission.w_ib_b, events)
    assert_same_states(fold_whole(learned, parameters).states, direct.states)


def test_the_tuner_learns_the_noise_of_the_dvl_as_well(
    recording: list[Raw], mission: Mission
) -> None:
    parameters = filter_parameters(dvl__noise_source="adaptive")
    settings = TunerParameters(measurement_noise=True).of_vehicle(parameters)
    tuner, expected = DvlTuner(settings), []
    rows = zip(mission.stamps_ns.tolist(), mission.f_b, mission.w_ib_b, strict=True)
    inputs = [*(Imu(*row) for row in rows), *dvl_events(mission)]
    for event in sorted(inputs, key=lambda event: (event.stamp_ns, event.kind)):
        expected += tuner.add_sample(event) if isinstance(event, Imu) else tuner.add_ping(event)
    assert len(expected) > 5
    told = [SensorNoise(one.stamp_ns, "dvl", one.R) for one in expected]
    learned = list(LearnedOfDvl(Listed(recording), settings))
    assert [raw for raw in learned if raw.topic != "measurement_noise"] == recording
    direct = fold_arrays(
        parameters, mission.stamps_ns, mission.f_b, mission.w_ib_b, [*dvl_events(mission), *told]
    )
    assert_same_states(fold_whole(learned, parameters).states, direct.states)


def test_the_first_message_of_the_topic_initialises(recording: list[Raw], mission: Mission) -> None:
    """Of the one before the first sample and the one at its stamp, the latter."""
    parameters = filter_parameters(initial__mode="topic")
    states = fold_whole(recording, parameters).states
    C, v_n = mission.truth.C_n_b[0], mission.truth.v_n[0]
    start_ns = int(mission.stamps_ns[0])
    start = Initial(start_ns, C, mission.truth.p_o[0], C.T @ v_n, "body")
    events = [*dvl_events(mission), start]
    direct = fold_arrays(parameters, mission.stamps_ns, mission.f_b, mission.w_ib_b, events)
    # A quaternion is between the two, so they agree to rounding only.
    for name in ("C_n_b", "v_n", "llh", "P"):
        np.testing.assert_allclose(
            states["nav"][name], direct.states["nav"][name], rtol=1e-9, atol=1e-9
        )


def test_a_recording_that_begins_again_is_folded_in_parts(
    recording: list[Raw], whole: Whole, mission: Mission, tmp_path: Path
) -> None:
    """Each part is as the whole of a recording that is played once; nothing is lost."""
    parameters, states = filter_parameters(), States()
    with Output(tmp_path / "out", parameters, 0.0) as output:
        twice = fold_recording([*recording, *recording], parameters, [states, output])
    numbers, single = report(twice), report(whole.replayed)
    assert len(states.parts) == len(twice.parts) == 2
    for part in states.parts:
        assert_same_states(part, whole.states)
    assert numbers["velocity_rmse"] == pytest.approx(single["velocity_rmse"], rel=1e-12)
    assert numbers["dvl_accepted"] == 2 * single["dvl_accepted"]
    assert numbers["imu_samples"] == 2 * single["imu_samples"]
    assert numbers["counts"]["time_jumps"] == 1
    # The first samples of the new time were refused, and used after all.
    assert numbers["counts"]["recovered"] > 0
    assert numbers["rejected"] == {}
    with BagReader(tmp_path / "out") as out:
        stamps = [raw.time_ns for raw in out.raw({"/odometry/filtered"})]
    assert sorted(stamps) == sorted(2 * mission.stamps_ns.tolist())


def test_bad_messages_are_counted_and_change_nothing_else(
    whole: Whole, mission: Mission, tmp_path: Path
) -> None:
    raws = record(mission, every=100)
    last_ns = int(mission.stamps_ns[-1])

    def imu(stamp_ns: int, f: list[float]) -> Raw:
        message = imu_message(stamp_ns, "imu", np.array(f), np.zeros(3))
        return encode("/imu", last_ns + 10, message)

    def dvl(stamp_ns: int, v: list[float]) -> Raw:
        return encode("/dvl", last_ns + 10, twist_message(stamp_ns, "dvl", np.array(v)))

    raws += [
        imu(last_ns + 10, [0.0, np.nan, 0.0]),
        imu(START_NS + NS, [0.0, 0.0, 9.8]),
        dvl(last_ns, [np.inf, 0.0, 0.0]),
        dvl(START_NS + NS, [0.0, 0.0, 0.0]),
    ]
    recording = read(save(tmp_path / "bad", raws), REPLAY)
    replayed, states, _ = fold_whole(recording, filter_parameters())
    assert replayed.refused == {
        Refused("imu/data_raw", "not_finite"): 1,
        Refused("imu/data_raw", "too_late"): 1,
        Refused("dvl/velocity", "not_finite"): 1,
        Refused("dvl/velocity", "too_late"): 1,
    }
    assert report(replayed)["rejected"]["dvl/velocity: too_late"] == 1
    assert_same_states(states, whole.states)
    numbers = report(replayed)
    assert numbers["dvl_rejected"] == 2
    assert numbers["dvl_rejected_by_reason"] == {"not_finite": 1, "too_late": 1}


def accounted(numbers: dict[str, Any]) -> dict[str, int]:
    """How many messages of IMU and DVL the numbers tell the fate of."""
    refused = sum(n for key, n in numbers["rejected"].items() if key.startswith(f"{IMU}: "))
    of_dvl = [numbers[f"dvl_{fate}"] for fate in ("accepted", "rejected", "not_judged")]
    for fate in ("rejected", "not_judged"):
        assert sum(numbers[f"dvl_{fate}_by_reason"].values()) == numbers[f"dvl_{fate}"]
    return {IMU: numbers["imu_samples"] + refused, DVL: sum(of_dvl)}


def recorded(raws: Sequence[Raw]) -> dict[str, int]:
    return {name: sum(raw.topic == name for raw in raws) for name in (IMU, DVL)}


def test_every_message_is_accounted_for_where_the_imu_stops(recording: list[Raw]) -> None:
    """The pings after it wait for samples that never come, and the last are too far ahead."""
    last_ns = START_NS + 8 * NS
    stopped = [raw for raw in recording if raw.topic != IMU or raw.time_ns <= last_ns]
    for limit, far in ((100.0, 0), (6.0, 6)):
        # So many samples may be on their way, beside the limit.
        parameters = filter_parameters(jump_limit=limit, imu__rate=10_000.0 / limit)
        replayed = fold_recording(stopped, parameters)
        numbers = report(replayed)
        assert accounted(numbers) == recorded(stopped)
        assert numbers["messages"] == Counter(
            raw.topic for raw in stopped if raw.topic in (IMU, DVL)
        )
        assert numbers["dvl_not_judged_by_reason"] == {"no_sample": 12 - far}
        assert numbers["dvl_rejected_by_reason"] == ({"far_ahead": far} if far else {})
        found = {i.name: i for i in incidents_of(replayed)}
        waited = found["dvl refused: no_sample"]
        assert waited.count == 12 - far
        assert waited.begin == pytest.approx(last_ns / NS + 1.0, abs=0.02)
        if far:
            # Told at the time at which they came.
            assert found["dvl refused: far_ahead"].end == pytest.approx(
                last_ns / NS + 12.0, abs=0.02
            )


def test_every_message_is_accounted_for_over_a_time_jump_and_a_gap(recording: list[Raw]) -> None:
    """What was refused at first and then used is not refused, and is no incident."""
    gap = [raw for raw in recording if not 5.0 < (raw.time_ns - START_NS) / NS < 9.0]
    for raws in (gap, [*recording, *recording], [*gap, *recording]):
        replayed = fold_recording(raws, filter_parameters())
        numbers = report(replayed)
        assert numbers["counts"]["recovered"] > 0
        assert accounted(numbers) == recorded(raws)
        assert not [i for i in incidents_of(replayed) if "refused" in i.name]


def test_messages_that_are_refused_are_incidents_at_the_time_at_which_they_came(
    recording: list[Raw],
) -> None:
    """Also where their stamps are nonsense, and stamps and recorder are of different clocks."""
    bad = []
    for raw in recording:
        since = (raw.time_ns - START_NS) / NS
        if raw.topic == IMU and 6.0 < since < 6.05:
            raw = encode(
                IMU, raw.time_ns, imu_message(raw.time_ns, "", np.full(3, np.nan), (0,) * 3)
            )
        if raw.topic == DVL and 11.5 < since < 13.5:
            stamp_ns = START_NS + 10**8 * NS if since < 12.5 else raw.time_ns
            raw = encode(DVL, raw.time_ns, twist_message(stamp_ns, "", (np.inf, 0.0, 0.0)))
        bad.append(raw._replace(time_ns=raw.time_ns - START_NS // 2))
    found = {i.name: i for i in incidents_of(fold_recording(bad, filter_parameters()))}
    samples, pings = found[f"{IMU} refused: not_finite"], found["dvl refused: not_finite"]
    assert (samples.count, pings.count) == (4, 2)
    assert samples.begin == pytest.approx(START_NS / NS + 6.01, abs=0.02)
    assert pings.begin == pytest.approx(START_NS / NS + 12.0, abs=0.02)
    assert pings.end == pytest.approx(START_NS / NS + 13.0, abs=0.02)


# ---------------------------------------------------------------- the numbers


def test_the_numbers_are_those_of_the_arrays(whole: Whole, mission: Mission) -> None:
    replayed, states, _ = whole
    numbers, truth = report(replayed), mission.truth

    def rms(error: NDArray[np.float64]) -> float:
        return float(np.sqrt(np.mean(np.sum(error**2, axis=-1))))

    assert numbers["reference_stamps"] == len(states) == len(mission.stamps_ns)
    assert numbers["velocity_rmse"] == pytest.approx(rms(states["nav"]["v_n"] - truth.v_n))
    v_b = np.einsum("kji,kj->ki", states["nav"]["C_n_b"], states["nav"]["v_n"])
    v_b_true = np.einsum("kji,kj->ki", truth.C_n_b, truth.v_n)
    assert numbers["body_velocity_rmse"] == pytest.approx(rms(v_b - v_b_true))
    horizontal = (position(states["nav"]) - truth.p_o)[:, :2]
    assert numbers["position_rmse_horizontal"] == pytest.approx(rms(horizontal))
    yaw = np.arctan2(states["nav"]["C_n_b"][:, 1, 0], states["nav"]["C_n_b"][:, 0, 0])
    yaw -= np.arctan2(truth.C_n_b[:, 1, 0], truth.C_n_b[:, 0, 0])
    yaw = np.degrees((yaw + np.pi) % (2 * np.pi) - np.pi)
    assert numbers["heading_rmse_deg"] == pytest.approx(rms(yaw[:, None]), rel=0.02)
    nis = [update.report.nis for update in replayed.updates]
    assert numbers["nis_mean"] == numbers["nis_mean_accepted"] == pytest.approx(np.mean(nis))
    assert numbers["dvl_accepted"] == len(nis)
    deeper = truth.llh[-1, 2] - states["nav"]["llh"][-1, 2]
    assert numbers["depth_error_end"] == pytest.approx(deeper, abs=1e-9)
    down = np.zeros(15)  # of a position in metres, by the error in the group
    down[POSITION.stop - 1] = 1.0
    down[ATTITUDE] = -coordinates.turns_position(states[-1], invariant=True)[2]
    sigma = np.sqrt(down @ states["nav"]["P"][-1, :15, :15] @ down)
    assert numbers["depth_sigma_end"] == pytest.approx(sigma, rel=1e-6)
    assert 0.9 < numbers["body_velocity_inside_3_sigma"] <= 1.0
    assert len(numbers["innovation_autocorrelation"]) == 10


def test_the_mean_nis_is_over_all_measurements_that_were_judged(
    mission: Mission, tmp_path: Path
) -> None:
    """A rejected one counts: what is left without it fits, whatever the covariance is."""
    wrong = mission.v_d.copy()
    wrong[12] += 3.0
    wrong[13] = 0.0  # refused by name: nothing was judged
    recording = read(save(tmp_path / "wrong", record(replace(mission, v_d=wrong))), REPLAY)
    replayed = fold_recording(recording, filter_parameters())
    reports = [update.report for update in replayed.updates]
    assert [r.reason for r in reports if not r.accepted] == ["gate", "no_lock"]
    judged = [r.nis for r in reports if r.reason != "no_lock"]
    accepted = [r.nis for r in reports if r.accepted]
    numbers = report(replayed)
    assert numbers["nis_mean"] == pytest.approx(np.mean(judged))
    assert numbers["nis_mean_accepted"] == pytest.approx(np.mean(accepted))
    assert numbers["nis_mean"] > 2.0 * numbers["nis_mean_accepted"]


def states_at(fold: FoldResult, stamps_ns: Stamps) -> tuple[Track, Array]:
    """States at stamps (M,) of a reference, and sigmas (M, 6) of v_b and position."""
    none = np.zeros((len(stamps_ns), 3))
    reference = Reference(stamps_ns, Track(np.zeros((len(stamps_ns), 3, 3)), none, none))
    reference.take(fold.filter, fold.states)
    return reference.result.track, reference.result.sigma


def test_a_reference_between_stamps_of_the_imu_is_met_between_them() -> None:
    mission = simulate(TRAJECTORY, constant(np.zeros(6)), seed=5, duration=10.0, start_ns=START_NS)
    samples = mission.stamps_ns, mission.f_b, mission.w_ib_b
    result = fold_arrays(filter_parameters(), *samples, [])
    stamps_ns = mission.stamps_ns[:-1] + 3_000_000
    between, sigma = states_at(result, stamps_ns)
    at, sigma_at = states_at(result, mission.stamps_ns)
    for name in ("v_b", "p_o"):
        values = getattr(at, name)
        mean = 0.7 * values[:-1] + 0.3 * values[1:]
        np.testing.assert_allclose(getattr(between, name), mean, rtol=0, atol=1e-12)
        assert np.abs(values[:-1] - mean).max() > 1e-6
    np.testing.assert_allclose(sigma, 0.7 * sigma_at[:-1] + 0.3 * sigma_at[1:], atol=1e-12)
    # A part of the turn: between the neighbours, and 0.3 of the angle between them away.
    step = np.linalg.norm(at.C_n_b[1:] - at.C_n_b[:-1], axis=(1, 2))
    part = np.linalg.norm(between.C_n_b - at.C_n_b[:-1], axis=(1, 2))
    np.testing.assert_allclose(part, 0.3 * step, rtol=1e-4, atol=1e-12)
    assert step.max() > 1e-5


def test_a_recording_without_truth_has_no_errors_to_tell(bag: Path) -> None:
    recording = read(bag, replace(REPLAY, ground_truth_topic=""))
    numbers = report(fold_recording(recording, filter_parameters()))
    assert numbers["reference_stamps"] == 0
    assert numbers["velocity_rmse"] is None
    assert numbers["dvl_accepted"] == int(DURATION)


def test_innovations_are_normalised_by_their_covariance() -> None:
    rng = np.random.default_rng(1)
    A = rng.standard_normal((3, 3))
    S = A @ A.T + np.eye(3)
    nu = rng.multivariate_normal(np.zeros(3), S, size=20_000)
    z = normalised_innovations(nu, np.broadcast_to(S, (len(nu), 3, 3)))
    np.testing.assert_allclose(z.T @ z / len(z), np.eye(3), atol=0.05)
    np.testing.assert_allclose(
        np.sum(z**2, axis=1), np.einsum("ki,ij,kj->k", nu, np.linalg.inv(S), nu)
    )


def test_autocorrelation_of_a_first_order_process() -> None:
    rng = np.random.default_rng(2)
    x = np.zeros((20_000, 3))
    for k in range(1, len(x)):
        x[k] = 0.8 * x[k - 1] + 0.6 * rng.standard_normal(3)
    np.testing.assert_allclose(autocorrelation(x, 4), [0.8, 0.64, 0.512, 0.41], atol=0.02)
    assert np.abs(autocorrelation(rng.standard_normal((20_000, 3)), 10)).max() < 0.02


# ---------------------------------------------------------------- injected noise


def imu_of(recording: list[Raw]) -> NDArray[np.float64]:
    messages = [decode(raw).message for raw in recording if raw.topic == "imu/data_raw"]
    return np.array([[*m.linear_acceleration, *m.angular_velocity] for m in messages])


def test_injected_noise_has_the_variance_that_the_oracle_is_told(recording: list[Raw]) -> None:
    noisy = list(Injected(Listed(recording), Injection((1e-3, 5e-2), (1e-6, 1e-4), seed=3)))
    added = imu_of(noisy) - imu_of(recording)
    told: list[NDArray[np.float64]] = []
    for raw in noisy:
        message = decode(raw).message
        if raw.topic == "ground_truth/process_noise":
            Q_f = np.reshape(message.linear_acceleration_covariance, (3, 3))
            Q_w = np.reshape(message.angular_velocity_covariance, (3, 3))
            now = np.concatenate([np.diag(Q_f), np.diag(Q_w)])
        elif raw.topic == "imu/data_raw":
            told.append(now)
    q = np.array(told)
    assert (q[:, :3] >= 1e-3).all() and (q[:, :3] <= 5e-2).all()
    assert (q[:, 3:] >= 1e-6).all() and (q[:, 3:] <= 1e-4).all()
    assert len(np.unique(q[:, :3])) >= 3 and len(np.unique(q[:, 3:])) >= 3
    z = added / np.sqrt(q)
    np.testing.assert_allclose(z.std(axis=0), 1.0, atol=0.1)
    np.testing.assert_allclose(z.mean(axis=0), 0.0, atol=0.1)
    assert np.abs(np.corrcoef(z.T) - np.eye(6)).max() < 0.1
    others = [raw for raw in recording if not raw.topic.endswith(("data_raw", "process_noise"))]
    assert [raw for raw in noisy if not raw.topic.endswith(("data_raw", "process_noise"))] == others


def test_the_seed_decides_the_injected_noise(recording: list[Raw]) -> None:
    injections = [Injection((1e-3, 5e-2), (1e-6, 1e-4), seed) for seed in (1, 1, 2)]
    first, again, other = (list(Injected(Listed(recording), i)) for i in injections)
    assert first == again
    assert (imu_of(first) != imu_of(other)).all()


def test_recorded_process_noise_does_not_hold_for_an_injected_imu(bag: Path) -> None:
    recording = read(
        bag, replace(REPLAY, process_noise_topic="/true_q", true_process_noise_topic="")
    )
    assert "process_noise" in {raw.topic for raw in recording}
    noisy = Injected(recording, Injection((1e-3, 5e-2), (1e-6, 1e-4), seed=3))
    assert "process_noise" not in {raw.topic for raw in noisy} | noisy.topics


# ---------------------------------------------------------------- the command

CONFIG = """
/**/insdvl_filter:
  ros__parameters:
    initial: {mode: topic}
/**/insdvl_replay:
  ros__parameters:
    imu_topic: /imu
    dvl_topic: /dvl
    ground_truth_topic: /truth
    true_process_noise_topic: /true_q
"""


def config(folder: Path, text: str = CONFIG) -> Path:
    path = folder / "config.yaml"
    path.write_text(text)
    return path


def test_the_command_writes_its_numbers(
    bag: Path, recording: list[Raw], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["replay", str(bag), "--config", str(config(tmp_path))]
    assert cli.main([*arguments, "--json", str(tmp_path / "a.json")]) == 0
    printed = capsys.readouterr().out
    numbers = json.loads((tmp_path / "a.json").read_text())
    parameters = build(FilterParameters, {"initial.mode": "topic"})
    expected = report(fold_recording(recording, parameters))
    assert {name: numbers[name] for name in expected} == expected
    assert f"{expected['velocity_rmse']:.4g} m/s" in printed
    assert sorted(f.name for f in tmp_path.iterdir()) == ["a.json", "config.yaml"]


def test_the_recorded_outputs_replay_to_the_same_numbers(bag: Path, tmp_path: Path) -> None:
    noise = ["--inject-noise", "1e-3,5e-2,1e-6,1e-4", "--seed", "4"]
    arguments = [
        "replay", str(bag), "--config", str(config(tmp_path)), "--json", str(tmp_path / "a.json")
    ]  # fmt: skip
    out = ["--out", str(tmp_path / "out"), "--rate", "0"]
    assert cli.main([*arguments, *noise, *out]) == 0
    again = tmp_path / "again.yaml"
    again.write_text("/insdvl_filter:\n  ros__parameters: {initial: {mode: topic}}\n")
    arguments = [
        "replay", str(tmp_path / "out"), "--config", str(again), "--json", str(tmp_path / "b.json")
    ]  # fmt: skip
    assert cli.main(arguments) == 0
    a, b = (json.loads((tmp_path / name).read_text()) for name in ("a.json", "b.json"))
    for name in ("velocity_rmse", "nis_mean", "dvl_accepted", "innovation_autocorrelation"):
        assert a[name] == b[name]

    recording = read(tmp_path / "out", ReplayParameters())
    replayed, states, _ = fold_whole(recording, build(FilterParameters, {"initial.mode": "topic"}))
    states = states[states["nav"]["initialised"] != 0]
    with BagReader(tmp_path / "out") as out:
        odometry = [m.message for m in out.messages(["/odometry/filtered"])]
        assert out.topics["/dvl/innovation"].size == int(DURATION)
        assert out.topics["/imu/bias"].size == int(DURATION) + 1
        fixes = [m.message for m in out.messages(["/gps/filtered"])]
        assert len(fixes) == int(DURATION) + 1
        assert fixes[0].header.frame_id == "base_link"
        latitude = np.degrees(states["nav"]["llh"][0, 0])
        assert fixes[0].latitude == pytest.approx(latitude, abs=1e-12)
    assert len(odometry) == len(states)
    for k in (0, 700, len(odometry) - 1):
        expected = odometry_of(replayed.fold.filter, states, k)
        linear, there = odometry[k].twist.twist.linear, odometry[k].pose.pose.position
        assert (linear.x, linear.y, linear.z) == tuple(expected.twist_linear)
        assert (there.x, there.y, there.z) == tuple(expected.position)
        twist, pose = odometry[k].twist.covariance, odometry[k].pose.covariance
        rounded = (expected.twist_covariance.astype("f4"), expected.pose_covariance.astype("f4"))
        np.testing.assert_array_equal(twist.reshape(6, 6), rounded[0])
        np.testing.assert_array_equal(pose.reshape(6, 6), rounded[1])


Change = Callable[[list[str], Path], list[str]]


def with_option(*option: str) -> Change:
    return lambda arguments, folder: [*arguments, *option]


def with_config(text: str) -> Change:
    def change(arguments: list[str], folder: Path) -> list[str]:
        config(folder, text)
        return arguments

    return change


def with_bag(name: str) -> Change:
    return lambda arguments, folder: [arguments[0], str(folder / name), *arguments[2:]]


def source(name: str) -> str:
    return CONFIG.replace(
        "{mode: topic}", f"{{mode: topic}}\n    process_noise: {{source: {name}}}"
    )


BAD_INPUT = {
    "no recording": (with_bag("absent"), "absent does not exist"),
    "no rosbag2": (with_bag("."), "no metadata.yaml"),
    "no configuration": (with_option("--config", "absent.yaml"), "absent.yaml"),
    "no YAML": (with_config("{"), "config.yaml"),
    "an unknown parameter": (with_config(CONFIG + "    imu_topics: /imu"), "'imu_topics'"),
    "a wrong type": (
        with_config(CONFIG.replace("initial:", "max_delay: 3_600.0\n    initial:")),
        "'max_delay' must be a float, got '3_600.0'",
    ),
    "an absent topic": (
        with_config(CONFIG.replace("/imu", "/other")),
        "'/other' is not in .*; it has /dvl, /imu, /true_q, /truth",
    ),
    "an absent DVL": (with_config(CONFIG.replace("/dvl", "/other")), "'/other' is not in"),
    "a topic of another type": (
        with_config(CONFIG.replace("/dvl", "/truth2").replace("/truth\n", "/dvl\n")),
        "/dvl .* has type geometry_msgs/msg/TwistStamped, expected nav_msgs/msg/Odometry",
    ),
    "a topic named twice": (
        with_config(CONFIG + "    process_noise_topic: /imu"),
        "process_noise_topic '/imu' is already played on imu/data_raw",
    ),
    "no message that initialises": (
        with_config(CONFIG.replace("/truth", "/absent")),
        "initial.mode is 'topic', but nothing .* on ground_truth/odometry",
    ),
    "an unknown model": (
        with_config(source("external") + "/**/insdvl_tuner: {ros__parameters: {model: none}}"),
        "none",
    ),
    "no process noise and no tuner": (
        with_config(source("external") + "/**/insdvl_tuner: {ros__parameters: {enabled: false}}"),
        "the tuner is not enabled",
    ),
    "a tuner that tells less often than the filter forgets": (
        with_config(source("external") + "/**/insdvl_tuner: {ros__parameters: {rate: 0.1}}"),
        "'rate' of insdvl_tuner must be at least 0.2 Hz, got 0.1: q_timeout of insdvl_filter is 5",
    ),
    "limits that are no numbers": (with_option("--inject-noise", "1,2,3,x"), "got '1,2,3,x'"),
    "limits the wrong way round": (with_option("--inject-noise", "2,1,1,2"), "0 < LO <= HI"),
    "a limit of zero": (with_option("--inject-noise", "0,1,1,2"), "0 < LO <= HI"),
    "an infinite limit": (with_option("--inject-noise", "1,inf,1,2"), "0 < LO <= HI"),
    "a negative seed": (
        with_option("--inject-noise", "1,2,1,2", "--seed", "-1"),
        "--seed must be >= 0, got -1",
    ),
    "nowhere to write": (with_option("--json", "absent/a.json"), "absent is not a folder"),
    "a folder in the way": (with_option("--json", "/"), "--json /: is a folder"),
    "an output that is there": (with_option("--out", "/"), "/ exists already"),
}


@pytest.mark.parametrize("case", BAD_INPUT)
def test_bad_input_ends_with_one_sentence_and_nothing_written(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], case: str
) -> None:
    change, expected = BAD_INPUT[case]
    json_path = tmp_path / "a.json"
    arguments = [
        "replay", str(bag), "--config", str(config(tmp_path)), "--json", str(json_path)
    ]  # fmt: skip
    arguments = change(arguments, tmp_path)
    before = sorted(tmp_path.iterdir())
    assert cli.main(arguments) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("insdvl replay: ")
    assert said.err.count("\n") == 1
    assert re.search(expected, said.err)
    assert sorted(tmp_path.iterdir()) == before


def told(folder: Path, capsys: pytest.CaptureFixture[str], *arguments: str) -> list[str]:
    """What the command says on stderr about parameters, where there is no recording."""
    (folder / "none").mkdir(exist_ok=True)
    given = ["replay", str(folder / "none"), "--json", str(folder / "a.json"), *arguments]
    assert cli.main(given) == 2
    *lines, last = capsys.readouterr().err.splitlines()
    if "is not a rosbag2 recording" not in last:
        lines.append(last)
    return lines


def test_several_files_are_taken_in_their_order(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = tmp_path / "first.yaml", tmp_path / "second.yaml"
    first.write_text("/**: {ros__parameters: {imu: {rate: 200}, max_delay: 3, foreign: 1}}\n")
    second.write_text("/**/insdvl_filter: {ros__parameters: {max_delay: 4.0}}\n")
    arguments = ["replay", str(bag), "--config", str(first), "--config", str(second)]
    arguments += ["--config", str(config(tmp_path)), "--json", str(tmp_path / "a.json")]
    assert cli.main(arguments) == 0
    parameters = json.loads((tmp_path / "a.json").read_text())["parameters"]["insdvl_filter"]
    assert (parameters["imu.rate"], parameters["max_delay"]) == (200.0, 4.0)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith("unknown parameters are ignored in section '/**': foreign")
    assert line.startswith("insdvl replay: WARN ")


def test_the_namespace_may_be_chosen(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = "/{}/insdvl_filter: {{ros__parameters: {{max_delay: fast}}}}\n"
    file = tmp_path / "config.yaml"
    file.write_text(text.format("port") + text.format("starboard"))
    (line,) = told(tmp_path, capsys, "--config", str(file))
    assert "/port/insdvl_filter, /starboard/insdvl_filter; choose a namespace" in line
    for namespace in ("/port", "starboard/"):
        (line,) = told(tmp_path, capsys, "--config", str(file), "--namespace", namespace)
        assert f"section '/{namespace.strip('/')}/insdvl_filter': parameter 'max_delay'" in line


def test_a_file_for_other_nodes_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "config.yaml"
    file.write_text("/**/insdvl_filtr: {ros__parameters: {max_delay: 3.0}}\n")
    (line,) = told(tmp_path, capsys, "--config", str(file))
    assert "WARN" in line
    assert "none of the file's values reached any of /insdvl_filter, /insdvl_tuner" in line
    file.write_text("/**/insdvl_tuner: {ros__parameters: {rate: 2}}\n")
    (line,) = told(tmp_path, capsys, "--config", str(file))
    assert "none of the file's values reached this node, /insdvl_filter" in line


def test_all_faults_of_all_nodes_are_told_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "config.yaml"
    file.write_text(
        "/**/insdvl_filter: {ros__parameters: {imu.rate: 0, max_dealy: 1.0}}\n"
        "/**/insdvl_tuner: {ros__parameters: {rate: -1}}\n"
        "/**/insdvl_replay: {ros__parameters: {bag: 5}}\n"
    )
    lines = told(tmp_path, capsys, "--config", str(file))
    for line, name in zip(lines, ("'imu.rate'", "'max_dealy'", "'rate'", "'bag'"), strict=True):
        assert name in line


def test_a_recording_that_is_too_long_is_refused_before_it_is_read(
    bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    count = len(list(read(bag, REPLAY).on(["imu/data_raw"])))
    monkeypatch.setattr(replay, "MAX_SAMPLES", count)
    read(bag, REPLAY)
    monkeypatch.setattr(replay, "MAX_SAMPLES", count - 1)
    monkeypatch.setattr(BagReader, "raw", None)
    with pytest.raises(BagError, match=rf"has {count} messages on /imu; at most"):
        read(bag, REPLAY)


def test_a_damaged_recording_leaves_earlier_results_alone(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    damaged = tmp_path / "damaged.mcap"
    whole = next(bag.glob("*.mcap")).read_bytes()
    damaged.write_bytes(whole[: len(whole) // 2])
    (tmp_path / "a.json").write_text("earlier")
    arguments = ["--config", str(config(tmp_path)), "--json", str(tmp_path / "a.json")]
    out = ["--out", str(tmp_path / "out")]
    assert cli.main(["replay", str(damaged), *arguments, *out]) == 2
    assert "damaged.mcap" in capsys.readouterr().err
    assert (tmp_path / "a.json").read_text() == "earlier"
    assert not (tmp_path / "out").exists()
