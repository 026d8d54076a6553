"""State records, as tests look at them."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from insdvl.navigation.filter import LAYOUT
from insdvl.navigation.state.layout import part


def P15(s: Any) -> np.ndarray:  # noqa: N802
    """Covariance (..., 15, 15) of the states that every filter has."""
    return s["nav"]["P"][..., :15, :15]


def density(s: Any) -> np.ndarray:
    """Density (..., 15, 15) that the adaptive process noise has estimated."""
    root = s["noise"]["root"][..., :15, :]
    return root @ np.swapaxes(root, -1, -2)


def fields(s: Any) -> Iterator[tuple[str, np.ndarray]]:
    """Dotted name and value of every field."""
    for path, field in LAYOUT.fields():
        yield ".".join((*path, field.name)), part(s, path)[field.name]


def put(s: Any, name: str, value: Any) -> None:
    """Set a field by its dotted name; of P the states that every filter has."""
    *path, last = name.split(".")
    if name == "nav.P":
        s["nav"]["P"][..., :15, :15] = value
    else:
        part(s, path)[last] = value
