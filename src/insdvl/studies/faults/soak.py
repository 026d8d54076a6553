"""The core alone for long: hours of mission, messages in and odometry out; millions of steps.

The mission is a level circle that closes every hour, so that hours follow each other without a
seam. Every hour has its own noise and no bias, which would change at the seam.
"""

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from insdvl.arrays import Array
from insdvl.messages.feed import Feed
from insdvl.messages.topics import IMU
from insdvl.navigation.events import NS, Imu
from insdvl.navigation.filter import Filter
from insdvl.navigation.geometry.frames import ENU, rpy_from_rotation
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.prediction.kept import Kept
from insdvl.navigation.state.fields import State
from insdvl.parameters.declaration import build, flatten
from insdvl.simulation.initial_errors import P_0
from insdvl.simulation.mission import ImuModel, Mission, simulate
from insdvl.simulation.noise import SCENARIOS
from insdvl.simulation.trajectories import LOOP
from insdvl.studies.faults.stream import Arrival, learned_from, sensor_arrivals
from insdvl.timeline.output import AppliedUpdate
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.tuner import Tuner

LEG = 3600.0  # s of mission: a whole number of circles
SENSORS = ImuModel(
    accelerometer_bias_std=0.0,
    gyroscope_bias_std=0.0,
    accelerometer_bias_walk=0.0,
    gyroscope_bias_walk=0.0,
)


#: Filters that make millions of steps, without the gate: it would rightly start again.
STEPPED: dict[str, dict[str, Any]] = {
    "invariant, with DVL error": {"dvl.bias_model": "gauss_markov", "gate.enabled": False},
    "ned": {"error_state": "ned", "gate.enabled": False},
}


def start_parameters() -> dict[str, Any]:
    """The filter's parameters for the beginning of any hour, by name."""
    truth = LOOP.truth(np.zeros(1))
    return {
        **flatten(P_0, "initial."),
        "initial.rpy": tuple(rpy_from_rotation(ENU.attitude(truth.C_o_b[0])).tolist()),
        "initial.velocity": tuple((ENU.body @ truth.C_n_b[0].T @ truth.v_n[0]).tolist()),
        "origin.height": LOOP.h_0,
    }


def hour(number: int, duration: float = LEG) -> Mission:
    """An hour of the mission, or a shorter leg; its stamps continue those of the previous one."""
    return simulate(
        LOOP,
        SCENARIOS["varying"],
        seed=1 + number,
        duration=duration,
        imu=SENSORS,
        start_ns=round(number * duration * NS),
    )


@dataclass(frozen=True)
class Health:
    """How accurate the numbers are, each the worst of many states.

    Attributes:
        asymmetry: Largest |P - P^T|, relative to the standard deviations.
        smallest_eigenvalue: Of the correlation matrix of P, which is positive definite while this
            is above 0.
        orthonormality: Largest element of |C^T C - I|.
    """

    asymmetry: float = 0.0
    smallest_eigenvalue: float = 1.0
    orthonormality: float = 0.0

    def with_state(self, state: State, P: Array) -> "Health":
        """The worst of this and of a state; NaN where the state is not finite.

        Args:
            state: The state.
            P: (n, n) its covariance.
        """
        C = state["nav"]["C_n_b"]
        if not all(np.isfinite(state["nav"][name]).all() for name in ("C_n_b", "v_n", "llh", "P")):
            return Health(np.nan, np.nan, np.nan)
        sigma = np.sqrt(np.diag(P))
        correlation = P / np.outer(sigma, sigma)
        return Health(
            float(np.maximum(self.asymmetry, np.abs(correlation - correlation.T).max())),
            float(np.minimum(self.smallest_eigenvalue, np.linalg.eigvalsh(correlation)[0])),
            float(np.maximum(self.orthonormality, np.abs(C.T @ C - np.eye(3)).max())),
        )


@dataclass(frozen=True)
class Hour:
    """The numbers of an hour.

    Attributes:
        samples: IMU messages sent.
        outputs: Odometry published.
        seconds: Time of filter and tuner, without that of making the messages.
        memory: Resident memory of the process at the end of the hour, without the mission [MB].
        nis: Mean normalised innovation squared.
        body_velocity_rmse: [m/s].
        health: After the updates.
    """

    samples: int
    outputs: int
    seconds: float
    memory: float
    nis: float
    body_velocity_rmse: float
    health: Health


