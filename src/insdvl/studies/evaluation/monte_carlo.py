"""One run of the comparison: a mission, the same for all approaches, and the errors of each.

A run has its own random streams, made from the seed of the study, the split and the number of the
run: for the noise profile, noise and biases of the mission, and for the initial error, which is
drawn from the filter's P_0. Searches use runs of the split `TUNING`, reports those of `TEST`;
training draws from other streams.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from scipy.spatial.transform import Rotation

from insdvl.arrays import Array, Stamps
from insdvl.navigation.coordinates import body_velocity_jacobian, position_error
from insdvl.navigation.error_state import ACCELEROMETER_BIAS, ATTITUDE, GYROSCOPE_BIAS, POSITION
from insdvl.navigation.events import NS, Event, Imu, Initial, ProcessNoise, SensorNoise
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.odometry import position_in_odom
from insdvl.navigation.parameters import FilterParameters
from insdvl.simulation.drawn.scenarios import DRAWN, Scenario
from insdvl.simulation.initial_errors import P_0, drawn_initial
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.noise import SCENARIOS, ProfileFactory, segments
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.trajectories import AUV
from insdvl.studies.evaluation.approaches import (
    ORACLE,
    TAUGHT,
    Approach,
    estimator,
    own_estimator,
)
from insdvl.studies.evaluation.metrics import (
    Track,
    attitude_error,
    autocorrelation,
    nees,
    normalised_innovations,
    rmse,
    scores,
)
from insdvl.studies.evaluation.taught import lessons_of, taught_model
from insdvl.timeline.output import FoldResult
from insdvl.timeline.recorded import fold_arrays
from insdvl.tuner.measurement_noise import DvlTuner
from insdvl.tuner.offline import tuned, tuned_by_own
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.windows import Estimator

#: Splits: first keys of the random streams.
TEST, TUNING = 2000, 2001
_INITIAL = 2002
_TEACHING = 2004

#: Shortest and longest time between changes [s] of the profiles of the study of window and rate.
CHANGES = MappingProxyType({"fast": (2.0, 6.0), "varying": (15.0, 45.0), "slow": (60.0, 180.0)})
#: Noise profiles: the scenarios, those of `CHANGES`, and those that are not white.
PROFILES: Mapping[str, ProfileFactory | Scenario] = MappingProxyType(
    {name: segments(1e-3, 0.05, *times) for name, times in CHANGES.items()}
    | dict(SCENARIOS)
    | dict(DRAWN)
)

#: Numbers of an approach in a run; nan where one is undefined.
METRICS = (
    "body_rmse",
    "srmse",
    "smae",
    "heading_rmse_deg",
    "tilt_rmse_deg",
    "position_drift_percent",
    "nees_velocity",
    "nees_attitude",
    "nees_velocity_attitude",
    "nees_bias",
    "nees_position",
    "nis",
    "nis_accepted",
    "innovation_autocorrelation",
    "failed",
)
#: Numbers of each second: squared errors of the body velocity [(m/s)^2] and of the heading [deg^2],
#: each with the variance in the filter's covariance.
SERIES = ("body_velocity", "body_velocity_variance", "heading", "heading_variance")

OUTLIER = 1.0  # m/s
FAILURE_SPEED = 5.0  # m/s; a larger body velocity error for FAILURE_TIME is a failure
FAILURE_TIME = 10.0  # s
RATE, MAX_GAP_NS = 1.0, NS // 10  # Hz, ns; defaults of the tuner
_NEES_RATE = 4  # Hz; at and between the updates


@dataclass(frozen=True)
class Study:
    """Missions of the AUV that differ in their random numbers only.

    Attributes:
        scenario: Key of `PROFILES`.
        seed: Random seed of all runs.
        duration: Length [s], at most that of the trajectory; None for the whole trajectory.
        dvl_std: Noise of each component of a ping on the DVL's data sheet, one sigma [m/s].
        dvl_rate: Pings per second.
        outliers: Probability that a ping is off by `OUTLIER`.
    """

    scenario: str
    seed: int
    duration: float | None = None
    dvl_std: float = 0.1
    dvl_rate: float = 1.0
    outliers: float = 0.0


def numbered(runs: int) -> dict[str, int]:
    """The numbers of the runs, as tasks of a pool."""
    return {f"{number}": number for number in range(runs)}


def mission_of_run(study: Study, split: int, run: int) -> Mission:
    """The mission of a run, the same for all approaches."""
    stream, dvl = _stream_of_run(study, split, run), _dvl_of(study)
    return simulate(AUV, PROFILES[study.scenario], seed=stream, duration=study.duration, dvl=dvl)


def _stream_of_run(study: Study, split: int, run: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(study.seed, spawn_key=(split, run))


def _dvl_of(study: Study) -> DvlModel:
    return DvlModel(
        rate=study.dvl_rate,
        noise_std=(study.dvl_std,) * 3,
        outlier_probability=study.outliers,
        outlier_size=OUTLIER,
    )


def initial_of_run(mission: Mission, study: Study, split: int, run: int) -> Initial:
    """Initial state of the filters in a run: the truth with an error drawn from P_0."""
    stream = np.random.SeedSequence(study.seed, spawn_key=(_INITIAL, split, run))
    rng = np.random.default_rng(stream)
    return drawn_initial(mission.initial, P_0, rng, stamp_ns=mission.start_ns)


class Run:
    """One mission, which every approach navigates.

    Attributes:
        mission: The mission, in NED and forward-right-down.
        truth: The truth at the stamps of the IMU.
    """

    def __init__(self, study: Study, split: int, number: int) -> None:
        self._of = study, split, number
        self.mission = mission_of_run(study, split, number)
        truth = self.mission.truth
        self.truth = track(truth.C_n_b, truth.v_n, truth.p_o)
        self._received: dict[str, tuple[Stamps, Array]] = {}
        self._initial = initial_of_run(self.mission, study, split, number)

    def fold(self, approach: Approach) -> FoldResult:
        """The mission through the filter of an approach, with the Q and R that it receives."""
        if not approach.q_source:
            return self.fold_received(approach.parameters, np.empty(0, np.int64), np.empty((0, 6)))
        if approach.q_source not in self._received:
            self._received[approach.q_source] = self._variances(approach)
        stamps_ns, variances = self._received[approach.q_source]
        return self.fold_received(
            approach.parameters,
            stamps_ns,
            approach.q_factor * variances,
            told_r=approach.told_r,
            further=self._tuned_r(approach.parameters) if approach.tuned_r else (),
        )

    def fold_received(
        self,
        parameters: FilterParameters,
        stamps_ns: Stamps,
        variances: Array,
        *,
        told_r: bool = False,
        further: Iterable[Event] = (),
    ) -> FoldResult:
        """The mission through a filter that receives variances (K, 6) from stamps (K,) on.

        With ``told_r`` it also receives the true variances of the pings.
        """
        m = self.mission
        received: list[Event] = [
            ProcessNoise(stamp_ns, np.diag(q[:3]), np.diag(q[3:]))
            for stamp_ns, q in zip(stamps_ns.tolist(), variances, strict=True)
        ]
        pings = zip(m.dvl_stamps_ns.tolist(), m.v_d, m.r, strict=True)
        measured = [Dvl(stamp, v_d, np.diag(r) if told_r else None) for stamp, v_d, r in pings]
        events = [self._initial, *measured, *received, *further]
        every = round(parameters.imu.rate) // _NEES_RATE
        return fold_arrays(parameters, m.stamps_ns, m.f_b, m.w_ib_b, events, every)

    def learned(
        self, estimate: Estimator, window: int, history: int, rate: float
    ) -> tuple[Stamps, Array]:
        """Output of a tuner with this estimator: stamps (K,) and variances (K, 6).

        Args:
            estimate: The estimator.
            window: Least number of samples that it uses.
            history: Largest number of samples that it uses.
            rate: Of the tuner [Hz].
        """
        m = self.mission
        return tuned(m.stamps_ns, self._samples, estimate, window, rate, MAX_GAP_NS, history)

    def _tuned_r(self, parameters: FilterParameters) -> list[SensorNoise]:
        """What the tuner learns of the pings' noise, for a filter with these parameters."""
        tuner, m = DvlTuner(TunerParameters().of_vehicle(parameters)), self.mission
        found, pings = [], list(zip(m.dvl_stamps_ns.tolist(), m.v_d, strict=True))
        for stamp_ns, f_b, w_ib_b in zip(m.stamps_ns.tolist(), m.f_b, m.w_ib_b, strict=True):
            found += tuner.add_sample(Imu(stamp_ns, f_b, w_ib_b))
            while pings and pings[0][0] <= stamp_ns:
                found += tuner.add_ping(Dvl(*pings.pop(0)))
        return [SensorNoise(one.stamp_ns, Dvl.name, one.R) for one in found]

    @property
    def _samples(self) -> Array:
        """(N, 6)."""
        return np.hstack([self.mission.f_b, self.mission.w_ib_b])

    def _variances(self, approach: Approach) -> tuple[Stamps, Array]:
        source = approach.q_source
        if source == ORACLE:
            return self.mission.process_noise()
        if source == TAUGHT:
            study, split, number = self._of
            model = taught_model(
                lessons_of(
                    PROFILES[study.scenario],
                    _dvl_of(study),
                    approach.parameters,
                    vehicle=_stream_of_run(study, split, number),
                    seed=np.random.SeedSequence(study.seed, spawn_key=(_TEACHING, split, number)),
                )
            )
            return self.learned(model.variances, model.window, model.history, RATE)
        own = own_estimator(source)
        if own is not None:
            return tuned_by_own(self.mission.stamps_ns, self._samples, own, RATE, MAX_GAP_NS)
        return self.learned(*estimator(source), RATE)


