"""The subcommands of `insdvl` and how their arguments are parsed, without importing any of them.

A command is two functions, in two modules: one declares its arguments and imports nothing but the
standard library, so that a help or a wrong call is answered at once; the other runs it.
"""

import argparse
import difflib
import sys
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pkgutil import resolve_name
from types import MappingProxyType
from typing import Any, NoReturn

#: The last two are 128 and the signal, as shells have it: SIGINT, and SIGPIPE.
WRONG_CALL, INTERRUPTED, READER_GONE = 2, 130, 141


@dataclass(frozen=True)
class Command:
    """A subcommand.

    Attributes:
        arguments: ``module:function`` that declares the arguments on a parser.
        run: ``module:function`` from the parsed arguments to the exit code.
        meaning: What it does, in a few words.
        goal: What one wants of it, in the overview; empty where the overview only names it.
        example: Its arguments there.
        failed: What exit code 1 means; empty where there is none.
        kept: What an interruption leaves; empty for nothing.
        interrupted: What exit code 130 means.
    """

    arguments: str
    run: str
    meaning: str
    goal: str = ""
    example: str = ""
    failed: str = ""
    kept: str = ""
    interrupted: str = "interrupted (Ctrl-C)"

    @property
    def exit_codes(self) -> str:
        """What each exit code means."""
        failed = f"1 {self.failed}, " if self.failed else ""
        text = f"exit code: 0 done, {failed}2 wrong call or input refused, 130 {self.interrupted}"
        return textwrap.fill(text, 80)


def _study(name: str, meaning: str, **more: str) -> Command:
    """A command with a folder of its own among the studies."""
    arguments = f"insdvl.studies.arguments.{name}:add_arguments"
    return Command(arguments, f"insdvl.studies.{name}.command:run", meaning, **more)


def _about(name: str, meaning: str, **more: str) -> Command:
    """A command that tells something of the software."""
    arguments = f"insdvl.studies.arguments.about:{name}"
    return Command(arguments, f"insdvl.studies.about.{name}:run", meaning, **more)


def _exchange(arguments: str, name: str, meaning: str, **more: str) -> Command:
    """A command that reads or writes text files."""
    return Command(
        f"insdvl.studies.arguments.exchange:{arguments}",
        f"insdvl.studies.exchange.{name}:run",
        meaning,
        **more,
    )


_COMPUTES = {"failed": "a computation failed", "kept": "finished parts are kept, run it again"}

#: In the order of a first day.
COMMANDS: Mapping[str, Command] = MappingProxyType(
    {
        "check": _study(
            "check",
            "say what is in a recording and whether the filter can use it",
            goal="is it usable?",
            example="dive",
            failed="the recording is not usable",
        ),
        "init": _study(
            "init",
            "write a parameter file, filled from a recording",
            goal="make a parameter file",
            example="dive -o my.yaml",
            failed="the recording is not usable",
        ),
        "replay": _study(
            "replay",
            "run the filter over a rosbag2 recording",
            goal="navigate it",
            example="dive -c my.yaml --out run1",
            failed="with --strict, the verdict has a finding",
            interrupted="interrupted (Ctrl-C), with a result of what was navigated until then",
        ),
        "report": _study(
            "report",
            "write the page of a replay, or of two",
            goal="look at it again",
            example="run1 run2 -o both.html",
        ),
        "import": _exchange(
            "import_",
            "importing",
            "make a recording of text files of an IMU, a DVL and a reference",
            goal="take text files",
            example="imu.csv dvl.csv --map m.yaml --out dive",
        ),
        "export": _exchange("export", "exporting", "write a topic of a recording as CSV or TUM"),
        "train": _study(
            "training",
            "train a process noise model on simulations",
            goal="learn process noise",
            example="--preset default --out models",
            **_COMPUTES,
        ),
        "evaluate": _study(
            "evaluation",
            "compare sources of process noise on simulations",
            goal="compare sources of Q",
            example="--scenario varying --json varying.json",
            **_COMPUTES,
        ),
        "results": _study("results", "recompute the pages of results", **_COMPUTES),
        "consistency": _study(
            "consistency",
            "recompute the page on consistency: errors against their sigmas",
            **_COMPUTES,
        ),
        "models": _about("models", "list the shipped models"),
        "params": _about(
            "params",
            "explain parameters",
            goal="explain a parameter",
            example="lever_arm",
            failed="there is no such parameter",
        ),
        "doctor": _about(
            "doctor",
            "check the installation",
            goal="is the set-up right?",
            failed="something is wrong, and is named",
        ),
        "warm": Command(
            "insdvl.studies.arguments.about:warm",
            "insdvl.studies.warm:run",
            "compile all functions and cache them, for the first start",
            failed="nothing can be cached",
        ),
        "cite": _about("cite", "print BibTeX entries"),
        "completion": _about("completion", "print the completion script of a shell"),
    }
)


