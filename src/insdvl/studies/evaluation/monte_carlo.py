"""One run of the comparison: a mission, the same for all approaches, and the errors of each."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from insdvl.arrays import Array, Stamps
from insdvl.navigation.coordinates import body_velocity_jacobian, position_error
from insdvl.navigation.error_state import ACCELEROMETER_BIAS, ATTITUDE, GYROSCOPE_BIAS, POSITION
from insdvl.navigation.events import NS, Event, Imu, Initial, ProcessNoise, SensorNoise
from insdvl.navigation.geometry.frames import rotation_from_vector
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.odometry import position_in_odom
from insdvl.navigation.parameters import FilterParameters
from insdvl.simulation.mission import Mission
from insdvl.studies.evaluation import outages
from insdvl.studies.evaluation.approaches import (
    BANDS,
    MATCHED,
    ORACLE,
    TAUGHT,
    TRUE_FACTOR,
    TRUE_FACTORS,
    Approach,
    estimator,
    own_estimator,
)
from insdvl.studies.evaluation.matched.navigate import navigate
from insdvl.studies.evaluation.metrics import (
    Track,
    attitude_error,
    autocorrelation,
    nees,
    normalised_innovations,
    rmse,
    scores,
)
from insdvl.studies.evaluation.missions import (
    TEST,
    TUNING,
    Study,
    initial_of_run,
    mission_of_run,
    stream_of_run,
)
from insdvl.studies.evaluation.taught import lessons_of, taught_model
from insdvl.timeline.output import FoldResult
from insdvl.timeline.recorded import fold_arrays
from insdvl.tuner.measurement_noise import DvlTuner
from insdvl.tuner.offline import tuned, tuned_by_own
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.windows import Estimator

_TEACHING = 2004  # key of the random streams

#: Numbers of an approach in a run; nan where one is undefined.
METRICS = (
    "body_rmse",
    "srmse",
    "smae",
    "heading_rmse_deg",
    "tilt_rmse_deg",
    "position_drift_percent",
    "depth_rmse",
    *outages.METRICS,
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

FAILURE_SPEED = 5.0  # m/s; a larger body velocity error for FAILURE_TIME is a failure
FAILURE_TIME = 10.0  # s
RATE, MAX_GAP_NS = 1.0, NS // 10  # Hz, ns; defaults of the tuner
_NEES_RATE = 4  # Hz; at and between the updates


def numbered(runs: int) -> dict[str, int]:
    """The numbers of the runs, as tasks of a pool."""
    return {f"{number}": number for number in range(runs)}


class Flight:
    """A mission and its start, which every filter navigates.

    Attributes:
        mission: The mission, in NED and forward-right-down.
        truth: The truth at the stamps of the IMU.
        outages: Of the DVL.
    """

    def __init__(
        self, mission: Mission, initial: Initial, silent: tuple[outages.Outage, ...] = ()
    ) -> None:
        self.mission, self.outages, self._initial = mission, silent, initial
        self.truth = track(mission.truth.C_n_b, mission.truth.v_n, mission.truth.p_o)

    @property
    def samples(self) -> Array:
        """(N, 6) readings of the IMU, f_b then w_ib_b."""
        return np.hstack([self.mission.f_b, self.mission.w_ib_b])

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
        return fold_arrays(parameters, m.stamps_ns, m.f_b, m.w_ib_b, events, _every(parameters))


class Run(Flight):
    """One mission of a study."""

    def __init__(self, study: Study, split: int, number: int) -> None:
        self._of = study, split, number
        mission = mission_of_run(study, split, number)
        super().__init__(mission, initial_of_run(mission, study, split, number), study.outages)
        self._received: dict[str, tuple[Stamps, Array]] = {}

    def fold(self, approach: Approach) -> FoldResult:
        """The mission through the filter of an approach, with what it is told of the noise."""
        if approach.q_source == MATCHED:
            return navigate(
                self.mission, self._initial, approach.parameters, _every(approach.parameters)
            )
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
        return tuned(m.stamps_ns, self.samples, estimate, window, rate, MAX_GAP_NS, history)

    def _tuned_r(self, parameters: FilterParameters) -> list[SensorNoise]:
        """What the tuner learns of the pings' noise, for a filter with these parameters."""
        tuner, m = DvlTuner(TunerParameters().of_vehicle(parameters)), self.mission
        found, pings = [], list(zip(m.dvl_stamps_ns.tolist(), m.v_d, strict=True))
        for stamp_ns, f_b, w_ib_b in zip(m.stamps_ns.tolist(), m.f_b, m.w_ib_b, strict=True):
            found += tuner.add_sample(Imu(stamp_ns, f_b, w_ib_b))
            while pings and pings[0][0] <= stamp_ns:
                found += tuner.add_ping(Dvl(*pings.pop(0)))
        return [SensorNoise(one.stamp_ns, Dvl.name, one.R) for one in found]

    def _variances(self, approach: Approach) -> tuple[Stamps, Array]:
        source = approach.q_source
        if source == ORACLE:
            return self.mission.process_noise()
        if source in (TRUE_FACTOR, TRUE_FACTORS):
            stamps_ns, told = self.learned(*estimator(BANDS), RATE)
            each = source == TRUE_FACTORS
            return stamps_ns, at_true_level(self.mission, stamps_ns, told, each=each)
        if source == TAUGHT:
            study, split, number = self._of
            model = taught_model(
                lessons_of(
                    study.noise,
                    study.sensors.dvl,
                    approach.parameters,
                    vehicle=stream_of_run(study, split, number),
                    seed=np.random.SeedSequence(study.seed, spawn_key=(_TEACHING, split, number)),
                    imu=study.sensors.imu,
                )
            )
            return self.learned(model.variances, model.window, model.history, RATE)
        own = own_estimator(source)
        if own is not None:
            return tuned_by_own(self.mission.stamps_ns, self.samples, own, RATE, MAX_GAP_NS)
        return self.learned(*estimator(source), RATE)


