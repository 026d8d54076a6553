"""The arguments of `insdvl replay`."""

import argparse
from pathlib import Path

from insdvl.commands import examples


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.epilog = examples(
        "replay dive --config vehicle.yaml --json numbers.json",
        "replay dive.mcap --config vehicle.yaml --json numbers.json --out result-bag",
    )
    parser.add_argument("bag", type=Path, metavar="BAG", help="rosbag2: a folder, .mcap or .db3")
    parser.add_argument(
        "--config",
        type=Path,
        required=True,
        action="append",
        metavar="FILE",
        help="YAML parameter file of the nodes, read as ROS reads it; the sections of filter, "
        "tuner and replay are used. Several files are given as with --params-file, in their order",
    )
    parser.add_argument(
        "--namespace",
        metavar="NS",
        help="namespace of the nodes; by default the one that the sections are for",
    )
    parser.add_argument("--json", type=Path, required=True, metavar="FILE", help="JSON output file")
    parser.add_argument(
        "--out", type=Path, metavar="BAG", help="new rosbag2 for inputs and outputs"
    )
    parser.add_argument(
        "--inject-noise",
        metavar="ACC_LO,ACC_HI,GYR_LO,GYR_HI",
        help="add white noise to the IMU, with a log-uniform variance between these limits "
        "[(m/s^2)^2 and (rad/s)^2] for each channel and each 15 to 45 s; process_noise.source "
        "'oracle' is given the variances",
    )
    parser.add_argument("--seed", type=int, default=0, help="random seed of the noise (default: 0)")