def flown_hours(count: int, duration: float = LEG) -> Iterator[Hour]:
    """Fly hours one after the other with one filter and one tuner.

    Args:
        count: Number of hours.
        duration: Duration of each [s]; where it is shorter the heading jumps at the seam.
    """
    parameters = build(FilterParameters, start_parameters() | {"process_noise.source": "external"})
    feed, tuner = Feed(parameters), Tuner(TunerParameters())
    for number in range(count):
        mission = hour(number, duration)
        truth = mission.truth
        v_b = np.einsum("kji,kj->ki", truth.C_n_b, truth.v_n) @ ENU.body
        k = outputs = 0
        squared, seconds = 0.0, 0.0
        nis: list[float] = []
        health = Health()
        for arrival in sensor_arrivals(mission):
            begin = time.perf_counter()
            for output in _published(arrival, feed, tuner):
                if isinstance(output, AppliedUpdate):
                    nis.append(output.report.nis)
                    state = feed.fold.states[-1]
                    health = health.with_state(state, feed.fold.filter.covariance(state))
                    continue
                error = output.twist_linear - v_b[k]
                squared += float(error @ error)
                outputs, k = outputs + 1, k + 1
            seconds += time.perf_counter() - begin
        samples = mission.stamps_ns.size
        del mission, truth, v_b  # not part of the memory, and not kept while the next is simulated
        yield Hour(
            samples=samples,
            outputs=outputs,
            seconds=seconds,
            memory=memory(os.getpid()),
            nis=float(np.mean(nis)),
            body_velocity_rmse=float(np.sqrt(squared / max(outputs, 1))),
            health=health,
        )


def steps(parameters: FilterParameters, millions: int, seed: int) -> Iterator[Health]:
    """A quick turn for millions of predictions with an update after each thousand.

    Args:
        parameters: Parameters of a filter that starts from them.
        millions: Number of millions.
        seed: Random seed of the noise.

    Yields:
        The health of each million.
    """
    filter_, chunk, rounds = Filter(parameters), 1000, 1000
    rng = np.random.default_rng(seed)
    f_b = np.array([0.1, -0.2, -9.8]) + rng.normal(0.0, 0.1, (chunk, 3))
    w_ib_b = np.array([0.02, -0.01, 0.3]) + rng.normal(0.0, 0.03, (chunk, 3))
    readings = np.hstack([f_b, w_ib_b])
    state = filter_.empty()
    kept = Kept(chunk, state.dtype)
    filter_.await_start(state, Imu(0, f_b[0], w_ib_b[0]), readings[0])
    step_ns = round(NS / parameters.imu.rate)
    stamps_ns = np.arange(1, chunk + 1) * step_ns
    for _ in range(millions):
        health = Health()
        for _ in range(rounds):
            filter_.predict_samples(state, stamps_ns, f_b, w_ib_b, readings, 0, chunk, kept)
            v_d = rng.normal((1.0, 0.0, 0.0), 0.05)
            filter_.update(state, Dvl(int(stamps_ns[-1]), v_d), w_ib_b[-25:].mean(axis=0), 1 / 25)
            health = health.with_state(state[0], filter_.covariance(state)[0])
            stamps_ns += chunk * step_ns
        yield health


def _published(arrival: Arrival, feed: Feed, tuner: Tuner) -> list[Any]:
    """What the filter publishes after a message and after the process noise learned from it."""
    feed.give(arrival.topic, arrival.message)
    if arrival.topic == IMU and (learned := learned_from(arrival, tuner)):
        feed.give(learned.topic, learned.message)
    return feed.fold.take()


def processor_time() -> tuple[int, int]:
    """Time of all processors since the start of the machine [ticks], and the share of its host."""
    ticks = [int(n) for n in Path("/proc/stat").read_text(encoding="ascii").split()[1:9]]
    return sum(ticks), ticks[7]  # steal, proc(5)


def memory(pid: int) -> float:
    """Resident memory of a process [MB]."""
    pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
