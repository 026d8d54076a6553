"""The command `insdvl report`: the page of a result, or of two side by side."""

import argparse
import sys
from pathlib import Path

from insdvl.extras import MissingPackageError
from insdvl.files import check_writable, write
from insdvl.studies.report.page import page_of
from insdvl.studies.report.results import REPORT, read_result


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
