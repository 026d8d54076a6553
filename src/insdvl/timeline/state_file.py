"""The filter's memory in a file, so that a filter that was killed goes on where it was.

The file is one line of JSON, then the bytes of one state record (state/). The line has what is
needed to refuse a file that is damaged, of another version, or of a filter whose numbers would mean
something else. Nothing in a file is executed, and no more of it is read than a record is long.
"""

import hashlib
import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from insdvl import files
from insdvl.arrays import Array, Records
from insdvl.navigation.events import MAX_DISTANCE, MAX_SPEED, MAX_VARIANCE, NS
from insdvl.navigation.filter import LAYOUT, Filter
from insdvl.navigation.geometry.earth import MAX_LATITUDE
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.settings import differences
from insdvl.navigation.state.fields import COVARIANCE, NEVER, NUMBER, STAMP, Field, State
from insdvl.navigation.state.layout import part
from insdvl.parameters.declaration import changed, flatten

FORMAT = "insdvl state 11"
#: The line of JSON is no longer than this [bytes].
MAX_HEADER = 65_536

#: Parameters, or groups of them, that decide what the numbers of a record mean, or with which the
#: operator says that another state is wanted.
DECIDING = (
    "frame_convention",
    "error_state",
    "imu.mount",
    "imu.lever_arm",
    "dvl.mount",
    "process_noise.",
    "initial.",
    "origin.",
)

_GROUPS = tuple(name for name in DECIDING if name.endswith("."))

#: For how long an unused file is reported after another has been written.
TOLD_NS = 60 * NS


class StateFileError(ValueError):
    """A state file cannot be used; the message says why."""


def encode(
    record: State, parameters: FilterParameters, settings: FilterParameters | None = None
) -> bytes:
    """The content of a file.

    Args:
        record: An initialised state.
        parameters: Of its filter, as it was started.
        settings: Its parameters with the settings in force; the same where None.
    """
    data = record.tobytes()
    header = {
        "format": FORMAT,
        "stamp_ns": int(record["channels"]["imu_ns"]),
        "layout": _layout(record.dtype),
        "blocks": _blocks(parameters),
        "parameters": _deciding(parameters),
    }
    if changes := differences(parameters, settings or parameters):
        header["settings"] = changes
    header["sha256"] = _digest(header, data)
    return json.dumps(header).encode() + b"\n" + data


def decode(data: bytes, filter_: Filter) -> Records:
    """The record in the content of a file, in an array of length 1.

    Args:
        data: The content.
        filter_: That is to go on with it.

    Raises:
        StateFileError: It is damaged, or of another version or filter.
    """
    line, newline, body = data.partition(b"\n")
    try:
        header = json.loads(line) if newline else None
    except (ValueError, RecursionError):
        header = None
    if not isinstance(header, dict) or not isinstance(header.get("parameters"), dict):
        raise StateFileError("damaged: the first line is not a header")
    if header.get("format") != FORMAT:
        theirs = files.shown(header.get("format"))
        raise StateFileError(
            f"written by another version of this software: its format is {theirs}, "
            f"this one reads '{FORMAT}'"
        )
    if header.get("layout") != _layout(LAYOUT.dtype):
        raise StateFileError("written by another version of this software")
    if len(body) != LAYOUT.dtype.itemsize or header.get("sha256") != _digest(header, body):
        raise StateFileError("damaged: wrong checksum")
    if header.get("blocks") != _blocks(filter_.parameters):
        raise StateFileError(
            f"written with different error states: optional blocks were "
            f"{files.shown(header.get('blocks'))}, now {files.shown(_blocks(filter_.parameters))}"
        )
    theirs, ours = header["parameters"], _deciding(filter_.parameters)
    for name in sorted(theirs.keys() | ours.keys()):
        if theirs.get(name) != ours.get(name):
            raise StateFileError(
                f"written with different parameters: '{name}' was {files.shown(theirs.get(name))}, "
                f"now {files.shown(ours.get(name))}"
            )
    record = np.frombuffer(body, LAYOUT.dtype).copy()
    _check(record[0])
    if header.get("stamp_ns") != int(record[0]["channels"]["imu_ns"]):
        raise StateFileError("damaged: the first line and the record have different stamps")
    return record


