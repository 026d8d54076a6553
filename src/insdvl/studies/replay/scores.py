"""What a folded recording is worth: its errors against the recorded truth, and its innovations."""

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from insdvl.arrays import Array, Stamps
from insdvl.files import finite
from insdvl.messages import convert
from insdvl.messages.convert import RejectedMessage
from insdvl.messages.topics import IMU, TRUTH
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.frames import NED
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.odometry import Odometry, odometry
from insdvl.recordings.base import Raw, decode
from insdvl.studies.evaluation.metrics import (
    Track,
    autocorrelation,
    inside_fraction,
    normalised_innovations,
    scores,
)
from insdvl.studies.replay.fold import Replayed
from insdvl.timeline.fold import Fold
from insdvl.timeline.output import FoldResult
from insdvl.watch.consistency import scaled_nis
from insdvl.watch.start import large_biases, report_of_start

DVL = Dvl.name
LAGS = 10  # of the autocorrelation


def states_at(fold: Fold | FoldResult, stamps_ns: Stamps) -> tuple[Track, Array]:
    """The state at some stamps, in the axes of the stream, and sigmas (M, 6) of v_b and position.

    Between two stamps of the IMU position, velocity and sigmas are interpolated linearly, the
    attitude along the shortest rotation.

    Args:
        fold: The result.
        stamps_ns: (M,) stamps from the first to the last initialised state.
    """

    def sigmas(entry: Odometry) -> Array:
        variances = (np.diag(P)[:3] for P in (entry.twist_covariance, entry.pose_covariance))
        return np.sqrt(np.concatenate([*variances]))

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
    return track, between(sigmas)


def truth_of(recording: Sequence[Raw]) -> tuple[Stamps, Track]:
    """Stamps (M,) and states of the ground truth, in the axes of the stream."""
    events = []
    for raw in recording:
        if raw.topic == TRUTH:
            try:
                events.append(convert.initial(decode(raw).message, NED, once=True))
            except RejectedMessage:  # counted where it is folded
                continue
    return np.array([event.stamp_ns for event in events], dtype=np.int64), Track(
        np.array([event.C_o_b for event in events]).reshape(-1, 3, 3),
        np.array([event.v for event in events]).reshape(-1, 3),
        np.array([event.p_o for event in events]).reshape(-1, 3),
    )


def errors_of(fold: Fold | FoldResult, stamps_ns: Stamps, truth: Track) -> dict[str, Any]:
    """The errors at those stamps (M,) of the truth for which there is a state, and the NIS.

    ``velocity_rmse`` is of the vector in navigation axes. ``nis_mean`` is over all DVL updates that
    were judged, ``nis_mean_accepted`` over those that corrected the state: a filter that rejects
    what does not fit has a small one of these whatever its covariance is. ``depth_error_end`` is
    how much deeper the filter is than the truth at the last stamp. What is not known is None.
    """
    dvl = [u.report for u in fold.updates if u.report.measurement == DVL]
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
        "depth_error_end": None,
        "depth_sigma_end": None,
        "body_velocity_inside_3_sigma": None,
        "reference_stamps": int(inside.sum()),
        "nis_mean": _mean([scaled_nis(report) for report in dvl if report.judged]),
        "nis_mean_accepted": _mean([scaled_nis(report) for report in dvl if report.corrected]),
    }
    if inside.sum() < 2:
        return result
    truth = Track(truth.C_n_b[inside], truth.v_b[inside], truth.p_o[inside])
    track, sigma = states_at(fold, stamps_ns[inside])
    errors = scores(track, truth)
    down = fold.filter.vehicle.axes.nav[2, 2]  # of the stream's z
    result |= {
        "velocity_rmse": errors.srmse,
        "body_velocity_rmse": errors.body_velocity_rmse,
        "velocity_smae": errors.smae,
        "position_rmse_horizontal": errors.position_rmse_horizontal,
        "position_drift_percent": errors.position_drift_percent,
        "heading_rmse_deg": errors.heading_rmse_deg,
        "tilt_rmse_deg": errors.tilt_rmse_deg,
        "depth_error_end": float(down * (track.p_o[-1, 2] - truth.p_o[-1, 2])),
        "depth_sigma_end": float(sigma[-1, 5]),
        "body_velocity_inside_3_sigma": inside_fraction(truth.v_b - track.v_b, sigma[:, :3]),
    }
    return {name: finite(value) for name, value in result.items()}


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None


def _updates_of(name: str, replayed: Replayed) -> dict[str, Any]:
    """How many updates of a measurement were accepted and rejected, and its mean NIS.

    The NIS of the DVL is among the numbers of `errors_of`.
    """
    reports = [u.report for u in replayed.updates if u.report.measurement == name]
    reasons = Counter(report.reason for report in reports if not report.accepted)
    for (topic, reason), count in replayed.refused.items():
        # What is refused on the topic of the IMU is the sample; of its measurement, by its name.
        if topic == name or (topic != IMU and replayed.measurements.get(topic) == name):
            reasons[reason] += count
    numbers: dict[str, Any] = {
        f"{name}_accepted": sum(report.accepted for report in reports),
        f"{name}_rejected": sum(reasons.values()),
        f"{name}_rejected_by_reason": dict(reasons),
    }
    if name != DVL:
        numbers[f"{name}_nis_mean"] = _mean([scaled_nis(r) for r in reports if r.judged])
    return numbers


def report(recording: Sequence[Raw], replayed: Replayed) -> dict[str, Any]:
    """The numbers of the command's JSON; None where the recording has nothing to compare with.

    Beside `errors_of`, the autocorrelation of the innovations of the DVL updates that corrected the
    state, and how many updates of each measurement were accepted and rejected. After a time jump
    the errors are those of the last part, the counts those of all parts.
    """
    fold = replayed.fold
    reports = [u.report for u in replayed.updates if u.report.measurement == DVL]
    corrected = [report for report in reports if report.corrected]
    nu = np.array([r.innovation for r in corrected]).reshape(-1, 3)
    S = np.array([r.S for r in corrected]).reshape(-1, 3, 3)
    known = replayed.initialised
    times_ns = fold.states["nav"]["time_ns"][known]
    document = errors_of(fold, *truth_of(recording))
    start, findings = None, []
    if known.size:
        last = fold.states[-1]
        started = report_of_start(fold.filter, last)
        start = started.text or None
        findings = [f for f in (started.missing, *large_biases(fold.filter, last)) if f]
    for name in dict.fromkeys(replayed.measurements.values()):
        document |= _updates_of(name, replayed)
    return document | {
        "innovation_autocorrelation": (
            autocorrelation(normalised_innovations(nu, S), LAGS) if len(corrected) > LAGS else None
        ),
        "imu_samples": sum(len(part.states) for part in replayed.parts),
        "first_stamp": times_ns[0] / NS if known.size else None,
        "duration": float(times_ns[-1] - times_ns[0]) / NS if known.size else 0.0,
        "counts": fold.counts,
        "rejected": {str(key): count for key, count in replayed.refused.items()},
        "frames": replayed.findings,
        "start": start,
        "findings": [finding for finding in findings if finding != start],
    }
