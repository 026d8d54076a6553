"""An estimator of your own: its inputs, its answers, and the same in all places that take one."""

import re
from pathlib import Path

import numpy as np
import pytest

from insdvl.cli import main
from insdvl.files import read_json
from insdvl.navigation.events import NS
from insdvl.parameters.declaration import ParameterError
from insdvl.tuner.offline import tuned_by_own
from insdvl.tuner.own import EstimatorError, OwnEstimator
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.tuner import TunedNoise, Tuner

PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "estimator.md"
EXAMPLE = "mine_of_the_page.noise:variances"
#: A module with estimators that do what they should not, or tell what they were given.
MODULE = """
import numpy as np

def told(samples, rate):
    return np.abs([len(samples), rate, *samples[0, :2], *samples[-1, 4:]])

def shape(samples, rate):
    return samples.var(axis=0)[:5]

def nan(samples, rate):
    return np.full(6, np.nan)

def negative(samples, rate):
    return -samples.var(axis=0)

def raising(samples, rate):
    raise KeyError("spectrum")

def words(samples, rate):
    return "much"

def late(samples, rate):
    return samples[-1] / 0.0 if len(samples) > 400 else np.ones(6)

number = 3.0
"""


@pytest.fixture(autouse=True)
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "estimators_of_a_test.py").write_text(MODULE)
    (tmp_path / "broken_of_a_test.py").write_text("import no_such_package\n")
    (tmp_path / "mine_of_the_page").mkdir()
    code = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)[0]
    (tmp_path / "mine_of_the_page" / "noise.py").write_text(code)


def of(function: str) -> str:
    return f"estimators_of_a_test:{function}"


def white(n: int) -> np.ndarray:
    return np.random.default_rng(1).standard_normal((n, 6)) * [0.1, 0.1, 0.2, 1e-3, 1e-3, 2e-3]


def fed(tuner: Tuner, stamps: np.ndarray, samples: np.ndarray) -> list[TunedNoise]:
    answers = [tuner.add(stamp, row) for stamp, row in zip(stamps.tolist(), samples, strict=True)]
    return [answer for answer in answers if answer is not None]


def test_the_example_of_the_page_estimates_white_noise() -> None:
    q = OwnEstimator(EXAMPLE)(white(2000), 100.0)
    np.testing.assert_allclose(q, np.square([0.1, 0.1, 0.2, 1e-3, 1e-3, 2e-3]), rtol=0.5)


def test_it_is_given_the_samples_since_the_last_gap_and_their_rate() -> None:
    stamps = 7 * NS + NS // 50 * np.arange(4000)
    stamps[3000:] += NS
    samples = np.arange(4000.0)[:, None] + np.arange(6) / 8.0
    at, told = tuned_by_own(stamps, samples, OwnEstimator(of("told")), 1.0, NS // 10)
    for stamp, (count, rate, first, _, _, last) in zip(at, told, strict=True):
        closing = int(np.searchsorted(stamps, stamp))
        assert last == closing + 5 / 8
        assert count == min(closing + 1 - (3000 if closing >= 3000 else 0), 2000) >= 200
        assert first == closing - count + 1
        assert rate == pytest.approx(50.0)


def test_a_tuner_gives_the_bits_of_a_whole_recording() -> None:
    stamps = np.cumsum(np.random.default_rng(2).integers(NS // 120, NS // 80, 2600))
    samples = white(2600)
    tuner = Tuner(TunerParameters(estimator=of("told")))
    answers = fed(tuner, stamps, samples)
    at, q = tuned_by_own(stamps, samples, OwnEstimator(of("told")), 1.0, NS // 10)
    assert tuner.name == of("told")
    assert at.tolist() == [answer.stamp_ns for answer in answers]
    np.testing.assert_array_equal(q, [answer.variances for answer in answers])


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("", "must be PACKAGE.MODULE:FUNCTION, got ''"),
        ("numpy.var", "must be PACKAGE.MODULE:FUNCTION, got 'numpy.var'"),
        ("../mine.py:variances", "must be PACKAGE.MODULE:FUNCTION"),
        ("no_such_package:f", "cannot import no_such_package: ModuleNotFoundError"),
        ("broken_of_a_test:f", "cannot import broken_of_a_test: ModuleNotFoundError"),
        (of("absent"), "estimators_of_a_test has no function 'absent'"),
        (of("number"), "estimators_of_a_test has no function 'number'"),
        (of("shape"), r"must answer 6 variances, got an array of shape \(5,\)"),
        (of("nan"), "must answer finite variances >= 0, got .nan"),
        (of("negative"), "must answer finite variances >= 0"),
        (of("raising"), "'estimators_of_a_test:raising' failed: KeyError: 'spectrum'"),
        (of("words"), "failed: ValueError"),
    ],
)
def test_what_is_no_estimator_is_refused_by_name(name: str, sentence: str) -> None:
    with pytest.raises(EstimatorError, match=sentence):
        OwnEstimator(name)
    if name:
        with pytest.raises(ParameterError, match="parameter 'estimator': "):
            Tuner(TunerParameters(estimator=name))


def test_a_tuner_outlives_an_estimator_that_fails() -> None:
    tuner = Tuner(TunerParameters(estimator=of("late")))
    stamps = NS // 100 * np.arange(1, 701)
    with np.errstate(divide="ignore"):
        assert len(fed(tuner, stamps, white(700))) == 3
    assert (tuner.counts["windows"], tuner.counts["failed"]) == (3, 3)
    assert "finite variances" in tuner.failure


def test_evaluate_has_a_row_for_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "numbers.json"
    call = ["evaluate", "--runs", "2", "--duration", "10", "--jobs", "1", "--json", str(file)]
    assert main([*call, "--rows", "oracle", "--estimator", EXAMPLE]) == 0
    rows = {row["approach"]: row for row in read_json(file, 10**7)["rows"]}
    assert rows.keys() == {"oracle", f"estimator {EXAMPLE}"}
    assert rows[f"estimator {EXAMPLE}"]["body_rmse"] != rows["oracle"]["body_rmse"]
    assert main([*call, "--rows", "oracle", "--estimator", of("nan")]) == 2
    assert "insdvl evaluate: estimator 'estimators_of_a_test:nan' must" in capsys.readouterr().err
