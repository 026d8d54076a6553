"""The page docs/reliability.md, generated from the numbers of its parts.

Sentences here say what was done; every number and every verdict comes from the documents.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from insdvl.files import read_parts
from insdvl.studies.faults.verdicts import (
    LATENCY_FACTOR,
    LATENCY_RISE,
    MEMORY_GROWTH,
    ROUNDING,
    STOLEN,
    WORST,
    Verdict,
    lost,
    verdicts,
    worst,
)
from insdvl.studies.report.markdown import number

Documents = Mapping[str, Any]

#: Parts of the page, each a JSON file beside it.
MESSAGES, PROCESSES, SOAK = "messages", "processes", "soak"
PARTS = (MESSAGES, PROCESSES, SOAK)


def documents(folder: Path) -> dict[str, Any]:
    """The parts of a folder that have been computed, now or before.

    Raises:
        ValueError: A file cannot be read, is damaged or lacks a number; the message names it.
    """
    return read_parts(folder, PARTS, markdown)


def markdown(parts: Documents) -> str:
    """The page; a part whose numbers are missing is named as such."""
    sections = [_INTRODUCTION.format(verdict=_verdict(parts)), _messages(parts)]
    sections += [_processes(parts), _soak(parts)]
    return "\n".join(section.strip() + "\n" for section in sections)


_INTRODUCTION = """
# Reliability

Faults of messages, clocks, processes and networks: what is expected of the filter, and what was
measured. Two commands measure it and write this page:

```
make faults                        # the fault matrix: about half an hour on two cores
make soak                          # one more hour of mission; ARGS="--hours 2" for two
make soak ARGS="--hours 0 --core-hours 10 --steps 10"   # the core alone
```

The numbers are in [reliability/](reliability/). {verdict}

The commands check every expectation; a row is met if all of its expectations are. In addition, with
each fault of messages, time or network the output must be finite, the covariance of the error state
symmetric and positive definite, the published stamps must increase, and no valid message may be
lost: each valid IMU sample is in the output with its stamp, and each valid DVL measurement was
judged. For processes the output is checked in the same way where a row has errors: it must be
finite, with positive variances of the velocity, increasing stamps and no lost sample. The reasons
are explained in [diagnostics.md](reference/diagnostics.md), the behaviour of the filter in
[filter.md](explanation/filter.md).
"""


def _verdict(parts: Documents) -> str:
    rows = [row for part in (MESSAGES, PROCESSES) for row in parts.get(part, {"rows": []})["rows"]]
    met = sum(row["met"] for row in rows)
    lost = sum(row["lost"] for row in rows)
    return f"**{met} of {len(rows)} rows are met; valid messages lost: {lost}.**"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def _cells(row: Mapping[str, Any]) -> list[str]:
    """Fault, expected, seen, errors, recovery, messages lost, met.

    What must hold under every fault is shown where it does not.
    """
    checks = [check for check in row["checks"] if not (check.get("always") and check["met"])]
    recovery = "–" if row["recovery"] is None else f"{row['recovery']:.1f}"
    return [
        row["fault"],
        "; ".join(check["expected"] for check in checks),
        "; ".join(check["seen"] if check["met"] else f"**{check['seen']}**" for check in checks),
        _error(row, "error_during"),
        _error(row, "error_after"),
        recovery,
        str(row["lost"]),
        "yes" if row["met"] else "**no**",
    ]


def _error(row: Mapping[str, Any], name: str) -> str:
    calm = row.get(f"{name}_calm")
    text = number(row[name], 3)
    return text if calm is None else f"{text} ({number(calm, 3)})"


_HEAD = (
    "fault",
    "expected",
    "seen",
    "error during [m/s]",
    "error after [m/s]",
    "recovery [s]",
    "lost",
    "met",
)


def _groups(rows: Sequence[Mapping[str, Any]]) -> str:
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault(row["group"], []).append(row)
    return "\n".join(
        f"### {group}\n\n{_table(_HEAD, [_cells(row) for row in members])}"
        for group, members in groups.items()
    )


_MESSAGES = """
## Messages and time

