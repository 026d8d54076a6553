"""Settings: the parameters that may change while the filter runs, as an event at a stamp."""

import json
from dataclasses import dataclass

from insdvl.navigation.events import Event, Limits
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import Declaration, declarations, flatten

#: Declarations of the parameters that may change, by their names.
SETTINGS: dict[str, Declaration] = {
    declaration.name: declaration
    for declaration in declarations(FilterParameters)
    if declaration.changeable
}


@dataclass(frozen=True, slots=True)
class Settings(Event):
    """The settings that are in force from the stamp on.

    Attributes:
        parameters: All parameters; they differ from those of the filter in settings only.
        number: How many changes were made before. Of one stamp the last one counts.
    """

    parameters: FilterParameters
    number: int = 0

    kind = 3

    def payload(self) -> bytes:
        """The number, so that the last comes first, and the settings."""
        values = flatten(self.parameters)
        text = json.dumps([values[name] for name in SETTINGS])
        return (2**63 - self.number).to_bytes(8, "big") + text.encode()

    def limits(self) -> Limits:
        """None: the parameters have been checked."""
        return ()


def differences(
    before: FilterParameters, after: FilterParameters
) -> dict[str, tuple[object, object]]:
    """The settings that differ between two sets of parameters: name, value before and after."""
    old, new = flatten(before), flatten(after)
    return {name: (old[name], new[name]) for name in SETTINGS if old[name] != new[name]}
