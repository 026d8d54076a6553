"""The arguments of `insdvl import` and `insdvl export`."""

import argparse
from collections.abc import Iterator
from pathlib import Path

from insdvl.commands import examples
from insdvl.studies.arguments.output import add_json_option
from insdvl.studies.arguments.recording import add_recording, recording_faults, taken


def import_(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `insdvl import`."""
    parser.epilog = examples(
        "import imu.csv dvl.csv --map map.yaml --out dive",
        "import imu.csv dvl.csv truth.csv --map map.yaml --out dive",
    )
    parser.set_defaults(faults=_faults_of_import)
    parser.add_argument("imu", type=Path, metavar="IMU", help="text file with a row per sample")
    parser.add_argument("dvl", type=Path, metavar="DVL", help="text file with a row per velocity")
    parser.add_argument(
        "truth",
        type=Path,
        nargs="?",
        metavar="TRUTH",
        help="text file with position and attitude to compare with",
    )
    parser.add_argument(
        "--map",
        type=Path,
        required=True,
        metavar="YAML",
        help="which column is what, in which unit and along which axis",
    )
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="BAG",
        help="new folder, a rosbag2; an existing one is not overwritten",
    )
    add_json_option(parser)


def _faults_of_import(arguments: argparse.Namespace) -> Iterator[str]:
    for path in (arguments.imu, arguments.dvl, arguments.truth, arguments.map):
        if path is not None and not path.is_file():
            yield f"{path} is not a file" if path.exists() else f"{path} does not exist"
    yield from taken("--out", arguments.out)


def export(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `insdvl export`."""
    parser.epilog = examples(
        "export run1 -o track.tum",
        "export dive --topic /imu/data_raw --from 10 --to 20 -o imu.csv",
    )
    parser.set_defaults(faults=recording_faults)
    add_recording(parser, "rosbag2, or the result of insdvl replay, which is one")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="FILE",
        help="the file, .csv or .tum; an existing one is overwritten",
    )
    parser.add_argument(
        "--topic",
        metavar="TOPIC",
        help="topic of an odometry, an IMU or a velocity (default: odometry/filtered)",
    )
    add_json_option(parser)
