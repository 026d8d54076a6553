"""The arguments of `insdvl replay`."""

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

RATE = 10.0  # Hz, of the odometry in the result
MIN_RATE, MAX_RATE = 0.01, 10_000.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.epilog = examples(
        "replay dive -c my.yaml --out run1 --strict",
        "replay dive --set dvl.noise_std=0.05 --from 60 --to 300",
        "replay dive -c my.yaml --compare process_noise.source=external",
    )
    parser.set_defaults(faults=_faults)
    add_recording(parser)
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
    add_json_option(parser)
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


def _faults(arguments: argparse.Namespace) -> Iterator[str]:
    yield from recording_faults(arguments)
    if not (arguments.rate == 0.0 or MIN_RATE <= arguments.rate <= MAX_RATE):
        yield f"--rate must be 0 or within {MIN_RATE:g} to {MAX_RATE:g} Hz, got {arguments.rate:g}"
    yield from taken("--out", arguments.out)
    if arguments.seed < 0:
        yield f"--seed must be >= 0, got {arguments.seed}"
