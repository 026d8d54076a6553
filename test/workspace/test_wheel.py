"""The core as a wheel: `pip install ./src` builds it, and it is whole."""

import os
import shutil
import subprocess
import sys
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest
from sources import ROOT
from test_dependencies import EXTRAS, PIP_NAMES, setup_argument

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """It is built from a copy: a build leaves files behind."""
    folder = tmp_path_factory.mktemp("wheel")
    ignored = shutil.ignore_patterns("build", "*.egg-info", "__pycache__")
    shutil.copytree(ROOT / "src", folder / "src", ignore=ignored)
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-index"]
    command += ["--no-build-isolation", "--wheel-dir", str(folder), str(folder / "src")]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    (built,) = folder.glob("*.whl")
    return built


def test_its_metadata_are_whole(wheel: Path) -> None:
    assert wheel.name == f"insdvl-{setup_argument('insdvl', 'version')}-py3-none-any.whl"
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [n for n in archive.namelist() if n.endswith(".dist-info/METADATA")]
        metadata = Parser().parsestr(archive.read(name).decode())
    assert metadata["Requires-Python"] == ">=3.10"
    assert metadata["License"] == "Apache-2.0"
    assert metadata["Description-Content-Type"] == "text/markdown"
    assert str(metadata.get_payload()).startswith("# insdvl")
    assert set(metadata.get_all("Provides-Extra", [])) == EXTRAS.keys() | {"test"}
    required = metadata.get_all("Requires-Dist", [])
    always = {text.split()[0].lower() for text in required if "extra" not in text}
    assert always == {PIP_NAMES.get(name, name) for name in ("numba", "numpy", "scipy", "yaml")}


def test_it_has_all_files_of_the_package_and_no_others(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    package = ROOT / "src" / "insdvl"
    modules = {f"insdvl/{path.relative_to(package)}" for path in package.rglob("*.py")}
    models = {f"insdvl/models/{p.name}" for p in (ROOT / "models").iterdir() if p.is_file()}
    assets = {f"insdvl/studies/report/assets/{n}" for n in ("report.css", "report.js")}
    inside = {name for name in names if name.startswith("insdvl/")}
    assert inside == modules | models | assets | {"insdvl/py.typed"}
    assert any(name.endswith("LICENSE") and ".dist-info/" in name for name in names)


def test_what_it_installs_runs(wheel: Path, tmp_path: Path) -> None:
    target = tmp_path / "target"
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
    subprocess.run([*command, "--target", str(target), str(wheel)], check=True)
    environment = {**os.environ, "PYTHONPATH": str(target)}
    code = "import insdvl; from insdvl.cli import main; print(insdvl.__file__); main(['models'])"
    result = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stderr
    assert result.stdout.startswith(str(target)) and "default" in result.stdout
