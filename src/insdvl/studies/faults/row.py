"""A row of the fault matrix: what happens, and what is expected, as a machine can check it.

Faults of messages (rows/) and faults of processes (ros_insdvl_sim) are told in this one form. They
differ in how a fault is made, and in the evidence that its checks look at.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

Fault = TypeVar("Fault")
Evidence = TypeVar("Evidence")


@dataclass(frozen=True)
class Check(Generic[Evidence]):
    """An expectation.

    Attributes:
        text: In words.
        judge: What is seen, in words, and whether it is as expected.
    """

    text: str
    judge: Callable[[Evidence], tuple[str, bool]]


@dataclass(frozen=True)
class Row(Generic[Fault, Evidence]):
    """A fault and what is expected.

    Attributes:
        subject: What the fault happens to; the rows of a subject are a table of the page.
        name: What happens, in words.
        fault: Makes it happen.
        checks: What is expected, beside what always is.
    """

    subject: str
    name: str
    fault: Fault
    checks: tuple[Check[Evidence], ...]

    def judged(
        self, evidence: Evidence, always: Iterable[Check[Evidence]] = ()
    ) -> list[dict[str, Any]]:
        """Each expectation and what is seen, as JSON takes it.

        Args:
            evidence: Of the row.
            always: What is expected of every row; marked as such.
        """
        own = [_judged(check, evidence) for check in self.checks]
        return own + [_judged(check, evidence) | {"always": True} for check in always]


def _judged(check: Check[Evidence], evidence: Evidence) -> dict[str, Any]:
    seen, met = check.judge(evidence)
    return {"expected": check.text, "seen": seen, "met": met}
