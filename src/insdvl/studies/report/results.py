"""The folder of a result as `insdvl replay` writes it, read back for the report."""

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array
from insdvl.files import read_json

NUMBERS = "numbers.json"
TRACK = "track.csv"
UPDATES = "updates.csv"
REFERENCE = "reference.csv"
REPORT = "report.html"

#: Limits of what is read: a day of states at 10 Hz has 400 MB.
MAX_NUMBERS_BYTES = 64 * 2**20
MAX_TABLE_BYTES = 2**30


class ResultError(ValueError):
    """A folder is not a result, or is damaged; the message names the file."""


@dataclass(frozen=True)
class Updates:
    """What the filter did with M measurements of one kind.

    Attributes:
        stamp: (M,) [s].
        accepted: (M,) whether each was used.
        reason: (M,) why not.
        nis: (M,) normalised innovation squared, nan where nothing was predicted.
        rows: (M,) number of rows that were measured, 0 where nothing was predicted.
        innovation: (M, m) innovations.
        sigma: (M, m) what the filter expected of them, one sigma.
    """

    stamp: Array
    accepted: NDArray[np.bool_]
    reason: NDArray[np.str_]
    nis: Array
    rows: Array
    innovation: Array
    sigma: Array


@dataclass(frozen=True)
class Result:
    """A result.

    Attributes:
        title: Name of the folder.
        numbers: The JSON document.
        track: Columns of track.csv by name.
        updates: By measurement.
        reference: Columns of reference.csv; None without a reference.
    """

    title: str
    numbers: dict[str, Any]
    track: dict[str, Array]
    updates: dict[str, Updates]
    reference: dict[str, Array] | None

    @property
    def start(self) -> float:
        """Stamp of the first state [s]; the report counts from there."""
        return float(self.track["stamp"][0])

    @property
    def duration(self) -> float:
        """Time from the first to the last state [s]."""
        return float(self.track["stamp"][-1]) - self.start

    def vector(self, name: str, letters: str = "xyz") -> Array:
        """(N, m) of columns of the track that differ by their last letter."""
        return np.stack([self.track[f"{name}_{letter}"] for letter in letters], axis=1)

    @property
    def is_enu(self) -> bool:
        """Whether the axes of the stream are east, north, up."""
        told = self.numbers["parameters"]["insdvl_filter"]
        return bool(told["frame_convention"] == "enu")

    def east_north(self, values: Array) -> Array:
        """(N, 2) east and north of values (N, >= 2) along x and y of the navigation axes."""
        return values[:, :2] if self.is_enu else values[:, 1::-1]

    def depth(self, z: Array) -> Array:
        """Depth below the origin (N,) of coordinates z (N,) [m]."""
        return -z if self.is_enu else z

    @property
    def horizontal_covariance(self) -> Array:
        """(N, 2, 2) of east and north [m^2]."""
        sigma = self.east_north(self.vector("position_sigma"))
        P = np.einsum("ki,ij->kij", sigma**2, np.eye(2))
        P[:, 0, 1] = P[:, 1, 0] = self.track["position_covariance_xy"]
        return P

    @property
    def heading_deg(self) -> Array:
        """(N,) heading from north through east, without jumps [deg]."""
        yaw = np.degrees(np.unwrap(np.radians(self.track["yaw_deg"])))
        heading = 90.0 - yaw if self.is_enu else yaw
        return heading - 360.0 * np.floor(heading[0] / 360.0)

    @property
    def body_axes(self) -> list[str]:
        """Names of the axes of the body."""
        return ["forward", "left", "up"] if self.is_enu else ["forward", "right", "down"]

    def of_reference(self, name: str, letters: str = "xyz") -> Array:
        """(N, m) of columns of the reference."""
        assert self.reference is not None
        return np.stack([self.reference[f"{name}_{letter}"] for letter in letters], axis=1)


def read_result(folder: Path, title: str = "") -> Result:
    """Read a result.

    Args:
        folder: That `insdvl replay` wrote.
        title: In place of the folder's name.

    Raises:
        ResultError: The folder is not a result, or a file in it is damaged.
    """
    if not folder.is_dir():
        raise ResultError(f"{folder} is not a folder; insdvl replay writes one")
    if not (folder / NUMBERS).is_file():
        raise ResultError(f"{folder} is not a result of insdvl replay: it has no {NUMBERS}")
    try:
        numbers = read_json(folder / NUMBERS, MAX_NUMBERS_BYTES)
    except ValueError as error:
        raise ResultError(str(error)) from error
    reference = folder / REFERENCE
    return Result(
        title or folder.name,
        numbers,
        _table(folder / TRACK),
        _updates(folder / UPDATES),
        _table(reference) if reference.exists() else None,
    )


def _checked(path: Path) -> Path:
    try:
        size = path.stat().st_size
    except OSError as error:
        raise ResultError(f"cannot read {path}: {error.strerror or error}") from error
    if size > MAX_TABLE_BYTES:
        raise ResultError(f"{path} has {size} bytes, more than the limit of {MAX_TABLE_BYTES}")
    return path


def _table(path: Path) -> dict[str, Array]:
    """The columns of a table of numbers, by name."""
    try:
        with _checked(path).open(encoding="utf-8") as file:
            names = file.readline().strip().split(",")
            values = np.loadtxt(file, delimiter=",", ndmin=2)
    except (OSError, ValueError) as error:
        raise ResultError(f"{path} is damaged: {error}") from error
    if not values.size or values.shape[1] != len(names):
        raise ResultError(f"{path} is damaged: its rows do not have {len(names)} numbers")
    return dict(zip(names, values.T, strict=True))


def _updates(path: Path) -> dict[str, Updates]:
    rows: dict[str, list[dict[str, str]]] = {}
    try:
        with _checked(path).open(encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file):
                rows.setdefault(row["measurement"], []).append(row)
        return {name: _of_kind(found) for name, found in rows.items()}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ResultError(f"{path} is damaged: {error}") from error


def _of_kind(rows: list[dict[str, str]]) -> Updates:
    def numbers(name: str) -> Array:
        return np.array([float(row[name] or "nan") for row in rows])

    count = sum(bool(rows[0].get(f"innovation_{k}")) for k in range(6))
    return Updates(
        stamp=numbers("stamp"),
        accepted=numbers("accepted") > 0.0,
        reason=np.array([row["reason"] for row in rows]),
        nis=numbers("nis"),
        rows=numbers("rows"),
        innovation=np.stack([numbers(f"innovation_{k}") for k in range(count)], axis=1),
        sigma=np.stack([numbers(f"sigma_{k}") for k in range(count)], axis=1),
    )