A simulated AUV with an IMU at 100 Hz and a DVL at 1 Hz. A fault changes the messages, and the
filter takes the changed messages one after the other, as its node does. The noise is that of the
scenario `constant` (0.1 m/s² and 0.03 rad/s per sample) or, for a *good* IMU, that of
`constant-tableI` (0.01 m/s², 0.001 rad/s). Rows that depend on the noise are flown with three
seeds; the same seeds give the same bits.

Errors are the RMS of the body velocity vector over all seeds: *during* the fault (if it is an
instant: over the 5 s after it) and *after* it (10 to 40 s after its end); in brackets the error of
the same flight without the fault over the same time. *Recovery* is the time from the end of the
fault until the velocity stays within 0.05 m/s of that flight, for the slowest seed.
"""


def _messages(parts: Documents) -> str:
    if MESSAGES not in parts:
        return f"{_MESSAGES}\nNot computed: {MESSAGES}."
    return f"{_MESSAGES.strip()}\n\n{_groups(parts[MESSAGES]['rows'])}"


_PROCESSES = """
## Processes and network

Real processes: simulator, relay, tuner and filter, at {rate_factor:g} times real time. Errors are
relative to the simulator's truth, *during* and *after* the fault as each row says. *Recovery* is
the mission time from the end of the fault until the error stays below 0.5 m/s. These numbers depend
on when a signal arrives, and differ slightly between runs.
"""


def _processes(parts: Documents) -> str:
    document = parts.get(PROCESSES)
    head = _PROCESSES.format(rate_factor=document["rate_factor"] if document else float("nan"))
    if document is None:
        return f"## Processes and network\n\nNot computed: {PROCESSES}."
    return f"{head.strip()}\n\n{_groups(document['rows'])}"


_SOAK = f"""
## Soak

A level circle for hours: simulator, tuner and filter as processes, the filter with the tuner's
process noise, and a witness that counts what is published. Filter and tuner run for one call of the
command; the simulator flies legs of an hour. A search finds the highest speed at which nothing is
lost, the mission keeps its pace and no queue grows. If an hour at that speed loses a message, the
speed has failed and the next hour is a step slower. If the host of a virtual machine took more than
{100.0 * STOLEN:g} % of the processors during that hour, it is flown again instead.
"""


_SEARCH = (
    "times real time",
    "mission [s]",
    "speed held",
    "messages lost",
    "latency at the end, median [ms]",
    "taken by the host [%]",
)


def _soak(parts: Documents) -> str:
    document = parts.get(SOAK)
    if document is None:
        return f"{_SOAK}\nNot computed: {SOAK}."
    sections = [_SOAK.strip(), _judged(verdicts(document))]
    if document["search"]:
        rows = [
            [
                f"{t['rate_factor']:g}",
                f"{t['mission']:.0f}",
                f"{100.0 * t['held']:.0f} %",
                str(t["lost"]),
                number(t["latency"], 3),
                f"{100.0 * t['stolen']:.1f}" if "stolen" in t else "not recorded",
            ]
            for t in document["search"]
        ]
        sections.append(_table(_SEARCH, rows))
    if document["legs"]:
        sections += [_summary(document["legs"]), _legs(document["legs"])]
    if document["core"]:
        sections += [_CORE.strip(), _core(document["core"])]
    if document["steps"]:
        sections += [_STEPS.strip(), _steps(document["steps"])]
    return "\n\n".join(section.strip() for section in sections)


_VERDICTS = f"""
The command fails if one of these does not hold. Memory and latency are compared between the end of
a filter's first hour, when it has allocated what it needs, and the end of its last hour; they are
not judged if less than an hour lies between. Memory may grow by {MEMORY_GROWTH:.1f} MB per hour of
mission, a gigabyte in a month: a computer at sea can spare that, and no filter runs longer between
two starts. Latency is the median of the last sixth of a leg. It may become {LATENCY_FACTOR:g} times
as large, since it depends on the load of the machine, or rise by {LATENCY_RISE:g} ms, an interval
of the IMU; a queue or a record that grows without bound exceeds both. Each of 10^7 steps may round
by 2^-52, in the worst case all in the same direction, which gives {ROUNDING:.1e}: a larger error is
not rounding.
"""


def _judged(judged: Sequence[Verdict]) -> str:
    words = {True: "yes", False: "**no**", None: "not judged"}
    rows = [(verdict.expected, verdict.seen, words[verdict.holds]) for verdict in judged]
    holding, failing = (sum(v.holds is holds for v in judged) for holds in (True, False))
    return (
        f"**Of {len(judged)} expectations {holding} hold, {failing} do not, and "
        f"{len(judged) - holding - failing} cannot be judged.**\n{_VERDICTS}\n"
        + _table(("expected", "seen", "holds"), rows)
    )


def _summary(legs: Sequence[Mapping[str, Any]]) -> str:
    hours = sum(leg["mission"] for leg in legs) / 3600.0
    wall = sum(leg["wall"] for leg in legs) / 3600.0
    messages = sum(row["sent"] for leg in legs for row in leg["messages"])
    missing = sum(lost(leg) for leg in legs)
    return (
        f"**{hours:.4g} mission hours in {wall:.1f} h of wall time: {messages} messages counted, "
        f"{missing} lost.** A negative slope is memory that was freed."
    )


def _memory(leg: Mapping[str, Any], name: str) -> str:
    if leg["memory"] is None:
        return "–"
    return f"{leg['memory'][name]['end']:.1f} ({leg['memory'][name]['slope']:+.2f})"


def _legs(legs: Sequence[Mapping[str, Any]]) -> str:
    head = (
        "hour",
        "speed",
        "filter lives for [legs]",
        "lost",
        "filter [MB], end (slope per hour)",
        "tuner [MB], end (slope per hour)",
        "latency p50 / p99 [ms], first sixth",
        "last sixth",
        "NIS",
        "velocity RMSE [m/s]",
    )
    rows = []
    for leg in legs:
        first, last = leg["latency"][0], leg["latency"][-1]
        rows.append(
            [
                str(leg["leg"] + 1),
                f"{leg['rate_factor'] * leg['held']:.1f}",
                str(leg["legs_of_filter"]),
                str(lost(leg)),
                *(_memory(leg, name) for name in ("filter", "tuner")),
                *(f"{number(part['p50'], 3)} / {number(part['p99'], 3)}" for part in (first, last)),
                number(leg["nis"], 3),
                number(leg["body_velocity_rmse"], 3),
            ]
        )
    return _table(head, rows)


_CORE = """
### The core alone

