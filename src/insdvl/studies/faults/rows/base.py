"""What the rows of messages and time have in common: the flight of a row, and usual values."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

from insdvl.studies.faults.changes import Change
from insdvl.studies.faults.checks import AFTER, SETTLE, Pairs
from insdvl.studies.faults.row import Row
from insdvl.studies.faults.stream import Sensors

#: When most faults begin and end, from the start of the mission [s].
BEGIN, END = 80.0, 110.0
SEEDS = (1, 2, 3)
ONE_SEED = (1,)  # where nothing depends on the noise

NOISY = Sensors()
_NOTHING: Mapping[str, Any] = MappingProxyType({})

#: Parameters with which a filter starts under way: it finds roll and pitch from a second of
#: specific force, and the velocity from the DVL. After a time jump it knows no more.
LEVELLING: Mapping[str, Any] = MappingProxyType(
    {
        "initial.mode": "levelling",
        "initial.velocity_std": 1.5,
        "initial.tilt_std": 0.05,
        "initial.heading_std": 1.5,
    }
)


@dataclass(frozen=True)
class FlightRow(Row[Change, Pairs]):
    """A fault of messages or time, flown through the core.

    Attributes:
        begin: Beginning of the fault, from the start of the mission [s].
        end: Its end [s].
        parameters: Parameters of the filter, on top of those that fit the mission.
        sensors: What navigates.
        calm: Sensors of the flight without the fault, where they differ.
        seeds: Random seeds, one flight each.
    """

    begin: float = BEGIN
    end: float = END
    parameters: Mapping[str, Any] = field(default_factory=lambda: _NOTHING)
    sensors: Sensors = NOISY
    calm: Sensors | None = None
    seeds: tuple[int, ...] = SEEDS

    @property
    def duration(self) -> float:
        """Duration of the mission [s]; most rows have the same, to share calm flights."""
        end = self.end if self.sensors.rate > 500.0 else max(self.end, END)
        return end + SETTLE + AFTER + 1.0

    def with_seeds(self, seeds: tuple[int, ...]) -> "FlightRow":
        """The same row with other seeds."""
        return replace(self, seeds=seeds)
