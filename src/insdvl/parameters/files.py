"""Parameter files of ROS 2, read as rcl reads them, so that a node and a command agree.

rcl has its own rules: how the names of nodes and of parameters nest, that a list has one type, and
in which order values replace each other; what a text means is in scalars.py. What rcl refuses is
refused here, in its words where they tell the fault, but all faults of all files at once. Files
that are too large or too deeply nested are refused beside that (see `yaml_files`).
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from insdvl import yaml_files
from insdvl.files import shown
from insdvl.parameters.declaration import ParameterError
from insdvl.parameters.scalars import TYPES, scalar, type_name
from insdvl.yaml_files import Mapping, Scalar, YamlError

_PARAMETERS = "ros__parameters"

#: Stands for the file of an argument.
ARGUMENT = Path("-p")

#: A part of a section's name: a name, ``*`` for any one name, or ``**`` for any number of them.
_PART = re.compile(r"[A-Za-z_][A-Za-z0-9_]*|\*{1,2}")


@dataclass(frozen=True)
class Given:
    """A value that a file gives to a parameter.

    Attributes:
        path: The file, or `ARGUMENT`.
        line: Line of the value; an argument has none, 0.
        section: Name of the section, such as ``/**`` or ``/auv/insdvl_filter``.
        name: Full name of the parameter.
        value: bool, int, float, str, or a list of one of them; an empty list is no value to rcl.
        nested: Whether the name was nested, not dotted.
    """

    path: Path
    line: int
    section: str
    name: str
    value: Any
    nested: bool

    @property
    def is_argument(self) -> bool:
        """Whether it stands on a command line."""
        return self.path == ARGUMENT

    @property
    def place(self) -> str:
        """Where it stands, for a message."""
        if self.is_argument:
            return f"-p {self.name}"
        return f"{self.path}, line {self.line}, section '{self.section}'"

    @property
    def is_for_all(self) -> bool:
        """Whether it is for nodes of any name: the last part of the section is a wildcard."""
        return self.section.endswith("*")


@dataclass(frozen=True)
class ParameterFile:
    """What a file says.

    Attributes:
        path: The file.
        sections: Names of its sections.
        given: All values, in their order.
    """

    path: Path
    sections: tuple[str, ...]
    given: tuple[Given, ...]


def read(paths: Sequence[Path]) -> list[ParameterFile]:
    """Parameter files.

    Raises:
        ParameterError: Files cannot be read, or are not parameter files; a line for each fault.
    """
    files, faults = [], []
    for path in paths:
        reader = _Reader(path)
        try:
            for document in yaml_files.nodes(path):
                reader.level(document, "")
        except OSError as error:
            reader.fault(error.strerror or str(error))
        except YamlError as error:
            reader.fault(str(error))
        files.append(ParameterFile(path, tuple(reader.sections), tuple(reader.given)))
        faults += reader.faults
    if faults:
        raise ParameterError("\n".join(faults))
    return files


def argument(rule: str) -> ParameterFile:
    """A parameter of the command line, as a file of one value that has no lines.

    Args:
        rule: What follows ``-p``: ``NAME:=VALUE``, or ``NODE:NAME:=VALUE``.

    Raises:
        ParameterError: It is none.
    """
    target, separator, text = rule.partition(":=")
    node, _, name = target.rpartition(":")
    try:
        documents = yaml_files.documents(text.encode())
        if not (separator and name and len(documents) == 1) or isinstance(documents[0], Mapping):
            raise YamlError("it must be NAME:=VALUE")
        value = _value(name, documents[0])
    except YamlError as error:
        raise ParameterError(f"cannot read the argument -p {shown(rule)}: {error}") from error
    section = node or "/**"
    given = Given(ARGUMENT, 0, section, name, value, nested=False)
    return ParameterFile(given.path, (section,), (given,))


def matches(section: str, node: str) -> bool:
    """Whether a section is for a node.

    Args:
        section: Its name; ``/*`` in it stands for any one name and ``/**`` for any number of them.
        node: The node's full name, such as ``/auv/insdvl_filter``.
    """
    wildcards = {"*": r"/\w+", "**": r"(/\w+)*"}
    parts = section.removeprefix("/").split("/")
    pattern = "".join(wildcards.get(part, f"/{part}") for part in parts)
    return re.fullmatch(pattern, node, re.ASCII) is not None


def effective(files: Sequence[ParameterFile], node: str) -> dict[str, Given]:
    """The values that reach a node, by their names, as rcl and rclpy merge them.

    Sections are merged in the order in which their names appear first. In one section a later value
    replaces an earlier one.

    Args:
        files: In their order on the command line.
        node: The node's full name.
    """
    sections: dict[str, list[_Entry]] = {}
    for file in files:
        for section in file.sections:
            sections.setdefault(section, [])
        for given in file.given:
            _enter(sections[given.section], given)
    found: dict[str, Given] = {}
    for section, entries in sections.items():
        if matches(section, node):
            found |= {entry.name: entry.effective for entry in entries}
    return found


def repeated(files: Sequence[ParameterFile], node: str) -> Iterator[tuple[Given, Given]]:
    """Values that one section of one file gives twice to a parameter of a node.

    rcl takes one of them in silence.
    """
    for file in files:
        first: dict[tuple[str, str], Given] = {}
        for given in file.given:
            before = first.setdefault((given.section, given.name), given)
            if before is not given and matches(given.section, node):
                yield before, given


class _Entry:
    """A value in rcl's list of a section, which keeps what was given before with another type."""

    def __init__(self, given: Given) -> None:
        self.name = given.name
        self._given = {_rank(given.value): given}

    def replace(self, given: Given) -> None:
        self._given[_rank(given.value)] = given

    @property
    def effective(self) -> Given:
        """The one that rclpy takes, by its type."""
        return self._given[min(self._given)]


def _enter(entries: list[_Entry], given: Given) -> None:
    """A dotted name replaces the first entry of that name; a nested one is always a new entry."""
    same = [entry for entry in entries if entry.name == given.name]
    if same and not given.nested:
        same[0].replace(given)
    else:
        entries.append(_Entry(given))


def _rank(value: Any) -> int:
    """Place of a value's type in the order in which rclpy looks for a value."""
    if not isinstance(value, list):
        return TYPES.index(type(value))
    return len(TYPES) + (TYPES.index(type(value[0])) if value else len(TYPES))


class _Reader:
    """Collects sections, values and faults of one file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.sections: list[str] = []
        self.given: list[Given] = []
        self.faults: list[str] = []

    def fault(self, text: str) -> None:
        self.faults.append(f"cannot read the parameter file {self._path}: {text}")

    def level(self, node: yaml_files.Node, name: str) -> None:
        """A level of names of nodes: each key is a part of a name, until one is ros__parameters."""
        if not isinstance(node, Mapping):
            self._no_value(node)
            return
        is_first = True
        for key, value in node.items:
            if key.text == _PARAMETERS and not is_first:
                self.fault(f"{_PARAMETERS} in line {key.line} is not the only one of its section")
            elif key.text == _PARAMETERS:
                is_first = False
                self._section(name, key.line, value)
            else:
                self.level(value, f"{name.removesuffix('/')}/{key.text}" if name else key.text)

    def _no_value(self, node: yaml_files.Node) -> None:
        self.fault(f"Cannot have a value before {_PARAMETERS} at line {node.line}")

    def _section(self, name: str, line: int, node: yaml_files.Node) -> None:
        parts = name.removeprefix("/").split("/")
        wrong = [part for part in parts if not _PART.fullmatch(part)]
        if not name:
            self.fault(f"There are no node names before {_PARAMETERS} at line {line}")
        elif wrong:
            self.fault(f"section {shown(name)} in line {line}: {shown(wrong[0])} is not a name")
        elif not isinstance(node, Mapping):
            self._no_value(node)
        else:
            self.sections.append(name)
            self._values(node, name, "", is_last=True)

    def _values(self, node: Mapping, section: str, prefix: str, *, is_last: bool) -> None:
        for k, (key, value) in enumerate(node.items, 1):
            name, is_end = prefix + key.text, is_last and k == len(node.items)
            if not key.text:
                self.fault(f"No key at line {key.line}")
            elif isinstance(value, Mapping) and value.items:
                self._values(value, section, f"{name}.", is_last=is_end)
            elif isinstance(value, Mapping) and not is_end:  # it confuses rcl
                self.fault(f"'{name}' in line {key.line} is empty")
            else:
                try:
                    found = [] if isinstance(value, Mapping) else _value(name, value)
                except YamlError as error:
                    self.fault(str(error))
                else:
                    at = self._path, key.line, section
                    self.given.append(Given(*at, name, found, nested=bool(prefix)))


def _value(name: str, node: Scalar | yaml_files.Sequence) -> Any:
    """A value or a list of values.

    Raises:
        YamlError: It is none.
    """
    if isinstance(node, Scalar):
        return scalar(node)
    values: list[Any] = []
    for element in node.elements:
        if not isinstance(element, Scalar):
            raise YamlError(f"'{name}' in line {element.line} has lists or names in a list")
        value = scalar(element)
        if values and type(value) is not type(values[0]):
            raise YamlError(
                f"Sequence should be of same type. Value type '{type_name(value)}' do not belong "
                f"at line_num {element.line}"
            )
        values.append(value)
    return values
