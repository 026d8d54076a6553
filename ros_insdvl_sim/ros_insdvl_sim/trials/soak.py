"""The soak: hours of mission through simulator, filter and tuner as processes, in legs.

A leg is an hour of mission: a level circle that closes, so that leg follows leg without a seam and
one filter navigates all of them. The numbers of a leg are written to a file when it is over;
another call adds legs to it. An interrupted leg is not in the file, and is flown again.
"""

import argparse
import os
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from insdvl.files import check_writable, finite, json_text, write
from insdvl.jobs.parallel import environment
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build
from insdvl.studies.faults import page, soak
from insdvl.studies.faults.verdicts import Verdict, verdicts
from ros_insdvl_sim.trials.environment import exit_code_of, isolate
from ros_insdvl_sim.trials.soak_search import add_legs, search_speed


def soak_and_judge(options: argparse.Namespace) -> int:
    """Add hours to what is there, and write the page; the exit code."""
    isolate()
    folder: Path = options.out / "reliability"
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "soak.json"
    check_writable(file, "--out")
    document: dict[str, Any] = {
        "search": [],
        "rate_factor": None,
        "legs": [],
        "core": [],
        "steps": {},
    }
    document |= page.documents(folder).get(page.SOAK, {})

    def keep() -> None:
        document["environment"] = environment() | {"cores": len(os.sched_getaffinity(0))}
        write(file, json_text(document).encode())
        write(options.out / "reliability.md", page.markdown(page.documents(folder)).encode())

    if options.core_hours:
        _fly_core(document, options, keep)
    if options.steps:
        _step(document, options.steps)
    keep()
    if options.hours:
        if options.rate_factor:
            document["rate_factor"], document["search"] = options.rate_factor, []
        elif document["rate_factor"] is None:
            document["rate_factor"], document["search"] = search_speed()
            keep()
        add_legs(document, options.hours, options.leg, keep)
    return _report(verdicts(document))


def _fly_core(
    document: dict[str, Any], options: argparse.Namespace, keep: Callable[[], None]
) -> None:
    """Hours of mission through the core alone."""
    document["core"] = []
    for number, hour in enumerate(soak.flown_hours(options.core_hours, options.leg)):
        document["core"].append(finite(asdict(hour)) | {"hour": number})
        print(f"core, hour {number + 1}: {hour.seconds:.1f} s", flush=True)
        keep()


def _step(document: dict[str, Any], millions: int) -> None:
    """Millions of steps of the filter alone."""
    document["steps"] = {}
    for name, values in soak.STEPPED.items():
        health = soak.steps(build(FilterParameters, values), millions, seed=1)
        document["steps"][name] = [finite(asdict(million)) for million in health]
        print(f"{millions} million steps, {name}", flush=True)


def _report(judged: list[Verdict]) -> int:
    """Print what holds; the exit code."""
    words = {True: "holds", False: "FAILS", None: "not judged"}
    for verdict in judged:
        print(f"{words[verdict.holds]:12}{verdict.expected}: {verdict.seen}", flush=True)
    return 1 if any(verdict.holds is False for verdict in judged) else 0


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="soak", description=__doc__.split("\n")[0])
    parser.add_argument("--hours", type=int, default=1, help="of mission to add (default: 1)")
    parser.add_argument(
        "--core-hours", type=int, default=0, help="of mission through the core alone, replaced"
    )
    parser.add_argument("--steps", type=int, default=0, help="millions of filter steps, replaced")
    parser.add_argument(
        "--rate-factor",
        type=float,
        default=0.0,
        help="speed; 0 takes the one in the file, or searches for the highest",
    )
    parser.add_argument(
        "--leg", type=float, default=soak.LEG, help="seconds of a leg, shorter for a trial"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("docs"), metavar="DIR", help="folder (default: ./docs)"
    )
    options = parser.parse_args(arguments)
    for name in ("hours", "core_hours", "steps"):
        if getattr(options, name) < 0:
            parser.error(f"--{name.replace('_', '-')} must be >= 0, got {getattr(options, name)}")
    if not 10.0 <= options.leg <= soak.LEG:
        parser.error(f"--leg must be from 10 to {soak.LEG:g} s, got {options.leg:g}")
    if not 0.0 <= options.rate_factor <= 1000.0:
        parser.error(f"--rate-factor must be from 0 to 1000, got {options.rate_factor:g}")
    return options


def main() -> int:
    """Run the soak from the command line."""
    options = parse(None)
    return exit_code_of("soak", lambda: soak_and_judge(options), failed=2)


if __name__ == "__main__":
    sys.exit(main())
