"""Models and their cards: what ships, and what is refused with which words."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from insdvl.parameters.declaration import ParameterError
from insdvl.tuner import models
from insdvl.tuner.features.handcrafted import FEATURE_NAMES, features
from insdvl.tuner.features.schemas import SCHEMAS
from insdvl.tuner.models import (
    KINDS,
    ModelError,
    UnknownModelError,
    load_model,
    sha256,
    shipped_cards,
    write_model,
)
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.tuner import Tuner


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """A copy of the shipped model that a test may spoil."""
    shipped = load_model("paper").path
    for file in (shipped, shipped.with_suffix(".json")):
        shutil.copy(file, tmp_path)
    return tmp_path / "paper.npz"


def change_card(model: Path, **changes: object) -> None:
    card_file = model.with_suffix(".json")
    card = {**json.loads(card_file.read_text()), **changes}
    card_file.write_text(json.dumps({k: v for k, v in card.items() if v is not None}))


def test_the_shipped_model_and_its_card_belong_together():
    model = load_model("paper")
    assert model.path.name == "paper.npz"
    assert model.card["sha256"] == sha256(model.path.read_bytes())
    assert model.card["feature_schema"] == "paper"
    assert tuple(model.card["features"]) == FEATURE_NAMES
    assert model.window == model.card["window"] == 200
    assert model.regressor.n_trees == model.card["ensemble"]["trees"] == 30


def test_a_name_and_a_path_give_the_same_model(model, monkeypatch):
    windows = np.random.default_rng(0).normal(9.8, 0.1, (6, 200))
    expected = load_model("paper").variances(windows)
    np.testing.assert_array_equal(load_model(str(model)).variances(windows), expected)
    monkeypatch.chdir(model.parent)
    np.testing.assert_array_equal(load_model("paper.npz").variances(windows), expected)
    np.testing.assert_array_equal(load_model("./paper.npz").variances(windows), expected)


def test_variances_are_the_forests_answer_to_the_features():
    model = load_model("paper")
    windows = np.random.default_rng(1).normal(0.0, 0.15, (50, 200))
    np.testing.assert_array_equal(
        model.variances(windows), model.regressor.predict(features(windows))
    )
    assert np.mean(model.variances(windows)) == pytest.approx(0.15**2, rel=0.1)


# What the scale-equivariant model promises


def test_the_default_model_knows_noise_of_any_size_and_unit():
    """White noise on smooth motion, over 16 decades of variance; sigma of the RMSE is 1.6 %."""
    model = load_model("default")
    rng = np.random.default_rng(2)
    t = np.arange(200) / 100.0
    for sigma in (1e-6, 1e-3, 0.1, 1.0, 100.0):
        motion = 9.8 + sigma * np.array([3.0 * t - t**2 + 0.4 * t**5, np.exp(t), np.sin(1.5 * t)])
        windows = np.repeat(motion, 700, axis=0) + sigma * rng.standard_normal((2100, 200))
        relative = model.variances(windows) / sigma**2 - 1.0
        assert np.sqrt(np.mean(relative**2)) == pytest.approx(np.sqrt(2.0 / 194.0), rel=0.08)
        assert abs(relative.mean()) < 0.015


@pytest.mark.parametrize("factor", [2.0**-60, 2.0**-9, 2.0**40])
def test_the_default_model_is_equivariant_to_the_bit_for_powers_of_two(factor):
    model = load_model("default")
    windows = np.random.default_rng(3).normal(0.3, 0.1, (50, 200))
    expected = factor**2 * model.variances(windows)
    np.testing.assert_array_equal(model.variances(factor * windows), expected)


def test_the_default_model_answers_the_same_under_gravity():
    model = load_model("default")
    windows = np.random.default_rng(4).normal(0.0, 1e-3, (200, 200))
    plain = model.variances(windows)
    for offset in (-9.80665, 9.80665, 1000.0):
        np.testing.assert_allclose(model.variances(windows + offset), plain, rtol=1e-6)


@pytest.mark.parametrize("value", [0.0, 9.80665, -1e-30, 1e69])
def test_the_default_model_says_that_a_constant_window_has_no_noise(value):
    assert load_model("default").variances(np.full((1, 200), value)).tolist() == [0.0]


@pytest.mark.parametrize("shape", [(200,), (6, 199), (6, 201)])
def test_windows_of_another_length_are_refused(shape):
    with pytest.raises(ValueError, match=r"windows must be \(M, 200\)"):
        load_model("paper").variances(np.zeros(shape))


@pytest.mark.parametrize("position", [0.0, 0.1, 0.5, 0.999])
def test_one_altered_bit_is_refused_with_both_hashes(model, position):
    data = bytearray(model.read_bytes())
    data[int(position * len(data))] ^= 0b100
    model.write_bytes(data)
    expected = json.loads(model.with_suffix(".json").read_text())["sha256"]
    with pytest.raises(ModelError) as refusal:
        load_model(str(model))
    for part in (str(model), "altered", expected, sha256(bytes(data))):
        assert part in str(refusal.value)


def test_missing_arrays_are_named_with_the_hash_that_the_card_expects(model):
    expected = json.loads(model.with_suffix(".json").read_text())["sha256"]
    model.unlink()
    with pytest.raises(ModelError) as refusal:
        load_model(str(model))
    for part in (str(model), "No such file", expected):
        assert part in str(refusal.value)


def test_a_missing_card_is_named(model):
    model.with_suffix(".json").unlink()
    with pytest.raises(ModelError, match=r"paper\.json: No such file"):
        load_model(str(model))


@pytest.mark.parametrize("name", ["absent", "models/absent.npz", "absent.onnx", "n" * 300])
def test_an_unknown_model_is_a_wrong_parameter_and_the_shipped_ones_are_named(name):
    shipped = ", ".join(card["name"] for card in shipped_cards())
    with pytest.raises(UnknownModelError, match=f"shipped are {shipped}; one of your own"):
        load_model(name)
    with pytest.raises(ParameterError, match="^parameter 'model': there is no model '[a-n]"):
        Tuner(TunerParameters(model=name))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "is not valid JSON"),
        ("{", "is not valid JSON"),
        ("[1]", "is not a JSON object"),
        ("null", "is not a JSON object"),
        ('"paper"', "is not a JSON object"),
    ],
)
def test_a_card_that_is_not_a_json_object_is_named(model, text, reason):
    model.with_suffix(".json").write_text(text)
    with pytest.raises(ModelError, match=rf"card.*paper\.json {reason}"):
        load_model(str(model))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sha256": None}, "sha256 must be of type str, got None"),
        ({"feature_schema": 3}, "feature_schema must be of type str, got 3"),
        ({"kind": None}, "kind must be of type str, got None"),
        ({"kind": "oracle"}, "kind 'oracle' is unknown; known are forest, network"),
        ({"window": "200"}, "window must be of type int, got '200'"),
        ({"window": True}, "window must be of type int, got True"),
        ({"window": 2}, "window must be >= 3 and <= 10000, got 2"),
        ({"feature_schema": "wavelets"}, "'wavelets' is unknown; known are bands, default, paper"),
        ({"features": list(FEATURE_NAMES[::-1])}, "features are not those of the schema 'paper'"),
        ({"features": []}, "features are not those of the schema 'paper'"),
    ],
)
def test_a_card_that_does_not_fit_is_refused(model, change, message):
    change_card(model, **change)
    with pytest.raises(ModelError, match=r"paper\.json") as refusal:
        load_model(str(model))
    assert message in str(refusal.value)


@pytest.mark.parametrize("name", sorted(SCHEMAS))
def test_the_shortest_window_of_a_schema_is_one_that_it_can_use(name):
    schema = SCHEMAS[name]
    X, scale = schema.extract(np.random.default_rng(0).standard_normal((6, schema.min_samples)))
    assert X.shape == (6, schema.width(schema.min_samples)) and scale.shape == (6,)
    assert np.isfinite(X).all()


def rewrite(model: Path, **changes: np.ndarray) -> None:
    """Other arrays, with a card that vouches for them."""
    with np.load(model) as archive:
        arrays = {**archive, **changes}
    np.savez(model, **arrays)
    change_card(model, sha256=sha256(model.read_bytes()))


def test_arrays_that_are_no_forest_are_refused_even_where_the_hash_is_right(model):
    rewrite(model, value=np.zeros(3))
    with pytest.raises(ModelError, match=r"paper\.npz is not usable: value has 3 elements"):
        load_model(str(model))


def test_a_forest_of_other_features_is_refused(model):
    rewrite(model, n_features=np.array(25, np.int32))
    with pytest.raises(ModelError, match=r"paper\.npz has 25 features, its schema 'paper' has 24"):
        load_model(str(model))


def test_the_bytes_that_are_hashed_are_the_bytes_that_are_used(model, monkeypatch):
    """A file that is exchanged between the check and the use must not get in."""

    def exchange(data: bytes) -> str:
        model.write_bytes(b"exchanged")
        return sha256(data)

    monkeypatch.setattr(models, "sha256", exchange)
    assert load_model(str(model)).regressor.n_trees == 30


PAGE = Path(__file__).parents[3] / "docs" / "explanation" / "tuner.md"


def test_the_documented_lines_make_a_model_of_ones_own(tmp_path, monkeypatch):
    (lines,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(lines, names)
    mine = load_model("models/mine.npz")
    assert sorted(file.name for file in Path("models").iterdir()) == ["mine.json", "mine.npz"]
    X, scale = names["X"], names["scale"]
    expected = scale * np.exp(names["ensemble"].predict(X))
    found = mine.variances(names["windows"])
    np.testing.assert_array_equal(found, expected)
    assert np.sqrt(np.mean((found / names["q"] - 1.0) ** 2)) < 0.12


def test_a_model_is_written_whole_or_not_at_all(model, monkeypatch):
    card = json.loads(model.with_suffix(".json").read_text())
    folder, data = model.parent, model.read_bytes()
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    for change, message in (
        ({"kind": "table"}, "kind 'table' is unknown"),
        ({"window": 1}, "window must be >= 3"),
        ({"features": ["mean"]}, "features are not those of the schema"),
        ({"feature_schema": "window", "features": []}, "has 24 features"),
        ({"name": "../paper"}, "must be a valid file name, got '../paper'"),
        ({"name": None}, "name must be of type str"),
    ):
        with pytest.raises(ModelError, match=message):
            write_model(folder, data, {**card, **change})
    with pytest.raises(ModelError, match="not a valid .npz archive"):
        write_model(folder, b"nothing", card)

    calls = []

    def full(path, content):
        calls.append(path)
        if len(calls) == 2:
            raise OSError(28, "No space left on device")
        path.write_bytes(content)

    monkeypatch.setattr(models, "write", full)
    with pytest.raises(OSError, match="No space left"):
        write_model(folder, data, card)
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before


def test_prediction_needs_no_scikit_learn():
    program = (
        "import sys; from insdvl.tuner.tuner import Tuner; from insdvl.tuner.parameters import "
        "TunerParameters; Tuner(TunerParameters()); print('sklearn' in sys.modules)"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert ended.stdout.strip() == "False"


def test_every_shipped_file_is_part_of_a_model_that_loads():
    folder = load_model("paper").path.parent
    suffixes = {".json", *(kind.suffix for kind in KINDS.values())}
    names = {file.stem for file in folder.iterdir() if file.suffix in suffixes}
    assert names >= {"paper", "dnn", "dnn-default"}
    for name in names:
        assert load_model(name).path.stat().st_size < 25e6
