"""Compilation of the hot functions with numba, and the cache of the compiled functions.

The cache is in the package itself, where its installation has compiled; in ``$INSDVL_CACHE_DIR``;
or in the user's cache folder. One that is filled may be read-only, as in an image. If there is none
to read or to write, the functions are compiled in memory, with one warning. A full, damaged or
read-only cache never stops a program; it costs compile time and one warning.

Cached functions are executed, as are the files in Python's ``__pycache__``. A folder that belongs
to another user than root, this one and the owner of the package, or is world-writable, is therefore
not used.

numba checks a cached function against its own source file only, not against the files of the
functions that it calls. The name of a cache folder therefore contains a digest of the source file,
of all files of this package that it imports, and of the versions of Python and numba. Editing
another file recompiles nothing. It also names the processor: on another one the functions are
compiled again, into a folder beside it.
"""

import contextlib
import errno
import hashlib
import os
import re
import stat
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core.caching import (
    CompileResultCacheImpl,
    FunctionCache,
    NullCache,
    _CacheLocator,
)
from numba.core.registry import cpu_target
from numba.core.runtime import rtsys

_Function = TypeVar("_Function", bound=Callable[..., Any])

_PACKAGE = Path(__file__).parent

#: Why functions are compiled, see `compiling`.
FIRST = "once for this version on this computer"
OTHER_PROCESSOR = "once more, because the compiled functions are for another processor"


class CacheWarning(UserWarning):
    """The compiled functions cannot be cached on disk; programs work, but start slowly."""


@dataclass
class _Listener:
    """Who is told of a compilation, see `compiling`."""

    begins: Callable[[str], None]
    warns: Callable[[str], None]
    began: float | None = None  # on the monotonic clock [s]


_listeners: list[_Listener] = []
_warned: list[str] = []


@contextlib.contextmanager
def compiling(
    begins: Callable[[str], None], ends: Callable[[float], None], warns: Callable[[str], None]
) -> Iterator[None]:
    """Tell of the compilation of functions that are called within and are not cached.

    Args:
        begins: Called before the first of them is compiled, with the reason, `FIRST` or
            `OTHER_PROCESSOR`; never if all are cached.
        ends: Called at the end, with the time since then [s].
        warns: Called in the place of the warning about the cache.
    """
    listener = _Listener(begins, warns)
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.remove(listener)
        if listener.began is not None:
            ends(time.monotonic() - listener.began)


def _tell_compilation(source: Path) -> None:
    """A function of a file is about to be compiled."""
    for listener in _listeners:
        if listener.began is None:
            listener.began = time.monotonic()
            listener.begins(OTHER_PROCESSOR if _is_for_another_processor(source) else FIRST)


def _warn_once(reason: str) -> None:
    """Warn once per program: later failures usually follow from the first."""
    _warned.append(reason)
    if len(_warned) > 1:
        return
    text = (
        f"compiled functions are not cached ({reason}); set INSDVL_CACHE_DIR to a writable folder"
    )
    if _listeners:
        _listeners[-1].warns(text)
    else:
        # Of no line of a file: Python would print that line below the warning.
        warnings.warn_explicit(text, CacheWarning, _PACKAGE.name, 0)


#: A line that imports, and what. Reading the syntax tree instead takes a fifth of the start.
_IMPORT = re.compile(r"^[ \t]*(?:from ([\w.]+) import (\([^)]*\)|.*)|import (.*))", re.MULTILINE)
_NAME = re.compile(r"[\w.]+")


@cache
def _imported(source: Path) -> set[Path]:
    """Files of this package that a file imports directly."""
    found: set[Path] = set()
    for module, names, modules in _IMPORT.findall(source.read_text("utf-8")):
        for name in _NAME.findall(modules or module):
            package, *path = name.split(".")
            if package != _PACKAGE.name:
                continue
            folder = _PACKAGE.joinpath(*path)
            if path and (file := folder.with_suffix(".py")).is_file():
                found.add(file)
            elif (file := folder / "__init__.py").is_file():
                found.add(file)
                parts = (folder / part for part in _NAME.findall(names))
                inner = (file for p in parts for file in (p.with_suffix(".py"), p / "__init__.py"))
                found.update(file for file in inner if file.is_file())
    return found


@cache
def source_digest(source: Path) -> str:
    """Digest of a file and of all files of this package that it imports, as 16 hexadecimal digits.

    The results of its code depend on no other file of the package.
    """
    reached, waiting = {source}, [source]
    while waiting:
        new = _imported(waiting.pop()) - reached
        reached |= new
        waiting += new
    digest = hashlib.sha256()
    for file in sorted(reached | {Path(__file__)}):
        digest.update(_file_digest(file))
    return digest.hexdigest()[:16]


@cache
def _file_digest(file: Path) -> bytes:
    """Digest of the name of a file in this package, and of its content."""
    name = file.relative_to(_PACKAGE) if file.is_relative_to(_PACKAGE) else Path(file.name)
    return hashlib.sha256(name.as_posix().encode() + b"\0" + file.read_bytes()).digest()


def _user_cache_dir() -> Path | None:
    base = os.environ.get("XDG_CACHE_HOME")
    if base:
        return Path(base) / "insdvl"
    try:
        return Path.home() / ".cache" / "insdvl"
    except RuntimeError:  # there is no home folder
        return None


