"""The convolutional network: fit with torch, turned into an ONNX file, with its card.

As published: three convolutions of 30 filters with kernel 3 and ReLU, pooling, a dense layer, on a
window of one channel; one network serves all channels. The pooling is the mean over time, which is
what the estimate of a variance needs: a mean of a nonlinear function of the samples' differences.

Where answers are absolute the dense layer is followed by a softplus, because a variance is
positive; a plain dense layer is free to answer with a negative one where there is little noise.

A raw window is hard to learn from: gravity and slow motion are hundreds of times the noise, and
the noise is all that matters. The inputs are therefore standardised as the first convolution sees
them, three samples at a time: it is trained in the principal axes of those triples over the
training examples, each in units of its spread. That is a linear map of its weights, so it changes
where the training goes and not what the network can be; the file holds the weights of the raw
samples. Without it the error on an unseen trajectory was 3 to 30 times as large.

Trained on the random 80 % of the data set, as published, and beside it without leakage, see
`ensemble`. The number of epochs and the learning rate come from cross-validation over the four
trajectories, each once left out, on a data set of another seed.

Numbers that are drawn, the first weights and the order of the examples, come from numpy: the same
versions on the same kind of processor give the same bytes, on any number of workers.

torch, onnx and onnxruntime (`insdvl[dnn]`) are imported when a network is trained, not before.
"""

import platform
from collections.abc import Callable, Mapping
from importlib.metadata import version
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insdvl.parallel import Pool, Result, Store
from insdvl.training import dataset
from insdvl.training.assessment import PUBLISHED, described, metrics, splits
from insdvl.training.dataset import DataSet, Indices
from insdvl.tuner.network import Network
from insdvl.tuner.schemas import SCHEMAS

Array = NDArray[np.float64]

CONVOLUTIONS = 3
FILTERS = 30
KERNEL = 3  # samples
EPOCHS = 8
BATCH = 64  # examples
LEARNING_RATE = 5e-3  # the largest: it rises over the first quarter of the steps, then falls
RISE = 0.25

#: What training needs beside insdvl: the extra `dnn`.
PACKAGES = ("torch", "onnx", "onnxruntime")

_OPSET, _IR_VERSION = 17, 8  # of 2022: onnxruntime 1.14 and later read them


def missing_packages() -> list[str]:
    """Those of PACKAGES that are not installed."""
    return [name for name in PACKAGES if find_spec(name) is None]


