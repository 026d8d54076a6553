"""The arguments of `insdvl replay`."""

import argparse
from pathlib import Path

from insdvl.commands import examples

RATE = 10.0  # Hz, of the odometry in the result


def add_set_option(parser: argparse.ArgumentParser) -> None:
    """Declare --set."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="set a parameter, in place of what files say; NODE:NAME=VALUE where several nodes "
        "know the name. May be given several times",
    )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.epilog = examples(
        "replay dive -c my.yaml --out run1 --strict",
        "replay dive --set dvl.noise_std=0.05 --from 60 --to 300",
        "replay dive -c my.yaml --compare process_noise.source=external",
    )
    parser.add_argument("bag", type=Path, metavar="BAG", help="rosbag2: a folder, .mcap or .db3")
    parser.add_argument(
        "-c",
        "--config",
        type=Path,
        action="append",
        metavar="YAML",
        help="parameter file of the nodes, read as ROS reads it; the sections of filter, tuner and "
        "replay are used (default: all defaults). Several files are given as with --params-file, "
        "in their order",
    )
    add_set_option(parser)
    parser.add_argument(
        "--compare",
        action="append",
        default=[],
        metavar="YAML|NAME=VALUE",
        help="also replay with this file after the others, or with this value, and show the "
        "numbers side by side; once for each further configuration",
    )
    parser.add_argument(
        "--estimator",
        metavar="PACKAGE.MODULE:FUNCTION",
        help="take Q from your own estimator, see docs/how-to/estimator.md",
    )
    for name, what in (("from", "begin"), ("to", "end")):
        parser.add_argument(
            f"--{name}",
            type=float,
            dest=what,
            metavar="S",
            help=f"{what} so many seconds after the recording's first message",
        )
    parser.add_argument(
        "--namespace",
        metavar="NS",
        help="namespace of the nodes; by default the one that the sections are for",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="OUT",
        help="new folder for the result: a rosbag2 with inputs and outputs, report.html, "
        "track.csv, track.tum, numbers.json (default: BAG-replay in the working directory; with "
        "--json alone none)",
    )
    parser.add_argument(
        "--json", metavar="FILE", help="write the numbers to a file; - is standard output"
    )
    parser.add_argument(
        "--rate",
        type=float,
        default=RATE,
        metavar="HZ",
        help=f"rate of the odometry in OUT; 0 is every sample (default: {RATE:g})",
    )
    parser.add_argument(
        "--strict", action="store_true", help="exit with 1 where the verdict has a finding"
    )
    parser.add_argument(
        "--inject-noise",
        metavar="ACC_LO,ACC_HI,GYR_LO,GYR_HI",
        help="add white noise to the IMU, with a log-uniform variance between these limits "
        "[(m/s^2)^2 and (rad/s)^2] for each channel and each 15 to 45 s; process_noise.source "
        "'oracle' is given the variances",
    )
    parser.add_argument("--seed", type=int, default=0, help="random seed of the noise (default: 0)")
