"""What a folded recording is worth: its errors against the recorded truth, and its innovations."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from insdvl.arrays import Stamps
from insdvl.files import finite
from insdvl.messages.refusals import NO_SAMPLE
from insdvl.messages.topics import IMU
from insdvl.navigation.events import NS
from insdvl.navigation.filter import Filter
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.studies.evaluation.metrics import (
    Track,
    autocorrelation,
    inside_fraction,
    normalised_innovations,
    scores,
)
from insdvl.studies.replay.fold import Replayed
from insdvl.studies.replay.reference import AtReference, Reference
from insdvl.timeline.output import AppliedUpdate, FoldResult
from insdvl.watch.consistency import scaled_nis
from insdvl.watch.start import large_biases, report_of_start
from insdvl.watch.state_summary import summary

DVL = Dvl.name
#: Reasons for which there was nothing to judge a measurement by: no state yet, no sample any more.
NOT_JUDGED = ("not_initialised", NO_SAMPLE)
LAGS = 10  # of the autocorrelation


def errors_of(fold: FoldResult, stamps_ns: Stamps, truth: Track) -> dict[str, Any]:
    """See `errors_at`, of a result with the states at all samples.

    Args:
        fold: The result.
        stamps_ns: (M,) stamps of the truth.
        truth: Its states.
    """
    reference = Reference(stamps_ns, truth)
    reference.take(fold.filter, fold.states)
    return errors_at(reference.result, fold.filter, fold.updates)


def errors_at(at: AtReference, filter_: Filter, updates: Sequence[AppliedUpdate]) -> dict[str, Any]:
    """The errors at those stamps of the truth for which there is a state, and the NIS.

    ``velocity_rmse`` is of the vector in navigation axes. ``nis_mean`` is over all DVL updates that
    were judged, ``nis_mean_accepted`` over those that corrected the state: a filter that rejects
    what does not fit has a small one of these whatever its covariance is. ``depth_error_end`` is
    how much deeper the filter is than the truth at the last stamp. What is not known is None.
    """
    dvl = [u.report for u in updates if u.report.measurement == DVL]
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
        "reference_stamps": len(at),
        "nis_mean": _mean([scaled_nis(report) for report in dvl if report.judged]),
        "nis_mean_accepted": _mean([scaled_nis(report) for report in dvl if report.corrected]),
    }
    if len(at) < 2:
        return result
    truth, track, sigma = at.truth, at.track, at.sigma
    errors = scores(track, truth)
    down = filter_.vehicle.axes.nav[2, 2]  # of the stream's z
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


def innovation_autocorrelation(updates: Sequence[AppliedUpdate]) -> list[float] | None:
    """Of the normalised innovations of the DVL updates that corrected the state, at lags 1 to LAGS.

    None where there are no more of them than lags.
    """
    reports = [u.report for u in updates if u.report.measurement == DVL and u.report.corrected]
    if len(reports) <= LAGS:
        return None
    nu, S = (np.array([getattr(r, name) for r in reports]) for name in ("innovation", "S"))
    return autocorrelation(normalised_innovations(nu, S), LAGS)


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None


def _updates_of(name: str, replayed: Replayed) -> dict[str, Any]:
    """What became of all recorded messages of a measurement, and its mean NIS.

    They were accepted, rejected, or not judged, since the filter had no state yet or no sample any
    more. The NIS of the DVL is among the numbers of `errors_at`.
    """
    reports = [u.report for u in replayed.updates if u.report.measurement == name]
    reasons = Counter(report.reason for report in reports if not report.accepted)
    for (topic, reason), count in replayed.refused.items():
        # What is refused on the topic of the IMU is the sample; of its measurement, by its name.
        if topic == name or (topic != IMU and replayed.measurements.get(topic) == name):
            reasons[reason] += count
    rejected = {reason: count for reason, count in reasons.items() if reason not in NOT_JUDGED}
    not_judged = {reason: count for reason, count in reasons.items() if reason in NOT_JUDGED}
    numbers: dict[str, Any] = {
        f"{name}_accepted": sum(report.accepted for report in reports),
        f"{name}_rejected": sum(rejected.values()),
        f"{name}_rejected_by_reason": rejected,
        f"{name}_not_judged": sum(not_judged.values()),
        f"{name}_not_judged_by_reason": not_judged,
    }
    if name != DVL:
        numbers[f"{name}_nis_mean"] = _mean([scaled_nis(r) for r in reports if r.judged])
    return numbers


def report(replayed: Replayed) -> dict[str, Any]:
    """The numbers of the command's JSON; None where the recording has nothing to compare with.

    Beside `errors_at`, the autocorrelation of the innovations of the DVL updates that corrected the
    state, and how many updates of each measurement were accepted and rejected. After a time jump
    the errors are those of the last part, the counts those of all parts.
    """
    last, filter_ = replayed.last, replayed.fold.filter
    document = errors_at(replayed.at_reference, filter_, last.updates)
    start, findings, factor = None, [], None
    if last.known_ns:
        state = last.known[0]
        if filter_.parameters.process_noise.adaptive_factor:
            factor = summary(state).factor
        started = report_of_start(filter_, state)
        start = started.text or None
        findings = [f for f in (started.missing, *large_biases(filter_, state)) if f]
    begin_ns, end_ns = last.known_ns or (0, 0)
    for name in dict.fromkeys(replayed.measurements.values()):
        document |= _updates_of(name, replayed)
    return document | {
        "innovation_autocorrelation": innovation_autocorrelation(replayed.updates),
        "process_noise_factor": factor,
        "imu_samples": sum(part.size for part in replayed.parts),
        "first_stamp": begin_ns / NS if last.known_ns else None,
        "duration": float(end_ns - begin_ns) / NS,
        "messages": dict(replayed.messages),
        "counts": replayed.fold.counts,
        "rejected": {str(key): count for key, count in replayed.refused.items()},
        "frames": replayed.findings,
        "start": start,
        "findings": [finding for finding in findings if finding != start],
    }
