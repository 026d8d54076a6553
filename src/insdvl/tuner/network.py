"""A convolutional network in an ``.onnx`` file: checks, and prediction with onnxruntime.

The network has one input, float32 (M, F) with any number M of rows, and one output, float32 (M,).
The operators between them are free: onnxruntime knows them, and nothing in such a file can run code
of its own. The weights are in the file itself.

onnxruntime is imported only when a network is loaded; trees do not need it.
"""

from typing import Any

import numpy as np

from insdvl.arrays import Array
from insdvl.tuner import onnx_content

MAX_BYTES = 64 * 2**20  # of a file; shipped files have a thousandth

_FLOAT = "tensor(float)"
_BLOCK = 8  # rows at a time; more do not fit the cache
#: Operators that repeat others, and may not terminate.
_LOOPS = frozenset({b"Loop", b"Scan"})


class NetworkError(ValueError):
    """The file is not a valid network, or onnxruntime is missing."""


class Network:
    """A network on one thread. The output for a row does not depend on other rows.

    Attributes:
        n_features: Length F of a row.
    """

    def __init__(self, session: Any) -> None:
        """Check input and output of the network.

        Args:
            session: An ``onnxruntime.InferenceSession``.

        Raises:
            NetworkError: The number, type or shape of inputs or outputs is wrong.
        """
        inputs, outputs = session.get_inputs(), session.get_outputs()
        if len(inputs) != 1 or len(outputs) != 1:
            raise NetworkError(
                f"a network must have 1 input and 1 output, got {len(inputs)} and {len(outputs)}"
            )
        for tensor, shape in (inputs[0], "(M, F)"), (outputs[0], "(M,)"):
            sizes = tensor.shape
            wanted = 1 + (tensor is inputs[0])
            # A fixed size is a number; a free one is a name or None.
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
            NetworkError: onnxruntime is not installed or rejects the file, the file is too large or
                refers to others, or `Network` rejects it.
        """
        if len(data) > MAX_BYTES:
            raise NetworkError(f"a network must have at most {MAX_BYTES} bytes, got {len(data)}")
        try:
            content = onnx_content.read(data)
        except ValueError as error:
            raise NetworkError(f"not a valid ONNX file: {error}") from error
        if not content.has_all:
            raise NetworkError("a network must contain its weights, this one refers to other files")
        if not content.operators.isdisjoint(_LOOPS):
            raise NetworkError("a network must not contain Loop or Scan, which may not terminate")
        try:
            import onnxruntime
        except ImportError as error:
            raise NetworkError("a network needs onnxruntime: install insdvl[onnx]") from error
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.inter_op_num_threads = 1
        options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
        options.log_severity_level = 4  # it raises all errors as well
        # It would also load its own format, which was not checked.
        options.add_session_config_entry("session.load_model_format", "ONNX")
        try:
            session = onnxruntime.InferenceSession(
                data, options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # its errors have no other common class
            reason = " ".join(str(error).split())
            raise NetworkError(f"onnxruntime cannot run the network: {reason}") from error
        return cls(session)

    def predict(self, X: Array) -> Array:
        """The output of the network for each row.

        Args:
            X: (M, n_features).

        Returns:
            (M,).

        Raises:
            ValueError: `X` has another shape, is not finite in float32, or is so large that an
                output is not.
        """
        X = np.asarray(X, dtype=np.float64)
        if X.ndim != 2 or X.shape[1] != self.n_features:
            raise ValueError(f"X must be (M, {self.n_features}), got {X.shape}")
        # Whole blocks: onnxruntime rounds differently where fewer rows are left.
        rows = np.zeros((-(-X.shape[0] // _BLOCK) * _BLOCK, self.n_features), np.float32)
        with np.errstate(over="ignore"):  # the value is then infinite, and rejected
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
            raise ValueError(f"the network's output for row {row} is {out[row]}: X is too large")
        return out
