"""The networks that ship, what is refused as a network, and what happens without onnxruntime."""

import json
import shutil
import subprocess
import sys
from collections.abc import Sequence
from functools import reduce

import numpy as np
import pytest

from insdvl import cli
from insdvl.jobs.options import Workers
from insdvl.jobs.pool import open_pool
from insdvl.simulation.sensors.imu import ideal_imu
from insdvl.simulation.trajectories import BASELINE
from insdvl.studies.training import dataset
from insdvl.studies.training.dataset import Recipe
from insdvl.studies.training.metrics import errors
from insdvl.tuner import network, onnx_content
from insdvl.tuner.features import closed_form
from insdvl.tuner.models import ModelError, load_model, sha256
from insdvl.tuner.network import Network, NetworkError

NAMES = {"dnn": "window", "dnn-default": "scaled_window"}
FLOAT, DOUBLE = 1, 11


# ONNX files by hand: the tests do without the onnx package.


def varint(n: int) -> bytes:
    """A number below 2^21 as protobuf has it, in three bytes where fewer would do as well."""
    return bytes([n % 128 + 128, n // 128 % 128 + 128, n // 16384])


def field(number: int, value: int | str | bytes) -> bytes:
    """A field of a protobuf message; numbers and sizes below 2^21."""
    if isinstance(value, int):
        return varint(number * 8) + varint(value)
    data = value.encode() if isinstance(value, str) else value
    return varint(number * 8 + 2) + varint(len(data)) + data


def value_info(name: str, dtype: int, shape: Sequence[int | str]) -> bytes:
    dims = [field(1, field(1 + isinstance(size, str), size)) for size in shape]
    tensor = field(1, dtype) + field(2, b"".join(dims))
    return field(1, name) + field(2, field(1, tensor))


def file(
    inputs: Sequence[tuple[int, Sequence[int | str]]] = ((FLOAT, ("M", 4)),),
    outputs: Sequence[tuple[int, Sequence[int | str]]] = ((FLOAT, ("M",)),),
    operator: str = "ReduceMax",
    extra: bytes = b"",
) -> bytes:
    """A model whose outputs are the largest value of each row of its first input."""
    axes = field(5, field(1, "axes") + field(8, 1) + field(20, 7))
    keep = field(5, field(1, "keepdims") + field(3, 0) + field(20, 2))
    graph = field(2, "g") + extra
    for i, (dtype, shape) in enumerate(inputs):
        graph += field(11, value_info(f"in{i}", dtype, shape))
    for i, (dtype, shape) in enumerate(outputs):
        flat = axes + keep if len(shape) == 1 else b""
        node = field(1, "in0") + field(2, f"out{i}") + field(4, operator if flat else "Identity")
        graph += field(1, node + flat) + field(12, value_info(f"out{i}", dtype, shape))
    return field(1, 8) + field(7, graph) + field(8, field(2, 17))


def test_a_file_is_run_as_it_says():
    largest = Network.load(file())
    X = np.random.default_rng(0).standard_normal((21, 4))
    assert largest.n_features == 4
    np.testing.assert_array_equal(largest.predict(X), X.max(axis=1).astype(np.float32))
    assert largest.predict(X).dtype == np.float64
    assert largest.predict(np.empty((0, 4))).shape == (0,)


WIDE = ((FLOAT, ("M", 4)),)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (file(inputs=((DOUBLE, ("M", 4)),), outputs=((DOUBLE, ("M",)),)),
         r"in0 must be tensor\(float\) \(M, F\) with M free, got tensor\(double\) \('M', 4\)"),
        (file(inputs=((FLOAT, (6, 4)),)), r"in0 must be .*, got tensor\(float\) \(6, 4\)"),
        (file(inputs=((FLOAT, ("M", "N")),)), r"in0 must be .* \('M', 'N'\)"),
        (file(inputs=((FLOAT, ("M", 4, 1)),), outputs=((FLOAT, ("M", 4, 1)),)), r"in0 must be"),
        (file(outputs=((FLOAT, ("M", 4)),)),
         r"out0 must be tensor\(float\) \(M,\) with M free, got tensor\(float\) \('M', 4\)"),
        (file(inputs=WIDE * 2), "must have 1 input and 1 output, got 2 and 1"),
        (file(outputs=((FLOAT, ("M",)),) * 2), "must have 1 input and 1 output, got 1 and 2"),
        (file(operator="Pickle"), "onnxruntime cannot run the network: .*Pickle"),
        (b"", "onnxruntime cannot run the network: "),
        (b"no network", "not a valid ONNX file: it has a field of type 6"),
        (file()[:-40], "not a valid ONNX file: it ends within a field"),
        (file() + b"\x80" * 11, "not a valid ONNX file: it has a number that does not end"),
    ],
)  # fmt: skip
def test_a_file_of_another_form_is_refused_in_one_line(data, message):
    with pytest.raises(NetworkError, match=message) as refusal:
        Network.load(data)
    assert "\n" not in str(refusal.value)


