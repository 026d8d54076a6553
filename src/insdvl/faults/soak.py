"""Hours of mission through the core alone: messages in, odometry out, in one process.

The motion is a level circle that closes in each hour, so hour follows hour without a seam; every
hour has noise of its own, and no bias, which would change at the seam.
"""

import heapq
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insdvl import messages
from insdvl.events import NS
from insdvl.faults.stream import Arrival, dvl_arrivals, imu_arrivals
from insdvl.fold import AppliedUpdate, Fold
from insdvl.frames import ENU, NED, rpy_from_rotation
from insdvl.inputs import Inputs
from insdvl.parameters import FilterParameters, TunerParameters, build
from insdvl.simulation.mission import ImuModel, Mission, simulate
from insdvl.simulation.noise import SCENARIOS
from insdvl.simulation.trajectories import LOOP
from insdvl.state import State
from insdvl.tuner.tuner import Tuner

Array = NDArray[np.float64]

LEG = 3600.0  # s of mission: a whole number of circles
IMU = ImuModel(
    accelerometer_bias_std=0.0,
    gyroscope_bias_std=0.0,
    accelerometer_bias_walk=0.0,
    gyroscope_bias_walk=0.0,
)


def start_parameters() -> dict[str, Any]:
    """Names and values of the filter's parameters for the beginning of any hour."""
    truth = LOOP.truth(np.zeros(1))
    return {
        "initial.rpy": tuple(rpy_from_rotation(ENU.attitude(truth.C_n_b[0])).tolist()),
        "initial.velocity": tuple((ENU.body @ truth.C_n_b[0].T @ truth.v_n[0]).tolist()),
        "origin.height": LOOP.h_0,
    }


def hour(number: int, duration: float = LEG) -> Mission:
    """An hour of the mission, or a shorter leg; its stamps follow those of the one before."""
    return simulate(
        LOOP,
        SCENARIOS["varying"],
        seed=1 + number,
        duration=duration,
        imu=IMU,
        start_ns=round(number * duration * NS),
    )


@dataclass(frozen=True)
class Hour:
    """What an hour took.

    Attributes:
        samples: IMU messages sent.
        outputs: Odometry published.
        seconds: Of the filter and the tuner together, without making the messages.
        memory: Resident memory of the process at its end [MB].
        nis: Mean normalised innovation squared.
        body_velocity_rmse: [m/s].
        asymmetry: Largest |P - P^T| after an update, relative to the standard deviations.
        smallest_eigenvalue: Of the correlation matrix of P, after an update; P is positive definite
            while this is above 0.
        orthonormality: Largest element of |C^T C - I| after an update.
    """

    samples: int
    outputs: int
    seconds: float
    memory: float
    nis: float
    body_velocity_rmse: float
    asymmetry: float
    smallest_eigenvalue: float
    orthonormality: float


def run(hours: int, duration: float = LEG) -> Iterator[Hour]:
    """Hours one after the other through one filter and one tuner.

    Args:
        hours: How many.
        duration: Of each [s]; at the seam of shorter ones the heading jumps.
    """
    parameters = build(FilterParameters, start_parameters() | {"process_noise.source": "external"})
    fold, inputs, tuner = Fold(parameters), Inputs(parameters), Tuner(TunerParameters())
    for number in range(hours):
        mission = hour(number, duration)
        truth = mission.truth
        v_b = np.einsum("kji,kj->ki", truth.C_n_b, truth.v_n) @ ENU.body
        k = outputs = 0
        squared, seconds = 0.0, 0.0
        nis: list[float] = []
        numbers: list[tuple[float, float, float]] = []
        for arrival in _arrivals(mission):
            begin = time.perf_counter()
            for output in _taken(arrival, fold, inputs, tuner):
                if isinstance(output, AppliedUpdate):
                    nis.append(output.report.nis)
                    numbers.append(_health(fold.states[-1]))
                    continue
                error = output.twist_linear - v_b[k]
                squared += float(error @ error)
                outputs, k = outputs + 1, k + 1
            seconds += time.perf_counter() - begin
        asymmetry, eigenvalue, orthonormality = np.array(numbers).T
        yield Hour(
            samples=mission.stamps_ns.size,
            outputs=outputs,
            seconds=seconds,
            memory=memory(os.getpid()),
            nis=float(np.mean(nis)),
            body_velocity_rmse=float(np.sqrt(squared / max(outputs, 1))),
            asymmetry=float(asymmetry.max()),
            smallest_eigenvalue=float(eigenvalue.min()),
            orthonormality=float(orthonormality.max()),
        )


def _health(state: State) -> tuple[float, float, float]:
    """Asymmetry, smallest eigenvalue of the correlations, and orthonormality, see `Hour`."""
    P, C = state["P"], state["C_n_b"]
    sigma = np.sqrt(np.diag(P))
    correlation = P / np.outer(sigma, sigma)
    return (
        float(np.abs(correlation - correlation.T).max()),
        float(np.linalg.eigvalsh(correlation)[0]),
        float(np.abs(C.T @ C - np.eye(3)).max()),
    )


def _taken(arrival: Arrival, fold: Fold, inputs: Inputs, tuner: Tuner) -> list[Any]:
    """What the filter publishes after a message, and after the process noise learned from it."""
    _give(arrival.topic, arrival.message, fold, inputs)
    if arrival.topic == "imu/data_raw":
        sample = messages.imu(arrival.message, NED)
        tuned = tuner.add(sample.stamp_ns, np.concatenate([sample.f_b, sample.w_ib_b]))
        if tuned is not None:
            arrival.message.linear_acceleration_covariance = np.diag(tuned.variances[:3]).ravel()
            arrival.message.angular_velocity_covariance = np.diag(tuned.variances[3:]).ravel()
            _give("process_noise", arrival.message, fold, inputs)
    return fold.take()


def _give(topic: str, message: Any, fold: Fold, inputs: Inputs) -> None:
    for event in inputs.events(topic, message, fold.newest_ns):
        fold.add(event)


def _arrivals(mission: Mission) -> Iterator[Arrival]:
    """One at a time: an hour of messages at once would be a gigabyte."""
    return heapq.merge(
        imu_arrivals(mission), dvl_arrivals(mission), key=lambda arrival: arrival.time_ns
    )


def memory(pid: int) -> float:
    """Resident memory of a process [MB]."""
    pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
