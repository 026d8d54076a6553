"""Parameters of a filter that is told its start: the published P_0, at the first sample."""

from typing import Any

from insdvl.parameters.declaration import flatten
from insdvl.simulation.initial_errors import P_0

TOLD: dict[str, Any] = flatten(P_0, "initial.")
