"""The cause `unexpected errors`: what a callback raised and nobody expected."""

import traceback
from collections import Counter

from ros_insdvl.status.diagnostics import ERROR, RECENT, Status, View

#: Event under which they are counted.
UNEXPECTED = "unexpected errors"


class UnexpectedErrors:
    """Counts errors by their kind and place."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()

    @property
    def total(self) -> int:
        """Number of all of them."""
        return self._counts.total()

    def count(self, error: Exception) -> bool:
        """Count an error; whether it is the first of its kind and place."""
        place = traceback.extract_tb(error.__traceback__)[-1]
        key = f"{type(error).__name__} at {place.name}, line {place.lineno}"
        self._counts[key] += 1
        return self._counts[key] == 1

    def status(self, view: View) -> Status:
        """The status of the errors."""
        status = Status(UNEXPECTED, "none")
        status.values.update(self._counts)
        if count := view.events.recent[UNEXPECTED]:
            status.complain(
                ERROR,
                "errors",
                f"{count} unexpected errors in the last {RECENT:.0f} s: this is a bug, please "
                "report it with the node's log; if they continue, restart the node",
            )
        return status