def at_true_level(mission: Mission, stamps_ns: Stamps, told: Array, *, each: bool = False) -> Array:
    """Told variances times the factor that makes their level that of the truth.

    The level is the mean over a mission of the logarithm of the variances that are effective.

    Args:
        mission: The mission.
        stamps_ns: (K,) of the told variances.
        told: (K, 6).
        each: Whether each channel has a factor of its own.
    """
    logarithm = np.mean(np.log(over_effective(mission, stamps_ns, told)), axis=0)
    scaled: Array = told / np.exp(logarithm if each else np.mean(logarithm))
    return scaled


def over_effective(mission: Mission, stamps_ns: Stamps, told: Array) -> Array:
    """Told variances (K, 6) from stamps (K,) on, over the effective ones of the next sample."""
    after = np.searchsorted(mission.stamps_ns, stamps_ns)
    return told / mission.q[np.minimum(after, len(mission.q) - 1)]


def _every(parameters: FilterParameters) -> int:
    """Of so many samples the whole state of the last one is kept."""
    return round(parameters.imu.rate) // _NEES_RATE


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
    return replace(result, C_n_b=rotation_from_vector(psi) @ result.C_n_b)


def failed(
    result: Track, truth: Track, rate: float, silent: tuple[outages.Outage, ...] = ()
) -> bool:
    """Whether a result is not finite, or its body velocity was off for `FAILURE_TIME`.

    Args:
        result: The result.
        truth: At the same samples, one interval of the IMU after the start and on.
        rate: Of the IMU [Hz].
        silent: Outages of the DVL, in which a drift is no failure.
    """
    if not all(np.isfinite(a).all() for a in (result.C_n_b, result.v_b, result.p_o)):
        return True
    lost = np.linalg.norm(result.v_b - truth.v_b, axis=1) > FAILURE_SPEED
    lost &= outages.outside(np.arange(1, lost.size + 1) / rate, silent)
    ends = np.flatnonzero(np.diff(np.concatenate([[0], lost.astype(int), [0]])))
    return bool((np.diff(ends)[::2] >= FAILURE_TIME * rate).any())


def assess(fold: FoldResult, run: Flight) -> tuple[Array, Array]:
    """The metrics of a filter in a run, in the order of `METRICS`, and its series.

    Returns:
        (len(METRICS),) and (K, len(SERIES)) over K seconds; all are nan but ``failed`` where the
        filter failed.
    """
    m, truth, s = run.mission, run.truth, fold.states
    rate = fold.filter.parameters.imu.rate
    step = _every(fold.filter.parameters)
    at = slice(step - 1, None, step)
    seconds = slice(_NEES_RATE - 1, None, _NEES_RATE)  # among those samples, whose states are kept
    series = np.full((len(s[seconds]), len(SERIES)), np.nan)
    result = track_of(fold)
    if fold.counts.get("diverged") or failed(result, truth, rate, run.outages):
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
    if run.outages:
        values |= outages.errors_at_ends(
            run.outages,
            (m.stamps_ns[at] - m.start_ns) / NS,
            dv=dv,
            P_v=P_va[:, :3, :3],
            dp=dp,
            P_p=P[:, POSITION, POSITION],
            position=(truth.p_o - result.p_o)[at],
        )

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
        "depth_rmse": rmse((truth.p_o - result.p_o)[:, 2]),
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
        fold, truth = run.fold(approach), run.truth
        result, rate = track_of(fold), approach.parameters.imu.rate
        if fold.counts.get("diverged") or failed(result, truth, rate):
            rows.append((np.inf, np.inf))
        else:
            rows.append((rmse(truth.v_b - result.v_b), rmse(truth.v_n - result.v_n)))
    return {"errors": np.array(rows)}
