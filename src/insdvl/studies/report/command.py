"""The command `insdvl report`: the page of a result, or of two side by side."""

import argparse
import sys
from pathlib import Path

from insdvl.extras import MissingPackageError
from insdvl.files import check_writable, write
from insdvl.studies.report.page import page_of
from insdvl.studies.report.results import REPORT, read_result

EXAMPLES = """\
examples:
  insdvl report mission-replay                     writes mission-replay/report.html again
  insdvl report run1 run2 -o both.html             two results side by side
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.epilog = EXAMPLES
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument(
        "results",
        type=Path,
        nargs="+",
        metavar="OUT",
        help="one or two folders that insdvl replay wrote",
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        help=f"the page (default: {REPORT} in the folder; of two, comparison.html in the working "
        "directory)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Write the page. The exit code is 2 if the input is refused; then nothing is written."""
    try:
        print(_report(arguments.results, arguments.output))
    except (ValueError, OSError, MissingPackageError) as error:
        print(f"insdvl report: {error}", file=sys.stderr)
        return 2
    return 0


def _report(folders: list[Path], output: Path | None) -> Path:
    """The page that was written."""
    if len(folders) > 2:
        raise ValueError(f"one or two results can be shown, got {len(folders)}")
    if output is None:
        output = folders[0] / REPORT if len(folders) == 1 else Path("comparison.html")
    results = [read_result(folder) for folder in folders]
    check_writable(output, "--output")
    write(output, page_of(results).encode())
    return output
