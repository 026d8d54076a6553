"""Arguments of the commands that read a recording, and what is wrong with them at first sight."""

import argparse
import math
from collections.abc import Iterator
from pathlib import Path


def add_recording(parser: argparse.ArgumentParser, text: str = "") -> None:
    """Declare BAG, and the part of it that is read."""
    parser.add_argument(
        "bag", type=Path, metavar="BAG", help=text or "rosbag2: a folder, .mcap or .db3"
    )
    for name, what in (("from", "begin"), ("to", "end")):
        parser.add_argument(
            f"--{name}",
            type=float,
            dest=what,
            metavar="S",
            help=f"{what} so many seconds after the recording's first message",
        )


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


def recording_faults(arguments: argparse.Namespace) -> Iterator[str]:
    """What is wrong with the arguments that are declared here."""
    if not arguments.bag.exists():
        yield f"recording {arguments.bag} does not exist"
    begin, end = arguments.begin or 0.0, arguments.end
    if not 0.0 <= begin < math.inf or (end is not None and not end > begin):
        yield f"--from must be at least 0 and --to above it, got {arguments.begin} and {end}"
    for path in getattr(arguments, "config", None) or []:
        if not path.exists():
            yield f"--config {path} does not exist"


def taken(option: str, path: Path | None) -> Iterator[str]:
    """What is wrong with a new file or folder that exists already."""
    if path is not None and (path.exists() or path.is_symlink()):
        yield f"{option} {path} exists already and is not overwritten"