def nearest(name: str, known: Iterable[str]) -> str:
    """``; did you mean X?`` where one of the known names is near, else an empty text."""
    near = difflib.get_close_matches(name, list(known), n=1)
    return f"; did you mean {near[0]}?" if near else ""


class Names(tuple[str, ...]):
    """The names that an option knows, as its choices: a help and a completion list them.

    The parser takes any name: `unknown_names` tells a wrong one beside what else is wrong.
    """

    __slots__ = ()

    def __contains__(self, name: object) -> bool:
        return True


def unknown_names(option: str, names: Iterable[str], known: Sequence[str]) -> Iterator[str]:
    """A sentence for each name that is not among the known ones, with the nearest of them."""
    for name in names:
        if name not in known:
            near = nearest(name, known)
            yield f"{option}: unknown name {name!r}{near}; known are {', '.join(known)}"


class Parser(argparse.ArgumentParser):
    """Parses the arguments of a command; a wrong call is told in a few lines, not a whole usage."""

    def __init__(self, **options: Any) -> None:
        options.setdefault("allow_abbrev", False)
        options.setdefault("formatter_class", argparse.RawDescriptionHelpFormatter)
        super().__init__(**options)

    def unknown_options(self, words: Sequence[str]) -> list[str]:
        """A sentence for each word that looks like an option and is none."""
        known = self._option_string_actions  # argparse has no public name for it
        found = []
        for word in words:
            if word == "--":
                break
            name = word.partition("=")[0]
            if name.startswith("--") and name not in known:
                found.append(f"unknown option {name}{nearest(name, known)}")
        return found

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As argparse does; all unknown options are told together, before what may follow of it."""
        words = sys.argv[1:] if args is None else list(args)
        unknown = self.unknown_options(words)
        if unknown and not {"-h", "--help"} & set(words):
            self.error("\n".join(unknown))
        return super().parse_args(words, namespace)

    def error(self, message: str) -> NoReturn:
        """Say what is wrong with the call, one line for each, and end with `WRONG_CALL`."""
        lines = [f"{self.prog}: {line}" for line in message.splitlines()]
        self.exit(WRONG_CALL, "\n".join([*lines, f"See {self.prog} --help."]) + "\n")


def declare(name: str, parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of a command, and what its help says of examples and exit codes.

    What is parsed has `faults`, a function from it to what is wrong with the values, all at once.
    """
    command = COMMANDS[name]
    parser.set_defaults(faults=lambda arguments: [])
    resolve_name(command.arguments)(parser)
    parser.description = f"{command.meaning[0].upper()}{command.meaning[1:]}."
    parser.epilog = f"{parser.epilog}\n\n{command.exit_codes}"


def examples(*lines: str) -> str:
    """The epilog of a help, from the arguments of some calls."""
    return "\n".join(["examples:", *(f"  insdvl {line}" for line in lines)])


def parser_of(name: str) -> Parser:
    """The parser of one command."""
    parser = Parser(prog=f"insdvl {name}")
    declare(name, parser)
    return parser


def whole_parser() -> argparse.ArgumentParser:
    """One parser of all commands, as tools need it that look at parsers."""
    parser = argparse.ArgumentParser(prog="insdvl")
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND")
    for name, command in COMMANDS.items():
        declare(name, subparsers.add_parser(name, help=command.meaning))
    return parser


def overview() -> str:
    """What one can do, with an example each: 12 lines, 80 columns."""
    shown = {name: command for name, command in COMMANDS.items() if command.goal}
    others = ", ".join(name for name in COMMANDS if name not in shown)
    lines = [
        f"  {command.goal:23} insdvl {name} {command.example}".rstrip()
        for name, command in shown.items()
    ]
    return "\n".join(
        [
            "insdvl navigates by IMU and DVL: from a recording, here 'dive', to a track.",
            *lines,
            f"  also: {others}",
            "insdvl COMMAND --help has the options; insdvl --help lists all commands.",
        ]
    )


def summary() -> str:
    """All commands, each with its meaning."""
    width = max(map(len, COMMANDS)) + 2
    lines = ["usage: insdvl [--help] [--version] COMMAND ...", "", "commands:"]
    lines += [f"  {name:{width}}{command.meaning}" for name, command in COMMANDS.items()]
    lines += ["", "exit code: 0 done, 1 failed as the command's help says, 2 wrong call or input"]
    lines += ["refused, 130 interrupted (Ctrl-C)", "insdvl COMMAND --help has options and examples"]
    return "\n".join(lines)
