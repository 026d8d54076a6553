"""What a build installs: executables, data files, and modules that are not the source folders."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix, get_package_share_directory

ROOT = Path(__file__).parents[2]
SOURCES = {
    "insdvl": ROOT / "src",
    "ros_insdvl": ROOT / "ros_insdvl",
    "ros_insdvl_sim": ROOT / "ros_insdvl_sim",
}
EXECUTABLES = {
    "ros_insdvl": {"filter", "monitor", "tuner"},
    "ros_insdvl_sim": {"demo", "faults", "relay", "replay", "simulator", "soak"},
}
MAINS = [f"{package}.{name}" for package, names in EXECUTABLES.items() for name in sorted(names)]


def python(code: str, folder: Path) -> str:
    """The output of code that runs outside the repository, and so sees installed packages only."""
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


def contents(folder: Path, pattern: str = "*") -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.glob(pattern) if path.is_file()}


@pytest.mark.parametrize("package", EXECUTABLES)
def test_executables_are_where_ros2_run_looks(package: str) -> None:
    folder = Path(get_package_prefix(package)) / "lib" / package
    found = {path.name for path in folder.iterdir() if os.access(path, os.X_OK)}
    assert found == EXECUTABLES[package]


def test_console_script_is_in_bin() -> None:
    assert os.access(Path(get_package_prefix("insdvl")) / "bin" / "insdvl", os.X_OK)


@pytest.mark.parametrize("target", ["insdvl.cli", *MAINS])
def test_entry_points_exist(target: str, tmp_path: Path) -> None:
    assert python(f"import {target}; print(callable({target}.main))", tmp_path) == "True\n"


@pytest.mark.parametrize("package", SOURCES)
def test_modules_come_from_the_build(package: str, tmp_path: Path) -> None:
    file = Path(python(f"import {package}; print({package}.__file__)", tmp_path).strip())
    assert not file.is_relative_to(SOURCES[package])


def test_models_are_installed(tmp_path: Path) -> None:
    code = "import importlib.resources as r; print(r.files('insdvl').joinpath('models'))"
    installed = contents(Path(python(code, tmp_path).strip()))
    assert {Path(name).suffix for name in installed} >= {".json", ".npz"}
    assert installed == contents(ROOT / "models")


@pytest.mark.parametrize("package", SOURCES)
def test_data_files_are_installed(package: str) -> None:
    share = Path(get_package_share_directory(package))
    assert contents(share, "*.xml") == contents(SOURCES[package], "*.xml")
    assert contents(share / "config") == contents(SOURCES[package] / "config")


def test_discovery_profile_is_installed() -> None:
    share = Path(get_package_share_directory("ros_insdvl"))
    assert (share / "config" / "fastdds_localhost.xml").is_file()


def test_readme_commands_exist() -> None:
    readme = (ROOT / "README.md").read_text()
    commands = re.findall(r"(?:ros2 run |\.venv/lib/)(\w+)[ /](\w+)", readme)
    assert {package for package, _ in commands} == EXECUTABLES.keys()
    assert [command for command in commands if command[1] not in EXECUTABLES[command[0]]] == []
