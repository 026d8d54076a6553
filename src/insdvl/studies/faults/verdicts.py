"""Limits for the numbers of the soak: one judgement for the page and for the exit code."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

HOUR = 3600.0  # s of mission
#: Growth of a process [MB per hour of mission]: a gigabyte in a month, which a computer at sea can
#: spare, and a month is longer than a filter runs between two starts.
MEMORY_GROWTH = 1000.0 / (30.0 * 24.0)
#: A queue or a record that grows without bound doubles the latency again and again, and exceeds
#: both: twice the latency, and an interval of the IMU more.
LATENCY_FACTOR, LATENCY_RISE = 2.0, 10.0  # -, ms
#: Error of numbers near 1: each of 10^7 steps rounds by 2^-52, all in the same direction.
ROUNDING = 1e7 * 2.0**-52

#: Share of the processors' time that the host of a virtual machine may take: above it a loss is
#: attributed to the host.
STOLEN = 0.05
#: Processes whose memory is judged.
PROCESSES = ("filter", "tuner")
#: Which of many values is the worst, for each number of `soak.Health`.
WORST: Mapping[str, Callable[[Sequence[float]], float]] = {
    "asymmetry": max,
    "smallest_eigenvalue": min,
    "orthonormality": max,
}


@dataclass(frozen=True)
class Verdict:
    """Whether an expectation holds.

    Attributes:
        expected: What is expected.
        seen: What was measured.
        holds: None where the numbers do not decide it.
    """

    expected: str
    seen: str
    holds: bool | None


@dataclass(frozen=True)
class _Span:
    """The time from the end of a filter's first hour to the end of its last leg.

    Attributes:
        first: The leg at whose end the filter has run for an hour of mission.
        last: Its last leg.
        hours: Hours of mission between the ends of both.
    """

    first: Mapping[str, Any]
    last: Mapping[str, Any]
    hours: float


def verdicts(document: Mapping[str, Any]) -> list[Verdict]:
    """All expectations of the soak."""
    legs = document["legs"]
    spans = [span for life in _lives(legs) if (span := _span(life)) is not None]
    return [
        _loss(legs),
        *(_memory(name, spans) for name in PROCESSES),
        _latency(spans),
        _core(document["core"]),
        _health(document),
    ]


def lost(leg: Mapping[str, Any]) -> int:
    """Messages of a leg that did not arrive."""
    return sum(abs(row["sent"] - row["received"]) for row in leg["messages"])


def worst(health: Sequence[Mapping[str, float | None]]) -> dict[str, float | None]:
    """The worst value of each number; None where one was not finite."""
    result: dict[str, float | None] = {}
    for name, worst_of in WORST.items():
        finite = [value for h in health if (value := h[name]) is not None]
        result[name] = worst_of(finite) if len(finite) == len(health) else None
    return result


def _lives(legs: Sequence[Mapping[str, Any]]) -> list[list[Mapping[str, Any]]]:
    """The legs of each filter: a call starts one, and again after a leg that was too fast."""
    lives: list[list[Mapping[str, Any]]] = []
    for leg in legs:
        if not lives or leg["legs_of_filter"] == 1:
            lives.append([])
        lives[-1].append(leg)
    return lives


def _span(life: Sequence[Mapping[str, Any]]) -> _Span | None:
    """What is compared in the life of a filter; None where it is less than an hour."""
    flown = list(accumulate(leg["mission"] for leg in life))
    first = next((k for k, seconds in enumerate(flown) if seconds >= HOUR), None)
    if first is None or flown[-1] - flown[first] < HOUR:
        return None
    return _Span(life[first], life[-1], (flown[-1] - flown[first]) / HOUR)


def _judged(expected: str, seen: Sequence[str], holds: Sequence[bool], missing: str) -> Verdict:
    """A verdict that holds if all of several do; without any it is not judged."""
    return Verdict(expected, "; ".join(seen) or missing, all(holds) if holds else None)


_NO_SPAN = "no filter has run for an hour after its first hour"


def _loss(legs: Sequence[Mapping[str, Any]]) -> Verdict:
    expected = "no message is lost"
    if not legs:
        return Verdict(expected, "no hour was flown", None)
    missing = sum(lost(leg) for leg in legs)
    sent = sum(row["sent"] for leg in legs for row in leg["messages"])
    return Verdict(expected, f"{missing} of {sent}", missing == 0)


def _memory(name: str, spans: Sequence[_Span]) -> Verdict:
    seen, holds = [], []
    for span in spans:
        before, after = span.first["memory"], span.last["memory"]
        if before is None or after is None:
            seen.append(f"nothing was published at the ends of {span.hours:g} h")
            holds.append(False)
        else:
            growth = (after[name]["end"] - before[name]["end"]) / span.hours
            seen.append(f"{growth:+.2f} MB per hour over {span.hours:g} h")
            holds.append(growth <= MEMORY_GROWTH)
    expected = f"memory of the {name} grows by at most {MEMORY_GROWTH:.1f} MB per hour"
    return _judged(expected, seen, holds, _NO_SPAN)


def _latency(spans: Sequence[_Span]) -> Verdict:
    seen, holds = [], []
    for span in spans:
        before, after = (leg["latency"][-1]["p50"] for leg in (span.first, span.last))
        if before is None or after is None:
            seen.append(f"nothing was published at the ends of {span.hours:g} h")
            holds.append(False)
        else:
            seen.append(f"{before:.1f} ms, then {after:.1f} ms over {span.hours:g} h")
            holds.append(after <= max(LATENCY_FACTOR * before, before + LATENCY_RISE))
    expected = (
        f"the median latency is at most {LATENCY_FACTOR:g} times what it was, "
        f"or {LATENCY_RISE:g} ms more"
    )
    return _judged(expected, seen, holds, _NO_SPAN)


def _core(hours: Sequence[Mapping[str, Any]]) -> Verdict:
    expected = "the core alone publishes an odometry for each sample"
    if not hours:
        return Verdict(expected, "no hour was flown", None)
    seen = f"{sum(hour['outputs'] for hour in hours)} of {sum(hour['samples'] for hour in hours)}"
    return Verdict(expected, seen, all(hour["outputs"] == hour["samples"] for hour in hours))


def _health(document: Mapping[str, Any]) -> Verdict:
    """The health of the core over its hours and over the millions of steps."""
    health = [hour["health"] for hour in document["core"]]
    health += [million for filter_ in document["steps"].values() for million in filter_]
    expected = (
        f"P is symmetric and C orthonormal to {ROUNDING:.1e}, P positive definite, in the core "
        "alone and in the millions of steps"
    )
    if not health:
        return Verdict(expected, "nothing was flown", None)
    values = worst(health)
    asymmetry, smallest, orthonormality = (values[name] for name in WORST)
    if asymmetry is None or smallest is None or orthonormality is None:
        return Verdict(expected, "a state is not finite", False)
    return Verdict(
        expected,
        f"{asymmetry:.1e} and {orthonormality:.1e}; smallest eigenvalue {smallest:.1e}",
        asymmetry <= ROUNDING and orthonormality <= ROUNDING and smallest > 0.0,
    )
