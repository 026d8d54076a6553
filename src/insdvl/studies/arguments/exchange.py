"""The arguments of `insdvl import` and `insdvl export`."""

import argparse
from pathlib import Path

from insdvl.commands import examples


def import_(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `insdvl import`."""
    parser.epilog = examples(
        "import imu.csv dvl.csv --map map.yaml --out dive",
        "import imu.csv dvl.csv truth.csv --map map.yaml --out dive",
    )
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


def export(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `insdvl export`."""
    parser.epilog = examples(
        "export run1 -o track.tum", "export dive --topic /imu/data_raw -o imu.csv"
    )
    parser.add_argument(
        "bag",
        type=Path,
        metavar="BAG",
        help="rosbag2, or the result of insdvl replay, which is one",
    )
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
