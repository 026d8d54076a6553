"""The command `insdvl replay`: the core filter over a recording, without ROS.

The messages of a recording become the events that the filter node would make of them, in the
recorded order, and fold into the state that the node reaches: the same to the bit.
"""

import argparse
import math
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from insdvl.files import check_writable, finite, json_text, write
from insdvl.messages import convert as messages
from insdvl.messages.convert import RejectedMessage
from insdvl.messages.inputs import Q_TOPICS, Inputs
from insdvl.navigation.events import NS, Event
from insdvl.navigation.geometry.frames import CONVENTIONS, NED
from insdvl.navigation.odometry import Odometry, biases, odometry
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import ParameterError, flatten
from insdvl.parameters.sections import load_section
from insdvl.recordings import bags
from insdvl.recordings.bags import BagError, BagReader, BagWriter, Raw, decode
from insdvl.recordings.parameters import ReplayParameters
from insdvl.simulation.imu import white_noise
from insdvl.simulation.noise import segments
from insdvl.studies.evaluation.metrics import (
    Track,
    autocorrelation,
    inside_fraction,
    normalised_innovations,
    scores,
)
from insdvl.timeline.fold import Fold
from insdvl.timeline.output import AppliedUpdate, FoldResult
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.tuner import Tuner
from insdvl.watch.alignment import FrameCheck

Array = NDArray[np.float64]

TRUTH = "ground_truth/odometry"
#: Samples of a recording: 28 hours at 100 Hz. The states of all of them are in memory, 3 kB each.
MAX_SAMPLES = 10_000_000
LAGS = 10


# ---------------------------------------------------------------- recording


def read(path: Path, parameters: ReplayParameters) -> list[Raw]:
    """What is played of a recording, in the recorded order, on the topics of the nodes.

    Raises:
        BagError: The recording cannot be read, lacks the IMU or the DVL, or is too long.
    """
    with BagReader(path) as bag:
        topics = bags.played(bag, parameters)
        size = bag.topics[parameters.imu_topic].size
        if size > MAX_SAMPLES:
            raise BagError(
                f"{path} has {size} messages on {parameters.imu_topic}, and at most {MAX_SAMPLES} "
                "are read: split it"
            )
        return [raw._replace(topic=topics[raw.topic]) for raw in bag.raw(topics)]


@dataclass(frozen=True)
class Injection:
    """White noise for the IMU of a recording.

    Each channel keeps a log-uniform variance for 15 to 45 s, as in the scenario ``varying``.

    Attributes:
        accelerometer: Smallest and largest variance [(m/s^2)^2].
        gyroscope: Smallest and largest variance [(rad/s)^2].
        seed: Of all that is random.
    """

    accelerometer: tuple[float, float]
    gyroscope: tuple[float, float]
    seed: int

    def variances(self, stamps_ns: NDArray[np.int64], rng: np.random.Generator) -> Array:
        """Variance (N, 6) of each sample, f x, y, z then w x, y, z."""
        t = (stamps_ns - stamps_ns.min()) / NS
        columns = [
            segments(*limits)(float(t.max()) + 1.0, child).variance_at(t)[:, :3]
            for limits, child in zip(
                (self.accelerometer, self.gyroscope), rng.spawn(2), strict=True
            )
        ]
        return np.concatenate(columns, axis=1)

    def draw(self, stamps_ns: NDArray[np.int64]) -> tuple[Array, Array]:
        """Variance (N, 6) and noise (N, 6) of each sample, in the axes of the stream."""
        variance_rng, noise_rng = np.random.default_rng(self.seed).spawn(2)
        q = self.variances(stamps_ns, variance_rng)
        return q, white_noise(q, noise_rng)

    def __call__(self, recording: Sequence[Raw]) -> list[Raw]:
        """A recording whose IMU is noisier, with the true added variances as process noise.

        Recorded process noise and the covariances in the IMU's messages no longer hold: they are
        left out, as are samples without a usable stamp.
        """
        recording = [raw for raw in recording if _has_stamp(raw)]
        samples = [decode(raw).message for raw in recording if raw.topic == "imu/data_raw"]
        stamps_ns = np.array([messages.stamp_ns(sample.header) for sample in samples])
        q, noise = self.draw(stamps_ns)
        told_at = dict(changes(stamps_ns, q))
        noisy: list[Raw] = []
        k = 0
        for raw in recording:
            if raw.topic in Q_TOPICS.values():
                continue
            if raw.topic != "imu/data_raw":
                noisy.append(raw)
                continue
            header = samples[k].header
            if k in told_at:
                Q_f, Q_w = np.diag(q[k, :3]), np.diag(q[k, 3:])
                message = bags.imu_message(
                    told_at[k], header.frame_id, np.zeros(3), np.zeros(3), Q_f, Q_w
                )
                noisy.append(bags.encode(Q_TOPICS["oracle"], raw.time_ns, message))
            f = np.array(samples[k].linear_acceleration) + noise[k, :3]
            w = np.array(samples[k].angular_velocity) + noise[k, 3:]
            message = bags.imu_message(int(stamps_ns[k]), header.frame_id, f, w)
            noisy.append(bags.encode(raw.topic, raw.time_ns, message))
            k += 1
        return noisy


