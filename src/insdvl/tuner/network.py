"""A convolutional network in an ``.onnx`` file: its checks, and its prediction with onnxruntime.

The network has one input, float32 (M, F) with any number M of rows, and one output, float32 (M,).
What lies between is the file's own matter: onnxruntime knows the operators, and nothing in such a
file can run code of its own. The weights are in the file itself.

onnxruntime is imported when a network is loaded, not before: the trees do without it.
"""

from typing import Any

import numpy as np

from insdvl.arrays import Array
from insdvl.tuner import onnx_content

MAX_BYTES = 64 * 2**20  # of a file; those that ship have a thousandth of it

_FLOAT = "tensor(float)"
_BLOCK = 8  # rows at a time: more would leave the cache
#: Operators that repeat others: they need not end.
_LOOPS = frozenset({b"Loop", b"Scan"})


class NetworkError(ValueError):
    """A file that is no network of the form above, or nothing to run it with."""


class Network:
    """A network on one thread. A row's answer does not depend on the rows beside it.

    Attributes:
        n_features: Length F of a row.
    """

    def __init__(self, session: Any) -> None:
        """Check what the network takes and gives.

        Args:
            session: An ``onnxruntime.InferenceSession``.

        Raises:
            NetworkError: The input or the output is another one.
        """
        inputs, outputs = session.get_inputs(), session.get_outputs()
        if len(inputs) != 1 or len(outputs) != 1:
            raise NetworkError(
                f"a network must have 1 input and 1 output, got {len(inputs)} and {len(outputs)}"
            )
        for tensor, shape in (inputs[0], "(M, F)"), (outputs[0], "(M,)"):
            sizes = tensor.shape
            wanted = 1 + (tensor is inputs[0])
            # A size is a number where it is fixed, and a name or None where it is free.
            fixed = [isinstance(size, int) for size in sizes]
            if tensor.type != _FLOAT or fixed != [False, True][:wanted]:
                raise NetworkError(
                    f"{tensor.name} must be {_FLOAT} {shape} with M free, "
                    f"got {tensor.type} {tuple(sizes)}"
                )
        self.n_features: int = inputs[0].shape[1]
        self._session = session
        self._input: str = inputs[0].name

    @classmethod
    def load(cls, data: bytes) -> "Network":
        """A network from the bytes of an ``.onnx`` file.

        Raises:
            NetworkError: onnxruntime is not installed or refuses the file, the file is too large or
                refers to others, or `Network` refuses it.
        """
        if len(data) > MAX_BYTES:
            raise NetworkError(f"a network must have at most {MAX_BYTES} bytes, got {len(data)}")
        try:
            content = onnx_content.read(data)
        except ValueError as error:
            raise NetworkError(f"no network in ONNX's form: {error}") from error
        if not content.has_all:
            raise NetworkError("a network must hold its weights, this one refers to other files")
        if not content.operators.isdisjoint(_LOOPS):
            raise NetworkError("a network must have no Loop and no Scan, which need not end")
        try:
            import onnxruntime
        except ImportError as error:
            raise NetworkError(
                "a network needs onnxruntime, which the extra packages of insdvl[onnx] have"
            ) from error
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.inter_op_num_threads = 1
        options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
        options.log_severity_level = 4  # what it refuses it raises as well
        # Its own form of a file, which it would know by some bytes, is not what was checked.
        options.add_session_config_entry("session.load_model_format", "ONNX")
        try:
            session = onnxruntime.InferenceSession(
                data, options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # its errors have no other class in common
            reason = " ".join(str(error).split())
            raise NetworkError(f"no network that onnxruntime can run: {reason}") from error
        return cls(session)

    def predict(self, X: Array) -> Array:
        """The network's answer to each row.

        Args:
            X: (M, n_features).

        Returns:
            (M,).

        Raises:
            ValueError: `X` has another shape, is not finite in float32, or is so large that an
                answer is not.
        """
        X = np.asarray(X, dtype=np.float64)
        if X.ndim != 2 or X.shape[1] != self.n_features:
            raise ValueError(f"X must be (M, {self.n_features}), got {X.shape}")
        # Whole blocks: onnxruntime rounds an answer in another way where fewer rows are left.
        rows = np.zeros((-(-X.shape[0] // _BLOCK) * _BLOCK, self.n_features), np.float32)
        with np.errstate(over="ignore"):  # it is then infinite, and refused
            rows[: X.shape[0]] = X
        wrong = ~np.isfinite(rows).all(axis=1)
        if wrong.any():
            row = int(wrong.argmax())
            raise ValueError(f"X must be finite in float32, got {X[row].tolist()} in row {row}")
        out = np.empty(rows.shape[0])
        for start in range(0, rows.shape[0], _BLOCK):
            block = slice(start, start + _BLOCK)
            (out[block],) = self._session.run(None, {self._input: rows[block]})
        out = out[: X.shape[0]]
        wrong = ~np.isfinite(out)
        if wrong.any():
            row = int(wrong.argmax())
            raise ValueError(f"the network's answer to row {row} is {out[row]}: X is too large")
        return out
