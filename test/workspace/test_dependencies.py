"""Dependencies are declared where they are used, and pinned; the core needs no ROS."""

import ast
import json
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import pytest
import sources
from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from sources import PACKAGES, ROOT

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
ABOARD = {"numba", "numpy", "scipy", "yaml"}
EXTRAS = {
    "bags": {"lz4", "rosbags"},
    "cli": {"rich", "shtab"},
    "dask": {"dask", "distributed"},
    "dnn": {"onnx", "torch"},
    "jobs": {"joblib", "threadpoolctl"},
    "onnx": {"onnxruntime"},
    "plot": {"matplotlib"},
    "report": {"plotly"},
    "train": {"joblib", "sklearn", "threadpoolctl"},
}
#: Imported within functions only, where an option asks for them or their absence is told.
OPTIONAL = EXTRAS["cli"] | EXTRAS["dask"] | EXTRAS["dnn"] | EXTRAS["onnx"] | EXTRAS["report"]
PYTHONS = ("3.10", "3.11", "3.12", "3.13")


def third_party(package: str) -> set[str]:
    """What a package of ours imports itself."""
    return set().union(*(sources.third_party(name) for name in sources.names(package)))


def extras_of(package: str) -> set[str]:
    """What a package of ours needs of the extras, itself or through others of ours."""
    reached = sources.reached(sources.names(package))
    found = set().union(*(sources.third_party(name) for name in reached))
    return (found & set().union(*EXTRAS.values())) - OPTIONAL


def pip_names(packages: set[str]) -> set[str]:
    return {PIP_NAMES.get(name, name) for name in packages}


def rosdep_keys(packages: set[str]) -> set[str]:
    """Of what rosdep can install; the names of ROS packages are their keys."""
    return {ROSDEP_KEYS.get(name, name) for name in packages - PIP_ONLY - COMES_ALONG - OPTIONAL}


def entries(name: str) -> list[Requirement]:
    """The lines of a requirements or constraints file."""
    lines = (line.partition("#")[0].strip() for line in (ROOT / name).read_text().splitlines())
    return [Requirement(line) for line in lines if line]


def required() -> set[str]:
    names = ("requirements.txt", "requirements-test.txt")
    return {canonicalize_name(entry.name) for name in names for entry in entries(name)}


def setup_argument(package: str, name: str) -> Any:
    """What setup.py tells pip, read without running it."""
    tree = ast.parse((ROOT / PACKAGES[package] / "setup.py").read_text())
    keywords = [node for node in ast.walk(tree) if isinstance(node, ast.keyword)]
    (value,) = [node.value for node in keywords if node.arg == name]
    return ast.literal_eval(value)


def install_requires(package: str) -> set[str]:
    return set(setup_argument(package, "install_requires"))


def imported_packages(package: str) -> set[str]:
    """Other packages of ours that a package imports."""
    others = set().union(*(sources.ours(name) for name in sources.names(package)))
    return {sources.package_of(name) for name in others} - {package}


def output(code: str, folder: Path) -> str:
    """What code prints in an interpreter of its own."""
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


def depends(package: str, kind: str) -> set[str | None]:
    manifest = ElementTree.parse(ROOT / PACKAGES[package] / "package.xml")
    return {depend.text for depend in manifest.iter(kind)}


def test_what_runs_aboard_needs_four_packages() -> None:
    """Those of the core; ROS's own are the nodes'."""
    aboard = [name for name in sources.names("insdvl") if not sources.is_ashore(name)]
    found = set().union(*(sources.third_party(name) for name in aboard))
    assert found - OPTIONAL == ABOARD
    assert install_requires("insdvl") == pip_names(ABOARD)
    assert depends("insdvl", "exec_depend") == rosdep_keys(ABOARD)
    assert extras_of("ros_insdvl") == set()


def test_the_tests_of_the_core_need_what_is_ashore() -> None:
    assert depends("insdvl", "test_depend") >= rosdep_keys(extras_of("insdvl"))


@pytest.mark.parametrize("package", ["ros_insdvl", "ros_insdvl_sim"])
def test_package_xml_declares_what_is_used(package: str) -> None:
    used = third_party(package) | imported_packages(package) | extras_of(package)
    used |= sources.imported_by_launch_files(package)
    assert depends(package, "exec_depend") == rosdep_keys(used)


@pytest.mark.parametrize("package", ["ros_insdvl", "ros_insdvl_sim"])
def test_setup_py_declares_what_is_used(package: str) -> None:
    used = third_party(package) & (PIP_ONLY | COMES_ALONG | ROSDEP_KEYS.keys())
    assert install_requires(package) == pip_names(used | extras_of(package))


def test_extras_declare_what_is_ashore() -> None:
    extras = setup_argument("insdvl", "extras_require")
    assert {name: set(extras[name]) for name in extras if name != "test"} == {
        name: pip_names(packages) for name, packages in EXTRAS.items()
    }
    assert third_party("insdvl") == ABOARD.union(*EXTRAS.values())


