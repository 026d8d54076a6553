"""The command `insdvl completion`: what a shell needs to complete commands and options."""

import argparse

from insdvl.commands import whole_parser
from insdvl.extras import extra


def run(arguments: argparse.Namespace) -> int:
    """Print the script.

    Raises:
        MissingPackageError: The package that writes it is not installed.
    """
    with extra("cli"):
        import shtab
    print(shtab.complete(whole_parser(), shell=arguments.shell))
    return 0
