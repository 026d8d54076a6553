"""What was run: versions, the parameters that differ from the default, and the model."""

import platform
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import flatten
from insdvl.tuner.models import ModelError, load_model
from insdvl.tuner.parameters import TunerParameters

_PACKAGES = ("insdvl", "numpy", "numba", "scipy", "rosbags")
#: Of a model's card, what tells one model from another.
_CARD = ("name", "kind", "feature_schema", "window", "target", "sha256")


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that decide the numbers."""
    found = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:  # run from a source folder
            continue
    return found


def changed_parameters(*groups: FilterParameters | TunerParameters) -> dict[str, list[Any]]:
    """Parameters that differ from their default: name to value and default."""
    changed: dict[str, list[Any]] = {}
    for group in groups:
        default = flatten(type(group)())
        changed |= {
            name: [value, default[name]]
            for name, value in flatten(group).items()
            if value != default[name]
        }
    return changed


def card_of(parameters: TunerParameters) -> dict[str, Any] | None:
    """The card of the tuner's model, as far as it tells one model from another.

    None where there is none: an estimator of your own has no card.
    """
    if parameters.estimator:
        return None
    try:
        card = load_model(parameters.model).card
    except ModelError:
        return None
    return {name: card[name] for name in _CARD if name in card}
