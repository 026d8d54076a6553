"""Recordings of simulated missions, as a driver would make them."""

from pathlib import Path
from typing import Any

import numpy as np

from insdvl.navigation.geometry.frames import ENU, quaternion_from_rotation
from insdvl.recordings import bags
from insdvl.recordings.bags import BagWriter, Raw, encode
from insdvl.recordings.parameters import ReplayParameters
from insdvl.simulation.mission import Mission

REPLAY = ReplayParameters(
    imu_topic="/imu",
    dvl_topic="/dvl",
    ground_truth_topic="/truth",
    true_process_noise_topic="/true_q",
)


def truth_message(stamp_ns: int, truth: Any, k: int) -> Any:
    C, v_n = truth.C_n_b[k], truth.v_n[k]
    return bags.odometry_message(
        stamp_ns,
        ("odom", "base_link"),
        ENU.nav @ truth.p_n[k],
        quaternion_from_rotation(ENU.attitude(C)),
        ENU.body @ C.T @ v_n,
        ENU.body @ truth.w_nb_b[k],
    )


def record(mission: Mission, *, every: int = 1) -> list[Raw]:
    """The mission as it would be recorded, with the truth at every so many stamps of the IMU."""
    raws = [encode("/truth", mission.start_ns, truth_message(mission.start_ns, mission.initial, 0))]
    for k, stamp_ns in enumerate(mission.stamps_ns.tolist()):
        f, w = ENU.body @ mission.f_b[k], ENU.body @ mission.w_ib_b[k]
        raws.append(encode("/imu", stamp_ns, bags.imu_message(stamp_ns, "imu", f, w)))
        if k % every == 0:
            message = truth_message(stamp_ns, mission.truth, k)
            raws.append(encode("/truth", stamp_ns + 1, message))
    for stamp_ns, v_d in zip(mission.dvl_stamps_ns.tolist(), mission.v_d, strict=True):
        message = bags.twist_message(stamp_ns, "dvl", ENU.body @ v_d)
        raws.append(encode("/dvl", stamp_ns + 2, message))
    for stamp_ns, q in zip(*mission.process_noise(), strict=True):
        Q_f, Q_w = np.diag(q[:3]), np.diag(q[3:])
        message = bags.imu_message(int(stamp_ns), "imu", np.zeros(3), np.zeros(3), Q_f, Q_w)
        raws.append(encode("/true_q", int(stamp_ns) + 3, message))
    return sorted(raws, key=lambda raw: raw.time_ns)


def save(path: Path, raws: list[Raw]) -> Path:
    with BagWriter(path) as bag:
        for raw in raws:
            bag.write(raw)
    return path
