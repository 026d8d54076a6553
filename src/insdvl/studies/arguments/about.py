"""The arguments of the commands that tell something of the software."""

import argparse

from insdvl.commands import examples
from insdvl.studies.arguments.output import add_json_option

SHELLS = ("bash", "zsh")


def models(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `insdvl models`."""
    parser.epilog = examples("models", "models --json -")
    add_json_option(parser, alone=True)


def params(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `insdvl params`."""
    parser.epilog = examples(
        "params lever_arm", "params heading --node insdvl_filter", "params --json parameters.json"
    )
    parser.add_argument(
        "word",
        nargs="?",
        default="",
        metavar="WORD",
        help="part of the name or of the meaning; all parameters without it",
    )
    parser.add_argument("--node", metavar="NODE", help="of this node only, such as insdvl_filter")
    add_json_option(parser)


def doctor(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `insdvl doctor`."""
    parser.epilog = examples("doctor", "doctor --json -", "doctor && insdvl check dive")
    add_json_option(parser)


def warm(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `insdvl warm`: there are none."""
    parser.epilog = examples("warm", "warm && insdvl doctor")


def cite(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `insdvl cite`: there are none."""
    parser.epilog = examples("cite", "cite > insdvl.bib")


def completion(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `insdvl completion`."""
    parser.epilog = examples(
        "completion bash > ~/.local/share/bash-completion/completions/insdvl",
        "completion zsh > ~/.zsh/completions/_insdvl",
    )
    parser.add_argument("shell", choices=SHELLS, metavar="SHELL", help=" or ".join(SHELLS))
