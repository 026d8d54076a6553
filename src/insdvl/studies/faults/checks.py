"""Checks of the filter under a fault of messages.

A check looks at all seeds of a row: the flight with the fault beside the flight without it.
"""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from insdvl.messages.refusals import Refused
from insdvl.messages.topics import DVL, measurement_of
from insdvl.navigation.events import NS
from insdvl.studies.faults import expectation
from insdvl.studies.faults.flight import Flight

SETTLE = 10.0  # s after the end of a fault, when its consequences should be over
AFTER = 30.0  # s from then on, which are checked
CLOSE = 0.05  # m/s: largest difference from the flight without the fault that counts as recovered
MAX_SIGMAS = 3.0
# The largest of a row. A Gaussian error with a correlation time of tau crosses +-z sigma at a rate
# of 2 z phi(z) / tau. With nine of them (3 axes, 3 seeds) over 150 s and tau = 1 s, two of a
# hundred rows exceed 5 sigma by chance; 6 sigma is exceeded in one of a hundred such tables.
LARGEST_SIGMAS = 6.0


class Pair(NamedTuple):
    """One seed of a row.

    Attributes:
        flight: The flight with the fault.
        calm: The flight without it.
        begin_ns: Beginning of the fault, as a time of arrival.
        end_ns: Its end.
    """

    flight: Flight
    calm: Flight
    begin_ns: int
    end_ns: int

    @property
    def after_ns(self) -> tuple[int, int]:
        """Beginning and end of the time in which the consequences should be over."""
        begin_ns = self.end_ns + round(SETTLE * NS)
        return begin_ns, begin_ns + round(AFTER * NS)

    def recovery(self) -> float | None:
        """Time from the fault's end until the velocity stays `CLOSE` to the calm flight's [s].

        None where it does not, or where nothing is published any more.
        """
        until_ns = self.after_ns[1]
        _, a, b = np.intersect1d(self.flight.times_ns, self.calm.times_ns, return_indices=True)
        times_ns = self.flight.times_ns[a]
        inside = (times_ns >= self.end_ns) & (times_ns < until_ns)
        if not inside.any():
            return None
        difference = np.linalg.norm(self.flight.v_b[a] - self.calm.v_b[b], axis=1)[inside]
        times_ns = times_ns[inside]
        far = np.flatnonzero(difference >= CLOSE)
        if far.size == 0:
            return 0.0
        if far[-1] == times_ns.size - 1:
            return None
        return float(times_ns[far[-1] + 1] - self.end_ns) / NS


Pairs = Sequence[Pair]
Check = expectation.Check[Pairs]


def _range(values: Sequence[float], form: str) -> str:
    low, high = format(min(values), form), format(max(values), form)
    return low if low == high else f"{low} to {high}"


def same_bits() -> Check:
    """The published numbers are those without the fault, to the bit."""

    def judge(pairs: Pairs) -> tuple[str, bool]:
        same = [pair.flight.digest == pair.calm.digest for pair in pairs]
        return ("equal" if all(same) else f"equal in {sum(same)} of {len(same)}"), all(same)

    return Check("output equal to the bit to that without the fault", judge)


def refused(reason: str, *topics: str) -> Check:
    """Every message that the fault touches is refused for this reason, and no other message is.

    Args:
        reason: The reason.
        topics: Topics that the fault touches.
    """
    keys = [Refused(topic, reason) for topic in topics]

    def judge(pairs: Pairs) -> tuple[str, bool]:
        counts = [sum(pair.flight.refused.get(key, 0) for key in keys) for pair in pairs]
        touched = [sum(pair.flight.faulted.get(topic, 0) for topic in topics) for pair in pairs]
        others: Counter[Refused] = Counter()
        for pair in pairs:
            others.update({k: n for k, n in pair.flight.refused.items() if k not in keys})
        text = f"`{reason}` {_range(counts, 'd')} of {_range(touched, 'd')}"
        if others:
            text += ", also " + ", ".join(f"{name} {n}" for name, n in sorted(others.items()))
        return text, counts == touched and min(touched) > 0 and not others

    return Check(f"each counted as `{reason}`, nothing else refused", judge)


