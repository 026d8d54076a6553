"""The arguments of `insdvl init`."""

import argparse
from pathlib import Path

from insdvl.commands import examples


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.epilog = examples("init dive -o vehicle.yaml", "init dive.mcap -o config/vehicle.yaml")
    parser.add_argument("bag", type=Path, metavar="BAG", help="rosbag2: a folder, .mcap or .db3")
    parser.add_argument(
        "-o",
        "--out",
        type=Path,
        required=True,
        metavar="YAML",
        help="new parameter file; an existing one is not overwritten",
    )
