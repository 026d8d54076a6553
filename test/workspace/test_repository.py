"""The files as a stranger gets them."""

import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
NOT_OURS = {"build", "install", "log", "demo-output", "__pycache__"}
#: Where ROS is installed is no path of one machine.
MACHINE_PATH = re.compile(r"(?<![\w.~/-])/(?:home|opt(?!/ros)|root|tmp|work)/[\w.-]+")


def texts(folder: Path = ROOT) -> Iterator[tuple[Path, str]]:
    """Every text file, without what git ignores."""
    for path in sorted(folder.iterdir()):
        hidden = path.name.startswith(".") and path.name not in (".ci", ".gitignore")
        if hidden or path.name in NOT_OURS or path.is_symlink():
            continue
        if path.is_dir():
            yield from texts(path)
            continue
        try:
            yield path, path.read_text(encoding="utf-8")
        except UnicodeDecodeError:  # a binary file
            continue


def test_no_paths_of_a_machine() -> None:
    found = {
        str(path.relative_to(ROOT)): match.group()
        for path, text in texts()
        for match in MACHINE_PATH.finditer(text)
    }
    assert found == {}