ELSEWHERE = field(13, field(1, "location") + field(2, "weights")) + field(14, 1)
TENSOR = field(1, 4) + field(2, FLOAT) + field(8, "w") + ELSEWHERE


@pytest.mark.parametrize(
    "extra",
    [
        field(5, TENSOR),  # an initialiser
        field(15, field(1, TENSOR)),  # a sparse one
        field(1, field(2, "c") + field(4, "Constant") + field(5, field(5, TENSOR))),
        field(1, field(4, "If") + field(5, field(6, field(5, TENSOR)))),  # in a branch
    ],
)
def test_weights_in_another_file_are_refused(extra, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "weights").write_bytes(np.ones(4, np.float32).tobytes())
    with pytest.raises(
        NetworkError, match="must contain its weights, this one refers to other files"
    ):
        Network.load(file(extra=extra))


@pytest.mark.parametrize("operator", ["Loop", "Scan"])
@pytest.mark.parametrize(
    "content",
    [
        lambda node: file(extra=field(1, node)),
        lambda node: file(extra=field(1, field(4, "If") + field(5, field(6, field(1, node))))),
        lambda node: file() + field(25, field(1, "f") + field(7, node)),  # in a function
        lambda node: file() + field(7, field(1, node)),  # protobuf puts the two graphs together
    ],
)
def test_what_need_not_end_is_refused_wherever_it_is(content, operator):
    with pytest.raises(NetworkError, match="must not contain Loop or Scan"):
        Network.load(content(field(1, "in0") + field(4, operator)))


def test_names_of_loops_elsewhere_are_no_loops():
    X = np.random.default_rng(1).standard_normal((3, 4))
    named = field(
        5, field(1, 4) + field(2, FLOAT) + field(8, "w") + field(9, b'"\x04Loop' + b"\0" * 10)
    )
    np.testing.assert_array_equal(
        Network.load(file(extra=named + field(10, "Loop, location"))).predict(X),
        X.max(axis=1).astype(np.float32),
    )


def test_onnxruntimes_own_form_is_refused():
    """It names operators elsewhere; this begins as a file of both forms would."""
    with pytest.raises(NetworkError, match="cannot run the network: .*protobuf parsing failed"):
        Network.load(b"\x12\x06\0\0ORTM" + b"\0" * 200)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (field(7, field(1, b"") * 40), "more than 30 operators, attributes and tensors"),
        (field(1, 8) * 101, "more than 100 fields"),
        (field(7, reduce(lambda inner, _: field(1, field(5, field(6, inner))), range(9), b"")),
         "more than 20 levels"),
    ],
)  # fmt: skip
def test_a_file_that_would_take_long_or_much_is_refused(data, message, monkeypatch):
    monkeypatch.setattr(onnx_content, "MAX_MESSAGES", 30)
    monkeypatch.setattr(onnx_content, "MAX_FIELDS", 100)
    monkeypatch.setattr(onnx_content, "MAX_DEPTH", 20)
    with pytest.raises(NetworkError, match=f"not a valid ONNX file: it has {message}"):
        Network.load(data)


def test_a_file_that_is_too_large_is_refused_before_it_is_read(monkeypatch):
    with pytest.raises(NetworkError, match="must have at most 67108864 bytes, got 67108865"):
        Network.load(bytes(network.MAX_BYTES + 1))


