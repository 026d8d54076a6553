"""Dependencies are declared where they are used, and pinned; the core needs no ROS."""

import ast
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
PACKAGES = {"insdvl": "src", "ros_insdvl": "ros_insdvl", "ros_insdvl_sim": "ros_insdvl_sim"}
ROSDEP_KEYS = {
    "joblib": "python3-joblib",
    "matplotlib": "python3-matplotlib",
    "numpy": "python3-numpy",
    "scipy": "python3-scipy",
    "sklearn": "python3-sklearn",
    "yaml": "python3-yaml",
}
PIP_NAMES = {"sklearn": "scikit-learn", "yaml": "pyyaml"}
PIP_ONLY = {"numba", "rosbags"}  # no rosdep key on Ubuntu 24.04
COMES_ALONG = {"lz4", "threadpoolctl"}  # rosbags and scikit-learn need them
# Imported where they are needed, and not before: each is in an extra of that name.
EXTRAS = {"dask": {"dask", "distributed"}, "dnn": {"onnx", "torch"}, "onnx": {"onnxruntime"}}
OPTIONAL = set().union(*EXTRAS.values())
PYTHONS = ("3.10", "3.11", "3.12", "3.13")


def modules(package: str) -> list[Path]:
    return sorted((ROOT / PACKAGES[package] / package).rglob("*.py"))


def imports(module: Path) -> Iterator[str]:
    """The top-level packages that a module imports anywhere, relative imports aside."""
    for node in ast.walk(ast.parse(module.read_text())):
        if isinstance(node, ast.Import):
            yield from (name.name.partition(".")[0] for name in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            assert node.module is not None
            yield node.module.partition(".")[0]


def third_party(package: str) -> set[str]:
    found = {name for module in modules(package) for name in imports(module)}
    return found - set(sys.stdlib_module_names) - {package}


def entries(name: str) -> list[Requirement]:
    """The lines of a requirements or constraints file."""
    lines = (line.partition("#")[0].strip() for line in (ROOT / name).read_text().splitlines())
    return [Requirement(line) for line in lines if line]


def required() -> set[str]:
    return {canonicalize_name(entry.name) for entry in entries("requirements.txt")}


def setup_argument(package: str, name: str) -> Any:
    """What setup.py tells pip, read without running it."""
    tree = ast.parse((ROOT / PACKAGES[package] / "setup.py").read_text())
    keywords = [node for node in ast.walk(tree) if isinstance(node, ast.keyword)]
    (value,) = [node.value for node in keywords if node.arg == name]
    return ast.literal_eval(value)


def install_requires(package: str) -> set[str]:
    return set(setup_argument(package, "install_requires"))


def core_modules() -> list[str]:
    return [
        ".".join(module.relative_to(ROOT / "src").with_suffix("").parts)
        for module in modules("insdvl")
        if module.name not in ("__init__.py", "__main__.py")
    ]


def output(code: str, folder: Path) -> str:
    """What code prints in an interpreter of its own."""
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


@pytest.mark.parametrize("package", PACKAGES)
def test_package_xml_declares_what_is_imported(package: str) -> None:
    manifest = ElementTree.parse(ROOT / PACKAGES[package] / "package.xml")
    declared = {depend.text for depend in manifest.iter("exec_depend")}
    without_key = PIP_ONLY | COMES_ALONG | OPTIONAL
    assert declared == {ROSDEP_KEYS.get(name, name) for name in third_party(package) - without_key}


@pytest.mark.parametrize("package", PACKAGES)
def test_setup_py_declares_what_is_imported(package: str) -> None:
    names = third_party(package) & (PIP_ONLY | COMES_ALONG | set(ROSDEP_KEYS))
    assert install_requires(package) == {PIP_NAMES.get(name, name) for name in names}


def test_extras_declare_what_is_optional() -> None:
    extras = setup_argument("insdvl", "extras_require")
    assert {name: set(extras[name]) for name in extras if name != "test"} == EXTRAS
    assert third_party("insdvl") & OPTIONAL == OPTIONAL
    assert (
        set().union(*(third_party(package) for package in PACKAGES.keys() - {"insdvl"})) & OPTIONAL
        == set()
    )


def test_requirements_cover_the_packages() -> None:
    needed = set().union(*(install_requires(package) for package in PACKAGES))
    assert needed | EXTRAS["dask"] | EXTRAS["onnx"] <= required()
    assert not EXTRAS["dnn"] & required()


def test_readme_names_what_rosdep_cannot_give() -> None:
    used = set().union(*(third_party(package) for package in PACKAGES)) & PIP_ONLY
    (line,) = re.findall(r"^pip install (.*)$", (ROOT / "README.md").read_text(), re.MULTILINE)
    assert set(line.split()) >= used


@pytest.mark.parametrize("version", PYTHONS)
def test_every_requirement_has_one_pin(version: str) -> None:
    environment = {**default_environment(), "python_version": version}
    pins: dict[str, list[str]] = {}
    for pin in entries("constraints.txt"):
        assert re.fullmatch(r"==[^*]+", str(pin.specifier)), pin
        if pin.marker is None or pin.marker.evaluate(environment):
            pins.setdefault(canonicalize_name(pin.name), []).append(str(pin.specifier))
    assert {name: pin for name, pin in pins.items() if len(pin) != 1} == {}
    assert required() | OPTIONAL <= pins.keys()


def test_the_core_is_free_of_ros(tmp_path: Path) -> None:
    """Neither in its text nor in what an import of all of it loads."""
    assert third_party("insdvl") <= PIP_ONLY | COMES_ALONG | set(ROSDEP_KEYS) | OPTIONAL

    code = f"import sys\nfor name in {core_modules()}: __import__(name)\nprint(*sys.modules)"
    loaded = output(code, tmp_path).split()
    assert "insdvl.kernels" in loaded
    assert [name for name in loaded if re.match(r"rclpy|rosidl|rpyutils|\w+_msgs\b", name)] == []


def test_the_core_starts_without_the_optional_packages(tmp_path: Path) -> None:
    code = f"""
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {sorted(OPTIONAL)}:
            raise ModuleNotFoundError(name)

sys.meta_path.insert(0, Absent())
for name in {core_modules()}:
    __import__(name)
"""
    output(code, tmp_path)
