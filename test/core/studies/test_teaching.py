"""The DVL as teacher: its likelihood is that of the filter, and what is learned is true."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recordings import record, save

from insdvl.cli import main
from insdvl.jobs.options import Workers
from insdvl.jobs.pool import open_pool
from insdvl.navigation.events import NS
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.simulation.drawn.scenarios import DRAWN, Scenario
from insdvl.simulation.initial_errors import P_0, drawn_initial
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.sensors.imu import ImuModel
from insdvl.simulation.trajectories import BASELINE
from insdvl.studies.evaluation.approaches import Setting
from insdvl.studies.evaluation.sensors import Sensors
from insdvl.studies.evaluation.taught import lessons_of, model_of
from insdvl.studies.teaching import prior, slow_error
from insdvl.studies.teaching import teach as teach_module
from insdvl.studies.teaching.fit import Bands, Constant, Family, Fit, fit, log_likelihood
from insdvl.studies.teaching.increments import increments
from insdvl.studies.teaching.lesson import Lesson, LessonError, lesson_of
from insdvl.studies.teaching.residuals import innovations
from insdvl.studies.teaching.teach import (
    BANDS,
    CONFIGURED,
    CONSTANT,
    SIMULATED,
    Fits,
    TeachingError,
    constant_of,
    fits_of,
    teach,
)
from insdvl.studies.training.vehicles import Recipe, build
from insdvl.timeline.recorded import fold_arrays
from insdvl.tuner.models import load_model
from insdvl.tuner.offline import tuned_by_model
from insdvl.tuner.parameters import TunerParameters

Q = np.repeat([1e-3, 1e-8], 3)
SPOKEN = Setting("calibrated", sensors=Sensors(dvl_std=0.02)).filter((1e-3, 1e-8))


def mission(seed: int, duration: float = 120.0, dvl_rate: float = 1.0) -> Mission:
    dvl = DvlModel(noise_std=(0.02,) * 3, rate=dvl_rate)
    trajectory = list(BASELINE.values())[seed % len(BASELINE)]
    return simulate(trajectory, constant(Q), seed=seed, duration=duration, dvl=dvl)


def events_of(flown: Mission, seed: int) -> list:
    start = drawn_initial(flown.initial, P_0, np.random.default_rng(seed))
    pings = zip(flown.dvl_stamps_ns.tolist(), flown.v_d, strict=True)
    return [start, *(Dvl(stamp_ns, v_d) for stamp_ns, v_d in pings)]


def lesson(seed: int, duration: float = 120.0, dvl_rate: float = 1.0) -> Lesson:
    flown = mission(seed, duration, dvl_rate)
    samples = np.hstack([flown.f_b, flown.w_ib_b])
    return lesson_of(
        f"{seed}", SPOKEN, TunerParameters(), flown.stamps_ns, samples, events_of(flown, seed)
    )


def test_increments_of_parts_make_those_of_the_whole() -> None:
    """A bound within the interval of a sample cuts it."""
    flown = mission(1, 10.0)
    arrays = flown.stamps_ns, flown.f_b, flown.w_ib_b, np.zeros(6)
    whole = increments(*arrays, np.array([NS, 2 * NS]))
    parts = increments(*arrays, np.array([NS, NS + 123_456_789, NS + 700_000_001, 2 * NS]))
    turn, dv = np.eye(3), np.zeros(3)
    for C, step in zip(parts.turn, parts.dv, strict=True):
        dv, turn = dv + turn @ step, turn @ C
    np.testing.assert_allclose(turn, whole.turn[0], atol=1e-12)
    np.testing.assert_allclose(dv, whole.dv[0], atol=1e-5)
    assert parts.seconds.sum() == pytest.approx(1.0, abs=1e-12)


def test_the_small_filter_has_the_innovations_of_the_filter() -> None:
    """With the same process noise, within a tenth of their sigma; S within 3 %."""
    flown, taught = mission(2), lesson(2)
    samples = flown.stamps_ns, flown.f_b, flown.w_ib_b
    of_filter = {
        u.stamp_ns: u.report
        for u in fold_arrays(SPOKEN, *samples, events_of(flown, 2)).updates
        if u.report.measurement == Dvl.name
    }
    bounds = np.cumsum(np.rint(taught.stretch.steps.seconds * NS)).astype(int)
    begin = flown.dvl_stamps_ns[-1] - bounds[-1]
    q = np.tile(Q, (len(taught.X), 1))
    found = innovations(taught.stretch, q, 1.0, 0.0, 1.0)
    late = range(len(found.nu) // 2, len(found.nu))
    reports = [of_filter[int(begin + bounds[taught.stretch.pings[m]])] for m in late]
    sigma = np.sqrt([np.diagonal(r.S) for r in reports])
    nu = np.array([r.innovation for r in reports])
    assert np.sqrt(np.mean(((found.nu[late.start :] - nu) / sigma) ** 2)) < 0.1
    of_small = np.sqrt(np.diagonal(found.S[late.start :], axis1=1, axis2=2))
    np.testing.assert_allclose(of_small, sigma, rtol=0.03)


def test_the_likelihood_is_largest_near_the_truth() -> None:
    """A tenth and ten times the noise of either triad are less likely, by 3 or more.

    A tenth of that of the gyroscopes, which is hidden below that of the accelerometers, by less.
    """
    lessons = [lesson(seed, 200.0, 5.0) for seed in (3, 4, 5, 6)]
    family = Constant(lessons)
    true = np.array([np.log(1e-3), np.log(1e-8), 0.0, -3.0, 0.0])
    at_truth = log_likelihood(family, lessons, true)
    for group, factor, least in ((0, 0.1, 3.0), (0, 10.0, 3.0), (1, 0.1, 0.0), (1, 10.0, 3.0)):
        off = true.copy()
        off[group] += np.log(factor)
        assert log_likelihood(family, lessons, off) < at_truth - least


def test_too_little_is_refused_in_words() -> None:
    one = lesson(5)
    with pytest.raises(TeachingError, match=r"\d+ measurements of the DVL that count; at least"):
        fits_of([one])
    with pytest.raises(TeachingError, match="two different stretches"):
        fits_of([one, one])
    with pytest.raises(LessonError, match="a lesson needs 30"):
        lesson(6, 45.0)


def test_a_poor_dvl_teaches_nothing() -> None:
    """The same recordings, with a DVL that is told to be, and is, a hundred times worse."""
    poor = [_with_noise(lesson(seed), 2.0, seed) for seed in (7, 8)]
    with pytest.raises(TeachingError, match="the standard error of log q is"):
        teach(fits_of(poor))


def test_a_taught_constant_is_that_of_a_sample_at_any_rate_of_the_imu() -> None:
    """At 400 Hz a model sees means of four samples."""
    rate = 400.0
    q = Q * rate / 100.0
    setting = Setting("calibrated", sensors=Sensors(dvl_std=0.02)).filter((q[0], q[3]))
    flown = simulate(
        BASELINE["circle"],
        constant(q),
        seed=1,
        duration=60.0,
        imu=ImuModel(rate=rate),
        dvl=DvlModel(noise_std=(0.02,) * 3),
    )
    arrays = flown.stamps_ns, np.hstack([flown.f_b, flown.w_ib_b])
    fast = lesson_of("fast", setting, TunerParameters(), *arrays, events_of(flown, 1))
    _, variances = tuned_by_model(*arrays, model_of(constant_of([fast])), TunerParameters())
    expected = np.exp(fit(Constant([fast]), [fast]).numbers[:2]).repeat(3)
    np.testing.assert_allclose(variances, np.tile(expected, (len(variances), 1)), rtol=1e-9)
    with pytest.raises(TeachingError, match="a constant for IMUs of 100 to 400 Hz"):
        constant_of([fast, lesson(1)])


def test_what_simulated_vehicles_predict_as_well_is_not_taught() -> None:
    """However small the standard errors are, recordings that were left out decide."""
    lessons = [lesson(seed) for seed in (7, 8)]
    family = Bands(lessons)
    sure = Fit(family.mean, 1e-4 * np.eye(len(family.mean)), True)
    held = {answer: np.array([10.0, 5.0]) for answer in (BANDS, CONSTANT, SIMULATED, CONFIGURED)}
    with pytest.raises(TeachingError, match="no better than by the weights of simulated vehicles"):
        teach(Fits(lessons, np.arange(2), family, sure, held))
    better = {**held, BANDS: np.array([10.0, 6.0])}
    assert teach(Fits(lessons, np.arange(2), family, sure, better)).answer == BANDS


def test_what_is_left_out_teaches_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another velocity of its pings changes what predicts it by nothing, to the bit."""
    lessons = [lesson(seed) for seed in (7, 8, 9)]
    other = replace(
        lessons[1],
        stretch=replace(lessons[1].stretch, velocities=2.0 * lessons[1].stretch.velocities),
    )
    start = fit(Bands(lessons), lessons)

    def predicted_with(lessons: Sequence[Lesson]) -> dict[str, list[bytes]]:
        """Numbers that predict each lesson, in order."""
        found: dict[str, list[bytes]] = {one.name: [] for one in lessons}

        def spy(family: Family, test: Sequence[Lesson], numbers: np.ndarray) -> float:
            found[test[0].name].append(numbers.tobytes())
            return log_likelihood(family, test, numbers)

        for module in (teach_module, slow_error):
            monkeypatch.setattr(module, "log_likelihood", spy)
        part = np.arange(len(lessons))
        held = teach_module._held_out(lessons, part, start)
        slow_error._without(Fits(lessons, part, Bands(lessons), start, held))
        return found

    before, after = predicted_with(lessons), predicted_with([lessons[0], other, lessons[2]])
    assert {len(numbers) for numbers in before.values()} == {
        5
    }  # answers, and one without a slow error
    assert after["8"] == before["8"]
    assert after["7"] != before["7"] and after["9"] != before["9"]