@pytest.mark.parametrize("shape", [(4,), (2, 3), (2, 5), (1, 2, 4)])
def test_a_wrong_shape_is_refused(shape):
    with pytest.raises(ValueError, match=r"X must be \(M, 4\), got"):
        Network.load(file()).predict(np.zeros(shape))


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, 1e39])
def test_a_row_that_is_not_finite_is_refused(wrong):
    X = np.zeros((20, 4))
    X[13, 2] = wrong
    with pytest.raises(ValueError, match="must be finite in float32, got .* in row 13"):
        Network.load(file()).predict(X)


def test_an_answer_that_is_not_finite_is_refused():
    X = np.zeros((20, 200))
    X[13] = np.resize([3e38, -3e38], 200)
    with pytest.raises(ValueError, match="output for row 13 is .*: X is too large"):
        load_model("dnn").regressor.predict(X)


# The networks that ship


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_network_and_its_card_belong_together(name):
    model = load_model(name)
    card = model.card
    assert model.path.name == f"{name}.onnx"
    assert isinstance(model.regressor, Network)
    assert card["sha256"] == sha256(model.path.read_bytes())
    assert (card["kind"], card["feature_schema"]) == ("network", NAMES[name])
    assert model.window == model.regressor.n_features == 200
    assert card["data_set"] == load_model("paper").card["data_set"]
    for key, value in (("convolutions", 3), ("filters", 30), ("kernel", 3)):
        assert card["network"][key] == value
    assert set(card["versions"]) >= {"python", "numpy", "torch", "onnx", "onnxruntime"}
    split = card["metrics"]["random_split"]
    assert (split["training"], split["test"]) == (57_600, 14_400)
    assert [m["test"] for m in card["metrics"]["trajectory_split"]["unseen"].values()] == [
        18_000
    ] * 4


@pytest.fixture(scope="module")
def unseen():
    """3,600 examples of another seed."""
    with open_pool(Workers(jobs=1)) as pool:
        return dataset.build_data_set(Recipe("window", 987_654, n_windows=10), pool)


@pytest.mark.parametrize(
    "sign",
    [1, pytest.param(-1, marks=pytest.mark.long)],  # of axes that point the other way
)
@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_network_does_as_its_card_says_on_data_of_another_seed(name, sign, unseen):
    """An RMSE over 3,600 new examples has a sigma of about 1.5 % of it: the bound is five."""
    model = load_model(name)
    measured = errors(model.variances(sign * unseen.X), unseen.q)
    stated = model.card["metrics"]["random_split"]
    assert measured["rmse"] == pytest.approx(stated["rmse"], rel=0.075)
    # Below the limit of an estimator that knows the noise itself something would be wrong.
    assert measured["rmse"] > 2.4e-3


@pytest.mark.parametrize("name", NAMES)
def test_a_windows_answer_does_not_depend_on_the_others(name):
    model = load_model(name)
    windows = dataset.noisy_windows(Recipe("window", 5, n_windows=5), 1, 3)
    together = model.variances(windows)
    for rows in (1, 6, 7):
        parts = [model.variances(windows[i : i + rows]) for i in range(0, len(windows), rows)]
        np.testing.assert_array_equal(np.concatenate(parts), together)


def test_the_default_network_follows_the_unit_and_is_blind_to_offset_and_slope():
    model = load_model("dnn-default")
    windows = dataset.noisy_windows(Recipe("window", 11, n_windows=3), 2, 7)
    q = model.variances(windows)
    for factor in (2.0**-10, 2.0**7):
        np.testing.assert_array_equal(model.variances(factor * windows), factor**2 * q)
    for factor in (1e-3, 10.0):
        np.testing.assert_allclose(model.variances(factor * windows), factor**2 * q, rtol=1e-5)
    moved = windows + 3.0 - 0.01 * np.arange(200)
    np.testing.assert_allclose(model.variances(moved), q, rtol=1e-5)
    assert model.variances(np.full((1, 200), 9.8)).tolist() == [0.0]