def _has_stamp(raw: Raw) -> bool:
    """Whether a message that is a sample of the IMU has a stamp to draw noise for."""
    try:
        return (
            raw.topic != "imu/data_raw" or messages.sensor_stamp_ns(decode(raw).message.header) > 0
        )
    except RejectedMessage:
        return False


def changes(stamps_ns: NDArray[np.int64], q: Array) -> list[tuple[int, int]]:
    """When variances (N, 6) of samples are told: index of the sample, and stamp of the telling.

    A variance holds from the beginning of its first sample's interval on, which is the stamp
    before. It is told there, and again every second.
    """
    changed = (q[1:] != q[:-1]).any(axis=1)
    told: list[tuple[int, int]] = []
    for k in range(len(stamps_ns)):
        begin_ns = int(stamps_ns[max(k - 1, 0)])
        if k == 0 or changed[k - 1] or begin_ns - told[-1][1] >= NS:
            told.append((k, begin_ns))
    return told


def learn(recording: Sequence[Raw], parameters: TunerParameters) -> list[Raw]:
    """A recording with the process noise that the tuner node would publish on it.

    Raises:
        ModelError: The model cannot be used.
    """
    tuner = Tuner(parameters)
    learned: list[Raw] = []
    for raw in recording:
        learned.append(raw)
        if raw.topic != "imu/data_raw":
            continue
        message = decode(raw).message
        try:
            sample = messages.imu(message, NED)  # the message's own axes, as the node does
        except RejectedMessage:
            continue
        tuned = tuner.add(sample.stamp_ns, np.concatenate([sample.f_b, sample.w_ib_b]))
        if tuned is not None:
            q = tuned.variances
            frame, Q_f, Q_w = message.header.frame_id, np.diag(q[:3]), np.diag(q[3:])
            republished = bags.imu_message(
                tuned.stamp_ns, frame, sample.f_b, sample.w_ib_b, Q_f, Q_w
            )
            learned.append(bags.encode(Q_TOPICS["external"], raw.time_ns, republished))
    return learned


# ---------------------------------------------------------------- filter


@dataclass(frozen=True)
class Replayed:
    """A recording, folded.

    Attributes:
        fold: With the states at all IMU stamps; those before a time jump are in ``fold.left``.
        rejected: Messages that were not used, by ``topic: reason``.
        findings: What cannot be of the frames, see `FrameCheck`.
    """

    fold: Fold
    rejected: Counter[str]
    findings: list[str]

    @property
    def initialised(self) -> NDArray[np.intp]:
        """Indices of the initialised states, after the last time jump."""
        return np.flatnonzero(self.fold.states["nav"]["initialised"])

    @property
    def parts(self) -> list[Fold | FoldResult]:
        """What was folded between time jumps, in the order of arrival."""
        return [*self.fold.left, self.fold]

    @property
    def updates(self) -> list[AppliedUpdate]:
        """Of all parts."""
        return [update for part in self.parts for update in part.updates]


