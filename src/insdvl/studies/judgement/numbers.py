"""The numbers of a verdict: what was refused, biases, position, and the mount that fits."""

import math
from collections import Counter
from typing import Any

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.error_state import ATTITUDE
from insdvl.navigation.filter import Filter
from insdvl.navigation.odometry import odometry
from insdvl.studies.judgement.mounting import Mount
from insdvl.studies.replay.fold import Replayed


def refusals(document: dict[str, Any], sensor: str) -> Counter[str]:
    """Refused measurements of a sensor by reason, without those that nothing could judge."""
    return Counter(document[f"{sensor}_rejected_by_reason"])


def by_name(document: dict[str, Any], sensor: str) -> Counter[str]:
    """Those that were not refused by the gate: no lock, repeated, late, of another frame."""
    reasons = refusals(document, sensor)
    reasons.pop("gate", None)
    return reasons


def judged_count(document: dict[str, Any], sensor: str) -> int:
    """Number of measurements of a sensor that the filter could judge."""
    return int(refusals(document, sensor).total() + document[f"{sensor}_accepted"])


def refused_share(document: dict[str, Any], sensor: str) -> float | None:
    """Share of those that were refused."""
    count = judged_count(document, sensor)
    return refusals(document, sensor).total() / count if count else None


def biases(filter_: Filter, replayed: Replayed) -> dict[str, Any] | None:
    """The biases at the end over their initial sigmas, in IMU axes of the stream."""
    if not replayed.last.known_ns:
        return None
    nav, vehicle = replayed.last.known[0]["nav"], filter_.vehicle
    to_imu, initial = vehicle.axes.body @ vehicle.C_b_i.T, filter_.parameters.initial
    found = {}
    for name, estimate in (("accelerometer", nav["b_f"]), ("gyroscope", nav["b_w"])):
        values = to_imu @ estimate
        std = getattr(initial, f"{name}_bias_std")
        off: Array = values - np.array(getattr(initial, f"{name}_bias"))
        found[name] = {
            "value": values.tolist(),
            "in_initial_sigmas": (off / std).tolist() if std else None,
        }
    return found


def position(replayed: Replayed) -> dict[str, Any] | None:
    """Where it ended, how far it went, and what is known of that."""
    last, filter_ = replayed.last, replayed.fold.filter
    if not last.known_ns:
        return None
    end = odometry(filter_, last.known, 0)
    P = end.pose_covariance
    down = filter_.vehicle.axes.nav[2, 2]
    heading = last.known[0]["nav"]["P"][ATTITUDE.stop - 1, ATTITUDE.stop - 1]
    return {
        "distance": last.travelled.length,
        "horizontal": end.position[:2].tolist(),
        "horizontal_sigma": math.sqrt(float(np.linalg.eigvalsh(P[:2, :2])[-1])),
        "depth_below_origin": float(down * end.position[2]),
        "depth_sigma": math.sqrt(float(P[2, 2])),
        "heading_sigma_deg": math.degrees(math.sqrt(float(heading))),
    }


def changes(mount: Mount | None) -> dict[str, Any] | None:
    """What the innovations say of mount, lever arm, time offset and scale."""
    if mount is None:
        return None
    return {c.unknown.name: {"change": c.value, "sigma": c.sigma} for c in mount}
