"""The arguments of `insdvl init`."""

import argparse
from collections.abc import Iterator
from pathlib import Path

from insdvl.commands import examples
from insdvl.studies.arguments.output import add_json_option
from insdvl.studies.arguments.recording import (
    add_recording,
    add_set_option,
    recording_faults,
    taken,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.epilog = examples(
        "init dive -o vehicle.yaml",
        "init dive.mcap --from 60 --set dvl.type=geometry_msgs/msg/TwistStamped -o vehicle.yaml",
    )
    parser.set_defaults(faults=_faults)
    add_recording(parser)
    parser.add_argument(
        "-o",
        "--out",
        type=Path,
        required=True,
        metavar="YAML",
        help="new parameter file; an existing one is not overwritten",
    )
    add_set_option(parser)
    add_json_option(parser)


def _faults(arguments: argparse.Namespace) -> Iterator[str]:
    yield from recording_faults(arguments)
    yield from taken("--out", arguments.out)