def track(C_n_b: Array, v_n: Array, p_o: Array) -> Track:
    """A track from the velocity in NED (N, 3)."""
    return Track(C_n_b, np.einsum("kji,kj->ki", C_n_b, v_n), p_o)


def track_of(fold: FoldResult) -> Track:
    """The track of a filter at all samples."""
    kept = fold.track
    C_n_b, v_n = (np.ascontiguousarray(kept[name]) for name in ("C_n_b", "v_n"))
    return track(C_n_b, v_n, position_in_odom(kept))


def perfect_heading(result: Track, truth: Track) -> Track:
    """A result without its error about the vertical in attitude and NED velocity."""
    psi = attitude_error(result.C_n_b, truth.C_n_b)
    psi[:, :2] = 0.0
    return replace(result, C_n_b=Rotation.from_rotvec(psi).as_matrix() @ result.C_n_b)


def failed(result: Track, truth: Track, rate: float) -> bool:
    """Whether a result is not finite, or its body velocity was off for `FAILURE_TIME`."""
    if not all(np.isfinite(a).all() for a in (result.C_n_b, result.v_b, result.p_o)):
        return True
    lost = np.linalg.norm(result.v_b - truth.v_b, axis=1) > FAILURE_SPEED
    ends = np.flatnonzero(np.diff(np.concatenate([[0], lost.astype(int), [0]])))
    return bool((np.diff(ends)[::2] >= FAILURE_TIME * rate).any())


