"""An inspection as text of 80 columns, under the questions of an engineer, and as numbers."""

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from insdvl.files import finite
from insdvl.studies.check.findings import QUESTIONS, Finding, is_usable, settings_of
from insdvl.studies.check.inspection import Inspection
from insdvl.studies.report.parameter_page import yaml_value

WIDTH = 80
_NAME, _TYPE = 24, 26  # of a topic; a longer name has a line of its own


def text_of(name: str, seen: Inspection, found: Sequence[Finding]) -> str:
    """The report."""
    settings = settings_of(found)
    size = sum(topic.size for topic in seen.topics.values())
    lines = [f"{name}: {_clock(seen.span)}, {len(seen.topics)} topics, {size} messages", ""]
    lines += ["What is in it?", *_table(seen)]
    for question in QUESTIONS:
        of_question = [finding for finding in found if finding.question == question]
        if of_question:
            lines += ["", question]
        for finding in of_question:
            mark = "!" if finding.wrong else " "
            lines += wrapped(finding.text, f"  {mark} ", "    ")
    lines += ["", "What is to be set?"]
    if not settings:
        lines.append("    Nothing, as far as the recording tells.")
    for node, values in settings.items():
        lines += [f"    /**/{node}:", "      ros__parameters:"]
        lines += [f"        {key}: {yaml_value(value)}" for key, value in values.items()]
    lines += ["", "Is it usable?"]
    fatal = [finding.text.removeprefix("No: ") for finding in found if finding.fatal]
    if fatal:
        for text in fatal:
            lines += wrapped(f"No: {text}", "    ", "    ")
    else:
        lines.append("    Yes." if not settings else "    Yes, with what is to be set.")
    return "\n".join(lines)


def wrapped(text: str, first: str, others: str) -> list[str]:
    """A sentence in lines of 80 columns."""
    return textwrap.wrap(
        text,
        WIDTH,
        initial_indent=first,
        subsequent_indent=others,
        break_long_words=False,
        break_on_hyphens=False,
    )


def _table(seen: Inspection) -> Iterable[str]:
    """The topics: name, type, number of messages, rate, use."""
    uses = seen.sensors.uses
    yield f"    {'topic':{_NAME}} {'type':{_TYPE}} {'count':>8} {'Hz':>6}  use"
    for name, topic in sorted(seen.topics.items()):
        stamps = seen.stamps.get(name)
        rate = stamps.rate if stamps is not None else None
        if rate is None and seen.span:
            rate = topic.size / seen.span
        use = uses.get(name, "")
        if len(name) > _NAME:
            yield f"    {name}"
            name = ""
        kind, shown = topic.type.rpartition("/")[2], f"{rate:.4g}" if rate else ""
        yield f"    {name:{_NAME}} {kind:{_TYPE}} {topic.size:8} {shown:>6}  {use}".rstrip()


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes else f"{seconds:.1f} s"


def document_of(bag: str, seen: Inspection, found: Sequence[Finding]) -> dict[str, Any]:
    """The numbers of the command's JSON."""
    return {
        "bag": bag,
        "usable": is_usable(found),
        "duration": seen.span,
        "topics": {
            name: {
                "type": topic.type,
                "count": topic.size,
                "use": seen.sensors.uses.get(name),
                "stamps": asdict(seen.stamps[name]) if name in seen.stamps else None,
            }
            for name, topic in seen.topics.items()
        },
        "imu": _numbers(seen.imu),
        "gyroscope_bias": _numbers(seen.gyroscope_bias),
        "dvl": _numbers(seen.dvl),
        "orientation": _numbers(seen.orientation),
        "windows": seen.windows,
        "findings": [
            {
                "question": finding.question,
                "text": finding.text,
                "wrong": finding.wrong,
                "fatal": finding.fatal,
            }
            for finding in found
        ],
        "set": settings_of(found),
    }


def _numbers(facts: Any) -> Any:
    return None if facts is None else _plain(asdict(facts))


def _plain(value: Any) -> Any:
    """A value as JSON has it."""
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return finite(value)