def recorded_events(
    recording: Sequence[Raw], inputs: Inputs, fold: Fold, rejected: Counter[str]
) -> Iterator[tuple[str, Event]]:
    """The filter's events in the order of their messages, each with its topic.

    Args:
        recording: The messages.
        inputs: Of the filter.
        fold: Of the filter; takes each event before the next one is asked for.
        rejected: Counts the messages that cannot be used, by ``topic: reason``.

    Raises:
        BagError: What the parameters need is not in the recording, or a message is damaged.
    """
    there = {raw.topic for raw in recording}
    for topic, reason in inputs.required.items():
        if topic.lstrip("/") not in there:
            raise BagError(f"{reason}, but nothing in the recording is played on {topic}")
    names = {topic.lstrip("/"): topic for topic in inputs.topics}
    for raw in recording:
        if raw.topic not in names:
            continue
        try:
            for event in inputs.events(names[raw.topic], decode(raw).message, fold):
                yield raw.topic, event
        except RejectedMessage as rejection:
            rejected[f"{raw.topic}: {rejection.reason}"] += 1


def fold_recording(recording: Sequence[Raw], parameters: FilterParameters) -> Replayed:
    """All messages of a recording through the filter, as its node takes them.

    Raises:
        BagError: What the parameters need is not in the recording, or a message is damaged.
    """
    fold = Fold(parameters, capacity=sum(raw.topic == "imu/data_raw" for raw in recording) + 1)
    inputs = Inputs(parameters)
    rejected: Counter[str] = Counter()
    checks = [FrameCheck(parameters)]  # one of each part
    for topic, event in recorded_events(recording, inputs, fold, rejected):
        refusal = fold.add(event)
        if refusal is not None:
            rejected[f"{topic}: {refusal}"] += 1
        elif len(fold.left) < len(checks):
            checks[-1].add(event)
        if len(fold.left) >= len(checks):
            checks.append(FrameCheck(parameters))
            inputs.reset()
    findings = {finding: None for check in checks for finding in check.findings()}
    return Replayed(fold, rejected, list(findings))


# ---------------------------------------------------------------- scores


def states_at(fold: Fold | FoldResult, stamps_ns: NDArray[np.int64]) -> tuple[Track, Array]:
    """The result at some stamps, in the axes of the stream, and the sigmas (M, 3) of v_b.

    At a stamp between two of the IMU: position, velocity and sigma are interpolated linearly, the
    attitude along the shortest rotation.

    Args:
        fold: The result.
        stamps_ns: (M,) stamps from the first to the last initialised state.
    """
    times_ns = fold.states["nav"]["time_ns"]
    after = np.searchsorted(times_ns, stamps_ns)
    exact = times_ns[after] == stamps_ns
    before = np.where(exact, after, after - 1)
    needed, rows = np.unique(np.concatenate([before, after]), return_inverse=True)
    table = [odometry(fold.filter, fold.states, int(k)) for k in needed]
    a, b = rows[: len(stamps_ns)], rows[len(stamps_ns) :]
    span = np.where(exact, 1, times_ns[after] - times_ns[before])
    share = ((stamps_ns - times_ns[before]) / span)[:, None]

    def between(values: Callable[[Odometry], Array]) -> Array:
        column = np.array([values(entry) for entry in table])
        return np.where(exact[:, None], column[b], column[a] + share * (column[b] - column[a]))

    attitudes = Rotation.from_quat(np.array([entry.quaternion_xyzw for entry in table]))
    turn = (attitudes[a].inv() * attitudes[b]).as_rotvec()
    C = (attitudes[a] * Rotation.from_rotvec(share * turn)).as_matrix()
    track = Track(C, between(lambda o: o.twist_linear), between(lambda o: o.position))
    return track, between(lambda o: np.sqrt(np.diag(o.twist_covariance)[:3]))


