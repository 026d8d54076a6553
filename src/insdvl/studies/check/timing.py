"""The answers to the question of the stamps: clocks, rates, gaps, and sensors that stop."""

from collections.abc import Iterator

from insdvl.navigation.events import NS
from insdvl.studies.check.findings import MOST, STAMPS, Finding, fatal, setting, wrong
from insdvl.studies.check.inspection import Inspection
from insdvl.studies.check.stamps import StampFacts
from insdvl.studies.check.topics import DEPTH, DVL, IMU

#: What is to be there all the time. A satellite fix is not under water.
NAVIGATED = (IMU, DVL, DEPTH)


def stamp_answers(seen: Inspection) -> Iterator[Finding]:
    """All that is to be said of the stamps, of a recording with an IMU."""
    extent_ns = _extent_ns(seen)
    for topic, use in seen.sensors.uses.items():
        if use in NAVIGATED:
            yield from _stamps_of(use, seen.stamps[topic], *extent_ns)
    imu = seen.stamps[seen.sensors.imu]
    told = seen.parameters.imu
    if "imu.rate" in seen.found:
        names = [name for name in seen.found if name in ("imu.rate", "imu.max_gap")]
        yield setting(
            STAMPS,
            f"The IMU has {seen.found['imu.rate']:g} Hz.",
            {name: seen.found[name] for name in names},
        )
    elif imu.rate and abs(imu.rate / told.rate - 1.0) > 0.1:
        yield wrong(
            STAMPS,
            f"The IMU has {imu.rate:.4g} Hz, imu.rate is {told.rate:g}.",
            **{"imu.rate": float(f"{imu.rate:.3g}")},
        )
    dvl = seen.stamps.get(seen.sensors.dvl)
    have_stamps = dvl is not None and dvl.rate and imu.rate
    stamped = (imu.first_ns, imu.last_ns)
    if dvl is not None and have_stamps and not _overlap(stamped, (dvl.first_ns, dvl.last_ns)):
        met = imu.recorded_ns and dvl.recorded_ns and _overlap(imu.recorded_ns, dvl.recorded_ns)
        why = "other clocks" if met else "they were not recorded at the same time"
        yield fatal(STAMPS, f"No stamp of the DVL is within those of the IMU: {why}.")


def _overlap(a: tuple[int, int], b: tuple[int, int]) -> bool:
    return a[0] <= b[1] and b[0] <= a[1]


def _extent_ns(seen: Inspection) -> tuple[int, int]:
    """Times at which the recording of the sensors, all together, begins and ends."""
    every = [seen.stamps[topic].recorded_ns for topic in seen.sensors.uses]
    known = [both for both in every if both is not None]
    return min(first for first, _ in known), max(last for _, last in known)


def _stamps_of(use: str, s: StampFacts, begin_ns: int, end_ns: int) -> Iterator[Finding]:
    if s.unset > MOST * s.count:
        yield fatal(STAMPS, f"The {use} does not stamp its messages: {s.unset} stamps are zero.")
        return
    before, after = s.missing_at_ends(begin_ns, end_ns)
    span = (end_ns - begin_ns) / NS
    faults = [
        f"nothing in the first {before:.1f} of {span:.1f} s" * (before > 0.0),
        f"nothing in the last {after:.1f} s, from {span - after:.1f} of {span:.1f} s on"
        * (after > 0.0),
        f"{s.gaps} gaps, {s.missing:.3g} s together, the longest {s.longest:.3g} s" * (s.gaps > 0),
        f"{s.repeated} stamps occur twice" * (s.repeated > 0),
        f"{s.backward} stamps go back" * (s.backward > 0),
        f"{s.unset} stamps are zero" * (s.unset > 0),
    ]
    faults = [fault for fault in faults if fault]
    text = f"{use}: {'; '.join(faults) or f'{s.rate or 0.0:.4g} Hz without gaps'}."
    yield Finding(STAMPS, text, wrong=bool(faults))
    lost = before + after + s.missing
    if use in (IMU, DVL) and lost > MOST * span:
        yield fatal(
            STAMPS,
            f"The {use} is missing for {lost:.1f} of {span:.1f} s: look for why its driver "
            "stopped, or take with --from and --to the part that has it.",
        )
    if s.latency is None:
        return
    low, middle, high = (1e3 * seconds for seconds in s.latency)  # ms
    if s.has_own_clock:
        yield Finding(STAMPS, f"{use}: stamps and times of recording are of different clocks.")
    elif middle < -1.0:
        yield Finding(
            STAMPS,
            f"{use}: stamps are {-middle:.1f} ms after the times of recording: the clock of the "
            "sensor is ahead.",
            wrong=True,
        )
    else:
        yield Finding(
            STAMPS,
            f"{use}: recorded {middle:.1f} ms after its stamps; 5 to 95 %: {low:.1f} to "
            f"{high:.1f} ms.",
        )
