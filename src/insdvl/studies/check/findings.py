"""What is said of a recording: sentences under the questions of an engineer, and what to set.

A recording is usable when nothing is wrong with it that only its driver can mend.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

FILTER, REPLAY = "insdvl_filter", "insdvl_replay"
NEEDED, STAMPS, AXES, START, HEADING, SAMPLES, PINGS, FIT = (
    "Is there what the filter needs?",
    "Are the stamps right?",
    "Which way do the axes point?",
    "Does it move at the start?",
    "Where does the heading come from?",
    "Are the samples of the IMU good?",
    "Are the velocities of the DVL good?",
    "Do IMU and DVL fit each other?",
)
QUESTIONS = (NEEDED, STAMPS, AXES, START, HEADING, SAMPLES, PINGS, FIT)
#: Marks what a recording does not tell.
CHECK = "CHECK"
#: Share of a recording from which a fault makes it useless.
MOST = 0.5
NONE: Mapping[str, Mapping[str, Any]] = MappingProxyType({})


@dataclass(frozen=True)
class Finding:
    """A sentence under a question.

    Attributes:
        question: One of `QUESTIONS`.
        text: The sentence.
        wrong: Whether something is wrong or missing.
        fatal: Whether no parameter mends it.
        settings: Parameters to set, by node.
    """

    question: str
    text: str
    wrong: bool = False
    fatal: bool = False
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=lambda: NONE)


def fatal(question: str, text: str) -> Finding:
    """What no parameter mends."""
    return Finding(question, text, wrong=True, fatal=True)


def wrong(question: str, text: str, **values: Any) -> Finding:
    """What is wrong, with the parameters of the filter to set."""
    return Finding(question, text, wrong=True, settings={FILTER: values} if values else NONE)


def setting(question: str, text: str, settings: Mapping[str, Any], node: str = FILTER) -> Finding:
    """What parameters mend, those of a node."""
    return Finding(question, text, wrong=True, settings={node: settings})


def is_usable(found: Sequence[Finding]) -> bool:
    """Whether the filter can use the recording, with the settings."""
    return not any(finding.fatal for finding in found)


def settings_of(found: Sequence[Finding]) -> dict[str, dict[str, Any]]:
    """All that is to be set, by node; what is said last counts."""
    settings: dict[str, dict[str, Any]] = {}
    for finding in found:
        for node, values in finding.settings.items():
            settings.setdefault(node, {}).update(values)
    return settings


def right_angles(rpy: Sequence[float]) -> tuple[float, ...]:
    """The right angles that are nearest to roll, pitch, yaw [rad]: as most sensors are mounted."""
    return tuple(round(round(2.0 * x / math.pi) * math.pi / 2.0, 4) + 0.0 for x in rpy)
