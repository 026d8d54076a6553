"""Results of finished tasks on disk, so that an interrupted computation resumes.

A result belongs to the settings of its computation, to the files that hold its code, and to the
versions of the libraries. A change of any of them makes another folder, and removes the old one.
"""

import contextlib
import hashlib
import json
import platform
import re
import shutil
import sys
from collections.abc import Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from insdvl.files import archive, arrays, read, write
from insdvl.kernels import source_digest

MAX_RESULT_BYTES = 2**28  # of a stored result; those of a recording's windows have some megabytes

_LIBRARIES = ("numpy", "scipy", "numba", "scikit-learn")
_DIGEST = re.compile(r"[0-9a-f]{16}")  # names of a store's folders


@cache
def environment(source: Path) -> dict[str, str]:
    """What a result depends on besides its settings.

    Args:
        source: File of the module that computes it.

    Returns:
        ``insdvl``, the digest of that file and of all files of the package that it imports, and
        the versions of Python and of the libraries.
    """
    return {
        "insdvl": source_digest(source),
        "python": platform.python_version(),
        **{name: version(name) for name in _LIBRARIES},
    }


class Store:
    """Results on disk: ``folder/<digest>/<label>/<task>.npz``.

    The digest covers the settings and the `environment`. Results with another digest are removed.
    Two programs may use one store at the same time.

    Attributes:
        folder: Folder of the results; it exists.
    """

    def __init__(self, folder: Path, settings: Mapping[str, Any], source: Path) -> None:
        """Make the folder.

        Args:
            folder: Used by this store only.
            settings: The settings that the results depend on; must be valid JSON.
            source: File of the module that computes the results.

        Raises:
            OSError: The folder cannot be made.
        """
        text = json.dumps([settings, environment(source)], sort_keys=True)
        self._root = Path(folder)
        self.folder = self._root / hashlib.sha256(text.encode()).hexdigest()[:16]
        self.folder.mkdir(parents=True, exist_ok=True)
        for other in self._root.iterdir():
            if other != self.folder and _DIGEST.fullmatch(other.name):
                _remove(other)

    def path(self, label: str, task: str) -> Path:
        """File of a result."""
        return self.folder / label / f"{task}.npz"

    def clear(self) -> None:
        """Remove all results, and the folder unless it holds anything else."""
        _remove(self.folder)
        with contextlib.suppress(OSError):  # it holds the results of another program
            self._root.rmdir()


def _remove(folder: Path) -> None:
    # Another program may add to the folder, or remove it, at the same time; both are allowed.
    shutil.rmtree(folder, ignore_errors=True)


def write_result(path: Path, result: Mapping[str, NDArray[Any]]) -> None:
    """Write a result; the file is complete when it gets its name.

    Raises:
        OSError: It cannot be written.
    """
    data = archive(result)
    try:
        _write(path, data)
    except FileNotFoundError:  # another program removed the folder after we had made it
        _write(path, data)


def _write(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write(path, data)


def read_result(path: Path) -> Mapping[str, NDArray[Any]] | None:
    """A stored result; None where the file is missing or damaged, which is reported on stderr."""
    try:
        data = read(path, MAX_RESULT_BYTES)
        return arrays(data, len(data))  # results are stored without compression
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        print(f"{path} is damaged ({error}); computing it again", file=sys.stderr, flush=True)
        return None
