"""The soak's speed, and legs that are added at it."""

from collections.abc import Callable
from typing import Any

from insdvl.studies.evaluation.tables import number as shown
from insdvl.studies.faults.verdicts import STOLEN, lost
from ros_insdvl_sim.trials.environment import TrialError
from ros_insdvl_sim.trials.soak_graph import graph

#: The search for the speed: the first factor, the ratio of each to the one before, and the last.
#: A factor holds if nothing is lost, the mission takes the time that it should, and no queue grows:
#: at the end of a trial half of the outputs come within the latency.
FIRST_FACTOR, STEP, LAST_FACTOR = 4.0, 1.25, 40.0
TRIAL_TIME = 30.0  # s of the wall
HELD = 0.97
LATENCY = 100.0  # ms
DISTURBED = 3  # hours in a row that the host of a virtual machine may spoil


def search_speed() -> tuple[float, list[dict[str, Any]]]:
    """The highest factor that holds and loses nothing, and all trials.

    Raises:
        TrialError: Not even the first does.
    """
    tried, best, factor = [], 0.0, FIRST_FACTOR
    while factor <= LAST_FACTOR:
        with graph(factor) as flown:
            leg = flown.fly(0, round(TRIAL_TIME * factor))
        trial = _trial(leg)
        tried.append(trial)
        print(
            f"{factor:g} times real time: held {trial['held']:.3f}, lost {trial['lost']}, latency "
            f"{shown(trial['latency'], 1)} ms",
            flush=True,
        )
        latency = trial["latency"]
        if trial["lost"] or trial["held"] < HELD or latency is None or latency > LATENCY:
            break
        best, factor = factor, round(factor * STEP, 1)
    if not best:
        raise TrialError(f"messages are lost or late even at {FIRST_FACTOR:g} times real time")
    return best, tried


def add_legs(
    document: dict[str, Any], count: int, duration: float, keep: Callable[[], None]
) -> None:
    """Add legs to the document, and keep each.

    If the speed was searched for, a leg with losses counts as one more failed trial, and the next
    leg is a step slower; but not if the host of a virtual machine had taken the processors.

    Raises:
        TrialError: No speed is left, the host takes too much, or a process ended.
    """
    done = disturbed = 0
    while done < count:
        rate_factor = document["rate_factor"]
        if document["search"] and rate_factor < FIRST_FACTOR:
            raise TrialError(f"messages are lost even at {FIRST_FACTOR:g} times real time")
        with graph(rate_factor) as flown:
            failed = False
            while done < count and not failed:
                leg = flown.fly(len(document["legs"]), duration)
                failed = bool(document["search"]) and lost(leg) > 0
                disturbed = disturbed + 1 if failed and leg["stolen"] > STOLEN else 0
                if failed:
                    document["search"].append(_trial(leg))
                    if not disturbed:
                        document["rate_factor"] = round(rate_factor / STEP, 1)
                else:
                    document["legs"].append(leg)
                    done += 1
                keep()
                print(
                    f"leg {leg['leg'] + 1}: {rate_factor:g} times real time, {leg['wall']:.0f} s, "
                    f"lost {lost(leg)}, NIS {shown(leg['nis'], 3)}, the host took "
                    f"{100.0 * leg['stolen']:.1f} % of the processors",
                    flush=True,
                )
        if disturbed == DISTURBED:
            raise TrialError(
                f"{DISTURBED} hours in a row lost messages while the host took more than "
                f"{100.0 * STOLEN:g} % of the processors: use a quieter machine"
            )


def _trial(leg: dict[str, Any]) -> dict[str, Any]:
    """What the page shows of a trial of a speed."""
    return {
        "rate_factor": leg["rate_factor"],
        "mission": leg["mission"],
        "held": leg["held"],
        "lost": lost(leg),
        "latency": leg["latency"][-1]["p50"],
        "stolen": leg["stolen"],
    }
