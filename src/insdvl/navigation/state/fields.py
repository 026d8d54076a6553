"""What a field of the state record may hold, and the sizes that fields share."""

from dataclasses import dataclass
from typing import Any, TypeAlias

# A record's fields are attributes in kernels and keys in Python, which no static type expresses.
#: A state record, see layout.py.
State: TypeAlias = Any

#: Stamp of something that has not happened.
NEVER = -(2**62)
#: A stamp after all others.
FOREVER = 2**62

#: Error states that every filter has, see error_state.py.
CORE = 15
#: Their number rounded up to whole registers of four; no matrix of error states has shorter rows.
PADDED = 16
#: Most rows of one measurement.
MAX_ROWS = 4
#: Most innovations that the adaptive process noise averages.
MAX_WINDOW = 50
#: Readings of each kind of measurement that are remembered, to tell a repeated one.
READINGS = 8

# What a field holds, for the empty record and for the check of a stored one.
STAMP = "stamp"  # nanoseconds, NEVER at first
COUNT = "count"  # an integer, 0 at first
NUMBER = "number"  # finite, 0 at first
UNKNOWN = "unknown"  # finite once it is known, nan at first
COVARIANCE = "covariance"  # symmetric, positive semidefinite, 0 at first


@dataclass(frozen=True)
class Field:
    """One field of the record: its name, what it holds, its shape and the meaning."""

    name: str
    holds: str
    shape: tuple[int, ...] = ()

    @property
    def dtype(self) -> tuple[str, str, tuple[int, ...]]:
        """As numpy wants it."""
        return self.name, "i8" if self.holds in (STAMP, COUNT) else "f8", self.shape
