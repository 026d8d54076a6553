"""The command `insdvl report`: the page of a result, or of two side by side."""

import argparse
import sys
from pathlib import Path

from insdvl.extras import MissingPackageError
from insdvl.files import check_writable, write
from insdvl.studies.report.page import page_of
from insdvl.studies.report.results import REPORT, Result, read_result


def run(arguments: argparse.Namespace) -> int:
    """Write the page. The exit code is 2 if the input is refused; then nothing is written."""
    try:
        for path in _report(arguments):
            print(path)
    except (ValueError, OSError, MissingPackageError) as error:
        print(f"insdvl report: {error}", file=sys.stderr)
        return 2
    return 0


def _report(arguments: argparse.Namespace) -> list[Path]:
    """The files that were written."""
    folders: list[Path] = arguments.results
    if len(folders) > 2:
        raise ValueError(f"one or two results can be shown, got {len(folders)}")
    output: Path | None = arguments.output
    if output is None:
        output = folders[0] / REPORT if len(folders) == 1 else Path("comparison.html")
    pictures = {f"--{name}": getattr(arguments, name) for name in ("png", "pdf", "svg")}
    results = [read_result(folder) for folder in folders]
    for option, path in {"--output": output, **pictures}.items():
        if path is not None:
            check_writable(path, option)
    for option, path in pictures.items():
        if path is not None and path.suffix != f".{option[2:]}":
            raise ValueError(f"{option} {path}: the name must end in .{option[2:]}")
    write(output, page_of(results).encode())
    written = [output]
    for path in pictures.values():
        if path is not None:
            draw_result(path, results[0])
            written.append(path)
    return written


def draw_result(path: Path, result: Result) -> None:
    """Draw a result on paper; only this needs matplotlib."""
    from insdvl.studies.report import plots

    plots.draw_result(path, result)
