"""An expectation of a row of the fault matrix, as a check that a machine can make."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

Seen = TypeVar("Seen")


@dataclass(frozen=True)
class Check(Generic[Seen]):
    """An expectation.

    Attributes:
        text: In words.
        judge: From what was flown: what is seen, in words, and whether it is as expected.
    """

    text: str
    judge: Callable[[Seen], tuple[str, bool]]

    def document(self, flown: Seen) -> dict[str, Any]:
        """The check with what is seen, as JSON takes it."""
        seen, met = self.judge(flown)
        return {"expected": self.text, "seen": seen, "met": bool(met)}
