"""A trained model: a file with its numbers, and a card in JSON that describes them.

The card has the kind of the regressor (`kind`), its inputs (`feature_schema`), the number of
samples of the window, the training, the errors, and the SHA-256 of the file. A file that does not
match its card is rejected; nothing in either file can run code.
"""

import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol

from insdvl.arrays import Array
from insdvl.files import read, read_json, shown, write
from insdvl.tuner import forest, network, weights
from insdvl.tuner.features.schemas import SCHEMAS, Schema
from insdvl.tuner.forest import Forest
from insdvl.tuner.network import Network
from insdvl.tuner.weights import Weights

#: Required fields of a card and their types; all others are for people.
CARD_FIELDS = {
    "name": str,
    "kind": str,
    "feature_schema": str,
    "features": list,
    "window": int,
    "sha256": str,
}

_SHIPPED = Path(str(files("insdvl") / "models"))

MAX_CARD_BYTES = 2**20  # shipped cards have two kilobytes
MAX_WINDOW = 10_000  # samples, 10 s at 1 kHz; a tuner keeps and processes all of them


class ModelError(ValueError):
    """A model is missing, altered, or unusable in this version."""


class UnknownModelError(ModelError):
    """There is no such model: its name or its path is wrong."""


class Regressor(Protocol):
    """Computes the output of a model.

    Attributes:
        n_features: Length F of a row.
    """

    n_features: int

    def predict(self, X: Array) -> Array:
        """Outputs (M,) for rows (M, F); ValueError where a row cannot be used."""


@dataclass(frozen=True)
class Kind:
    """A kind of model.

    Attributes:
        suffix: Suffix of its file.
        max_bytes: Largest size of its file.
        load: Makes the regressor from the bytes of the file; ValueError where they are invalid.
    """

    suffix: str
    max_bytes: int
    load: Callable[[bytes], Regressor]


#: Kinds of models by their names on cards.
KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        "forest": Kind(".npz", forest.MAX_BYTES, Forest.load),
        "network": Kind(".onnx", network.MAX_BYTES, Network.load),
        "weights": Kind(".npz", weights.MAX_BYTES, Weights.load),
    }
)


@dataclass(frozen=True)
class Model:
    """A model ready for use.

    Attributes:
        path: File of its numbers.
        card: The card as read.
        window: Number of samples N of a window, the least that an estimate needs.
        schema: Inputs of the regressor, and the meaning of its outputs.
        regressor: Computes the outputs.
    """

    path: Path
    card: Mapping[str, Any]
    window: int
    schema: Schema
    regressor: Regressor

    @property
    def history(self) -> int:
        """Largest number of samples that an estimate uses."""
        return self.schema.history or self.window

    def variances(self, windows: Array) -> Array:
        """Variance per sample of the noise in each window.

        Args:
            windows: (M, N) of window to history samples, one channel each, in its unit; the six
                channels of a time together, in their order.

        Returns:
            (M,), in the square of that unit.

        Raises:
            ValueError: A window has another length, or is not finite or too large; or channels
                are missing.
        """
        if windows.ndim != 2 or not self.window <= windows.shape[1] <= self.history:
            lengths = f"{self.window}"
            if self.history != self.window:
                lengths += f" to {self.history}"
            raise ValueError(f"windows must be (M, {lengths}), got {windows.shape}")
        X, scale = self.schema.extract(windows)
        return self.schema.decode(self.schema.bounded(X, self.regressor.predict(X)), scale)


def sha256(data: bytes) -> str:
    """SHA-256 of a file's bytes, in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def write_model(folder: Path, data: bytes, card: Mapping[str, Any]) -> tuple[Path, Path]:
    """Write the two files of a model; both are complete before either gets its name.

    Args:
        folder: Output folder, which is made if needed.
        data: Bytes of the numbers, as from `Forest.save`.
        card: At least the CARD_FIELDS without ``sha256``, which is added here.

    Returns:
        Path of the numbers, for the tuner's parameter ``model``, and path of the card.

    Raises:
        ModelError: The card is incomplete or does not fit the numbers.
        OSError: The files cannot be written.
    """
    card = {**card, "sha256": sha256(data)}
    description = folder / f"{card.get('name')}.json"
    _check_card(card, description)
    if Path(card["name"]).name != card["name"]:
        raise ModelError(f"the model's name must be a valid file name, got {shown(card['name'])}")
    numbers = folder / f"{card['name']}{KINDS[card['kind']].suffix}"
    _assembled(card, description, data, numbers)
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(card, indent=2) + "\n"
    with tempfile.TemporaryDirectory(dir=folder, prefix=".model-") as temporary:
        for target, content in (numbers, data), (description, text.encode()):
            write(Path(temporary) / target.name, content)
        for target in numbers, description:
            os.replace(Path(temporary) / target.name, target)
    return numbers, description


def shipped_cards() -> list[Mapping[str, Any]]:
    """The cards of the shipped models, by name.

    Raises:
        ModelError: A card cannot be used.
    """
    return [_card(file) for file in _shipped_files()]


def _shipped_files() -> list[Path]:
    """The cards' files of the shipped models, by name."""
    return sorted(_SHIPPED.glob("*.json"))