def truth_of(recording: Sequence[Raw]) -> tuple[NDArray[np.int64], Track]:
    """Stamps (M,) and states of the ground truth, in the axes of the stream."""
    events = []
    for raw in recording:
        if raw.topic == TRUTH:
            try:
                events.append(messages.initial(decode(raw).message, NED, once=True))
            except RejectedMessage:  # counted where it is folded; it cannot be compared with
                continue
    return np.array([event.stamp_ns for event in events], dtype=np.int64), Track(
        np.array([event.C_n_b for event in events]).reshape(-1, 3, 3),
        np.array([event.v for event in events]).reshape(-1, 3),
        np.array([event.p_n for event in events]).reshape(-1, 3),
    )


def errors_of(
    fold: Fold | FoldResult, stamps_ns: NDArray[np.int64], truth: Track
) -> dict[str, Any]:
    """The errors at those stamps of the truth (M,) at which there is a state, and the NIS.

    ``velocity_rmse`` is of the vector in navigation axes; ``nis_mean`` is over the DVL updates
    that corrected the state. What cannot be told is None.
    """
    nis = [update.report.nis for update in fold.updates if update.report.corrected]
    times_ns = fold.states["nav"]["time_ns"][fold.states["nav"]["initialised"] != 0]
    inside = np.zeros(len(stamps_ns), dtype=bool)
    if times_ns.size:
        inside = (stamps_ns >= times_ns[0]) & (stamps_ns <= times_ns[-1])
    result: dict[str, Any] = {
        "velocity_rmse": None,
        "body_velocity_rmse": None,
        "velocity_smae": None,
        "position_rmse_horizontal": None,
        "position_drift_percent": None,
        "heading_rmse_deg": None,
        "tilt_rmse_deg": None,
        "body_velocity_inside_3_sigma": None,
        "reference_stamps": int(inside.sum()),
        "nis_mean": float(np.mean(nis)) if nis else None,
    }
    if inside.sum() < 2:
        return result
    truth = Track(truth.C_n_b[inside], truth.v_b[inside], truth.p_n[inside])
    track, sigma = states_at(fold, stamps_ns[inside])
    errors = scores(track, truth)
    result |= {
        "velocity_rmse": errors.srmse,
        "body_velocity_rmse": errors.body_velocity_rmse,
        "velocity_smae": errors.smae,
        "position_rmse_horizontal": errors.position_rmse_horizontal,
        "position_drift_percent": errors.position_drift_percent,
        "heading_rmse_deg": errors.heading_rmse_deg,
        "tilt_rmse_deg": errors.tilt_rmse_deg,
        "body_velocity_inside_3_sigma": inside_fraction(truth.v_b - track.v_b, sigma),
    }
    return {name: finite(value) for name, value in result.items()}


def report(recording: Sequence[Raw], replayed: Replayed) -> dict[str, Any]:
    """The numbers of the command's JSON; None where the recording has nothing to compare with.

    Beside `errors_of`, the autocorrelation of the innovations of the DVL updates that corrected.
    Where time has jumped, what compares with the truth is of the last part, the counts are of all.
    """
    fold = replayed.fold
    updates = replayed.updates
    corrected = [update.report for update in updates if update.report.corrected]
    reasons = Counter(u.report.reason for u in updates if not u.report.accepted)
    for key, count in replayed.rejected.items():
        topic, reason = key.split(": ")
        if topic.startswith("dvl/"):
            reasons[reason] += count
    nu = np.array([r.innovation for r in corrected]).reshape(-1, 3)
    S = np.array([r.S for r in corrected]).reshape(-1, 3, 3)
    known = replayed.initialised
    times_ns = fold.states["nav"]["time_ns"][known]
    return errors_of(fold, *truth_of(recording)) | {
        "dvl_accepted": sum(u.report.accepted for u in updates),
        "dvl_rejected": sum(reasons.values()),
        "dvl_rejected_by_reason": dict(reasons),
        "innovation_autocorrelation": (
            autocorrelation(normalised_innovations(nu, S), LAGS) if len(corrected) > LAGS else None
        ),
        "imu_samples": sum(len(part.states) for part in replayed.parts),
        "first_stamp": times_ns[0] / NS if known.size else None,
        "duration": float(times_ns[-1] - times_ns[0]) / NS if known.size else 0.0,
        "counts": fold.counts,
        "rejected": dict(replayed.rejected),
        "frames": replayed.findings,
    }


