"""Parameters that a command line sets: they take precedence over all files."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from typing import Any, TypeVar

from insdvl.parameters.declaration import ParameterError, declarations
from insdvl.parameters.files import ParameterFile, argument, effective
from insdvl.parameters.sections import Loaded, load

_Group = TypeVar("_Group")


def settings(
    rules: Sequence[str], groups: Mapping[str, type[Any]], faults: list[str]
) -> dict[str, dict[str, Any]]:
    """The values that are set, by node and name; a later one replaces an earlier one.

    Args:
        rules: ``NAME=VALUE``, or ``NODE:NAME=VALUE`` where several nodes know the name.
        groups: The parameters of each node.
        faults: What is wrong is added to it: a rule that is none, or a name that no node knows.
    """
    known = {node: {d.name for d in declarations(group)} for node, group in groups.items()}
    found: dict[str, dict[str, Any]] = {node: {} for node in groups}
    for rule in rules:
        try:
            _set(rule, known, found)
        except ParameterError as error:
            faults.append(f"--set {rule}: {error}")
    return found


def _set(rule: str, known: Mapping[str, set[str]], found: Mapping[str, dict[str, Any]]) -> None:
    target, separator, text = rule.partition("=")
    node, _, name = target.strip().rpartition(":")
    if not separator or not name:
        raise ParameterError("it must be NAME=VALUE")
    if node and node not in known:
        raise ParameterError(f"the nodes are {', '.join(known)}")
    nodes = [n for n, names in known.items() if name in names and node in ("", n)]
    if not nodes:
        every = sorted(set().union(*known.values()) if not node else known[node])
        near = get_close_matches(name, every, n=1)
        hint = f"; did you mean {near[0]}?" if near else ""
        raise ParameterError(f"unknown parameter {name!r}{hint}")
    try:
        (given,) = argument(f"{name}:={text}").given
    except ParameterError as error:
        raise ParameterError(str(error).partition(": ")[2]) from error
    for known_to in nodes:
        found[known_to][name] = given.value


def load_set(
    files: Sequence[ParameterFile], node: str, group: type[_Group], told: Mapping[str, Any]
) -> Loaded[_Group]:
    """The parameters of a node from files, and from what is set.

    Args:
        files: Parameter files, in their order.
        node: Full name of the node.
        group: Dataclass of its parameters.
        told: What is set, by name.

    Raises:
        ParameterError: Values are refused; a line for each fault.
    """
    # What is replaced is not judged, and a fault of what replaces it has no place in a file.
    kept = [
        replace(file, given=tuple(given for given in file.given if given.name not in told))
        for file in files
    ]
    values = {name: given.value for name, given in effective(kept, node).items()}
    return load(kept, node, group, {**values, **told})
