"""The fault matrix: every fault, what is expected, what was seen; and its page.

Faults of messages and time are flown through the core and give the same bits in every call; those
of processes and networks are flown as real processes.
"""

import argparse
import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from insdvl.files import check_writable, json_text, write
from insdvl.jobs.parallel import environment
from insdvl.studies.faults import matrix, page, rows
from insdvl.studies.faults.rows.base import ONE_SEED, FlightRow
from ros_insdvl_sim.trials.environment import exit_code_of, isolate
from ros_insdvl_sim.trials.process_rows.row import judged
from ros_insdvl_sim.trials.process_rows.rows import ROWS as PROCESS_ROWS

RATE_FACTOR = 4.0  # of the processes; low enough for a machine that does something else as well

#: Rows of messages in the short form, with one seed each.
SHORT = (
    "NaN in a channel, 1 % of the samples",
    "one copy with a stamp 10^6 s ahead",
    "bottom lock lost for 30 s: zeros",
    "clock set back by 500 s; jump_action reset",
)


def short_rows() -> list[FlightRow]:
    """The rows of messages in the short form."""
    chosen = [row for row in rows.ROWS if row.name in SHORT]
    return [row.with_seeds(ONE_SEED) for row in chosen]


def judged_messages(chosen: list[FlightRow], jobs: int) -> Iterator[dict[str, Any]]:
    """The rows of messages in their order, judged; several at a time."""
    if jobs == 1:
        yield from map(matrix.judged, chosen)
        return
    with ProcessPoolExecutor(jobs) as pool:
        yield from pool.map(matrix.judged_row, [rows.ROWS.index(row) for row in chosen])


def judged_processes(short: bool) -> Iterator[dict[str, Any]]:
    """The rows of processes in their order, judged."""
    for row in PROCESS_ROWS:
        if row.short or not short:
            yield judged(row, RATE_FACTOR)


def fly_matrix(options: argparse.Namespace) -> int:
    """Fly the rows and write numbers and page; the exit code is 1 if a row is not met."""
    isolate()
    folder: Path = options.out / "reliability"
    folder.mkdir(parents=True, exist_ok=True)
    check_writable(options.out / "reliability.md", "--out")
    chosen = short_rows() if options.short else list(rows.ROWS)
    parts: dict[str, Callable[[], Iterator[dict[str, Any]]]] = {
        page.MESSAGES: lambda: judged_messages(chosen, 1 if options.short else options.jobs),
        page.PROCESSES: lambda: judged_processes(options.short),
    }
    failed = 0
    for part in options.parts.split(","):
        judged: list[dict[str, Any]] = []
        document = {"rate_factor": RATE_FACTOR, "environment": environment(), "rows": judged}
        for row in parts[part]():
            judged.append(row)
            write(folder / f"{part}.json", json_text(document).encode())
            failed += not row["met"]
            print(
                f"{'met' if row['met'] else 'NOT MET':8}{row['group']}: {row['fault']}", flush=True
            )
            for check in row["checks"]:
                if not check["met"]:
                    print(f"        {check['expected']}: {check['seen']}", flush=True)
    write(options.out / "reliability.md", page.markdown(page.documents(folder)).encode())
    print(options.out / "reliability.md")
    return 1 if failed else 0


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="faults", description=__doc__.split("\n")[0])
    parser.add_argument(
        "--out", type=Path, default=Path("docs"), metavar="DIR", help="folder (default: ./docs)"
    )
    known = f"{page.MESSAGES},{page.PROCESSES}"
    parser.add_argument("--parts", default=known, help=f"parts to fly (default: {known})")
    parser.add_argument("--short", action="store_true", help="a few rows, with one seed each")
    parser.add_argument(
        "--jobs",
        type=int,
        default=len(os.sched_getaffinity(0)),
        help="rows of messages at a time (default: one for each core)",
    )
    options = parser.parse_args(arguments)
    for part in options.parts.split(","):
        if part not in known.split(","):
            parser.error(f"--parts must be one or more of {known}, got {part!r}")
    if options.jobs < 1:
        parser.error(f"--jobs must be >= 1, got {options.jobs}")
    return options


def main() -> int:
    """Fly the fault matrix from the command line."""
    options = parse(None)
    return exit_code_of("faults", lambda: fly_matrix(options), failed=2)


if __name__ == "__main__":
    sys.exit(main())