def assess(fold: FoldResult, run: Run) -> tuple[Array, Array]:
    """The metrics of a filter in a run, in the order of `METRICS`, and its series.

    Returns:
        (len(METRICS),) and (K, len(SERIES)) over K seconds; all are nan but ``failed`` where the
        filter failed.
    """
    m, truth, s = run.mission, run.truth, fold.states
    rate = fold.filter.parameters.imu.rate
    step = round(rate) // _NEES_RATE
    at = slice(step - 1, None, step)
    seconds = slice(_NEES_RATE - 1, None, _NEES_RATE)  # among those samples, whose states are kept
    series = np.full((len(s[seconds]), len(SERIES)), np.nan)
    result = track_of(fold)
    if failed(result, truth, rate):
        return _failure(), series
    values = _errors(result, truth)

    P = fold.filter.covariance(s)
    J = body_velocity_jacobian(
        result.C_n_b[at],
        s["nav"]["v_n"],
        invariant=fold.filter.vehicle.invariant,
        n=fold.filter.n,
    )
    J = np.concatenate([J, np.broadcast_to(np.eye(fold.filter.n)[ATTITUDE], J.shape)], axis=1)
    P_va = J @ P @ np.swapaxes(J, 1, 2)
    dv = (truth.v_b - result.v_b)[at]
    psi = attitude_error(result.C_n_b[at], truth.C_n_b[at])
    bias = m.bias[at] - np.hstack([s["nav"]["b_f"], s["nav"]["b_w"]])
    biases = slice(ACCELEROMETER_BIAS.start, GYROSCOPE_BIAS.stop)
    dp = position_error(
        s["nav"],
        truth.C_n_b[at],
        m.truth.llh[at],
        invariant=fold.filter.vehicle.invariant,
    )
    for name, error, covariance in (
        ("nees_velocity", dv, P_va[:, :3, :3]),
        ("nees_attitude", psi, P_va[:, 3:, 3:]),
        ("nees_velocity_attitude", np.hstack([dv, psi]), P_va),
        ("nees_bias", bias, P[:, biases, biases]),
        ("nees_position", dp, P[:, POSITION, POSITION]),
    ):
        values[name] = float(np.mean(nees(error, covariance))) / error.shape[1]

    reports = [update.report for update in fold.updates if update.report.judged]
    z = normalised_innovations(
        np.array([r.innovation for r in reports]), np.array([r.S for r in reports])
    )
    values["nis"] = float(np.mean([r.nis for r in reports]))
    accepted = [r.nis for r in reports if r.corrected]
    values["nis_accepted"] = float(np.mean(accepted)) if accepted else np.nan
    values["innovation_autocorrelation"] = autocorrelation(z, 1)[0]

    series[:, 0] = np.sum(dv[seconds] ** 2, axis=1)
    series[:, 1] = np.trace(P_va[seconds, :3, :3], axis1=1, axis2=2)
    series[:, 2] = np.degrees(psi[seconds, 2]) ** 2
    series[:, 3] = np.degrees(np.degrees(P_va[seconds, 5, 5]))
    return np.array([values.get(name, np.nan) for name in METRICS]), series


