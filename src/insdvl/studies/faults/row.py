"""A row of the fault matrix: what happens, and what is expected.

Faults of messages (rows/) and faults of processes (ros_insdvl_sim) are declared in this one form.
They differ in how a change is made, and in what their checks look at.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from insdvl.studies.faults.expectation import Check, Seen

Change = TypeVar("Change")


@dataclass(frozen=True)
class Row(Generic[Change, Seen]):
    """A fault and what is expected.

    Attributes:
        group: What the fault concerns; the rows of a group are a table of the page.
        name: What happens, in words.
        change: Makes it happen.
        checks: What is expected, beside what always is.
    """

    group: str
    name: str
    change: Change
    checks: tuple[Check[Seen], ...]

    def judged_checks(
        self, flown: Seen, always: Iterable[Check[Seen]] = ()
    ) -> list[dict[str, Any]]:
        """Each expectation and what is seen, as JSON takes it.

        Args:
            flown: What the checks look at.
            always: What is expected of every row; marked as such.
        """
        own = [check.document(flown) for check in self.checks]
        return own + [check.document(flown) | {"always": True} for check in always]
