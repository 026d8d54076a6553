"""What was refused, by name or by the gate, and a sensor that contradicts filter and DVL."""

import math
from bisect import bisect_right, insort
from collections import Counter
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any

from insdvl.navigation.events import NS
from insdvl.navigation.filter import Filter
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.state.groups import GATE_COUNTERS
from insdvl.navigation.state.layout import gate_counter
from insdvl.studies.judgement.finding import Finding
from insdvl.studies.judgement.innovations import FACTOR, SIGMAS
from insdvl.studies.judgement.numbers import by_name, judged_count, refusals
from insdvl.studies.replay.fold import Replayed

#: Share of the measurements that are refused, beyond which it is a finding.
REFUSED = 0.02
#: Counters of the IMU, behind whose faults [s] a misfit may be its doing.
IMU_FAULTS, BEHIND = ("gaps", "saturated", "frozen", "glitches", "no_data"), 5.0
#: What to look at where a sensor contradicts the filter.
LOOK_AT: Mapping[str, str] = MappingProxyType(
    {
        "depth": "look at its lag or late stamps (depth.time_offset), its drift, "
        "depth.water_density and depth.lever_arm, then depth.noise_std; if it is so from the start "
        "on, at depth.surface_height and initial.position",
        "heading": "look at steel and currents near the compass, its calibration, "
        "heading.declination and heading.mount, then heading.error_std and heading.noise_std; if "
        "it is so from the start on, at initial.rpy and initial.heading_std",
    }
)


def of_claims(document: dict[str, Any], filter_: Filter) -> Iterator[Finding]:
    """What is refused by name: no lock, repeated, too fast, late, of another frame."""
    reasons = by_name(document, Dvl.name)
    if not reasons or reasons.total() < REFUSED * judged_count(document, Dvl.name):
        return
    reason, _ = reasons.most_common(1)[0]
    remedy = filter_.parameters.dvl.REMEDIES.get(
        reason, "see in the report when; diagnostics.md has what the reasons mean"
    )
    text = f"{_share(reasons, document)}, and NIS says nothing of it"
    yield Finding("refused", text, remedy)


def of_gate(
    document: dict[str, Any], innovations: dict[str, Any] | None, filter_: Filter
) -> Iterator[Finding]:
    """The gate refuses one good measurement in a thousand (gate.probability)."""
    count, refused = judged_count(document, Dvl.name), refusals(document, Dvl.name)["gate"]
    if not _is_beyond_chance(refused, count, filter_):
        return
    if innovations and innovations["nis_median"] < FACTOR * innovations["nis_median_expected"]:
        remedy = "the others fit: these are outliers of the DVL; see in the report when"
    else:
        remedy = (
            "the DVL and the prediction contradict each other; check dvl.mount, dvl.lever_arm and "
            "dvl.time_offset, then process_noise, and see in the report when"
        )
    yield Finding("gate", _share(Counter(gate=refused), document), remedy)


def of_sensors(replayed: Replayed, document: dict[str, Any]) -> Iterator[Finding]:
    """A sensor whose gate complains while that of the DVL does not.

    An inflation and a restart take misfits in a row beyond 1.5 times the limit of the gate, which
    are no chance.
    """
    filter_, measured = replayed.fold.filter, set(replayed.measurements.values())
    complaints = {name: _complaints(replayed, name) for name in (Dvl.name, *LOOK_AT)}
    complaining = {
        name: gate
        for name, gate in complaints.items()
        if name in measured
        and (
            _is_beyond_chance(gate["gate"], judged_count(document, name), filter_)
            or any(gate[counter] for counter in GATE_COUNTERS)
        )
    }
    if Dvl.name in complaining:
        return
    for name, gate in complaining.items():
        happened = ", ".join(f"{counter} {gate[counter]}" for counter in GATE_COUNTERS)
        yield Finding(
            f"{name}_sensor",
            f"the {filter_.models[name].label} contradicts the filter, and the DVL does not: its "
            f"gate refused {gate['gate']} of {judged_count(document, name)} ({happened})",
            f"{LOOK_AT[name]}; see in the report when",
        )


def _complaints(replayed: Replayed, sensor: str) -> Counter[str]:
    """Refusals by a sensor's gate (``gate``), inflations and restarts, without those of the IMU.

    A fault of the IMU may move the filter off a good sensor, which is then refused until the filter
    gives in. So neither what is right behind a fault counts, nor what goes on from there.
    """
    found: Counter[str] = Counter()
    for part in replayed.parts:
        faults_ns = sorted(t for name in IMU_FAULTS for t in part.steps.get(name, ([], []))[0])
        for update in part.updates:
            if update.report.measurement != sensor or update.report.reason != "gate":
                continue
            if _is_behind(faults_ns, update.stamp_ns):
                insort(faults_ns, update.stamp_ns)
            else:
                found["gate"] += 1
        for counter in GATE_COUNTERS:
            steps = part.steps.get(gate_counter(sensor, counter), ([], []))
            for stamp_ns, count in zip(*steps, strict=True):
                found[counter] += 0 if _is_behind(faults_ns, stamp_ns) else count
    return found


def _is_behind(faults_ns: list[int], stamp_ns: int) -> bool:
    """Whether a stamp is right behind one of these, which rise."""
    before = bisect_right(faults_ns, stamp_ns)
    return before > 0 and stamp_ns - faults_ns[before - 1] <= BEHIND * NS


def _is_beyond_chance(refused: int, count: int, filter_: Filter) -> bool:
    """Whether a gate refused more of so many than chance explains, and enough to matter."""
    expected = (1.0 - filter_.parameters.gate.probability) * count
    return refused > max(expected + SIGMAS * math.sqrt(expected) + 1.0, REFUSED * count)


def _share(reasons: Counter[str], document: dict[str, Any]) -> str:
    names = ", ".join(f"{name} {n}" for name, n in reasons.most_common(3))
    share = 100.0 * reasons.total() / judged_count(document, Dvl.name)
    return f"{share:.0f} % of the DVL was refused ({names})"
