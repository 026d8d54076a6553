"""What does not fit, and what to set."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """Something that does not fit.

    Attributes:
        name: Short, for programs.
        text: What does not fit.
        remedy: What to set, and to what.
        cautious: Whether the filter only expects larger errors than it has.
    """

    name: str
    text: str
    remedy: str
    cautious: bool = False

    @property
    def sentence(self) -> str:
        """Both in one line."""
        return f"{self.text}: {self.remedy}" if self.remedy else self.text
