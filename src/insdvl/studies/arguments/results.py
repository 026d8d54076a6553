"""The arguments of `insdvl results`."""

import argparse
from collections.abc import Iterator
from pathlib import Path

from insdvl.commands import examples, unknown_names
from insdvl.jobs.arguments import add_worker_options, worker_faults
from insdvl.studies.arguments.evaluation import run_faults

#: The names that the modules of the study define; a test holds that they are the same.
VEHICLE, WITHHELD = "vehicle", "withheld"
PARTS = (
    "q-accuracy",
    "constant-calibrated",
    "constant-tableI-calibrated",
    "varying-calibrated",
    "wide-calibrated",
    "constant-paper",
    "constant-tableI-paper",
    "varying-paper",
    "wide-paper",
    "constant-paper-no-walk",
    "varying-ned",
    "varying-gate",
    "vibrating-spectrum",
    "coloured-spectrum",
    "waves-spectrum",
    "realistic-spectrum",
    "varying-spectrum",
    "wide-spectrum",
    "breadth",
    "other-vehicles",
    "dvl-noise",
    "window",
    VEHICLE,
    WITHHELD,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.epilog = examples(
        "results --parts wide-paper,window --jobs 2",
        "results --recordings bags --config vehicle.yaml --out docs",
    )
    parser.set_defaults(faults=_faults)
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("docs"),
        metavar="DIR",
        help="folder of results/, where numbers and pages go (default: ./docs)",
    )
    parser.add_argument(
        "--parts",
        metavar="NAME,NAME",
        help="parts to compute, separated by commas, or 'none' to write the pages only (default: "
        f"all): {', '.join(PARTS)}",
    )
    parser.add_argument(
        "--recordings",
        type=Path,
        metavar="DIR",
        help=f"folder of rosbag2 recordings for {VEHICLE} and {WITHHELD}",
    )
    parser.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        help=f"YAML file of the recordings for {VEHICLE} and {WITHHELD}",
    )
    parser.add_argument(
        "--runs",
        type=int,
        metavar="N",
        help="number of runs of each comparison (default: 100, 10 in breadth, 6 in other-vehicles)",
    )
    parser.add_argument(
        "--tuning-runs",
        type=int,
        default=5,
        metavar="N",
        help="number of runs of a search (default: 5)",
    )
    parser.add_argument("--seed", type=int, default=1, help="random seed (default: 1)")
    add_worker_options(parser)


def _faults(arguments: argparse.Namespace) -> Iterator[str]:
    if arguments.parts not in (None, "none"):
        asked = arguments.parts.split(",")
        yield from unknown_names("--parts", asked, PARTS)
        if arguments.recordings is None or arguments.config is None:
            for part in (VEHICLE, WITHHELD):
                if part in asked:
                    yield f"--parts {part} needs --recordings and --config"
    yield from run_faults(arguments)
    yield from worker_faults(arguments)