def decode_settings(data: bytes, parameters: FilterParameters) -> FilterParameters:
    """The parameters with the settings that were changed at run time and are in force.

    A setting that was started with another value than now is not taken: then the operator has
    decided anew.

    Args:
        data: The content of a file that `decode` takes.
        parameters: Of the filter that is to go on with it.

    Raises:
        StateFileError: Its settings are not those of any filter.
    """
    found = json.loads(data.partition(b"\n")[0]).get("settings", {})
    values = json.loads(json.dumps(flatten(parameters)))
    try:
        taken = {name: new for name, (old, new) in found.items() if values.get(name) == old}
        return changed(parameters, taken)
    except (AttributeError, TypeError, ValueError) as error:
        raise StateFileError(f"damaged: settings are {files.shown(found)}") from error


def load(path: Path, filter_: Filter) -> Records | None:
    """The record in a file, in an array of length 1; None where there is no file.

    Raises:
        StateFileError: It cannot be read, or `decode` refuses it.
    """
    data = _content(path)
    return None if data is None else decode(data, filter_)


def _content(path: Path) -> bytes | None:
    """What is in a file, None where there is none."""
    longest = MAX_HEADER + 1 + LAYOUT.dtype.itemsize
    try:
        if not path.exists():
            return None
        if not path.is_file():  # reading it might wait for ever
            raise StateFileError("not a regular file")
        with path.open("rb") as file:
            data = file.read(longest + 1)
    except OSError as error:
        raise StateFileError(f"cannot be read: {error.strerror or error}") from error
    if len(data) > longest:
        raise StateFileError(f"damaged: longer than {longest} bytes")
    return data


class StateFile:
    """Keeps a filter's state in a file.

    Attributes:
        path: The file.
        writes: How often it was written.
        failures: How often it could not be.
        error: Why the last attempt failed, None where it did not.
        unused: Why the file that was there at the start is not used; None where it is, and when
            another has been there for `TOLD_NS`. What is not used is set aside under the name with
            ``.unused`` behind it: the last known position is not lost to a clock that is not set.
        stamp_ns: Stamp of the state that was written last, None before.
        parameters: Of the filter, as it was started.
        settings: The same, after `load` with the settings that are in the file.
    """

    def __init__(self, path: Path, filter_: Filter) -> None:
        self.path = path
        self._filter = filter_
        self.parameters = self.settings = filter_.parameters
        self._period_ns = round(filter_.parameters.state_period * NS)
        self._tried_ns: int | None = None
        self.writes = 0
        self.failures = 0
        self.error: str | None = None
        self.unused: str | None = None
        self._loaded_ns: int | None = None
        self._first_ns: int | None = None  # of what was written
        self.stamp_ns: int | None = None

    def load(self) -> Records | None:
        """The record in the file, in an array of length 1; None where there is none to use."""
        try:
            data = _content(self.path)
            if data is None:
                return None
            record = decode(data, self._filter)
            self.settings = decode_settings(data, self.parameters)
        except StateFileError as error:
            self._set_aside(str(error))
            return None
        self._loaded_ns = self._tried_ns = int(record[0]["channels"]["imu_ns"])
        return record

    def left_at(self, stamp_ns: int, to_ns: int) -> bool:
        """Whether a time jump from one stamp to another leaves the state that was loaded.

        The file was then of another time than the samples, and is not used.
        """
        if self._loaded_ns != stamp_ns:
            return False
        self._loaded_ns = self._tried_ns = None
        limit = self._filter.parameters.jump_limit
        self._set_aside(
            f"its stamp is {stamp_ns / NS:.3f} s; the first sample, at {to_ns / NS:.3f} s, is not "
            f"within jump_limit ({limit:g} s) after it"
        )
        return True

    def _set_aside(self, why: str) -> None:
        self.unused = why
        aside = self.path.with_name(f"{self.path.name}.unused")
        try:
            if self.path.is_file():
                os.replace(self.path, aside)
        except OSError as error:
            self._fail(f"not set aside: {error.strerror or error}")

    def _fail(self, why: str) -> None:
        self.failures += 1
        self.error = why

    def offer(self, state: State) -> None:
        """Write a state, where the last one was tried `state_period` before; failures are kept.

        Args:
            state: An initialised state.
        """
        now_ns = int(state["channels"]["imu_ns"])
        if self._tried_ns is not None and 0 <= now_ns - self._tried_ns < self._period_ns:
            return
        self._tried_ns = now_ns
        try:
            _check(state)  # a good file is not replaced by what no filter would go on from
            content = encode(state, self.parameters, self._filter.parameters)
            files.write(self.path, content)
        except OSError as error:
            self._fail(error.strerror or str(error))
        except StateFileError as error:
            self._fail(f"state not written: {error}")
        else:
            if self._first_ns is None:
                self._first_ns = now_ns
            if not 0 <= now_ns - self._first_ns < TOLD_NS:
                self.unused = None
            self.writes += 1
            self.error, self.stamp_ns = None, now_ns

    def remove(self) -> None:
        """Forget the state; failures are kept."""
        self._tried_ns = self._first_ns = self.stamp_ns = self.unused = None
        try:
            os.unlink(self.path)
        except FileNotFoundError:
            pass
        except OSError as error:
            self._fail(error.strerror or str(error))