def assess_track(result: Track, truth: Track) -> Array:
    """The metrics of a result that has no covariance."""
    values = _errors(result, truth)
    return np.array([values.get(name, np.nan) for name in METRICS])


def _errors(result: Track, truth: Track) -> dict[str, float]:
    s = scores(result, truth)
    return {
        "body_rmse": s.body_velocity_rmse,
        "srmse": s.srmse,
        "smae": s.smae,
        "heading_rmse_deg": s.heading_rmse_deg,
        "tilt_rmse_deg": s.tilt_rmse_deg,
        "position_drift_percent": s.position_drift_percent,
        "failed": 0.0,
    }


def _failure() -> Array:
    values = np.full(len(METRICS), np.nan)
    values[METRICS.index("failed")] = 1.0
    return values


def evaluate_run(shared: tuple[Study, Sequence[Approach]], number: int) -> dict[str, Array]:
    """A run of the split `TEST` through all approaches.

    Returns:
        ``scores`` (A, len(METRICS)) and ``series`` (A, K, len(SERIES)) of the A approaches, and
        ``floors`` (2, len(METRICS)) of the rows `FLOORS`, the oracle being among the approaches.
    """
    study, approaches = shared
    run = Run(study, TEST, number)
    truth = run.truth
    assessed = []
    floors = [assess_track(replace(truth, v_b=np.zeros_like(truth.v_b)), truth), _failure()]
    for approach in approaches:
        fold = run.fold(approach)
        assessed.append(assess(fold, run))
        if approach.q_source == ORACLE:
            floors[1] = assess_track(perfect_heading(track_of(fold), truth), truth)
    return {
        "scores": np.array([values for values, _ in assessed]),
        "series": np.array([series for _, series in assessed]),
        "floors": np.array(floors),
    }


def tuning_run(shared: tuple[Study, Sequence[Approach]], number: int) -> dict[str, Array]:
    """A run of the split `TUNING` through all candidates.

    Returns:
        ``errors`` (A, 2): RMSE of the body velocity and SRMSE [m/s]; inf for a failure.
    """
    study, approaches = shared
    run = Run(study, TUNING, number)
    rows = []
    for approach in approaches:
        result, truth = track_of(run.fold(approach)), run.truth
        if failed(result, truth, approach.parameters.imu.rate):
            rows.append((np.inf, np.inf))
        else:
            rows.append((rmse(truth.v_b - result.v_b), rmse(truth.v_n - result.v_n)))
    return {"errors": np.array(rows)}