def _with_noise(one: Lesson, sigma: float, seed: int) -> Lesson:
    rng = np.random.default_rng(seed)
    velocities = one.stretch.velocities + rng.normal(0.0, sigma, one.stretch.velocities.shape)
    noise = np.full_like(one.stretch.noise, sigma**2)
    return replace(one, stretch=replace(one.stretch, velocities=velocities, noise=noise))


def test_a_vehicle_keeps_its_vibration_and_not_its_noise() -> None:
    """Its missions differ in their white noise; the one it was drawn for stays as it was."""
    seed = np.random.SeedSequence(9)
    flights = [
        simulate(BASELINE["circle"], DRAWN["vibrating"], seed=own, duration=20.0, vehicle=seed)
        for own in (np.random.SeedSequence(9), np.random.SeedSequence(10))
    ]
    drawn = simulate(BASELINE["circle"], DRAWN["vibrating"], seed=seed, duration=20.0)
    np.testing.assert_array_equal(flights[0].f_b, drawn.f_b)
    np.testing.assert_array_equal(flights[1].truth.v_n, drawn.truth.v_n)
    assert (flights[1].q != drawn.q).any()


CONFIG = """
/**/insdvl_filter:
  ros__parameters:
    dvl: {noise_std: [0.02, 0.02, 0.02]}
    process_noise:
      accelerometer_variance: [1.0e-3, 1.0e-3, 1.0e-3]
      gyroscope_variance: [1.0e-8, 1.0e-8, 1.0e-8]
    initial: {mode: topic}
/**/insdvl_replay:
  ros__parameters: {imu_topic: /imu, dvl_topic: /dvl, ground_truth_topic: /truth}
"""


