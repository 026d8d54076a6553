"""The convolutional network: fitted with torch, converted to an ONNX file.

As published: three convolutions of 30 filters with kernel 3, each with ReLU and pooling, and a
dense layer, on a window of one channel; one network serves all channels. The pooling keeps the
larger of two neighbours.

With absolute targets a softplus follows the dense layer, because a variance is positive; a plain
dense layer may give a negative one where there is little noise.

Raw windows are hard to learn from: gravity and slow motion are hundreds of times larger than the
noise. The inputs of the first convolution, three samples at a time, are therefore standardised: it
is trained in the principal axes of those triples over the training examples, each in units of its
spread. This is a linear map of its weights, so it changes the path of the training and not the set
of possible networks; the file has the weights for raw samples. Without it the error on an unseen
trajectory was 3 to 30 times larger.

In each epoch a window gets a random sign: axes, and with them gravity, may point either way, and q
is the same.

The pooling (the alternative was one mean over time before the dense layer), the largest learning
rate and the number of epochs were chosen on half of the windows of a data set with another seed, by
the error on a trajectory that was left out.

All random numbers (first weights, order of the examples, signs) come from numpy: the same versions
on the same kind of processor give the same bytes, on any number of workers.

torch, onnx (`insdvl[dnn]`) and onnxruntime (`insdvl[onnx]`) are imported only when a network is
trained.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array
from insdvl.extras import extra
from insdvl.jobs.pool import Pool
from insdvl.jobs.store import Store
from insdvl.jobs.tasks import Result
from insdvl.studies.training import dataset, procedure
from insdvl.studies.training.dataset import Indices, Recipe
from insdvl.studies.training.procedure import Method
from insdvl.tuner.features.schemas import SCHEMAS
from insdvl.tuner.network import Network

CONVOLUTIONS = 3
FILTERS = 30
KERNEL = 3  # samples
POOL = 2  # samples; the largest is kept
BATCH = 64  # examples
LEARNING_RATE = 1e-2  # the maximum: it rises over the first quarter of the steps, then falls
RISE = 0.25


@dataclass(frozen=True)
class Preset:
    """Settings of a model.

    Attributes:
        schema: Name of the feature schema.
        epochs: Number of passes over the examples.
    """

    schema: str
    epochs: int


PRESETS = {"dnn": Preset("window", 8), "dnn-default": Preset("scaled_window", 2)}

_LIBRARIES = ("numpy", "scipy", "torch", "onnx", "onnxruntime")
_STREAM = (1001,)  # random stream; not one of the data set
_OPSET, _IR_VERSION = 17, 8  # of 2022: onnxruntime 1.14 and later read them


def fit(
    X: Array, y: Array, absolute: bool, epochs: int, seed: int
) -> dict[str, NDArray[np.float32]]:
    """Fit the network on one thread.

    Args:
        X: (M, N) windows.
        y: (M,) targets.
        absolute: Whether a target is a variance, and so positive.
        epochs: Number of passes over the examples.
        seed: Random seed in [0, 2^32).

    Returns:
        The weights for raw windows: convolutions ``w1`` (30, 1, 3), ``b1`` (30,), ``w2``
        (30, 30, 3), ``b2``, ``w3``, ``b3``; dense layer ``w4`` (1, 30 n) for the n remaining
        samples, ``b4`` (1,); with absolute targets also ``gain`` (1,), the factor of the softplus.
    """
    with extra("dnn"):
        import torch
        from torch.nn import functional

    torch.set_num_threads(1)
    torch.use_deterministic_algorithms(True)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=_STREAM))
    axes = _principal_axes(X)
    shift, gain = (0.0, y.mean()) if absolute else (y.mean(), y.std())

    def layer(*shape: int) -> tuple[Any, Any]:
        """First weights and biases, uniform within 1 / sqrt(number of inputs)."""
        bound = 1.0 / np.sqrt(np.prod(shape[1:]))
        weight = torch.tensor(rng.uniform(-bound, bound, shape).astype(np.float32))
        if weight.ndim == 4:
            weight = weight.contiguous(memory_format=torch.channels_last)  # the faster one
        bias = torch.tensor(rng.uniform(-bound, bound, shape[0]).astype(np.float32))
        return weight.requires_grad_(), bias.requires_grad_()

    w1, b1 = layer(FILTERS, KERNEL)
    w2, b2 = layer(FILTERS, FILTERS, 1, KERNEL)
    w3, b3 = layer(FILTERS, FILTERS, 1, KERNEL)
    w4, b4 = layer(1, FILTERS * _pooled(X.shape[1]))
    weights = [w1, b1, w2, b2, w3, b3, w4, b4]
    whitening = torch.tensor(axes.astype(np.float32))

    def answers(x: Any) -> Any:
        """Output for windows (B, 1, 1, N), in units of the gain."""
        kernels = (w1 @ whitening).view(FILTERS, 1, 1, KERNEL)
        for weight, bias in (kernels, b1), (w2, b2), (w3, b3):
            x = functional.relu(functional.conv2d(x, weight, bias))
            x = functional.max_pool2d(x, (1, POOL))
        x = functional.linear(x.flatten(1), w4, b4)[:, 0]
        return functional.softplus(x) if absolute else x

    rows = torch.tensor(X.astype(np.float32))[:, None, None, :]
    wanted = torch.tensor(((y - shift) / gain).astype(np.float32))
    optimizer = torch.optim.Adam(weights, lr=LEARNING_RATE)
    steps = max(len(X) // BATCH, 1)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, LEARNING_RATE, total_steps=epochs * steps, pct_start=RISE
    )
    for _ in range(epochs):
        order = torch.tensor(rng.permutation(len(X)))
        signs = torch.tensor(rng.choice(np.array([-1.0, 1.0], np.float32), (len(X), 1, 1, 1)))
        for step in range(steps):
            batch = order[step * BATCH : (step + 1) * BATCH]
            optimizer.zero_grad()
            functional.mse_loss(answers(signs[batch] * rows[batch]), wanted[batch]).backward()
            optimizer.step()
            schedule.step()

    w1, b1, w2, b2, w3, b3, w4, b4 = (
        weight.detach().numpy().astype(np.float64) for weight in weights
    )
    folded = {
        "w1": (w1 @ axes)[:, None, :],
        "b1": b1,
        "w2": w2[:, :, 0],
        "b2": b2,
        "w3": w3[:, :, 0],
        "b3": b3,
    } | (
        {"w4": w4, "b4": b4, "gain": gain}
        if absolute
        else {"w4": gain * w4, "b4": gain * b4 + shift}
    )
    return {name: np.ascontiguousarray(array, np.float32) for name, array in folded.items()}


def _pooled(n: int) -> int:
    """Number of samples after the convolutions and their pooling of n samples."""
    for _ in range(CONVOLUTIONS):
        n = (n - KERNEL + 1) // POOL
    return n


def _principal_axes(X: Array) -> Array:
    """The map (3, 3) of three consecutive samples, of either sign, to axes of unit variance."""
    runs = np.lib.stride_tricks.sliding_window_view(X, KERNEL, axis=1).reshape(-1, KERNEL)
    variances, axes = np.linalg.eigh(runs.T @ runs / len(runs))
    return axes.T / np.sqrt(variances)[:, None]


def to_onnx(weights: Mapping[str, NDArray[np.float32]], window: int) -> bytes:
    """The file of the network; equal weights give equal bytes.

    Args:
        weights: See `fit`.
        window: Number of samples N of a row.
    """
    with extra("dnn"):
        from onnx import TensorProto, checker, helper, numpy_helper

    nodes = [helper.make_node("Unsqueeze", ["window", "channel"], ["x0"])]
    for layer in range(1, CONVOLUTIONS + 1):
        inputs = [f"x{layer - 1}", f"w{layer}", f"b{layer}"]
        nodes += [
            helper.make_node("Conv", inputs, [f"c{layer}"]),
            helper.make_node("Relu", [f"c{layer}"], [f"r{layer}"]),
            helper.make_node(
                "MaxPool", [f"r{layer}"], [f"x{layer}"], kernel_shape=[POOL], strides=[POOL]
            ),
        ]
    nodes += [
        helper.make_node("Flatten", [f"x{CONVOLUTIONS}"], ["flat"]),
        helper.make_node("Gemm", ["flat", "w4", "b4"], ["dense"], transB=1),
    ]
    last = "dense"
    if "gain" in weights:
        nodes += [
            helper.make_node("Softplus", ["dense"], ["positive"]),
            helper.make_node("Mul", ["positive", "gain"], ["variance"]),
        ]
        last = "variance"
    nodes.append(helper.make_node("Squeeze", [last, "channel"], ["answer"]))
    graph = helper.make_graph(
        nodes,
        "insdvl",
        [helper.make_tensor_value_info("window", TensorProto.FLOAT, ["M", window])],
        [helper.make_tensor_value_info("answer", TensorProto.FLOAT, ["M"])],
        [
            *(numpy_helper.from_array(array, name) for name, array in weights.items()),
            numpy_helper.from_array(np.array([1], np.int64), "channel"),
        ],
    )
    model = helper.make_model(
        graph,
        producer_name="insdvl",
        ir_version=_IR_VERSION,
        opset_imports=[helper.make_opsetid("", _OPSET)],
    )
    checker.check_model(model, full_check=True)
    return model.SerializeToString(deterministic=True)


def train(
    preset: str,
    window: int,
    seed: int,
    pool: Pool,
    store: Store | None,
    say: Callable[[str], None],
    n_windows: int = dataset.WINDOWS,
) -> tuple[bytes, dict[str, Any]]:
    """Train a model.

    Args:
        preset: Key of PRESETS.
        window: Number of samples of a window, at least 22, of which the last pooling leaves one.
        seed: Random seed in [0, 2^32) of the data set, the split and the network.
        pool: Does the work; the result does not depend on it.
        store: Keeps finished parts.
        say: Called with messages of progress.
        n_windows: See `Recipe`.

    Returns:
        The file of the model, and its card without name and hash.
    """
    schema, epochs = PRESETS[preset].schema, PRESETS[preset].epochs
    method = Method(
        kind="network",
        fit=_fit,
        settings=(not SCHEMAS[schema].relative, epochs, seed),
        regressor=lambda weights: Network.load(to_onnx(weights, window)),
        described_as=(
            "network",
            {
                "convolutions": CONVOLUTIONS,
                "filters": FILTERS,
                "kernel": KERNEL,
                "pooling": f"largest of {POOL}",
                "epochs": epochs,
                "batch": BATCH,
                "learning_rate": LEARNING_RATE,
            },
        ),
        versions={package: version(package) for package in _LIBRARIES},
    )
    weights, card = procedure.train_method(
        method, Recipe(schema, seed, window, n_windows), pool, store, say
    )
    return to_onnx(weights, window), card


def _fit(shared: tuple[Array, Array, bool, int, int], task: tuple[Indices, None]) -> Result:
    X, y, absolute, epochs, seed = shared
    training, _ = task
    return fit(X[training], y[training], absolute, epochs, seed)
