"""A trained model: arrays in an ``.npz`` file and, beside it, a card in JSON that describes them.

The card says what the model is given (`feature_schema`), the window's number of samples, how it was
trained and how well it does, and the SHA-256 of the ``.npz`` file. A file that is not the one of
its card is refused; nothing in either file can run code.
"""

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insdvl.tuner.features import MIN_SAMPLES, SCHEMAS, Schema
from insdvl.tuner.forest import Forest, ForestError

Array = NDArray[np.float64]

#: What a card must have, and of which type; the rest of it is for people.
CARD_FIELDS = {
    "name": str,
    "feature_schema": str,
    "features": list,
    "window": int,
    "sha256": str,
}


class ModelError(ValueError):
    """A model is missing, altered, or not one that this version can use."""


@dataclass(frozen=True)
class Model:
    """A model ready for use.

    Attributes:
        path: The file of the arrays.
        card: The card as it was read.
        window: Number of samples N of a window.
        schema: What the forest is given.
        forest: The trees.
    """

    path: Path
    card: Mapping[str, Any]
    window: int
    schema: Schema
    forest: Forest

    def variances(self, windows: Array) -> Array:
        """Variance per sample of the noise in each window.

        Args:
            windows: (M, window), one channel each, in its unit.

        Returns:
            (M,), in the square of that unit.

        Raises:
            ValueError: A window has another length, or is not finite or too large.
        """
        if windows.ndim != 2 or windows.shape[1] != self.window:
            raise ValueError(f"windows must be (M, {self.window}), got {windows.shape}")
        return self.forest.predict(self.schema.extract(windows))


def sha256(data: bytes) -> str:
    """SHA-256 of a file's bytes, in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def load_model(name_or_path: str) -> Model:
    """A model that ships with insdvl, by its name, or another by the path of its ``.npz`` file.

    A path has a separator or ends in ``.npz``.

    Raises:
        ModelError: A file is missing or altered, or its card does not fit. It names the file and
            the SHA-256 that its card expects.
    """
    arrays_file, card_file = _files(name_or_path)
    card = _card(card_file)
    expected = f"{card_file} expects SHA-256 {card['sha256']}"
    try:
        data = arrays_file.read_bytes()
    except OSError as error:
        reason = error.strerror or error
        raise ModelError(f"cannot read the model {arrays_file}: {reason}; {expected}") from error
    if sha256(data) != card["sha256"]:
        raise ModelError(
            f"the model {arrays_file} was altered: its SHA-256 is {sha256(data)}; {expected}"
        )
    try:
        forest = Forest.load(io.BytesIO(data))
    except ForestError as error:
        raise ModelError(f"the model {arrays_file} is not usable: {error}; {expected}") from error
    schema = _schema(card, card_file)
    if forest.n_features != len(schema.names):
        raise ModelError(
            f"the model {arrays_file} has {forest.n_features} features, its schema "
            f"{card['feature_schema']!r} has {len(schema.names)}; {expected}"
        )
    return Model(arrays_file, card, card["window"], schema, forest)


def _files(name_or_path: str) -> tuple[Path, Path]:
    """The arrays and the card of a model."""
    if "/" in name_or_path or name_or_path.endswith(".npz"):
        path = Path(name_or_path)
        return path, path.with_suffix(".json")
    shipped = Path(str(files("insdvl") / "models"))
    return shipped / f"{name_or_path}.npz", shipped / f"{name_or_path}.json"


def _card(file: Path) -> dict[str, Any]:
    try:
        card = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        reason = error.strerror or error
        raise ModelError(f"cannot read the model's card {file}: {reason}") from error
    except ValueError as error:
        raise ModelError(f"the model's card {file} is no JSON: {error}") from error
    if not isinstance(card, dict):
        raise ModelError(f"the model's card {file} is no JSON object")
    for name, kind in CARD_FIELDS.items():
        if type(card.get(name)) is not kind:
            raise ModelError(
                f"the model's card {file}: {name} must be of type {kind.__name__}, "
                f"got {card.get(name)!r}"
            )
    if card["window"] < MIN_SAMPLES:
        raise ModelError(
            f"the model's card {file}: window must be >= {MIN_SAMPLES}, got {card['window']}"
        )
    return card


def _schema(card: Mapping[str, Any], file: Path) -> Schema:
    schema = SCHEMAS.get(card["feature_schema"])
    if schema is None:
        raise ModelError(
            f"the model's card {file}: feature_schema {card['feature_schema']!r} is unknown, "
            f"known are {', '.join(SCHEMAS)}"
        )
    if tuple(card["features"]) != schema.names:
        raise ModelError(
            f"the model's card {file}: its features are not those of the schema "
            f"{card['feature_schema']!r} in this version"
        )
    return schema