def _candidates(name: str) -> list[Path]:
    """Folders of a name, the first choice first, that may hold compiled functions."""
    named = os.environ.get("INSDVL_CACHE_DIR")
    installed, user = _PACKAGE / "__pycache__" / name, _user_cache_dir()
    return [
        *([installed] if installed.is_dir() else []),
        *([Path(named) / name] if named else []),
        *([user / name] if user else []),
    ]


def _version(source: Path) -> str:
    """What a folder's name says of the source, and of the versions of Python and numba."""
    build = f"{sys.version} {numba.__version__} {source_digest(source)}"
    return f"kernels-{hashlib.sha256(build.encode()).hexdigest()[:16]}"


@cache
def _processor() -> str:
    """The same of the processor: its type and its features, as numba tells them or is told."""
    target = " ".join(cpu_target.target_context.codegen().magic_tuple())
    return hashlib.sha256(target.encode()).hexdigest()[:8]


@cache
def _folder(source: Path) -> tuple[Path | None, str]:
    """Folder for the compiled functions of a file; None, and why, if no folder is writable."""
    reason = "no home folder"
    for folder in _candidates(f"{_version(source)}-{_processor()}"):
        try:
            folder.mkdir(mode=0o755, parents=True, exist_ok=True)
            status = folder.stat()
            if (
                status.st_uid not in (0, os.getuid(), _PACKAGE.stat().st_uid)
                or status.st_mode & stat.S_IWOTH
            ):
                raise PermissionError(errno.EPERM, "owned by another user or world-writable")
            try:
                with tempfile.TemporaryFile(dir=folder):
                    return folder, ""
            except OSError:
                if any(folder.glob("*.nbi")):  # what it has can be read
                    return folder, ""
                raise
        except OSError as error:
            reason = f"{folder}: {error.strerror or error}"
    return None, reason


def _is_for_another_processor(source: Path) -> bool:
    """Whether the functions of a file are compiled, but for other processors only."""
    version = _version(source)
    parents = {folder.parent for folder in _candidates(version)} | {_PACKAGE / "__pycache__"}
    found = {f.parent.name for p in parents for f in p.glob(f"{version}-*/*.nbi")}
    return bool(found) and f"{version}-{_processor()}" not in found


def cache_dir(source: Path) -> Path | None:
    """Folder for the compiled functions of a file, or None if no folder is writable."""
    return _folder(source)[0]


class _NoCache(NullCache):
    """Of a function that cannot be cached."""

    def __init__(self, source: Path, reason: str) -> None:
        super().__init__()
        self._source, self._reason = source, reason

    def load_overload(self, sig: Any, target_context: Any) -> None:
        _tell_compilation(self._source)
        _warn_once(self._reason)


class _Locator(_CacheLocator):
    """Where the compiled form of a function is: in `cache_dir`, which may be read-only."""

    def __init__(self, function: Callable[..., Any], folder: Path) -> None:
        self._function = function
        self._folder = folder

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> "_Locator | None":
        folder = cache_dir(Path(py_file))
        return None if folder is None else cls(py_func, folder)

    def get_cache_path(self) -> str:
        return str(self._folder)

    def get_source_stamp(self) -> str:
        return self._folder.name

    def get_disambiguator(self) -> str:
        return str(self._function.__code__.co_firstlineno)


class _Implementation(CompileResultCacheImpl):
    _locator_classes = [_Locator]  # noqa: RUF012


class _ForgivingCache(FunctionCache):
    """numba's cache of one function, in a folder whose name identifies the source.

    Neither path nor modification time of the source matters, so another installation of the same
    source uses the same cache. A damaged or full cache gives a warning, not an exception.
    """

    _impl_class = _Implementation

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled function, or None.

        As numba's own, but without declaring to the compiler all that can be compiled, which costs
        more than to load what is: compiling declares it where it is needed. What a cached function
        may call is what allocates arrays; kernels have no dictionaries or sets, which hash.
        """
        found = None
        try:
            rtsys.initialize(target_context)
            found = self._load_overload(sig, target_context)
        except Exception as error:  # unpickling a damaged file may raise anything
            _warn_once(f"damaged cache: {error!r}")
            with contextlib.suppress(OSError):  # saving fails in the same way and warns
                self.flush()  # otherwise a damaged index would stay
        if found is None:
            _tell_compilation(Path(self._py_func.__code__.co_filename))
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)
        except Exception as error:  # a full disk, or a damaged index, which is read first
            _warn_once(f"cannot write the cache: {error!r}")


def kernel(function: _Function) -> _Function:
    """Compile a function with numba on its first call, and cache the result on disk.

    With ``error_model="numpy"`` a division by zero gives inf or nan, as in numpy, without a check.
    Floating-point operations are never reordered, so results are reproducible to the bit.
    """
    dispatcher: Any = numba.njit(error_model="numpy", nogil=True)(function)
    source = Path(function.__code__.co_filename)
    folder, reason = _folder(source)
    dispatcher._cache = _NoCache(source, reason) if folder is None else _ForgivingCache(function)
    return cast(_Function, dispatcher)
