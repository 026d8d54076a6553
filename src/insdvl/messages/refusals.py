"""Why a message is not used: the key under which refusals are counted."""

from typing import NamedTuple

#: Reason in a replay alone: the samples that a measurement waits for are not in the recording.
NO_SAMPLE = "no_sample"


class Refused(NamedTuple):
    """Topic and reason of messages that are not used.

    Attributes:
        topic: As the topic is named in the code.
        reason: One word, such as ``not_finite``; docs/reference/diagnostics.md has all of them.
    """

    topic: str
    reason: str

    def __str__(self) -> str:
        return f"{self.topic}: {self.reason}"