def test_the_default_network_holds_a_thousand_times_below_its_training():
    """There the vehicle's motion is far larger than the noise, and a straight line not enough."""
    rng = np.random.default_rng(12)
    readings = np.hstack(ideal_imu(BASELINE["lawn_mower"], np.arange(1, 40_001) / 100.0, 0.01))
    motion = np.ascontiguousarray(readings.T).reshape(-1, 200)
    q = 1e-3 * np.exp(rng.uniform(np.log(0.001), np.log(0.05), len(motion)))
    windows = motion + np.sqrt(q)[:, None] * rng.standard_normal(motion.shape)
    relative = load_model("dnn-default").variances(windows) / q - 1.0
    assert np.sqrt(np.mean(relative**2)) < 0.12
    straight = closed_form.linear(windows) / q - 1.0
    assert np.sqrt(np.mean(straight**2)) > 0.5


@pytest.mark.parametrize("name", NAMES)
def test_a_network_never_answers_with_a_negative_variance(name):
    model = load_model(name)
    quiet = np.random.default_rng(2).standard_normal((60, 200)) * np.logspace(-9, 0, 60)[:, None]
    for offset in (0.0, 9.8, -9.8):
        assert (model.variances(quiet + offset) >= 0.0).all()


@pytest.mark.parametrize("position", [0.0, 0.3, 0.999])
def test_one_altered_bit_is_refused(position, tmp_path):
    shipped = load_model("dnn").path
    shutil.copy(shipped.with_suffix(".json"), tmp_path)
    data = bytearray(shipped.read_bytes())
    data[int(position * len(data))] ^= 1
    (tmp_path / "dnn.onnx").write_bytes(data)
    with pytest.raises(ModelError, match=r"dnn\.onnx was altered"):
        load_model(str(tmp_path / "dnn.onnx"))


def test_a_network_of_another_window_is_refused(tmp_path):
    data = file()
    card = {**load_model("dnn").card, "sha256": sha256(data)}
    (tmp_path / "dnn.json").write_text(json.dumps(card))
    (tmp_path / "dnn.onnx").write_bytes(data)
    with pytest.raises(ModelError, match="has 4 features, its schema 'window' has 200"):
        load_model(str(tmp_path / "dnn.onnx"))


# Without the extra packages


def without(package: str, code: str) -> subprocess.CompletedProcess[str]:
    """Run code in a Python that does not find a package."""
    hidden = f"""
import sys
from importlib.machinery import PathFinder

class Finder(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        if name.partition(".")[0] == {package!r}:
            return None
        return PathFinder.find_spec(name, path, target)

sys.meta_path[sys.meta_path.index(PathFinder)] = Finder
"""
    return subprocess.run([sys.executable, "-c", hidden + code], capture_output=True, text=True)


def test_without_onnxruntime_a_network_is_refused_by_the_name_of_the_extra():
    code = """
from insdvl.tuner.models import ModelError, load_model
load_model("paper")
try:
    load_model("dnn")
except ModelError as error:
    print(error)
"""
    result = without("onnxruntime", code)
    assert result.returncode == 0, result.stderr
    assert "dnn.onnx is not usable: a network needs onnxruntime" in result.stdout
    assert "insdvl[onnx]" in result.stdout
    assert result.stdout.count("\n") == 1


def test_training_a_network_without_torch_is_one_sentence_and_exit_code_2(tmp_path):
    code = f"""
from insdvl import cli
sys.exit(cli.main(["train", "--preset", "dnn", "--out", {str(tmp_path / "models")!r}]))
"""
    result = without("torch", code)
    assert result.returncode == 2, result.stderr
    assert result.stderr.startswith("insdvl train: --preset dnn needs torch")
    assert "insdvl[dnn]" in result.stderr
    assert result.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("window", ["21", "2001"])
def test_a_window_that_the_network_cannot_take_is_refused(window, tmp_path, capsys):
    options = ["--preset", "dnn-default", "--window", window, "--out", str(tmp_path / "models")]
    assert cli.main(["train", *options]) == 2
    refusal = f"insdvl train: --window must be within 22 to 2000, got {window}\n"
    assert capsys.readouterr().err == refusal
    assert list(tmp_path.iterdir()) == []