# ---------------------------------------------------------------- files


def write_bag(
    bag: BagWriter, recording: Sequence[Raw], replayed: Replayed, parameters: FilterParameters
) -> None:
    """What was folded, and all that the filter node would publish of it.

    Raises:
        BagError: The disk refuses.
    """
    for raw in recording:
        bag.write(raw._replace(topic="/" + raw.topic))
    axes = CONVENTIONS[parameters.frame_convention].body
    frames = parameters.odom_frame, parameters.base_frame
    frame_ids = {raw.topic: decode(raw).message.header.frame_id for raw in _firsts(recording)}
    dvl_frame = frame_ids.get("dvl/velocity", frame_ids.get("dvl/velocity_cov", ""))
    second = None
    initialised = [
        (part, int(k))
        for part in replayed.parts
        for k in np.flatnonzero(part.states["nav"]["initialised"])
    ]
    for part, k in initialised:
        state = odometry(part.filter, part.states, k)
        message = bags.odometry_message(
            state.stamp_ns,
            frames,
            state.position,
            state.quaternion_xyzw,
            state.twist_linear,
            state.twist_angular,
            state.pose_covariance,
            state.twist_covariance,
        )
        bag.write(bags.encode("/odometry/filtered", state.stamp_ns, message))
        if state.stamp_ns // NS != second:
            second = state.stamp_ns // NS
            bias = biases(part.filter, part.states[k])
            message = bags.imu_message(
                bias.stamp_ns,
                frame_ids["imu/data_raw"],
                bias.accelerometer,
                bias.gyroscope,
                bias.accelerometer_covariance,
                bias.gyroscope_covariance,
            )
            bag.write(bags.encode("/imu/bias", bias.stamp_ns, message))
    for update in replayed.updates:
        if not np.isfinite(update.report.nis):
            continue  # nothing was predicted to compare it with
        message = bags.twist_message(
            update.stamp_ns,
            dvl_frame,
            axes @ update.report.innovation,
            axes @ update.report.S @ axes.T,
        )
        bag.write(bags.encode("/dvl/innovation", update.stamp_ns, message))


def _firsts(recording: Sequence[Raw]) -> list[Raw]:
    return list({raw.topic: raw for raw in reversed(recording)}.values())


# ---------------------------------------------------------------- command


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument("bag", type=Path, metavar="BAG", help="rosbag2: a folder, .mcap or .db3")
    parser.add_argument(
        "--config",
        type=Path,
        required=True,
        metavar="FILE",
        help="YAML of the nodes; its sections for filter, tuner and replay are used",
    )
    parser.add_argument(
        "--json", type=Path, required=True, metavar="FILE", help="where the numbers go"
    )
    parser.add_argument(
        "--out", type=Path, metavar="BAG", help="record inputs and outputs in a new rosbag2"
    )
    parser.add_argument(
        "--inject-noise",
        metavar="ACC_LO,ACC_HI,GYR_LO,GYR_HI",
        help="add white noise to the IMU; per channel a log-uniform variance between these limits, "
        "(m/s^2)^2 and (rad/s)^2, for 15 to 45 s each; source 'oracle' knows them",
    )
    parser.add_argument("--seed", type=int, default=0, help="of the injected noise (default: 0)")


def run(arguments: argparse.Namespace) -> int:
    """Replay; the exit code is 2 where the input is refused, and then nothing is written."""
    try:
        _replay(arguments)
    except MemoryError as error:
        print(f"insdvl replay: {arguments.bag} needs too much memory: {error}", file=sys.stderr)
        return 2
    except (ValueError, OSError) as error:
        sentence = " ".join(str(error).split())  # a YAML error comes in several lines
        print(f"insdvl replay: {sentence}", file=sys.stderr)
        return 2
    return 0


