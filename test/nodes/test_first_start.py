"""The first start of a version says that it compiles; a warm one has nothing to say."""

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from graphs import Graph

from insdvl import kernels
from ros_insdvl.tuner import TunerNode


@pytest.fixture
def node(managed: Any) -> TunerNode:
    return managed(Graph("/first")).make(TunerNode)


def test_what_is_compiled_is_told_and_how_long_it_took(
    node: TunerNode, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kernels, "_folder", lambda source: (None, "no home folder"))
    monkeypatch.setattr(kernels, "_warned", [])

    @kernels.kernel
    def twice(x: float) -> float:
        return 2.0 * x

    capfd.readouterr()
    with node.compiling():
        assert twice(1.0) == 2.0
    begins, warns, ends = capfd.readouterr().err.splitlines()
    assert "[INFO]" in begins and "compiling, once for this version" in begins
    assert "[WARN]" in warns and "not cached (no home folder); set INSDVL_CACHE_DIR" in warns
    assert "[INFO]" in ends and re.search(r"compiled in \d+ s", ends)

    with node.compiling():
        assert twice(1.0) == 2.0
    assert capfd.readouterr().err == ""


@pytest.mark.long
def test_after_warm_no_node_compiles(tmp_path: Path) -> None:
    """From an empty folder, which takes a minute."""
    environment = {**os.environ, "INSDVL_CACHE_DIR": str(tmp_path / "cache")}

    def said(code: str) -> str:
        done = subprocess.run(
            [sys.executable, "-c", code], env=environment, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        return done.stdout + done.stderr

    assert "compiling" in said("from insdvl.cli import main; main(['warm'])")
    for module, name in ("filter", "FilterNode"), ("tuner", "TunerNode"):
        code = f"import rclpy; rclpy.init(); from ros_insdvl.{module} import {name}; {name}()"
        assert said(code) == ""
