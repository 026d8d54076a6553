"""Text files with a row for each sample: read into arrays, by a map."""

import csv
from collections.abc import Iterator, Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import NamedTuple

import numpy as np

from insdvl.arrays import Array, Stamps
from insdvl.commands import nearest
from insdvl.files import beginning
from insdvl.studies.exchange.maps import STAMP_UNITS, MapError, SourceMap

MAX_BYTES = 2 * 2**30  # a day of an IMU at 200 Hz has about 2 GB
#: Stamps that a header can hold [ns]: seconds are a signed number of 32 bits.
MAX_STAMP_NS = (2**31 - 1) * 10**9
_SEPARATORS = (",", ";", "\t")


class Table(NamedTuple):
    """What was read of a file.

    Attributes:
        stamps_ns: (N,) stamps, in the order of the file [ns].
        values: By quantity (N, m), in SI, in the axes of the file; nan where there is no number.
        left_out: Lines of rows without a number in a quantity that every row must have.
    """

    stamps_ns: Stamps
    values: dict[str, Array]
    left_out: list[int]


def read_table(path: Path, source: SourceMap) -> Table:
    """Read a file.

    A row that lacks a number is left out; of a sigma it means that none is known.

    Raises:
        MapError: The file cannot be read, lacks a column, or has something else than numbers.
    """
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise MapError(f"{path} has {size} bytes, more than the limit of {MAX_BYTES}")
        with path.open(encoding="utf-8-sig", newline="") as file:
            return _read(path, source, file)
    except OSError as error:
        raise MapError(f"cannot read {path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise MapError(f"{path} is not a text file: {error}") from error
    except csv.Error as error:
        raise MapError(f"{path} cannot be read as a table: {error}") from error


def _read(path: Path, source: SourceMap, lines: Iterator[str]) -> Table:
    rows = _rows(lines, source)
    places = _places(path, source, rows)
    unit_ns = STAMP_UNITS[source.stamp_unit]
    stamps, numbers, left_out = [], [], []
    needed = _needed(source)
    for line, row in rows:
        if len(row) <= max(places):
            raise MapError(
                f"{path} line {line} has {len(row)} columns, column {max(places) + 1} is needed"
            )
        values = [_number(path, line, row[place]) for place in places[1:]]
        if not np.isfinite(np.array(values)[needed]).all():
            left_out.append(line)
            continue
        stamps.append(_stamp_ns(path, line, row[places[0]], unit_ns))
        numbers.append(values)
    if not stamps:
        raise MapError(f"{path} has no row with numbers in all columns of the map")
    read, values_of, first = np.array(numbers), {}, 0
    for name, quantity in source.quantities.items():
        width = len(quantity.columns)
        values_of[name] = quantity.factor * read[:, first : first + width]
        first += width
    return Table(np.array(stamps, dtype=np.int64), values_of, left_out)


def _rows(lines: Iterator[str], source: SourceMap) -> Iterator[tuple[int, list[str]]]:
    """Numbers of lines, and their texts; the first is that of the names where the map has names.

    That is the first comment that has them all, else the first line that is none.
    """
    for _ in range(source.skip):
        next(lines, "")
    separator = source.separator
    names = {column for column in source.columns if isinstance(column, str)}
    begun = False
    for number, text in enumerate(lines, source.skip + 1):
        if not text.strip():
            continue
        if text.startswith("#"):
            told = text.lstrip("#")
            row = _cells(told, source.separator or _separator_of(told))
            if begun or not names or not names <= set(row):
                continue
        else:
            separator = separator or _separator_of(text)
            row = _cells(text, separator)
        begun = True
        yield number, row


def _separator_of(text: str) -> str:
    return next((separator for separator in _SEPARATORS if separator in text), " ")


def _cells(text: str, separator: str) -> list[str]:
    if separator == " ":
        return text.split()
    (row,) = csv.reader([text], delimiter=separator)
    return [cell.strip() for cell in row]


def _places(path: Path, source: SourceMap, rows: Iterator[tuple[int, list[str]]]) -> list[int]:
    """Where the columns of a map are in a row; takes the line of names where there is one."""
    columns = source.columns
    if all(isinstance(column, int) for column in columns):
        return [int(column) - 1 for column in columns]
    _, names = next(rows, (0, []))
    if not names:
        raise MapError(f"{path} is empty: it has no line with the names of its columns")
    faults = []
    for column in columns:
        if isinstance(column, str) and column not in names:
            faults.append(
                f"{path} has no column {column!r}{nearest(column, names)} "
                f"(it has {beginning(', '.join(names))})"
            )
    if faults:
        raise MapError("\n".join(dict.fromkeys(faults)))
    return [c - 1 if isinstance(c, int) else names.index(c) for c in columns]


def _needed(source: SourceMap) -> Array:
    """Which numbers of a row must be there."""
    return np.array(
        [name != "sigma" for name, q in source.quantities.items() for _ in q.columns], dtype=bool
    )


def _number(path: Path, line: int, text: str) -> float:
    if not text:
        return float("nan")
    try:
        return float(text)
    except ValueError:
        raise MapError(f"{path} line {line}: {beginning(text)!r} is not a number") from None


def _stamp_ns(path: Path, line: int, text: str, unit_ns: int) -> int:
    """A stamp to the nanosecond, which a float of seconds since 1970 has not."""
    try:
        stamp_ns = int((Decimal(text) * unit_ns).to_integral_value())
    except (InvalidOperation, ValueError, OverflowError):
        raise MapError(f"{path} line {line}: {beginning(text)!r} is not a stamp") from None
    return stamp_ns


def check_stamps(path: Path, stamps_ns: Stamps) -> None:
    """Check that stamps can stand in a header.

    Raises:
        MapError: One is zero or below, which means that there is none, or too large.
    """
    low, high = int(stamps_ns.min()), int(stamps_ns.max())
    if low <= 0:
        raise MapError(
            f"{path} has the stamp {low / 1e9:g} s, stamps must be above 0: set stamp_offset"
        )
    if high > MAX_STAMP_NS:
        raise MapError(
            f"{path} has the stamp {high / 1e9:g} s, at most {MAX_STAMP_NS // 10**9} s is "
            "possible: set stamp_unit"
        )


def lines_text(lines: Sequence[int]) -> str:
    """The first of some lines, for a message."""
    shown = ", ".join(map(str, lines[:5]))
    return f"{shown} and {len(lines) - 5} more" if len(lines) > 5 else shown
