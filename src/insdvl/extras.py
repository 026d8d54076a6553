"""Packages that only some uses of insdvl need, each in an extra: ``pip install './src[bags]'``.

Aboard, numpy, numba, scipy and pyyaml are enough.
"""

from collections.abc import Iterator
from contextlib import contextmanager


class MissingPackageError(ModuleNotFoundError):
    """A package of an extra is not installed; the message names both."""


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Import the packages of an extra within this context.

    Args:
        name: Of the extra in setup.py.

    Raises:
        MissingPackageError: One of them is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise MissingPackageError(
            f"{error.name} is not installed: install insdvl[{name}]", name=error.name
        ) from error