def fit(X: Array, y: Array, absolute: bool, seed: int) -> dict[str, NDArray[np.float32]]:
    """The weights of the network for rows as they come, on one thread.

    Args:
        X: (M, N) windows.
        y: (M,) answers.
        absolute: Whether an answer is a variance, and so positive.
        seed: In [0, 2^32).

    Returns:
        Convolutions ``w1`` (30, 1, 3), ``b1`` (30,), ``w2`` (30, 30, 3), ``b2``, ``w3``, ``b3``,
        dense layer ``w4`` (1, 30), ``b4`` (1,); where answers are absolute ``gain`` (), which the
        softplus of the dense layer is multiplied by.
    """
    import torch
    from torch.nn import functional

    torch.set_num_threads(1)
    rng = np.random.default_rng(seed)
    center, axes = _principal_axes(X)
    shift, gain = (0.0, y.mean()) if absolute else (y.mean(), y.std())

    def drawn(*shape: int) -> NDArray[np.float32]:
        """First weights: uniform, with the variance that keeps ReLU layers at one scale."""
        bound = np.sqrt(6.0 / np.prod(shape[1:]))
        return rng.uniform(-bound, bound, shape).astype(np.float32)

    def of_convolution() -> Any:
        weight = torch.tensor(drawn(FILTERS, FILTERS, 1, KERNEL))
        return weight.contiguous(memory_format=torch.channels_last)  # the faster one

    w1, w2, w3, w4 = (
        torch.tensor(drawn(FILTERS, KERNEL)),
        of_convolution(),
        of_convolution(),
        torch.tensor(drawn(1, FILTERS)),
    )
    b1, b2, b3, b4 = (torch.zeros(size) for size in (FILTERS, FILTERS, FILTERS, 1))
    weights = [w1, b1, w2, b2, w3, b3, w4, b4]
    for weight in weights:
        weight.requires_grad_()
    whitening, origin = (torch.tensor(array.astype(np.float32)) for array in (axes, center))

    def answers(x: Any) -> Any:
        """Of windows (B, 1, 1, N), in units of the gain."""
        kernels = w1 @ whitening
        x = functional.conv2d(x, kernels.view(FILTERS, 1, 1, KERNEL), b1 - kernels @ origin)
        x = functional.conv2d(functional.relu(x), w2, b2)
        x = functional.conv2d(functional.relu(x), w3, b3)
        x = functional.linear(functional.relu(x).mean((2, 3)), w4, b4)[:, 0]
        return functional.softplus(x) if absolute else x

    rows = torch.tensor(X.astype(np.float32))[:, None, None, :]
    wanted = torch.tensor(((y - shift) / gain).astype(np.float32))
    optimizer = torch.optim.Adam(weights, lr=LEARNING_RATE)
    steps = max(len(X) // BATCH, 1)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, LEARNING_RATE, total_steps=EPOCHS * steps, pct_start=RISE
    )
    for _ in range(EPOCHS):
        order = rng.permutation(len(X))
        for step in range(steps):
            batch = torch.tensor(order[step * BATCH : (step + 1) * BATCH])
            optimizer.zero_grad()
            functional.mse_loss(answers(rows[batch]), wanted[batch]).backward()
            optimizer.step()
            schedule.step()

    w1, b1, w2, b2, w3, b3, w4, b4 = (
        weight.detach().numpy().astype(np.float64) for weight in weights
    )
    kernels = w1 @ axes
    folded = {
        "w1": kernels[:, None, :],
        "b1": b1 - kernels @ center,
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


def _principal_axes(X: Array) -> tuple[Array, Array]:
    """Mean (3,) of all runs of three samples, and the map (3, 3) to axes of unit variance."""
    runs = np.lib.stride_tricks.sliding_window_view(X, KERNEL, axis=1).reshape(-1, KERNEL)
    variances, axes = np.linalg.eigh(np.cov(runs.T))
    return runs.mean(axis=0), axes.T / np.sqrt(variances)[:, None]


def to_onnx(weights: Mapping[str, NDArray[np.float32]], window: int) -> bytes:
    """The network's file; equal weights give equal bytes.

    Args:
        weights: See `fit`.
        window: Number of samples N of a row.
    """
    from onnx import TensorProto, checker, helper, numpy_helper

    nodes = [helper.make_node("Unsqueeze", ["window", "channel"], ["x0"])]
    for layer in range(1, CONVOLUTIONS + 1):
        inputs = [f"x{layer - 1}", f"w{layer}", f"b{layer}"]
        nodes += [
            helper.make_node("Conv", inputs, [f"c{layer}"]),
            helper.make_node("Relu", [f"c{layer}"], [f"x{layer}"]),
        ]
    nodes += [
        helper.make_node("GlobalAveragePool", ["x3"], ["mean"]),
        helper.make_node("Flatten", ["mean"], ["pooled"]),
        helper.make_node("Gemm", ["pooled", "w4", "b4"], ["dense"], transB=1),
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
    name: str,
    schema: str,
    seed: int,
    pool: Pool,
    store: Store | None,
    say: Callable[[str], None],
    n_windows: int = dataset.WINDOWS,
) -> tuple[bytes, dict[str, Any]]:
    """The file of a network, and its card without the hash.

    Args:
        name: Of the model.
        schema: Name of the feature schema.
        seed: In [0, 2^32); of the data set, of the split, and of the network.
        pool: Runs the fits, one for each split.
        store: Keeps finished fits, or None.
        say: Is told what is being done.
        n_windows: Windows of each channel of a recording.
    """
    data = dataset.build(schema, seed, 1, n_windows)
    say(f"data set: {data.q.size} examples, {data.X.shape[1]} samples each")
    tasks = {split: training for split, (training, _) in splits(data, seed).items()}
    fits = pool.run(_fit, tasks, (data, schema, seed), store, f"networks {name}")
    files = {
        split: to_onnx(weights, dataset.WINDOW) for split, weights in zip(tasks, fits, strict=True)
    }
    networks = {split: Network.load(file) for split, file in files.items()}
    card = {
        "name": name,
        "kind": "network",
        "feature_schema": schema,
        "features": list(SCHEMAS[schema].names),
        "target": "variance per sample of a channel's white noise, in the square of its unit",
        "window": dataset.WINDOW,
        "data_set": described(data, seed, n_windows),
        "network": {
            "convolutions": CONVOLUTIONS,
            "filters": FILTERS,
            "kernel": KERNEL,
            "pooling": "mean over time",
            "epochs": EPOCHS,
            "batch": BATCH,
            "learning_rate": LEARNING_RATE,
            "seed": seed,
            "trained_on": PUBLISHED,
        },
        "metrics": metrics(networks, data, SCHEMAS[schema], seed, say),
        "versions": {
            "python": platform.python_version(),
            **{package: version(package) for package in ("numpy", "scipy", *PACKAGES)},
        },
    }
    return files[PUBLISHED], card


def _fit(shared: tuple[DataSet, str, int], training: Indices) -> Result:
    data, name, seed = shared
    schema = SCHEMAS[name]
    y = schema.encode(data.q[training], data.scale[training])
    return fit(data.X[training], y, not schema.relative, seed)