def nothing_refused() -> Check:
    """No message is refused, or all refused ones are recovered."""

    def judge(pairs: Pairs) -> tuple[str, bool]:
        names = sorted({str(key) for pair in pairs for key in pair.flight.refused})
        recovered = [pair.flight.counts.get("recovered", 0) for pair in pairs]
        kept = all(
            sum(pair.flight.refused.values()) == count
            for pair, count in zip(pairs, recovered, strict=True)
        )
        text = "refused: " + (", ".join(names) or "nothing")
        return (f"{text}, all recovered" if names and kept else text), kept

    return Check("no message refused for good", judge)


def update_reason(reason: str, share: float = 1.0, *, topic: str = DVL) -> Check:
    """At least a share of the measurements that the fault touches are refused for this reason.

    Args:
        reason: The reason, or several with "or" between them.
        share: The share.
        topic: Topic that the fault touches.
    """
    reasons = reason.split(" or ")

    def judge(pairs: Pairs) -> tuple[str, bool]:
        counts = [
            sum(
                update.reason in reasons and pair.begin_ns <= update.stamp_ns < pair.end_ns
                for update in pair.flight.updates_of(measurement_of(topic))
            )
            for pair in pairs
        ]
        touched = [pair.flight.faulted.get(topic, 0) for pair in pairs]
        enough = all(n >= share * m and m > 0 for n, m in zip(counts, touched, strict=True))
        return f"`{reason}` {_range(counts, 'd')} of {_range(touched, 'd')}", enough

    portion = "all" if share == 1.0 else f"at least {100.0 * share:g} %"
    return Check(f"{portion} refused as `{reason}`", judge)


def counter(name: str, low: int, high: int | None = None) -> Check:
    """A counter of the fold is within a range at the end of the flight."""
    high = low if high is None else high

    def judge(pairs: Pairs) -> tuple[str, bool]:
        counts = [pair.flight.counts.get(name, 0) for pair in pairs]
        return f"{name} {_range(counts, 'd')}", all(low <= n <= high for n in counts)

    return Check(f"{name} {low}" if low == high else f"{name} {low} to {high}", judge)


def covered(least: float = 0.95) -> Check:
    """Sigma covers the error, from the beginning of the fault to the end of what is checked."""

    def judge(pairs: Pairs) -> tuple[str, bool]:
        ratios = np.concatenate(
            [
                (np.abs(pair.flight.error) / pair.flight.sigma)[
                    pair.flight.inside(pair.begin_ns, pair.after_ns[1])
                ]
                for pair in pairs
            ]
        )
        if ratios.size == 0:
            return "no output", False
        share = float(np.mean(ratios <= MAX_SIGMAS))
        text = f"{100.0 * share:.1f} % within {MAX_SIGMAS:g} σ, largest {ratios.max():.1f} σ"
        return text, share >= least and float(ratios.max()) <= LARGEST_SIGMAS

    expected = f"{100.0 * least:g} % of the errors within {MAX_SIGMAS:g} σ"
    return Check(f"{expected}, none beyond {LARGEST_SIGMAS:g} σ", judge)


def height_covered() -> Check:
    """The height's sigma covers its error, from the beginning of the fault on."""
    return _covered_by("height")


def heading_covered() -> Check:
    """The heading's sigma covers its error, from the beginning of the fault on."""
    return _covered_by("heading")


def _covered_by(name: str) -> Check:
    def judge(pairs: Pairs) -> tuple[str, bool]:
        ratios = np.concatenate(
            [
                (
                    np.abs(getattr(pair.flight, f"{name}_error"))
                    / getattr(pair.flight, f"{name}_sigma")
                )[pair.flight.inside(pair.begin_ns, pair.after_ns[1])]
                for pair in pairs
            ]
        )
        largest = float(ratios.max()) if ratios.size else float("nan")
        return f"{name} within {largest:.1f} σ", largest <= LARGEST_SIGMAS

    return Check(f"{name} within {LARGEST_SIGMAS:g} σ", judge)