def recorded(folder: Path, seed: int, duration: float, dvl_rate: float = 1.0) -> Path:
    (folder / "own.yaml").write_text(CONFIG)
    flown = mission(seed, duration, dvl_rate)
    return save(folder / f"dive{seed}", record(flown, every=100))


def train(folder: Path, *bags: Path) -> int:
    options = ("--config", f"{folder / 'own.yaml'}", "--out", f"{folder / 'models'}")
    return main(["train", "--from-bags", *map(str, bags), *options])


def test_the_command_names_the_recordings_that_cannot_teach(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = recorded(tmp_path, 1, 25.0)
    assert train(tmp_path, short, recorded(tmp_path, 3, 60.0), recorded(tmp_path, 4, 26.0)) == 1
    first, second = capsys.readouterr().err.splitlines()
    assert first.startswith("insdvl train: no model: dive1 has 4 measurements of the DVL")
    assert second.startswith("insdvl train: no model: dive4 has 5 measurements of the DVL")
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(b"none")
    assert train(tmp_path, damaged, short) == 2
    first, second = capsys.readouterr().err.splitlines()
    assert first.startswith(f"insdvl train: cannot read recording {damaged}")
    assert second.startswith("insdvl train: dive1 has 4 measurements of the DVL")
    assert train(tmp_path, tmp_path / "nowhere") == 2
    assert "nowhere" in capsys.readouterr().err
    assert not (tmp_path / "models").exists()


def test_one_recording_is_no_lesson_and_no_test(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert train(tmp_path, recorded(tmp_path, 2, 60.0, 5.0)) == 1
    assert "no model: recordings of two different stretches" in capsys.readouterr().err
    assert not (tmp_path / "models").exists()


@pytest.mark.long
def test_recordings_become_a_model_that_the_tuner_loads(tmp_path: Path) -> None:
    """It knows the noise within a factor of 2 or two standard errors; its card says who taught."""
    bags = [recorded(tmp_path, seed, 200.0, 5.0) for seed in (21, 22, 23)]
    assert train(tmp_path, *bags) == 0
    model = load_model(str(tmp_path / "models" / "taught.npz"))
    assert set(model.card["teacher"]["recordings"]) == {"dive21", "dive22", "dive23"}
    rng = np.random.default_rng(1)
    q = model.variances(np.sqrt(Q)[:, None] * rng.standard_normal((6, 2000)))
    sigmas = model.card["teacher"]["sigma_of_log_q"]
    for group, channels in (("accelerometers", slice(0, 3)), ("gyroscopes", slice(3, 6))):
        off = np.log(q[channels].mean() / Q[channels][0])
        assert abs(off) < max(np.log(2.0), 2.0 * sigmas[group]["after"])


def vibrating_lessons(seed: int) -> Sequence[Lesson]:
    """A vehicle with vibration and constant white noise of a variance of 1e-3."""
    scenario = Scenario(white=(1e-3, 1.0001e-3), vibrating=True)
    dvl = DvlModel(noise_std=(0.02,) * 3, rate=5.0)
    own, flown = np.random.SeedSequence(seed).spawn(2)
    return lessons_of(scenario, dvl, SPOKEN, vehicle=own, seed=flown, missions=1)


@pytest.mark.long
def test_vibration_is_not_taken_for_noise() -> None:
    """The answer is within a factor of 1.5 of the true white noise, or two standard errors."""
    lessons = vibrating_lessons(11)
    family = Bands(lessons)
    found = fit(family, lessons)
    for group, true in enumerate((1e-3, 1e-8)):
        channels = slice(3 * group, 3 * group + 3)
        told = np.concatenate(
            [np.log(family.variances(x, found.numbers)[:, channels] / true) for x in lessons]
        )
        seen = np.concatenate(
            [np.log(x.scale[:, channels] / true) + x.X[:, channels, 4] for x in lessons]
        )
        sigma = found.sigma[[0, family.size]][group]
        assert abs(told.mean()) < max(np.log(1.5), 2.0 * sigma)
        assert seen.mean() > np.log(3.0)  # what is above 5.75 Hz is vibration for the most part
        assert seen.mean() - told.mean() > 2.0 * sigma  # no such answer is within the doubt


@pytest.mark.long
def test_standard_errors_are_those_of_repeated_lessons() -> None:
    """Of 2 x 24 logarithms of constants, 95 % are within two standard errors: 42 or more."""
    true = np.log([1e-3, 1e-8])
    within = 0
    for seed in range(24):
        lessons = [lesson(100 + seed, 300.0, 5.0)]
        found = fit(Constant(lessons), lessons)
        within += int(np.sum(np.abs(found.numbers[:2] - true) < 2.0 * found.sigma[:2]))
    assert within >= 42


@pytest.mark.long
def test_the_table_of_the_prior_is_what_its_vehicles_say() -> None:
    with open_pool(Workers(jobs=1)) as pool:
        recipe = Recipe("taught", prior.SEED, prior.VEHICLES, prior.DURATION)
        found, _ = prior.weights_of(build(recipe, pool))
    np.testing.assert_allclose(found, prior.WEIGHTS, atol=2e-3)
