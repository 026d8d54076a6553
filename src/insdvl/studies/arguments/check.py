"""The arguments of `insdvl check`."""

import argparse
from pathlib import Path

from insdvl.commands import examples
from insdvl.studies.arguments.output import add_json_option
from insdvl.studies.arguments.recording import add_recording, add_set_option, recording_faults


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.epilog = examples(
        "check dive", "check dive.mcap -c vehicle.yaml --json -", "check dive --from 60 --to 300"
    )
    parser.set_defaults(faults=recording_faults)
    add_recording(parser)
    parser.add_argument(
        "-c",
        "--config",
        type=Path,
        action="append",
        metavar="YAML",
        help="parameter file by which the recording is judged; several in their order (default: "
        "the defaults, with frame convention, mount and rate of the IMU as the recording tells)",
    )
    add_set_option(parser)
    add_json_option(parser)
