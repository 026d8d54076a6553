"""The filter's whole memory as one nested record, so that a snapshot is a copy of it.

A record is a numpy structured scalar. Its fields are named in Python (``s["nav"]["v_n"]``) and in
the kernels (``s.nav.v_n``) alike, and it passes between the two without conversion. Everything that
the future depends on is in it.

Every field is declared once, with what it may hold: the empty record, the counters of diagnostics
and the check of a state file follow from the declaration. The record has room for every
measurement's gate and for every block of optional error states, whatever is configured, so no
compiled type depends on the configuration.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from insdvl.arrays import Records, copied
from insdvl.navigation.state.fields import CORE, NEVER, PADDED, STAMP, UNKNOWN, Field, State
from insdvl.navigation.state.groups import (
    CHANNELS,
    COUNTERS,
    GATE,
    GATE_COUNTERS,
    ODOM,
    START,
    nav,
    noise,
)


@dataclass(frozen=True)
class Layout:
    """Which groups and fields a state record has.

    Attributes:
        groups: Fields of each group, by its name.
        gates: Fields of the gate, the same for each measurement in ``measurements``.
        measurements: Names of all kinds of measurements.
        size: Most error states n that can be in use.
    """

    groups: dict[str, tuple[Field, ...]]
    gates: tuple[Field, ...]
    measurements: tuple[str, ...]
    size: int

    def fields(self) -> Iterator[tuple[tuple[str, ...], Field]]:
        """Path (group, or ``gate`` and measurement) and declaration of each field."""
        for group, fields in self.groups.items():
            for field in fields:
                yield (group,), field
        for name in self.measurements:
            for field in self.gates:
                yield ("gate", name), field

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """Type of the record.

        It is one object: a call of a kernel would compare another field by field.
        """
        groups = [(name, _type(fields)) for name, fields in self.groups.items()]
        gates = [(name, _type(self.gates)) for name in self.measurements]
        return np.dtype([*groups, ("gate", np.dtype(gates, align=True))], align=True)

    def empty(self) -> Records:
        """One record, in an array of length 1, of a filter to which nothing has happened."""
        return copied(self._empty)

    @cached_property
    def _empty(self) -> Records:
        states = np.zeros(1, self.dtype)
        for path, field in self.fields():
            group = part(states[0], path)
            if field.holds == STAMP:
                group[field.name] = NEVER
            elif field.holds == UNKNOWN:
                group[field.name] = np.nan
        return states


def _type(fields: Sequence[Field]) -> np.dtype[np.void]:
    return np.dtype([field.dtype for field in fields], align=True)


def part(s: State, path: Sequence[str]) -> State:
    """The group of a record at a path of names."""
    for name in path:
        s = s[name]
    return s


def counters(s: State) -> dict[str, tuple[State, str]]:
    """Group and field of each counter in a record, by its name in diagnostics.

    Those of a gate have the name of its measurement before them: ``dvl inflations``.
    """
    found = {field.name: (s["counters"], field.name) for field in COUNTERS}
    for measurement in s["gate"].dtype.names:
        for name in GATE_COUNTERS:
            found[gate_counter(measurement, name)] = s["gate"][measurement], name
    return found


def gate_counter(measurement: str, name: str) -> str:
    """Name in diagnostics of a counter of a measurement's gate."""
    return f"{measurement} {name}"


def layout(
    measurements: Sequence[str], optional: int, groups: Mapping[str, tuple[Field, ...]]
) -> Layout:
    """Layout of the state record.

    Args:
        measurements: Names of all kinds of measurements.
        optional: Number of error states in all optional blocks together.
        groups: Further groups of fields, which stand beside their users.
    """
    n = max(CORE + optional, PADDED)
    every = {
        "nav": nav(n),
        "noise": noise(n),
        "channels": CHANNELS,
        "start": START,
        "odom": ODOM,
        "counters": COUNTERS,
        **groups,
    }
    return Layout(every, GATE, tuple(measurements), n)
