"""Which values of parameter files are for a node, and what is wrong with them."""

import difflib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from insdvl.files import beginning
from insdvl.parameters.declaration import ParameterError, build, declarations, faults
from insdvl.parameters.files import Given, ParameterFile, effective, matches, read, repeated

_Group = TypeVar("_Group")

#: Names of our nodes, and so of their sections in a parameter file.
NODES = (
    "insdvl_filter",
    "insdvl_tuner",
    "insdvl_replay",
    "insdvl_simulator",
    "insdvl_relay",
    "insdvl_monitor",
)

#: Parameters that rclpy gives to every node.
ROS_NAMES = ("qos_overrides", "use_sim_time", "start_type_description_service")


@dataclass(frozen=True)
class Loaded(Generic[_Group]):
    """The parameters of a node.

    Attributes:
        parameters: The group.
        ignored: Values of sections for nodes of any name that this node does not know.
    """

    parameters: _Group
    ignored: tuple[Given, ...]


def is_ros_name(name: str) -> bool:
    """Whether a parameter belongs to rclpy."""
    return name.split(".")[0] in ROS_NAMES


def load_section(
    path: Path | Sequence[Path], node: str, group: type[_Group], *, required: bool = False
) -> _Group:
    """A group of parameters from ROS 2 parameter files.

    Args:
        path: The file, or files in their order.
        node: Name of the node; a full name, such as ``/auv/insdvl_filter``, or a bare one, whose
            namespace is found by `full_name`.
        group: Dataclass of its parameters.
        required: Whether a section must be for the node; if not, without one all are defaults.

    Raises:
        ParameterError: Files or values are refused; a line for each fault.
    """
    files = read([path] if isinstance(path, Path) else path)
    name = node if node.startswith("/") else full_name(files, node)
    if required and not any(reaches(file, [name]) for file in files):
        raise ParameterError(nothing_for(files[0], [name]))
    return load(files, name, group).parameters


def full_name(files: Sequence[ParameterFile], node: str) -> str:
    """Name of a node with its namespace: the root, or where the only section of that name is.

    Args:
        files: The files.
        node: Bare name of the node.

    Raises:
        ParameterError: There are sections of that name in several namespaces.
    """
    sections = {f"/{s.removeprefix('/')}" for file in files for s in file.sections}
    found = sorted(s for s in sections if s.rpartition("/")[2] == node and "*" not in s)
    if len(found) > 1 and f"/{node}" not in found:
        raise ParameterError(
            f"there are sections of several nodes '{node}': {', '.join(found)}; choose a namespace"
        )
    return found[0] if len(found) == 1 else f"/{node}"


def load(
    files: Sequence[ParameterFile],
    node: str,
    group: type[_Group],
    values: Mapping[str, Any] | None = None,
    others: Collection[str] = (),
) -> Loaded[_Group]:
    """The parameters of a node.

    Args:
        files: Parameter files, in their order.
        node: Full name of the node.
        group: Dataclass of its parameters.
        values: What the node was given, where that is known; by default what rcl makes of the files
            (see `files.effective`). A value that stands in no file has no place in a message.
        others: Names that other nodes of the process know: to all nodes, as -p NAME:=VALUE, such a
            value may be given.

    Raises:
        ParameterError: Values are refused; a line for each fault, with the place of the value.
    """
    places = effective(files, node)
    if values is None:
        values = {name: given.value for name, given in places.items()}
    values = {name: value for name, value in values.items() if not is_ros_name(name)}
    known = {declaration.name for declaration in declarations(group)}
    unknown = [name for name in values if name not in known and name in places]
    given = [g for file in files for g in file.given if matches(g.section, node)]
    own = {g.name for g in given if not g.is_for_all}
    of_others = [name for name in unknown if name in others and name not in own]
    own |= {g.name for g in given if g.is_argument}
    ignored = [name for name in unknown if name not in own and name not in of_others]
    left_out = {*ignored, *of_others}
    values = {name: value for name, value in values.items() if name not in left_out}
    found = [
        f"{second.place}: parameter '{first.name}' is given again, first in line {first.line}"
        for first, second in repeated(files, node)
        if first.name in known
    ]
    for name, fault in faults(group, values).items():
        in_file = name in places and not places[name].is_argument
        found.append(f"{places[name].place}: {fault}" if in_file else fault)
    if found:
        raise ParameterError("\n".join(found))
    return Loaded(build(group, values), tuple(places[name] for name in ignored))


def nothing_for(file: ParameterFile, nodes: Collection[str]) -> str:
    """Sentence about a file that has nothing for any of the nodes."""
    sections = beginning(", ".join(file.sections)) or "none"
    names = {section.rpartition("/")[2] for section in file.sections}
    near = {n for node in nodes for n in difflib.get_close_matches(node.rpartition("/")[2], names)}
    wanted = " or ".join(f"/**/{node.rpartition('/')[2]}" for node in nodes)
    hint = f"; is {', '.join(sorted(near))} misspelt, or in another namespace" if near else ""
    return (
        f"{file.path}: none of the file's values reached {_this(nodes)}: its sections are "
        f"{sections}, expected {wanted}{hint}"
    )


def _this(nodes: Collection[str]) -> str:
    return f"this node, {', '.join(nodes)}" if len(nodes) == 1 else f"any of {', '.join(nodes)}"


def reaches(file: ParameterFile, nodes: Collection[str]) -> bool:
    """Whether a section of a file is for one of the nodes."""
    return any(matches(section, node) for section in file.sections for node in nodes)


def _is_for_others(file: ParameterFile, nodes: Collection[str]) -> bool:
    """Whether a file names other nodes of ours and does not mean these by another name.

    One file of a vehicle is given to all of its nodes, and need not have a section for each.
    """
    sections = {section.rpartition("/")[2] for section in file.sections}
    names = {node.rpartition("/")[2] for node in nodes}
    ours = set(NODES)
    return bool(sections) and sections <= ours and names <= ours and not names & sections


def ignored_text(ignored: Sequence[Given]) -> str:
    """Sentence about ignored values of one file."""
    names = beginning(", ".join(given.name for given in ignored))
    sections = ", ".join(sorted({f"'{given.section}'" for given in ignored}))
    return f"{ignored[0].path}: unknown parameters are ignored in section {sections}: {names}"


def warnings(
    files: Sequence[ParameterFile], nodes: Collection[str], ignored: Sequence[Given]
) -> list[str]:
    """What an operator should know of files that were taken: a sentence for each file or value.

    Args:
        files: The files.
        nodes: Full names of the nodes that read them.
        ignored: The values that none of the nodes knows.
    """
    told = [
        nothing_for(file, nodes)
        for file in files
        if not (reaches(file, nodes) or _is_for_others(file, nodes))
    ]
    for path in dict.fromkeys(given.path for given in ignored):
        told.append(ignored_text([given for given in ignored if given.path == path]))
    return told
