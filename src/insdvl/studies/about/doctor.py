"""The command `insdvl doctor`: whether the installation is as it should be."""

import argparse
import os
import platform
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module, metadata
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

PYTHONS = ((3, 10), (3, 13))  # the oldest and the newest version
#: Written by the set-up into its environment: the versions on which everything is tested.
PINS = Path(sys.prefix) / "constraints.txt"
_PIN = re.compile(r'([\w.-]+)==([^;\s]+)\s*(?:;\s*python_version (<|>=) "(\d+)\.(\d+)")?')
_REQUIREMENT = re.compile(r"([\w.-]+)[^;]*(?:;.*extra == [\"'](\w+)[\"'])?")


@dataclass(frozen=True)
class Result:
    """What was found of one thing.

    Attributes:
        text: A sentence.
        fault: Whether something does not work.
        absent: Whether it is missing and only some uses need it.
    """

    text: str
    fault: bool = False
    absent: bool = False

    @property
    def mark(self) -> str:
        """One word."""
        return "WRONG" if self.fault else "absent" if self.absent else "ok"


def run(arguments: argparse.Namespace) -> int:
    """Tell what is found; the exit code is 1 where something is wrong."""
    results = [*_python(), *_packages(), *_cache(), *_models(), *_ros()]
    wrong = any(result.fault for result in results)
    text = "\n".join(f"{result.mark:8}{result.text}" for result in results)
    if arguments.json is None:
        print(text)
        return int(wrong)
    document = {
        "right": not wrong,
        "results": [{"mark": result.mark, "text": result.text} for result in results],
    }
    try:
        # Not above: it needs numpy, which may be what is missing.
        output = import_module("insdvl.studies.document")
        output.check_place(arguments.json)
        output.tell(arguments.json, document, text)
    except (ImportError, ValueError, OSError) as error:
        print(f"insdvl doctor: {error}", file=sys.stderr)
        return 2
    return int(wrong)


def _python() -> Iterator[Result]:
    low, high = PYTHONS
    fits = low <= sys.version_info[:2] <= high
    known = f"{low[0]}.{low[1]} to {high[0]}.{high[1]}"
    text = f"Python {platform.python_version()} on {platform.machine()}"
    yield Result(text if fits else f"{text}: {known} are known to work", not fits)


def pins(text: str, version: tuple[int, int] = sys.version_info[:2]) -> dict[str, str]:
    """The versions of a constraints file for a version of Python, by normalised name."""
    found = {}
    for line in text.splitlines():
        match = _PIN.match(line)
        if match is None:
            continue
        name, pinned, relation, major, minor = match.groups()
        if relation is None or (version < (int(major), int(minor))) == (relation == "<"):
            found[_normal(name)] = pinned
    return found


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _packages() -> Iterator[Result]:
    """The required packages and those of the extras."""
    pinned = pins(PINS.read_text(encoding="utf-8")) if PINS.is_file() else {}
    missing: dict[str, list[str]] = {}
    extras = set()
    for requirement in metadata.requires("insdvl") or []:
        match = _REQUIREMENT.match(requirement)
        assert match is not None
        name, extra = match.groups()
        extras.add(extra)
        try:
            version = metadata.version(name)
        except metadata.PackageNotFoundError:
            if extra is None:
                yield Result(f"{name} is not installed, and nothing works without it", True)
            else:
                missing.setdefault(extra, []).append(name)
            continue
        expected = pinned.get(_normal(name), version)
        if extra is None or version != expected:
            differs = f", {PINS.name} has {expected}" if version != expected else ""
            yield Result(f"{name} {version}{differs}", version != expected)
    for extra in sorted(extras - {None}):
        names = ", ".join(missing.get(extra, []))
        if names:
            text = f"extra {extra} lacks {names}: install insdvl[{extra}] where you need it"
            yield Result(text, absent=True)
        else:
            yield Result(f"extra {extra}")


def _cache() -> Iterator[Result]:
    try:
        kernels = import_module("insdvl.kernels")
    except ImportError as error:  # told among the packages
        yield Result(f"compiled functions: {error}", True)
        return
    folder = kernels.cache_dir(Path(str(kernels.__file__)))
    if folder is None:
        yield Result(
            "compiled functions are not cached: no folder is writable; every start compiles for a "
            "minute. Set INSDVL_CACHE_DIR to a writable folder",
            True,
        )
    else:
        yield Result(f"compiled functions are cached in {folder.parent}")


def _models() -> Iterator[Result]:
    try:
        module = import_module("insdvl.tuner.models")
        names = sorted(path.stem for path in Path(str(files("insdvl") / "models")).glob("*.npz"))
        for name in names:
            module.load_model(name)
    except (ImportError, ValueError, OSError) as error:
        yield Result(f"models: {error}", True)
        return
    if names:
        yield Result(f"models can be read: {', '.join(names)}")
    else:
        yield Result("models: none is installed beside the package", True)


def _ros() -> Iterator[Result]:
    """ROS 2 is needed by the nodes only."""
    if find_spec("rclpy") is None:
        yield Result("ROS 2: no rclpy on the path; only the nodes need it", absent=True)
    else:
        distribution = os.environ.get("ROS_DISTRO", "from wheels, without a setup.sh")
        yield Result(f"ROS 2: rclpy is there ({distribution})")