def load_model(name_or_path: str) -> Model:
    """Load a shipped model by its name, or any model by the path of its file.

    A path has a separator or ends in the suffix of a kind of model, such as ``.npz``.

    Raises:
        UnknownModelError: There is no such model; the message names the shipped ones.
        ModelError: A file is missing or altered, or the card does not fit. The message names the
            file and the expected SHA-256.
    """
    named = Path(name_or_path)
    is_path = "/" in name_or_path or named.suffix in {kind.suffix for kind in KINDS.values()}
    card_file = named.with_suffix(".json") if is_path else _SHIPPED / f"{name_or_path}.json"
    if not any(os.path.lexists(file) for file in (card_file, named)[: 1 + is_path]):
        names = ", ".join(file.stem for file in _shipped_files())
        raise UnknownModelError(
            f"there is no model {shown(name_or_path)}: shipped are {names}; one of your own is "
            "named by the path of its file"
        )
    card = _card(card_file)
    kind = KINDS[card["kind"]]
    file = named if is_path else card_file.with_suffix(kind.suffix)
    expected = f"{card_file} expects SHA-256 {card['sha256']}"
    try:
        data = read(file, kind.max_bytes)
    except OSError as error:
        kind_of_error = UnknownModelError if isinstance(error, FileNotFoundError) else ModelError
        reason = error.strerror or error
        raise kind_of_error(f"cannot read the model {file}: {reason}; {expected}") from error
    return _assembled(card, card_file, data, file)


def _assembled(card: Mapping[str, Any], card_file: Path, data: bytes, file: Path) -> Model:
    """The model of a card and its numbers, after all checks."""
    expected = f"{card_file} expects SHA-256 {card['sha256']}"
    if sha256(data) != card["sha256"]:
        raise ModelError(f"the model {file} was altered: its SHA-256 is {sha256(data)}; {expected}")
    try:
        regressor = KINDS[card["kind"]].load(data)
    except ValueError as error:
        raise ModelError(f"the model {file} is not usable: {error}; {expected}") from error
    schema = _schema(card, card_file)
    width = schema.width(card["window"])
    if regressor.n_features != width:
        raise ModelError(
            f"the model {file} has {regressor.n_features} features, its schema "
            f"{card['feature_schema']!r} has {width}; {expected}"
        )
    return Model(file, card, card["window"], schema, regressor)


def _card(file: Path) -> dict[str, Any]:
    try:
        card = read_json(file, MAX_CARD_BYTES)
    except ValueError as error:
        raise ModelError(f"cannot read the model's card: {error}") from error
    _check_card(card, file)
    return card


def _check_card(card: Mapping[str, Any], file: Path) -> None:
    for name, kind in CARD_FIELDS.items():
        if type(card.get(name)) is not kind:
            raise ModelError(
                f"the model's card {file}: {name} must be of type {kind.__name__}, "
                f"got {shown(card.get(name))}"
            )
    if card["kind"] not in KINDS:
        raise ModelError(
            f"the model's card {file}: kind {shown(card['kind'])} is unknown; known are "
            f"{', '.join(KINDS)}"
        )


def _schema(card: Mapping[str, Any], file: Path) -> Schema:
    schema = SCHEMAS.get(card["feature_schema"])
    if schema is None:
        raise ModelError(
            f"the model's card {file}: feature_schema {shown(card['feature_schema'])} is unknown; "
            f"known are {', '.join(SCHEMAS)}"
        )
    if tuple(card["features"]) != schema.names:
        raise ModelError(
            f"the model's card {file}: its features are not those of the schema "
            f"{card['feature_schema']!r} in this version"
        )
    most = schema.history or MAX_WINDOW
    if not schema.min_samples <= card["window"] <= most:
        raise ModelError(
            f"the model's card {file}: window must be >= {schema.min_samples} and <= {most}, "
            f"got {shown(card['window'])}"
        )
    return schema
