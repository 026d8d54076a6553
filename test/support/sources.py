"""What our modules import, read from their text."""

import ast
import sys
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
#: What of the core stays on land.
ASHORE = ("recordings", "simulation", "jobs", "studies", "cli")
PACKAGES = {"insdvl": "src", "ros_insdvl": "ros_insdvl", "ros_insdvl_sim": "ros_insdvl_sim"}


@cache
def modules() -> dict[str, Path]:
    """Every module and package of ours, by its full name."""
    found = {}
    for package, folder in PACKAGES.items():
        for path in sorted((ROOT / folder / package).rglob("*.py")):
            parts = path.relative_to(ROOT / folder).with_suffix("").parts
            found[".".join(part for part in parts if part != "__init__")] = path
    return found


def package_of(name: str) -> str:
    return name.partition(".")[0]


def names(*packages: str) -> list[str]:
    """Full names of the modules of some packages."""
    return [name for name in modules() if package_of(name) in packages]


def is_ashore(name: str) -> bool:
    """Whether a module of the core stays on land."""
    return any(f"{name}.".startswith(f"insdvl.{room}.") for room in ASHORE)


@cache
def _imported(name: str) -> frozenset[str]:
    """Full names of all that a module imports, also within functions."""
    found = set()
    for node in ast.walk(ast.parse(modules()[name].read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name} has a relative import"
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                found.add(inner if inner in modules() else str(node.module))
    return frozenset(found)


def imported_by_launch_files(package: str) -> set[str]:
    """Top-level packages that the launch files of a package of ours import, Python's aside."""
    found = set()
    for path in (ROOT / PACKAGES[package] / "launch").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom):
                found.add(package_of(str(node.module)))
    return found - set(sys.stdlib_module_names)


def ours(name: str) -> frozenset[str]:
    """Our modules that a module imports."""
    return _imported(name) & modules().keys()


def third_party(name: str) -> set[str]:
    """Top-level packages that a module imports and that neither Python nor we have."""
    found = {package_of(other) for other in _imported(name)}
    return found - set(sys.stdlib_module_names) - PACKAGES.keys()


def reached(start: list[str]) -> set[str]:
    """Some modules, and those of ours that they import, and so on."""
    found: set[str] = set()
    waiting = list(start)
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting += ours(name)
    return found