The same mission, message by message through `Feed` and `Tuner` in one process; the seconds do not
include making the messages. After every DVL update: the largest asymmetry and the smallest
eigenvalue of the correlation matrix of P, and the largest element of $|C^T C - I|$. The memory is
that of the whole process, which also simulates the mission: an hour of it takes about 200 MB, part
of which is not yet freed. The memory of filter and tuner is in the table of processes.
"""

_HEALTH = tuple(name.replace("_", " ") for name in WORST)

_STEPS = """
### Millions of steps

A quick turn that repeats the same thousand samples, with an update after each thousand; the worst
of all updates so far.
"""


def _steps(filters: Mapping[str, Sequence[Mapping[str, float | None]]]) -> str:
    rows = [
        [name, f"{millions} million", *_health(worst(health[:millions]))]
        for name, health in filters.items()
        for millions in sorted({1, len(health)})
    ]
    return _table(("filter", "steps", *_HEALTH), rows)


def _health(health: Mapping[str, float | None]) -> list[str]:
    values = [health[name] for name in WORST]
    return ["not finite" if value is None else f"{value:.1e}" for value in values]


def _core(hours: Sequence[Mapping[str, Any]]) -> str:
    head = (
        "hour",
        "samples",
        "odometry",
        "seconds",
        "memory [MB]",
        "NIS",
        "velocity RMSE [m/s]",
        *_HEALTH,
    )
    rows = [
        [
            str(hour["hour"] + 1),
            str(hour["samples"]),
            str(hour["outputs"]),
            f"{hour['seconds']:.1f}",
            f"{hour['memory']:.1f}",
            number(hour["nis"], 3),
            number(hour["body_velocity_rmse"], 3),
            *_health(hour["health"]),
        ]
        for hour in hours
    ]
    return _table(head, rows)
