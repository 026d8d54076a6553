"""The row `matched`: the filter that has the true shaping states of the simulated noise.

Its state record is of another size, so all functions of the filter are compiled again for it: what
flies it is among the long tests.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from insdvl.arrays import Array, Records
from insdvl.navigation import coordinates
from insdvl.navigation.filter import Filter
from insdvl.navigation.prediction.kept import Kept
from insdvl.navigation.start.initial_state import Start
from insdvl.navigation.state.fields import CORE
from insdvl.simulation.drawn import scenarios
from insdvl.simulation.drawn.imu_errors import ImuErrors
from insdvl.simulation.drawn.scenarios import DRAWN
from insdvl.simulation.mission import simulate
from insdvl.simulation.noise import NoiseProfile
from insdvl.simulation.sensors.imu import ImuModel
from insdvl.simulation.trajectories import AUV
from insdvl.studies.evaluation.approaches import MATCHED, ORACLE, Setting, approach
from insdvl.studies.evaluation.comparison import summary
from insdvl.studies.evaluation.matched.navigate import LAYOUT, first_order, navigate, vehicle_with
from insdvl.studies.evaluation.matched.prediction import predict
from insdvl.studies.evaluation.monte_carlo import (
    METRICS,
    TEST,
    Run,
    Study,
    assess,
    initial_of_run,
    mission_of_run,
)
from insdvl.studies.evaluation.sensors import Sensors
from insdvl.studies.evaluation.tables import comparison_tables
from insdvl.studies.results.page import pages

CALIBRATED = Setting("calibrated")
#: The filter forgets its errors within less; so pieces of this length are independent.
PIECE = 20.0  # s


def metrics(run: Run, name: str, setting: Setting = CALIBRATED) -> dict[str, float]:
    values, _ = assess(run.fold(approach(name, setting)), run)
    return dict(zip(METRICS, values, strict=True))


# ---------------------------------------------------------------- white noise


@pytest.mark.long
@pytest.mark.parametrize(
    "scenario, setting, rate",
    [
        ("varying", CALIBRATED, 3.0),  # pings within samples
        ("varying", replace(CALIBRATED, error_state="ned"), 1.0),
        ("waves", CALIBRATED, 1.0),
        ("bottom-tactical", CALIBRATED, 1.0),  # the noise of the pings changes
    ],
)
def test_on_white_noise_it_is_the_oracle(scenario: str, setting: Setting, rate: float) -> None:
    study = Study(scenario, seed=40, duration=60.0, sensors=Sensors(dvl_rate=rate))
    run = Run(study, TEST, 0)
    oracle, matched = (run.fold(approach(name, setting)) for name in (ORACLE, MATCHED))
    assert oracle.counts["glitches"] == 0  # the navigation filter would leave samples out
    np.testing.assert_allclose(matched.track["v_n"], oracle.track["v_n"], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(matched.track["C_n_b"], oracle.track["C_n_b"], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(assess(matched, run)[0], assess(oracle, run)[0], rtol=1e-6)
    assert matched.states["nav"]["P"][:, CORE:].any() == np.False_


# ---------------------------------------------------------------- the shaping states


def test_first_order_errors_are_those_of_the_simulator() -> None:
    """Mean squares and products at a lag, over 1500 IMUs: within 4 of their standard errors."""
    rng, dt, count = np.random.default_rng(41), 0.01, 1500
    level = NoiseProfile(np.zeros(1), np.array([[0.01, 0.02, 0.04, 1e-7, 2e-7, 4e-7]]))
    errors = ImuErrors(
        coloured=level,
        time_constants=np.array([0.3, 0.5, 0.8, 1.3, 2.0, 3.0]),
        flicker=np.array([3e-8, 1e-7, 3e-7, 1e-12, 3e-12, 1e-11]),
        counts=np.zeros(6),
        lines=(),
        force=np.zeros((3, 3)),
        rate=np.zeros((3, 3)),
    )
    begins = dt * np.arange(100)
    found = errors.first_order(begins[:1], dt)
    expected = np.zeros((2, 6))
    for channel, tau, variance in zip(
        found.channels, found.time_constants, found.variances[0], strict=True
    ):
        expected[:, channel] += variance * np.exp(-begins[[0, -1]] / tau)
    noise = np.array([errors.noise(begins, dt, own) for own in rng.spawn(count)])
    of_one = np.array([noise[:, 0] ** 2, noise[:, 0] * noise[:, -1]])
    deviation = np.abs(of_one.mean(axis=1) - expected)
    assert (deviation < 4.0 * of_one.std(axis=1) / np.sqrt(count)).all()


def test_the_noise_of_a_mission_is_told_as_it_was_drawn() -> None:
    mission = Run(Study("realistic", seed=42, duration=60.0), TEST, 0).mission
    found, noise = first_order(mission), mission.noise
    assert found.variances.shape == (len(mission.stamps_ns), len(found.channels))
    assert len(found.channels) == LAYOUT.size - CORE - 3
    assert noise.dvl.bias_std > 0.0 and noise.white_r.shape == mission.v_d.shape
    assert (noise.white_r < mission.r).all() and (noise.white < mission.q).any()
    # The coloured noise comes last; its density at f = 0 is 2 sigma^2 tau.
    assert noise.imu is not None and noise.imu.coloured is not None
    last = noise.imu.coloured.variance_at([60.0])[0] * 0.01
    density = 2.0 * found.variances[-1, -6:] * found.time_constants[-6:]
    np.testing.assert_allclose(density, last, rtol=1e-12)


class Flight:
    """A started filter with shaping states, one in each channel, and its samples.

    Args:
        setting: Of the filter.
        samples: Number of them.
        decay: Of the shaping states, from sample to sample.
        white: Whether the samples have white noise.
    """

    def __init__(self, setting: Setting, samples: int, decay: float, *, white: bool) -> None:
        mission = simulate(AUV, DRAWN["realistic"], seed=43, duration=10.0)
        study = Study("varying", seed=44, duration=10.0)
        m = mission_of_run(study, TEST, 0)
        filter_ = Filter(setting.filter(accelerometer_bias_walk=0.0, gyroscope_bias_walk=0.0))
        self.vehicle, blocks = vehicle_with(filter_, mission.noise, 6)
        self.state = LAYOUT.empty()
        start = Start(filter_.parameters.initial, filter_.parameters.origin, self.vehicle, blocks)
        start.locate_from_parameters(self.state[0])
        start.initialise(self.state, initial_of_run(m, study, TEST, 0), 0, np.zeros(3))
        self._decay = decay
        self._stamps_ns = m.stamps_ns[:samples]
        self._readings = np.hstack([m.f_b, m.w_ib_b])[:samples]
        self._white = m.q[:samples] if white else np.zeros((samples, 6))
        self.first = CORE + 3
        self.bias_std = mission.noise.dvl.bias_std

    def advance(self, state: Records, sigma: Sequence[float]) -> None:
        """Over all samples."""
        n = len(self._stamps_ns)
        kept = Kept(n, LAYOUT.dtype)
        predict(
            state,
            self.vehicle.workspace,
            self.vehicle.constants,
            self._stamps_ns,
            self._readings,
            self._white,
            np.tile(sigma, (n, 1)),
            np.arange(6),
            np.full(6, self._decay),
            0,
            int(self._stamps_ns[-1]),
            *(kept.every, kept.states, kept.numbers, kept.integers, kept.verdicts),
        )


@pytest.mark.long
@pytest.mark.parametrize("error_state", ["invariant", "ned"])
@pytest.mark.parametrize("samples, decay", [(1, 0.9), (100, 1.0)])
def test_covariances_follow_the_derivative_of_the_motion(
    error_state: str, samples: int, decay: float
) -> None:
    """With P_0 = x x^T and no noise, P is T x (T x)^T; T x by moving x and flying both."""
    flight = Flight(replace(CALIBRATED, error_state=error_state), samples, decay, white=False)
    sigma, invariant = np.array([1.0, 1.2, 0.8, 0.1, 0.12, 0.08]), error_state == "invariant"
    for channel in range(6):
        at, step = flight.first + channel, 1e-3
        nominal, moved = flight.state.copy(), flight.state.copy()
        nominal["nav"]["P"] = 0.0
        nominal["nav"]["P"][0, at, at] = step**2
        moved["nav"]["optional"][0, at - CORE] = step
        flight.advance(nominal, sigma)
        flight.advance(moved, sigma)
        nav, true = nominal[0]["nav"], moved[0]["nav"]
        told = nav["P"][: flight.vehicle.n, at] / (decay * step)
        of = {"invariant": invariant}
        found = np.concatenate(
            [
                coordinates.velocity_error(nav, true["C_n_b"], true["v_n"], **of),
                coordinates.attitude_error(nav, true["C_n_b"], **of),
                np.zeros(6),
                coordinates.position_error(nav, true["C_n_b"], true["llh"], **of),
            ]
        )
        largest = np.abs(found).max()
        assert largest > 1e-7
        # Of second order in the step; a latitude in radians is rounded to 1 nm.
        np.testing.assert_allclose(told[:CORE], found, rtol=0.0, atol=1e-3 * largest + 3e-9)
        assert true["optional"][at - CORE] == pytest.approx(decay**samples * step, rel=1e-12)


@pytest.mark.long
def test_shaping_states_are_stationary() -> None:
    flight = Flight(CALIBRATED, 300, 0.97, white=True)
    state, n = flight.state.copy(), flight.vehicle.n
    flight.advance(state, np.full(6, 0.1))
    P = state[0]["nav"]["P"][:n, :n]
    of_dvl = np.full(3, flight.bias_std**2)
    expected = np.diag(np.concatenate([of_dvl, np.ones(6)]))
    np.testing.assert_allclose(P[CORE:, CORE:], expected, rtol=1e-12, atol=1e-14)
    np.testing.assert_array_equal(P, P.T)
    assert np.linalg.eigvalsh(P).min() > -1e-15


# ---------------------------------------------------------------- the bound


def within(mean: float, freedom: int) -> bool:
    """Whether a mean of squares of so many independent normal numbers is credible (0.1 %)."""
    low, high = chi2.ppf([0.0005, 0.9995], freedom) / freedom
    return bool(low < mean < high)


def is_consistent(runs: Sequence[dict[str, float]], study: Study, duration: float) -> None:
    """NEES of the velocity, NIS, and whether the innovations are white."""
    pieces = len(runs) * round(duration / PIECE)
    pings = len(runs) * round(duration * study.sensors.dvl_rate)
    mean = {name: float(np.mean([run[name] for run in runs])) for name in METRICS}
    assert within(mean["nees_velocity"], 3 * pieces), mean
    assert within(mean["nis"] / 3.0, 3 * pings), mean
    assert abs(mean["innovation_autocorrelation"]) < 3.3 / np.sqrt(3.0 * pings), mean


#: A good DVL, so that the noise of the IMU shows in the innovations.
GOOD = Study("", seed=45, duration=120.0, sensors=Sensors(dvl_std=0.02, dvl_rate=5.0))


@pytest.mark.long
def test_it_is_consistent_in_coloured_noise_and_no_worse_than_the_oracle() -> None:
    study = replace(GOOD, scenario="coloured")
    runs = [Run(study, TEST, number) for number in range(12)]
    matched, oracle = ([metrics(run, name) for run in runs] for name in (MATCHED, ORACLE))
    is_consistent(matched, study, 120.0)
    gain = squares(oracle) - squares(matched)
    assert gain.mean() > -3.0 * gain.std() / np.sqrt(len(gain))


@pytest.mark.long
def test_it_is_consistent_in_all_that_is_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    """`realistic` without errors of scale and alignment, which are in no state."""
    monkeypatch.setattr(scenarios, "SCALE_FACTOR", (0.0, 0.0))
    study = replace(GOOD, scenario="realistic")
    runs = [Run(study, TEST, number) for number in range(8)]
    is_consistent([metrics(run, MATCHED) for run in runs], study, 120.0)


@pytest.mark.long
def test_it_is_the_lower_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    """30 whole missions of `coloured`, and of `realistic` without errors of scale and alignment."""
    monkeypatch.setattr(scenarios, "SCALE_FACTOR", (0.0, 0.0))
    for scenario in ("coloured", "realistic"):
        study = Study(scenario, seed=47)
        runs = [Run(study, TEST, number) for number in range(30)]
        matched, oracle = ([metrics(run, name) for run in runs] for name in (MATCHED, ORACLE))
        of_dvl = [with_states_of_the_dvl(study, run, number) for number, run in enumerate(runs)]
        is_consistent(matched, study, 330.0)
        best = rmse(matched)
        nees = np.mean([run["nees_velocity"] for run in matched])
        print(f"{scenario}, over matched: oracle {rmse(oracle) / best:.4f}, effective Q and")
        print(f"states of the DVL {rmse(of_dvl) / best:.4f}; NEES of matched {nees:.3f}")
        assert best < rmse(oracle)


def with_states_of_the_dvl(study: Study, run: Run, number: int) -> dict[str, float]:
    """A filter that is told the effective Q, and has the DVL's slow error as states."""
    noise = replace(run.mission.noise, white=run.mission.q, imu=None)
    initial = initial_of_run(run.mission, study, TEST, number)
    fold = navigate(replace(run.mission, noise=noise), initial, CALIBRATED.filter(), 25)
    return dict(zip(METRICS, assess(fold, run)[0], strict=True))