def _replay(arguments: argparse.Namespace) -> None:
    _check_places(arguments)
    filter_ = load_section(arguments.config, "insdvl_filter", FilterParameters, required=True)
    tuner = load_section(arguments.config, "insdvl_tuner", TunerParameters)
    replay = load_section(arguments.config, "insdvl_replay", ReplayParameters)
    injection = _injection(arguments)

    recording = read(arguments.bag, replay)
    if injection is not None:
        recording = injection(recording)
    source = q_from = filter_.process_noise.source
    if source == "external":
        q_from = "external, recorded"
        if Q_TOPICS["external"] not in {raw.topic for raw in recording}:
            if not tuner.enabled:
                raise ParameterError(
                    "process_noise.source is 'external', but the recording has no process noise "
                    "and the tuner is not enabled"
                )
            if 1.0 / tuner.rate > filter_.q_timeout:
                raise ParameterError(
                    f"parameter 'rate' of insdvl_tuner must be at least {1 / filter_.q_timeout:g} "
                    f"Hz, got {tuner.rate!r}: q_timeout of insdvl_filter is {filter_.q_timeout:g} s"
                )
            recording, q_from = learn(recording, tuner), f"external, learned by {tuner.model}"
    replayed = fold_recording(recording, filter_)
    if not replayed.initialised.size:
        raise BagError(f"the filter was never initialised (initial.mode {filter_.initial.mode!r})")
    document = report(recording, replayed)
    document |= {
        "bag": str(arguments.bag),
        "process_noise": q_from,
        "injected_noise": asdict(injection) if injection else None,
        "parameters": {"insdvl_filter": flatten(filter_), "insdvl_tuner": flatten(tuner)},
    }
    if arguments.out is None:
        write(arguments.json, json_text(document).encode())
    else:
        with BagWriter(arguments.out) as bag:
            write_bag(bag, recording, replayed, filter_)
            write(arguments.json, json_text(document).encode())
    _print_table(document)


def _check_places(arguments: argparse.Namespace) -> None:
    """What takes long comes first: whether the results can be written is tried before it."""
    check_writable(arguments.json, "--json")
    if arguments.out is not None and arguments.out.exists():
        raise BagError(f"--out {arguments.out} exists already and is not overwritten")


def _injection(arguments: argparse.Namespace) -> Injection | None:
    if arguments.inject_noise is None:
        return None
    text = arguments.inject_noise
    try:
        limits = [float(part) for part in text.split(",")]
    except ValueError:
        limits = []
    ordered = len(limits) == 4 and 0 < limits[0] <= limits[1] and 0 < limits[2] <= limits[3]
    if not ordered or not all(math.isfinite(limit) for limit in limits):
        raise ValueError(
            "--inject-noise must be four numbers ACC_LO,ACC_HI,GYR_LO,GYR_HI with "
            f"0 < LO <= HI, got {text!r}"
        )
    if arguments.seed < 0:
        raise ValueError(f"--seed must be >= 0, got {arguments.seed}")
    return Injection((limits[0], limits[1]), (limits[2], limits[3]), arguments.seed)


def _print_table(document: dict[str, Any]) -> None:
    rows = (
        ("velocity RMSE, navigation axes", "velocity_rmse", "m/s"),
        ("velocity RMSE, body axes", "body_velocity_rmse", "m/s"),
        ("body velocity inside 3 sigma", "body_velocity_inside_3_sigma", ""),
        ("position RMSE, horizontal", "position_rmse_horizontal", "m"),
        ("heading RMSE", "heading_rmse_deg", "deg"),
        ("tilt RMSE", "tilt_rmse_deg", "deg"),
        ("reference stamps", "reference_stamps", ""),
        ("mean NIS (3 dof)", "nis_mean", ""),
        ("DVL accepted", "dvl_accepted", ""),
        ("DVL rejected", "dvl_rejected", ""),
        ("process noise", "process_noise", ""),
    )
    for text, name, unit in rows:
        value = document[name]
        shown = "no reference" if value is None else value
        if isinstance(value, float):
            shown = f"{value:.4g}"
        print(f"{text:32} {shown} {unit}".rstrip())
    if document["counts"]["time_jumps"]:
        print(f"{'time jumps':32} {document['counts']['time_jumps']}, errors are after the last")
    for key, count in document["rejected"].items():
        print(f"{'not used: ' + key:32} {count}")
    for finding in document["frames"]:
        print(f"frames: {finding}")