def test_requirements_cover_the_packages() -> None:
    needed = set().union(*(install_requires(package) for package in PACKAGES))
    assert needed | pip_names(set().union(*EXTRAS.values()) - EXTRAS["dnn"]) <= required()
    assert not EXTRAS["dnn"] & required()


def test_the_demo_installs_no_more_than_it_needs() -> None:
    """And nothing is installed twice."""
    demo, tests = (
        {canonicalize_name(entry.name) for entry in entries(name)}
        for name in ("requirements.txt", "requirements-test.txt")
    )
    assert demo & tests == set()
    assert demo & {"hypothesis", "pytest", "python-ins"} == set()
    extras = ("dask", "jobs", "onnx", "train")
    assert tests >= pip_names(set().union(*(EXTRAS[name] for name in extras)))


def test_pages_name_what_rosdep_cannot_give() -> None:
    used = set().union(*(third_party(package) for package in PACKAGES)) & PIP_ONLY
    install = (ROOT / "docs" / "how-to" / "install.md").read_text()
    (line,) = re.findall(r"^pip install ([^'\n]*)$", install, re.MULTILINE)
    assert set(line.split()) >= used
    page = (ROOT / "docs" / "how-to" / "aboard.md").read_text()
    assert set(re.findall(r"`pip install ([\w-]+)`", page)) == set(line.split())


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
    assert third_party("insdvl") <= ABOARD.union(*EXTRAS.values())

    why, loaded = failures(set(), sources.names("insdvl"), tmp_path)
    assert why == {}
    assert "matplotlib" in loaded
    assert [name for name in loaded if re.match(r"rclpy|rosidl|rpyutils|\w+_msgs$", name)] == []


IMPORTS = """
import json, sys
from importlib import import_module

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {absent}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Absent())
failures = {{}}
for name in {names}:
    try:
        import_module(name)
    except ModuleNotFoundError as error:
        failures[name] = str(error)
loaded = set()
for module in list(sys.modules.values()):
    parts = (getattr(module, "__file__", None) or "").split("/")
    for folder in {{"site-packages", "dist-packages"}}.intersection(parts):
        loaded.add(parts[parts.index(folder) + 1].partition(".")[0])
print(json.dumps([failures, sorted(loaded)]))
"""


def failures(absent: set[str], names: list[str], folder: Path) -> tuple[dict[str, str], set[str]]:
    """Which imports fail, and why, where packages are absent; and the packages that are loaded."""
    text = output(IMPORTS.format(absent=sorted(absent), names=names), folder)
    why, loaded = json.loads(text)
    return why, set(loaded)


def test_what_runs_aboard_loads_four_packages(tmp_path: Path) -> None:
    names = [name for name in sources.names("insdvl") if not sources.is_ashore(name)]
    why, loaded = failures(set(), names, tmp_path)
    assert why == {}
    assert loaded.isdisjoint(set().union(*EXTRAS.values()))
    _, needed = failures(set(), sorted(ABOARD), tmp_path)
    assert loaded - needed <= {"insdvl"}


@pytest.mark.parametrize(
    "name",
    [
        *(f"insdvl.studies.{c}.command" for c in ("check", "evaluation", "init", "replay")),
        "ros_insdvl_sim.simulator",
    ],
)
def test_a_start_does_not_wait_for_what_few_need(name: str, tmp_path: Path) -> None:
    """Each of these takes a part of a second to import, or more."""
    slow = {"matplotlib", "scipy.signal", "scipy.spatial", "scipy.stats"}
    text = f"import {name}, sys; print(*({slow} & sys.modules.keys()))"
    assert output(text, tmp_path).split() == []


@pytest.mark.parametrize(
    ("absent", "extras"),
    [
        pytest.param(set().union(*EXTRAS.values()), {"bags", "jobs", "plot"}, id="all"),
        pytest.param({"sklearn"}, {"train"}, id="sklearn", marks=pytest.mark.long),
    ],
)
def test_a_missing_package_is_told_with_its_extra(
    absent: set[str], extras: set[str], tmp_path: Path
) -> None:
    """And aboard none is missed."""
    why, _ = failures(absent, sources.names("insdvl"), tmp_path)
    assert {name for name in why if not sources.is_ashore(name)} == set()
    told = set()
    for name, reason in why.items():
        match = re.fullmatch(r"(\w+)[\w.]* is not installed: install insdvl\[(\w+)\]", reason)
        assert match, f"{name}: {reason}"
        package, extra = match.groups()
        assert package in EXTRAS[extra]
        told.add(extra)
    assert told == extras


def test_a_command_without_its_package_is_one_sentence(tmp_path: Path) -> None:
    call = ["replay", ".", "--json", "a.json"]
    code = "import sys; sys.modules['rosbags'] = None; from insdvl.cli import main; "
    result = subprocess.run(
        [sys.executable, "-c", f"{code}sys.exit(main({call}))"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert result.returncode == 2, result.stderr
    assert re.fullmatch(
        r"insdvl replay: rosbags[\w.]* is not installed: install insdvl\[bags\]\n", result.stderr
    )