def recovers(within: float) -> Check:
    """The velocity returns to that of the flight without the fault."""

    def judge(pairs: Pairs) -> tuple[str, bool]:
        times = [pair.recovery() for pair in pairs]
        known = [time for time in times if time is not None]
        text = f"back after {_range(known, '.1f')} s" if known else "not back"
        if known and len(known) < len(times):
            text += f", {len(times) - len(known)} not"
        return text, len(known) == len(times) and max(known) <= within

    return Check(f"back within {within:g} s", judge)


def error_below(limit: float) -> Check:
    """No velocity error is above a limit from the beginning of the fault on."""

    def judge(pairs: Pairs) -> tuple[str, bool]:
        errors = [
            np.linalg.norm(pair.flight.error, axis=1)[
                pair.flight.inside(pair.begin_ns, pair.after_ns[1])
            ]
            for pair in pairs
        ]
        largest = max((float(e.max()) for e in errors if e.size), default=float("nan"))
        return f"largest error {largest:.2f} m/s", largest < limit

    return Check(f"error below {limit:g} m/s", judge)


def rejoins(topic: str = DVL) -> Check:
    """The gate does not lock out: the measurements of a topic after the fault are used."""
    name = measurement_of(topic)

    def judge(pairs: Pairs) -> tuple[str, bool]:
        shares = []
        for pair in pairs:
            begin_ns, end_ns = pair.after_ns
            accepted = [
                not update.reason
                for update in pair.flight.updates_of(name)
                if begin_ns <= update.time_ns < end_ns
            ]
            shares.append(float(np.mean(accepted)) if accepted else 0.0)
        text = f"{100.0 * min(shares):.0f} % of the {name.upper()} used afterwards"
        return text, min(shares) >= 0.9

    return Check(f"{name.upper()} used again afterwards", judge)


def none_refused() -> Check:
    """No DVL measurement is refused but by the gate, and that no more often than by chance."""

    def judge(pairs: Pairs) -> tuple[str, bool]:
        reasons = Counter(
            update.reason
            for pair in pairs
            for update in pair.flight.updates_of(measurement_of(DVL))
            if pair.begin_ns <= update.time_ns < pair.after_ns[1] and update.reason
        )
        count = reasons.pop("gate", 0)
        text = ", ".join(f"`{name}` {n}" for name, n in sorted(reasons.items()))
        return f"{text or 'none'}, by the gate {count}", not reasons and count <= len(pairs)

    return Check("no good measurement refused, but for one per flight by the gate", judge)


def used(least: int) -> Check:
    """At least this many DVL measurements are used during the fault."""

    def judge(pairs: Pairs) -> tuple[str, bool]:
        counts = [
            sum(
                not update.reason and pair.begin_ns <= update.time_ns < pair.end_ns
                for update in pair.flight.updates_of(measurement_of(DVL))
            )
            for pair in pairs
        ]
        return f"{_range(counts, 'd')} used", min(counts) >= least

    return Check(f"at least {least} DVL measurements used during it", judge)


def stops() -> Check:
    """Nothing is published from the beginning of the fault on."""

    def judge(pairs: Pairs) -> tuple[str, bool]:
        outputs = sum(int((pair.flight.times_ns >= pair.begin_ns).sum()) for pair in pairs)
        return f"{outputs} outputs afterwards", outputs == 0

    return Check("nothing published afterwards", judge)


def always() -> tuple[Check, ...]:
    """What must hold under every fault."""

    def invariant(text: str, name: str) -> Check:
        def judge(pairs: Pairs) -> tuple[str, bool]:
            wrong = sum(not getattr(pair.flight, name) for pair in pairs)
            return (text if wrong == 0 else f"not {text}: {wrong} of {len(pairs)}"), wrong == 0

        return Check(text, judge)

    def lost(pairs: Pairs) -> tuple[str, bool]:
        counts = [pair.flight.lost for pair in pairs]
        return f"valid messages lost: {_range(counts, 'd')}", not any(counts)

    return (
        invariant("output finite", "finite"),
        invariant("covariance symmetric positive definite", "positive"),
        invariant("stamps rising", "monotonic"),
        Check("no valid message lost", lost),
    )