def _deciding(parameters: FilterParameters) -> dict[str, Any]:
    """Names and values of the parameters that decide, as JSON has them."""
    values = flatten(parameters)
    deciding = {n: v for n, v in values.items() if n in DECIDING or n.startswith(_GROUPS)}
    return dict(json.loads(json.dumps(deciding)))


def _blocks(parameters: FilterParameters) -> list[list[Any]]:
    """Name and size of each optional block of error states, in their order."""
    sensors = parameters.sensors.values()
    return [[block.name, len(block.std)] for sensor in sensors for block in sensor.blocks()]


def _layout(dtype: np.dtype[np.void]) -> str:
    """Digest of the names, types, shapes and places of a record's fields."""
    return _sha256(repr([dtype.descr, dtype.itemsize]).encode())


def _digest(header: dict[str, Any], body: bytes) -> str:
    """Of the record, and of the settings where some were changed."""
    changes = header.get("settings")
    return _sha256((json.dumps(changes).encode() if changes else b"") + body)


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _check(s: State) -> None:
    """Refuse a record that no filter could have written.

    Raises:
        StateFileError: It names the field.
    """
    nav, imu_ns = s["nav"], s["channels"]["imu_ns"]

    def require(right: Any, name: str, value: Any) -> None:
        if not right:
            raise StateFileError(f"damaged: '{name}' is {files.shown(np.asarray(value).tolist())}")

    require(nav["initialised"] == 1, "initialised", nav["initialised"])
    require(0 <= nav["time_ns"] == imu_ns, "imu_ns", imu_ns)
    for path, field in LAYOUT.fields():
        value = part(s, path)[field.name]
        require(_holds(field, value, nav["time_ns"]), ".".join((*path, field.name)), value)
    require(np.isfinite([nav["lat_0"], nav["lon_0"], nav["h_0"]]).all(), "lat_0", nav["lat_0"])
    require(abs(nav["lat_0"]) <= MAX_LATITUDE, "lat_0", nav["lat_0"])
    C = nav["C_n_b"]
    require(np.abs(C @ C.T - np.eye(3)).max() < 1e-6 and np.linalg.det(C) > 0.0, "C_n_b", C)
    require(np.abs(nav["v_n"]).max() <= MAX_SPEED, "v_n", nav["v_n"])
    for name in ("llh", "llh_r"):
        sizes = np.abs(nav[name])
        require((sizes <= (MAX_LATITUDE, np.pi, MAX_DISTANCE)).all(), name, nav[name])


def _holds(field: Field, value: Array, time_ns: int) -> bool:
    """Whether a field holds what it may, in a state at a time."""
    if field.holds == STAMP:
        stamps = np.asarray(value)
        return bool((((stamps >= 0) & (stamps <= time_ns)) | (stamps == NEVER)).all())
    if field.holds == NUMBER:
        return bool(np.isfinite(value).all())
    if field.holds == COVARIANCE:
        scale = np.abs(value).max()
        if not scale <= MAX_VARIANCE:  # nan is not
            return False
        symmetric = np.abs(value - value.T).max() <= 1e-9 * scale
        return bool(symmetric and np.linalg.eigvalsh(value)[0] >= -1e-9 * scale)
    return True
