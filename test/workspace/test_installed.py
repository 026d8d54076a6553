"""What a build installs: executables, data files, and modules that are not the source folders."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest
from ament_index_python.packages import get_package_prefix, get_package_share_directory

ROOT = Path(__file__).parents[2]
SOURCES = {
    "insdvl": ROOT / "src",
    "ros_insdvl": ROOT / "ros_insdvl",
    "ros_insdvl_sim": ROOT / "ros_insdvl_sim",
}
EXECUTABLES = {
    "ros_insdvl": {"filter", "monitor", "navigator", "tuner"},
    "ros_insdvl_sim": {"demo", "faults", "relay", "replay", "simulator", "soak"},
}
#: What an interpreter outside of the repository sees: the installed packages only.
LOOK = """
import importlib.resources, json
from importlib import import_module
from importlib.metadata import distribution

packages = ("insdvl", "ros_insdvl", "ros_insdvl_sim")
scripts = {
    package: {script.name: callable(script.load()) for script in distribution(package).entry_points}
    for package in packages
}
files = {package: import_module(package).__file__ for package in packages}
models = str(importlib.resources.files("insdvl").joinpath("models"))
print(json.dumps([scripts, files, models]))
"""


class Installed(NamedTuple):
    """Executables of each package and whether they can be called, its file, and the models."""

    scripts: dict[str, dict[str, bool]]
    files: dict[str, str]
    models: str


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    folder = tmp_path_factory.mktemp("elsewhere")
    result = subprocess.run(
        [sys.executable, "-c", LOOK], cwd=folder, capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr
    return Installed(*json.loads(result.stdout))


def contents(folder: Path, pattern: str = "*") -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.glob(pattern) if path.is_file()}


@pytest.mark.parametrize("package", EXECUTABLES)
def test_executables_are_where_ros2_run_looks(package: str) -> None:
    folder = Path(get_package_prefix(package)) / "lib" / package
    found = {path.name for path in folder.iterdir() if os.access(path, os.X_OK)}
    assert found == EXECUTABLES[package]


def test_console_script_is_in_bin() -> None:
    assert os.access(Path(get_package_prefix("insdvl")) / "bin" / "insdvl", os.X_OK)


@pytest.mark.parametrize("package", SOURCES)
def test_entry_points_can_be_called(package: str, installed: Installed) -> None:
    names = EXECUTABLES.get(package, {"insdvl"})
    assert installed.scripts[package] == dict.fromkeys(names, True)


@pytest.mark.parametrize("package", SOURCES)
def test_modules_come_from_the_build(package: str, installed: Installed) -> None:
    assert not Path(installed.files[package]).is_relative_to(SOURCES[package])


def test_models_are_installed(installed: Installed) -> None:
    found = contents(Path(installed.models))
    assert {Path(name).suffix for name in found} >= {".json", ".npz"}
    assert found == contents(ROOT / "models")


@pytest.mark.parametrize("package", SOURCES)
def test_data_files_are_installed(package: str) -> None:
    share = Path(get_package_share_directory(package))
    assert contents(share, "*.xml") == contents(SOURCES[package], "*.xml")
    for folder in ("config", "launch", "layouts"):
        assert contents(share / folder) == contents(SOURCES[package] / folder)


def test_discovery_profile_is_installed() -> None:
    share = Path(get_package_share_directory("ros_insdvl"))
    assert (share / "config" / "fastdds_localhost.xml").is_file()


def test_commands_of_the_nodes_exist() -> None:
    pages = (ROOT / "README.md", ROOT / "docs" / "how-to" / "nodes.md")
    text = "".join(page.read_text() for page in pages)
    commands = re.findall(r"(?:ros2 run |\.venv/lib/)(\w+)[ /](\w+)", text)
    assert {package for package, _ in commands} == EXECUTABLES.keys()
    assert [command for command in commands if command[1] not in EXECUTABLES[command[0]]] == []
