"""The command `insdvl`."""

import sys
from collections.abc import Sequence
from pkgutil import resolve_name

from insdvl import __version__
from insdvl.commands import (
    COMMANDS,
    INTERRUPTED,
    READER_GONE,
    WRONG_CALL,
    nearest,
    overview,
    parser_of,
    summary,
)
from insdvl.extras import MissingPackageError
from insdvl.pipe import ReaderGone, guarded


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; `Command.exit_codes` says what the exit code means."""
    try:
        with guarded():
            return _main(arguments)
    except ReaderGone:
        return READER_GONE


def _main(arguments: Sequence[str] | None) -> int:
    name, *rest = (sys.argv[1:] if arguments is None else list(arguments)) or [""]
    if not name:
        print(overview())
    elif name in ("-h", "--help"):
        print(summary())
    elif name == "--version":
        print(f"insdvl {__version__}")
    elif name not in COMMANDS:
        what = "option" if name.startswith("-") else "command"
        print(
            f"insdvl: unknown {what} {name!r}{nearest(name, COMMANDS)}\n"
            f"The commands are {', '.join(COMMANDS)}.",
            file=sys.stderr,
        )
        return WRONG_CALL
    else:
        return _run(name, rest)
    return 0


def _run(name: str, words: list[str]) -> int:
    """Parse the arguments of a command, then import and run it."""
    command = COMMANDS[name]
    try:
        parsed = parser_of(name).parse_args(words)
        if faults := list(parsed.faults(parsed)):
            print("\n".join(f"insdvl {name}: {fault}" for fault in faults), file=sys.stderr)
            return WRONG_CALL
        return int(resolve_name(command.run)(parsed))
    except MissingPackageError as error:
        print(f"insdvl {name}: {error}", file=sys.stderr)
        return WRONG_CALL
    except KeyboardInterrupt:
        kept = f"; {command.kept}" if command.kept else ""
        print(f"insdvl {name}: interrupted{kept}", file=sys.stderr)
        return INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