def rmse(runs: Sequence[dict[str, float]]) -> float:
    """Mean of the runs, as in the tables [m/s]."""
    return float(np.mean([run["body_rmse"] for run in runs]))


def squares(runs: Sequence[dict[str, float]]) -> Array:
    """Mean square of the error of the body velocity of each run [(m/s)^2]."""
    return np.square([run["body_rmse"] for run in runs])


# ---------------------------------------------------------------- the row


@pytest.mark.long
def test_outliers_are_left_out() -> None:
    study = Study("coloured", seed=48, duration=60.0, sensors=Sensors(outliers=0.3))
    run = Run(study, TEST, 0)
    fold = run.fold(approach(MATCHED, CALIBRATED))
    outlier = run.mission.dvl_outlier
    assert outlier.any()
    stamps = [update.stamp_ns for update in fold.updates]
    assert stamps == run.mission.dvl_stamps_ns[~outlier].tolist()


def test_aliased_vibration_is_refused() -> None:
    mission = simulate(AUV, DRAWN["vibrating"], seed=49, duration=10.0, imu=ImuModel(rate=50.0))
    initial = initial_of_run(mission, Study("vibrating", seed=50), TEST, 0)
    with pytest.raises(ValueError, match=r"aliased vibration, at [\d., ]+ Hz in the samples"):
        navigate(mission, initial, CALIBRATED.filter(), 25)


def test_the_tables_have_its_ratio() -> None:
    rng = np.random.default_rng(51)
    scores = {row: rng.uniform(0.5, 1.5, (6, len(METRICS))) for row in (ORACLE, MATCHED)}
    for values in scores.values():
        values[:, METRICS.index("failed")] = 0.0
    numbers = summary(scores, rng)
    middle, low, high = numbers["rows"][0]["ratio_to"]["matched"]["body_rmse"]
    body = METRICS.index("body_rmse")
    assert middle == pytest.approx(scores[ORACLE][:, body].mean() / scores[MATCHED][:, body].mean())
    document = numbers | {
        "plan": {"scenario": "coloured", "setting": {"preset": "calibrated"}, "seed": 1},
        "omitted": {},
        "searches": {},
        "environment": {},
    }
    assert "body velocity / matched" in comparison_tables(document)
    text = pages({"coloured-spectrum": document})["spectrum"]
    assert f"| `coloured` | {middle:.4f} [{low:.4f}, {high:.4f}] |" in text
