"""A filter that was killed goes on from its state file, honestly; a file that does not fit is not
used, and says why."""

import errno
import json
import os
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from records import P15, fields, put
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from told import TOLD

from insdvl import files
from insdvl.navigation.events import NS, Imu, Initial, Origin, ProcessNoise
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.odometry import Odometry, odometry
from insdvl.navigation.parameters import FilterParameters, OriginParameters
from insdvl.navigation.state.fields import NEVER
from insdvl.navigation.state.groups import GATE_COUNTERS
from insdvl.parameters.declaration import build
from insdvl.simulation.initial_errors import drawn_initial
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.noise import SCENARIOS
from insdvl.simulation.trajectories import trajectory_named
from insdvl.timeline.fold import Fold
from insdvl.timeline.jumps import TimeJump
from insdvl.timeline.state_file import StateFile, StateFileError, decode, encode, load

START_NS = 1_700_000_000 * NS
PARAMETERS = build(
    FilterParameters,
    TOLD
    | {
        "origin.height": -5.0,
        "initial.velocity": [1.0, 0.0, 0.0],
        "imu.frozen_samples": 0,  # samples at rest are all equal
    },
)


def rest(fold: Fold, first: int, last: int) -> list[str | None]:
    """Samples of a vehicle at rest at 100 Hz, by number; no channel is frozen."""
    f_b, noise = np.array([0.0, 0.0, -9.8]), np.full(3, 1e-7)
    return [
        fold.add(Imu(START_NS + k * NS // 100, f_b + k % 2 * noise, k % 2 * noise))
        for k in range(first, last)
    ]


def kept(fold: Fold) -> bytes:
    assert fold.latest is not None
    return encode(fold.latest, fold.parameters)


@pytest.fixture(scope="module")
def content() -> bytes:
    fold = Fold(PARAMETERS)
    rest(fold, 1, 301)
    return kept(fold)


def resumed(data: bytes, parameters: FilterParameters = PARAMETERS) -> Fold:
    fold = Fold(parameters)
    fold.resume(decode(data, fold.filter))
    return fold


# ---------------------------------------------------------------- going on


@pytest.mark.parametrize("source", ["external", "adaptive"])
def test_between_two_samples_a_restart_changes_no_bit(source: str) -> None:
    parameters = build(
        FilterParameters, TOLD | {"process_noise.source": source, "dvl.bias_model": "gauss_markov"}
    )
    m = simulate(trajectory_named("auv"), SCENARIOS["varying"], seed=2, duration=8.0)
    events: list[Any] = [
        Imu(*row) for row in zip(m.stamps_ns.tolist(), m.f_b, m.w_ib_b, strict=True)
    ]
    events += [Dvl(*row) for row in zip(m.dvl_stamps_ns.tolist(), m.v_d, strict=True)]
    events += [ProcessNoise(k * NS, np.eye(3) * 0.01 * k, None) for k in range(1, 8)]
    events.sort(key=lambda event: (event.stamp_ns, event.kind))
    whole, first = Fold(parameters), Fold(parameters)
    half = next(k for k, event in enumerate(events) if event.stamp_ns > m.stamps_ns[395])
    for event in events:
        whole.add(event)
    for event in events[:half]:
        first.add(event)
    second = resumed(kept(first), parameters)
    for event in events[half:]:
        assert second.add(event) is None
    a, b = whole.latest, second.latest
    assert a is not None and b is not None
    for (name, of_a), (_, of_b) in zip(fields(a), fields(b), strict=True):
        if not name.startswith("counters.") and name.rpartition(".")[2] not in GATE_COUNTERS:
            assert of_a.tobytes() == of_b.tobytes(), name


def killed_and_restarted(m: Mission, seed: int, down: float) -> tuple[np.ndarray, np.ndarray]:
    """Body velocity errors and covariances after a restart: at the first sample, and later."""
    rng = np.random.default_rng(seed)
    parameters = build(
        FilterParameters,
        TOLD
        | {
            "process_noise.accelerometer_variance": [1e-4] * 3,
            "process_noise.gyroscope_variance": [1e-6] * 3,
        },
    )
    first = Fold(parameters)
    killed = int(rng.integers(4400, 5500))  # while the vehicle turns
    stamps = m.stamps_ns
    for stamp, v in zip(m.dvl_stamps_ns.tolist(), m.v_d, strict=True):
        if stamp <= stamps[killed]:
            first.add(Dvl(stamp, v))
    truth = m.truth
    first.add(
        drawn_initial(m.initial, parameters.initial, rng, stamp_ns=m.start_ns, with_position=False)
    )
    samples = slice(0, killed + 1)
    first.add_recording(stamps[samples], m.f_b[samples], m.w_ib_b[samples], [])
    fold = resumed(kept(first), parameters)
    again = killed + round(down * 100)
    for event in events_between(m, again, again + 400):
        assert fold.add(event) in (None, "far_ahead")
    states = fold.states
    errors, covariances = [], []
    for after in (1, 50, 390):
        output = odometry(fold.filter, states, after)
        k = int(np.searchsorted(stamps, output.stamp_ns))
        true_v = truth.C_n_b[k].T @ truth.v_n[k] * [1.0, -1.0, -1.0]  # forward-left-up
        errors.append(output.twist_linear - true_v)
        covariances.append(output.twist_covariance[:3, :3])
    return np.array(errors), np.array(covariances)


def events_between(m: Mission, first: int, last: int) -> list[Imu | Dvl]:
    """Samples by number, and the DVL measurements among them, by stamp."""
    imu = zip(
        m.stamps_ns.tolist()[first:last], m.f_b[first:last], m.w_ib_b[first:last], strict=True
    )
    begin, end = m.stamps_ns[first], m.stamps_ns[last - 1]
    dvl = zip(m.dvl_stamps_ns.tolist(), m.v_d, strict=True)
    events = [*(Imu(*row) for row in imu), *(Dvl(*row) for row in dvl if begin < row[0] <= end)]
    return sorted(events, key=lambda event: (event.stamp_ns, event.kind))


def rotation(psi: np.ndarray) -> np.ndarray:
    return np.asarray(Rotation.from_rotvec(psi).as_matrix())


def test_after_a_restart_sigma_covers_the_error() -> None:
    m = simulate(trajectory_named("auv"), SCENARIOS["constant-tableI"], seed=7, duration=70.0)
    results = [killed_and_restarted(m, seed, (1.0, 4.0, 10.0)[seed % 3]) for seed in range(18)]
    errors = np.array([r[0] for r in results])
    P = np.array([r[1] for r in results])
    nees = np.einsum("rki,rkij,rkj->rk", errors, np.linalg.inv(P), errors)
    assert (nees < chi2.ppf(1 - 1e-4, 3)).all(), nees.max(axis=0)
    # Not because sigma is endless: with the DVL back it is what it was.
    assert np.sqrt(P[:, 2, 0, 0]).max() < 0.2


def test_what_is_not_later_than_the_state_is_too_late(content: bytes) -> None:
    fold = resumed(content)
    before = fold.states.tobytes()
    assert rest(fold, 250, 301) == ["too_late"] * 51
    assert fold.add(Dvl(START_NS + 3 * NS, np.zeros(3))) == "too_late"
    assert fold.take() == []
    assert fold.states.tobytes() == before
    assert rest(fold, 301, 303) == [None, None]
    assert [output.stamp_ns for output in fold.take()] == [
        START_NS + k * NS // 100 for k in (301, 302)
    ]
    assert set(fold.counts.values()) == {0}


@pytest.mark.parametrize("action", ["reset", "hold"])
@pytest.mark.parametrize("first", [3400, -100_000])
def test_a_state_of_another_time_is_left(content: bytes, action: str, first: int) -> None:
    parameters = replace(PARAMETERS, jump_action=action)
    fold = resumed(content, parameters)
    rest(fold, first, first + 20)
    outputs = fold.take()
    assert isinstance(outputs[0], TimeJump)
    assert outputs[0].from_ns == START_NS + 3 * NS
    anew = Fold(parameters)
    rest(anew, first, first + 20)
    expected = anew.take()
    assert len(outputs) == 1 + len(expected) == 21
    for output, other in zip(outputs[1:], expected, strict=True):
        assert isinstance(output, Odometry) and isinstance(other, Odometry)
        assert output.stamp_ns == other.stamp_ns
        assert output.twist_covariance.tobytes() == other.twist_covariance.tobytes()


def test_the_origin_of_a_state_of_another_time_is_not_used(content: bytes) -> None:
    """The vehicle is at sea somewhere else: today's fix counts."""
    parameters = replace(PARAMETERS, origin=OriginParameters(source="topic"))
    record = decode(content, Fold(PARAMETERS).filter)
    for origin in (None, Origin(START_NS + 40 * NS, 0.9, 0.2, 30.0)):
        fold = Fold(parameters)
        fold.resume(record)
        if origin is not None:
            fold.add(origin)
        rest(fold, 4000, 4020)
        if origin is None:
            assert fold.latest is None
        else:
            assert fold.latest["nav"]["lat_0"] == origin.lat


@pytest.mark.parametrize("seconds", [20.0, 35.0, 45.0])
def test_what_waits_for_the_first_sample_does_not_depend_on_a_file_that_is_not_used(
    content: bytes, seconds: float
) -> None:
    """A set_odometry, then the first sample, 46 s after the file."""
    parameters = replace(PARAMETERS, initial=replace(PARAMETERS.initial, mode="set_odometry"))
    stamp_ns = START_NS + round((3.0 + seconds) * NS)
    told = Initial(stamp_ns, np.eye(3), np.array([7.0, 8.0, 9.0]), np.zeros(3), "body")
    fold, anew = Fold(parameters), Fold(parameters)
    fold.resume(decode(content, Fold(PARAMETERS).filter))
    for each in (fold, anew):
        each.add(told)
        rest(each, 4900, 4920)
    for output, other in zip(fold.take()[1:], anew.take(), strict=True):
        assert isinstance(output, Odometry) and isinstance(other, Odometry)
        assert output.position.tobytes() == other.position.tobytes()
    assert fold.latest is not None and anew.latest is not None
    assert P15(fold.latest).tobytes() == P15(anew.latest).tobytes()


def test_before_its_own_samples_a_filter_knows_no_newest_stamp(content: bytes) -> None:
    """That of the file is no stamp for a set_odometry that has none."""
    fold = resumed(content)
    assert fold.newest_ns == NEVER
    rest(fold, 301, 303)
    assert fold.newest_ns == START_NS + 302 * NS // 100


def test_a_state_within_the_limit_is_a_gap(content: bytes) -> None:
    fold = resumed(content)
    rest(fold, 3200, 3210)  # 29 s later
    assert fold.counts["gaps"] == 1
    (*_, last) = fold.take()
    assert isinstance(last, Odometry)
    # 29 s with 0.5 m/s^2 unseen, and with turns that tilt it.
    assert 29.0 * 0.5 < np.sqrt(last.twist_covariance[0, 0]) < 1000.0


def test_reset_forgets_the_state_of_the_other_run(content: bytes) -> None:
    fold = resumed(content)
    fold.reset()
    assert fold.latest is None
    assert rest(fold, 1, 3) == [None, None]


def test_reset_keeps_the_origin_of_a_state_that_was_used(content: bytes) -> None:
    parameters = replace(PARAMETERS, origin=OriginParameters(source="topic"))
    for used in (True, False):
        fold = Fold(parameters)
        fold.resume(decode(content, Fold(PARAMETERS).filter))
        if used:
            rest(fold, 301, 303)
        fold.reset()
        rest(fold, 303, 305)
        assert (fold.latest is not None) == used


# ---------------------------------------------------------------- files that do not fit


def spoiled(content: bytes, name: str, value: Any) -> bytes:
    """A file with a right checksum and a wrong number."""
    record = decode(content, Fold(PARAMETERS).filter)
    put(record, name, value)
    return encode(record[0], PARAMETERS)


SPOILED = [
    ("nav.initialised", 0),
    ("nav.time_ns", 5),
    ("noise.q_ns", START_NS + 4 * NS),
    ("nav.lat_0", np.nan),
    ("nav.lat_0", 2.0),
    ("nav.v_n", np.inf),
    ("nav.v_n", 1e4),
    ("nav.llh", 1e9),
    ("nav.b_w", np.nan),
    ("nav.C_n_b", np.eye(3) * 1.01),
    ("nav.C_n_b", -np.eye(3)),
    ("nav.P", -np.eye(15)),
    ("nav.P", np.tri(15)),
    ("nav.P", np.full((15, 15), np.nan)),
    ("noise.Q_f", np.diag([1.0, 1.0, -1.0])),
    ("noise.Q_w", np.eye(3) * 1e13),
]


@pytest.mark.parametrize(("name", "value"), SPOILED)
def test_a_record_that_no_filter_writes_is_refused(content: bytes, name: str, value: Any) -> None:
    with pytest.raises(StateFileError, match="^damaged"):
        resumed(spoiled(content, name, value))


def test_every_flipped_bit_and_every_cut_is_noticed(content: bytes) -> None:
    filter_ = Fold(PARAMETERS).filter
    header, record, same = content.index(b"\n"), decode(content, filter_).tobytes(), 0
    for at in [*range(0, header + 40), *range(header + 40, len(content), 97)]:
        for bit in (0, 3, 7):
            data = bytearray(content)
            data[at] ^= 1 << bit
            # But in the last digit of a number, where it may mean the same.
            with suppress(StateFileError):
                assert decode(bytes(data), filter_).tobytes() == record
                same += 1
    assert same <= 2
    for size in range(0, len(content), 61):
        with pytest.raises(StateFileError, match="damaged"):
            decode(content[:size], filter_)
    with pytest.raises(StateFileError, match="damaged"):
        decode(content + b"x", filter_)


@given(st.binary(max_size=300))
@hypothesis_settings(max_examples=200)
def test_whatever_bytes_are_refused(data: bytes) -> None:
    filter_ = _FILTER
    with pytest.raises(StateFileError):
        decode(data, filter_)
    with pytest.raises(StateFileError):
        decode(b"[" * 60_000 + data, filter_)


_FILTER = Fold(PARAMETERS).filter


@pytest.mark.parametrize(
    "parameters",
    [
        {"initial.velocity": [2.0, 0.0, 0.0]},
        {"error_state": "ned"},
        {"imu.lever_arm": [1.0, 0.0, 0.0]},
        {"process_noise.gyroscope_variance": [0.1, 0.1, 0.1]},
        {"origin.latitude_deg": 33.0},
    ],
)
def test_a_file_of_other_parameters_is_refused_by_name(
    content: bytes, parameters: dict[str, Any]
) -> None:
    other = {"origin.height": -5.0, "initial.velocity": [1.0, 0.0, 0.0]} | parameters
    (name,) = parameters
    with pytest.raises(StateFileError, match=f"different parameters: '{name}' was .*, now"):
        resumed(content, build(FilterParameters, TOLD | other))


def test_a_file_of_other_states_or_another_version_is_refused(content: bytes) -> None:
    other = build(FilterParameters, TOLD | {"dvl.bias_model": "gauss_markov"})
    with pytest.raises(StateFileError, match=r"error states: .* were .*, now .*dvl_error"):
        resumed(content, other)
    for older in (b"insdvl state 10", b"insdvl state 2"):  # 2: positions were sums of metres
        with pytest.raises(StateFileError, match=f"another version.*'{older.decode()}'.*state 11"):
            resumed(content.replace(b"insdvl state 11", older))


def test_parameters_that_decide_nothing_may_change(content: bytes) -> None:
    assert resumed(content, replace(PARAMETERS, output_delay=1.0)).latest is not None


def test_only_files_are_read_and_no_more_than_a_record(tmp_path: Path, content: bytes) -> None:
    filter_ = Fold(PARAMETERS).filter
    assert load(tmp_path / "absent", filter_) is None
    with pytest.raises(StateFileError, match="not a regular file"):
        load(tmp_path, filter_)
    with pytest.raises(StateFileError, match="not a regular file"):
        load(Path("/dev/zero"), filter_)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(StateFileError, match="not a regular file"):
        load(tmp_path / "pipe", filter_)
    with pytest.raises(StateFileError, match="cannot be read"):
        load(tmp_path / ("x" * 300), filter_)
    huge = tmp_path / "huge"
    with huge.open("wb") as file:
        file.truncate(10**12)
    with pytest.raises(StateFileError, match="longer than"):
        load(huge, filter_)


# ---------------------------------------------------------------- writing


def test_it_is_written_once_in_a_period_and_read_again(tmp_path: Path) -> None:
    path = tmp_path / "state"
    fold = Fold(replace(PARAMETERS, state_period=0.5))
    file = StateFile(path, fold.filter)
    for k in range(1, 121):
        rest(fold, k, k + 1)
        file.offer(fold.latest)
    assert (file.writes, file.failures, file.error) == (3, 0, None)  # at 0.01, 0.51 and 1.01 s
    assert file.stamp_ns == START_NS + 101 * NS // 100
    record = StateFile(path, fold.filter).load()
    assert record is not None
    assert record[0].tobytes() == fold.states[100].tobytes()
    assert json.loads(path.read_bytes().split(b"\n")[0])["stamp_ns"] == file.stamp_ns
    file.remove()
    assert not path.exists()
    file.remove()  # once more does no harm
    assert file.failures == 0


def test_full_disk_is_counted_tried_again_and_spares_the_last_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "state"
    fold = Fold(PARAMETERS)
    file = StateFile(path, fold.filter)
    rest(fold, 1, 2)
    file.offer(fold.latest)
    before = path.read_bytes()

    def full(path: Path, data: bytes) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as broken:
        broken.setattr(files, "write", full)
        for k in range(2, 302):
            rest(fold, k, k + 1)
            file.offer(fold.latest)
    assert (file.writes, file.failures) == (1, 3)  # tried once a second
    assert file.error == "No space left on device"
    assert path.read_bytes() == before
    rest(fold, 302, 402)
    file.offer(fold.latest)
    assert (file.writes, file.failures, file.error) == (2, 3, None)


def test_folder_that_is_not_there_or_not_writable_is_counted(tmp_path: Path) -> None:
    fold = Fold(PARAMETERS)
    rest(fold, 1, 2)
    for path, reason in (
        (tmp_path / "absent" / "state", "No such file or directory"),
        (Path("/proc/state"), ""),
        (tmp_path, "directory"),
    ):
        file = StateFile(path, fold.filter)
        file.offer(fold.latest)
        assert (file.writes, file.failures) == (0, 1)
        assert file.error is not None and reason in file.error
    assert list(tmp_path.iterdir()) == []


def test_what_is_not_used_is_said_for_a_minute_and_set_aside(tmp_path: Path) -> None:
    path = tmp_path / "state"
    path.write_bytes(b"nothing of ours")
    fold = Fold(PARAMETERS)
    file = StateFile(path, fold.filter)
    assert file.load() is None
    assert file.unused is not None and "damaged" in file.unused
    assert (tmp_path / "state.unused").read_bytes() == b"nothing of ours"
    rest(fold, 1, 2)
    file.offer(fold.latest)
    assert path.is_file() and file.unused is not None
    later = fold.latest.copy()
    later["channels"]["imu_ns"] = later["nav"]["time_ns"] = START_NS + 70 * NS
    file.offer(later)
    assert file.unused is None
    file.path = tmp_path / "beside"
    file.offer(fold.latest)
    path.write_bytes(file.path.read_bytes())
    again = StateFile(path, fold.filter)
    assert again.load() is not None
    assert not again.left_at(START_NS, START_NS + 40 * NS)
    assert again.left_at(START_NS + NS // 100, START_NS + 40 * NS)
    assert again.unused is not None and "within jump_limit (30 s)" in again.unused
    assert not path.exists()
    assert StateFile(tmp_path / "state.unused", fold.filter).load() is not None


def test_a_state_that_could_not_be_read_again_does_not_replace_a_good_one(tmp_path: Path) -> None:
    path = tmp_path / "state"
    fold = Fold(PARAMETERS)
    file = StateFile(path, fold.filter)
    rest(fold, 1, 2)
    file.offer(fold.latest)
    good = path.read_bytes()
    for name, value in (("nav.v_n", np.nan), ("nav.P", -1.0), ("nav.llh", 1e12)):
        bad = fold.latest.copy()
        put(bad, name, value)
        bad["channels"]["imu_ns"] = bad["nav"]["time_ns"] = START_NS + 10 * NS
        file.offer(bad)
        assert file.error is not None and name.removeprefix("nav.") in file.error
        assert path.read_bytes() == good
        file._tried_ns = None
    assert (file.writes, file.failures) == (1, 3)
