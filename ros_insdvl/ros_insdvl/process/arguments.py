"""The command line of a node: its help, and what of it gives parameters.

ROS has its own part of a command line, from ``--ros-args`` to ``--``. rcl reads it and keeps to
itself where a value came from, so it is looked through here as well.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from insdvl.parameters.declaration import ParameterError
from insdvl.parameters.files import ParameterFile, argument, read

#: Options of ROS that are followed by a value.
_WITH_VALUE = (
    *("-p", "--param", "--params-file", "-r", "--remap", "-e", "--enclave"),
    *("--log-level", "--log-config-file", "--log-file-name"),
)

_HELP = """\
usage: ros2 run {package} {executable} [--ros-args -p NAME:=VALUE ... --params-file FILE ...]

{about}

parameters
  ros2 param list {node}
  ros2 param describe {node} NAME
  docs/reference/parameters.md describes all of them; share/{package}/config has files of
  the defaults

examples
{examples}

Any topic may be remapped (-r FROM:=TO), the node renamed (-r __node:=NAME) and put into a namespace
(-r __ns:=/NAME). What the node finds wrong is on /diagnostics; docs/reference/diagnostics.md says
what to do.
"""


@dataclass(frozen=True)
class Help:
    """What ``--help`` says of an executable.

    Attributes:
        package: Its package.
        executable: Its name.
        node: Name of its node, with ``/``.
        about: What it is, with its topics and services.
        examples: What follows ``--ros-args`` in each example.
    """

    package: str
    executable: str
    node: str
    about: str
    examples: tuple[str, ...]

    @property
    def text(self) -> str:
        """All of it."""
        run = f"  ros2 run {self.package} {self.executable} --ros-args "
        return _HELP.format(
            package=self.package,
            executable=self.executable,
            node=self.node,
            about=self.about.strip(),
            examples="\n".join(run + example for example in self.examples),
        )


def answered(help_: Help, arguments: Sequence[str]) -> int | None:
    """Print the help, or what is wrong, where the command line asks for it; the exit code then.

    Args:
        help_: Of the executable.
        arguments: What follows its name.
    """
    own, _ = split(arguments)
    if any(argument in ("-h", "--help") for argument in own):
        print(help_.text, end="")
        return 0
    if own:
        print(
            f"{help_.executable}: unknown argument {own[0]!r}; parameters are given as "
            "--ros-args -p NAME:=VALUE, see --help",
            file=sys.stderr,
        )
        return 2
    return None


def split(arguments: Sequence[str]) -> tuple[list[str], list[tuple[str, str]]]:
    """The arguments that are not ROS's, and ROS's options with their values, both in order."""
    own: list[str] = []
    options: list[tuple[str, str]] = []
    for_ros = False
    words = iter(arguments)
    for word in words:
        if word == "--ros-args":
            for_ros = True
        elif not for_ros:
            own.append(word)
        elif word == "--":
            for_ros = False
        else:
            options.append((word, next(words, "") if word in _WITH_VALUE else ""))
    return own, options


def parameter_files(arguments: Sequence[str]) -> list[ParameterFile]:
    """The parameter files on a command line, and each ``-p`` as a file of its own, in their order.

    Raises:
        ParameterError: Some are refused; a line for each fault.
    """
    files: list[ParameterFile] = []
    faults: list[str] = []
    for option, value in split(arguments)[1]:
        try:
            if option == "--params-file":
                files += read([Path(value)])
            elif option in ("-p", "--param"):
                files.append(argument(value))
        except ParameterError as error:
            faults.append(str(error))
    if faults:
        raise ParameterError("\n".join(faults))
    return files
