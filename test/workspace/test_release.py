"""Metadata, changelogs, and the files of an installation aboard, which name what exists."""

import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
import yaml
from ament_index_python.packages import get_package_share_directory
from catkin_pkg.changelog import Changelog, populate_changelog_from_rst
from sources import PACKAGES, ROOT
from test_dependencies import setup_argument
from test_installed import EXECUTABLES
from test_repository import texts

import insdvl
from insdvl.cli import COMMANDS

PAGE = ROOT / "docs" / "how-to" / "aboard.md"
DOCKERFILE = ROOT / "tools" / "aboard" / "Dockerfile"
UNIT = ROOT / "tools" / "aboard" / "insdvl.service"
ABOARD = [PAGE, DOCKERFILE, UNIT]
#: Where these files install the packages.
PREFIX = "(?:/opt/ros_insdvl|/insdvl/install)"


def manifest(package: str) -> ElementTree.ElementTree:
    return ElementTree.parse(ROOT / PACKAGES[package] / "package.xml")


def text_of(package: str, tag: str) -> str:
    element = manifest(package).find(tag)
    assert element is not None and element.text
    return element.text


@pytest.mark.parametrize("package", PACKAGES)
def test_a_changelog_is_one_that_release_tools_read(package: str) -> None:
    """They put version and date in the place of "Forthcoming"."""
    text = (ROOT / PACKAGES[package] / "CHANGELOG.rst").read_text()
    version = text_of(package, "version")
    title = f"{version} (2000-01-01)"
    released = text.replace(f"Forthcoming\n{'-' * 11}\n", f"{title}\n{'-' * len(title)}\n")
    changelog = populate_changelog_from_rst(Changelog(package), released)
    assert [found for found, _, _ in changelog.foreach_version()] == [version]
    assert len(changelog.get_content_of_version(version)[0].bullets) == text.count("\n* ") > 1


@pytest.mark.parametrize("package", PACKAGES)
def test_both_manifests_say_the_same(package: str) -> None:
    assert text_of(package, "name") == package
    assert text_of(package, "version") == setup_argument(package, "version")
    if package == "insdvl":
        assert text_of(package, "version") == insdvl.__version__
    assert text_of(package, "license") == setup_argument(package, "license") == "Apache-2.0"
    assert text_of(package, "maintainer") == setup_argument(package, "maintainer")


def test_no_address_is_invented() -> None:
    """The one that the format requires can belong to nobody, and the file says so."""
    for package in PACKAGES:
        maintainer = manifest(package).find("maintainer")
        assert maintainer is not None
        assert maintainer.attrib["email"].endswith(".invalid")
        assert "reaches nobody" in (ROOT / PACKAGES[package] / "package.xml").read_text()
    example = "example" + ".com"
    assert [str(path) for path, text in texts() if example in text] == []


def test_pages_and_units_name_what_there_is() -> None:
    """Executables, launch files, commands, and paths in the repository and in the installation."""
    found = dict.fromkeys(("run", "launch", "command", "source", "program", "share"), 0)

    def check(kind: str, is_there: bool, name: str) -> None:
        assert is_there, f"{kind} {name}"
        found[kind] += 1

    for text in map(Path.read_text, ABOARD):
        for package, name in re.findall(r"ros2 run (\w+) (\w+)", text):
            check("run", name in EXECUTABLES[package], name)
        for package, name in re.findall(r"ros2 launch (\w+) ([\w.]+\.py)", text):
            share = Path(get_package_share_directory(package))
            check("launch", (share / "launch" / name).is_file(), name)
        for name in re.findall(r"(?:`|&& )insdvl ([a-z]+)", text):
            check("command", name in COMMANDS, name)
        for name in re.findall(r"[ `(/]((?:tools|docs)/[\w./-]+\w)", text):
            check("source", (ROOT / name).exists(), name)
        for package, name in re.findall(rf"{PREFIX}/lib/(\w+)/(\w+)", text):
            check("program", name in EXECUTABLES[package], name)
        for package, name in re.findall(rf"{PREFIX}/share/(\w+)/([\w/.]+)", text):
            check("share", Path(get_package_share_directory(package), name).is_file(), name)
    assert all(found.values()), found


def test_the_image_is_sent_what_it_copies() -> None:
    kept = {line[1:] for line in (ROOT / ".dockerignore").read_text().split() if line[0] == "!"}
    copied = re.findall(r"^COPY (\S+)", DOCKERFILE.read_text(), re.MULTILINE)
    assert set(copied) == kept


def test_the_unit_restarts_what_may_succeed() -> None:
    """A wrong parameter ends a node with 2, see `ros_insdvl.process.execution`."""
    lines = UNIT.read_text().splitlines()
    assert "Restart=on-failure" in lines and "RestartPreventExitStatus=2" in lines
    folders = {name for line in lines for name in re.findall(r"/var/(cache|lib|log)/insdvl", line)}
    assert {f"{kind}Directory=insdvl" for kind in ("Cache", "State", "Logs")} <= set(lines)
    assert folders == {"cache", "lib", "log"}


def test_the_citation_is_of_this_version_and_licence() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["cff-version"] == "1.2.0"
    assert citation["version"] == text_of("insdvl", "version")
    assert citation["license"] == text_of("insdvl", "license")
    assert (
        citation["title"]
        in subprocess.run(
            [sys.executable, "-m", "insdvl.cli", "cite"], capture_output=True, text=True, check=True
        ).stdout
    )
