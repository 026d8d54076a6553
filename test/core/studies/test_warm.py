"""`insdvl warm` leaves nothing to compile, and says where it is kept, or why nothing is."""

from pathlib import Path

import pytest

from insdvl import kernels
from insdvl.cli import main


def test_it_says_where_the_functions_are(capsys: pytest.CaptureFixture[str]) -> None:
    folder = kernels.cache_dir(Path(kernels.__file__))
    assert folder is not None
    assert main(["warm"]) == 0
    captured = capsys.readouterr()
    assert f"ready in {folder.parent}, " in captured.out
    assert captured.err == ""


def test_what_cannot_be_kept_is_a_failure(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kernels, "cache_dir", lambda source: None)
    monkeypatch.setattr("insdvl.studies.warm.compile_all", lambda: None)
    assert main(["warm"]) == 1
    assert "insdvl warm: no folder is writable" in capsys.readouterr().err
