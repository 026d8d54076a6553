"""The order of the rooms: who may import whom, no circles, files and folders of readable size."""

import ast

import pytest
from sources import ROOT, is_ashore, modules, names, ours, package_of

CORE = ROOT / "src" / "insdvl"

#: Rooms by level: a file imports from its own room and from rooms of lower levels. Rooms of one
#: level do not know each other. "" are the files beside the rooms, cli.py aside.
LEVELS = (
    ("",),
    ("parameters",),
    ("navigation",),
    ("timeline",),
    ("messages",),
    ("tuner",),
    ("watch",),
    ("recordings", "simulation", "jobs"),
    ("studies",),
    ("cli",),
)
LEVEL = {room: level for level, rooms in enumerate(LEVELS) for room in rooms}

MAX_FILES = 13  # .py files in a folder
MAX_LINES = 450
#: Files that are longer because they are one table, with what they tabulate.
TABLES: dict[str, str] = {}


def room(name: str) -> str:
    """The room of a module of the core."""
    parts = name.split(".")
    return parts[1] if len(parts) > 2 or parts[-1] in LEVEL or parts[-1] == "cli" else ""


def test_every_room_has_its_level() -> None:
    rooms = {path.name for path in CORE.iterdir() if (path / "__init__.py").exists()}
    assert rooms == LEVEL.keys() - {"", "cli"}
    assert room("insdvl.kernels") == room("insdvl") == ""
    assert room("insdvl.cli") == "cli"
    assert room("insdvl.navigation") == room("insdvl.navigation.geometry.earth") == "navigation"


def test_nothing_is_imported_against_the_order_of_the_rooms() -> None:
    against = [
        f"{name} imports {other}"
        for name in names("insdvl")
        for other in sorted(ours(name))
        if room(other) != room(name) and LEVEL[room(other)] >= LEVEL[room(name)]
    ]
    assert against == []


def test_what_runs_aboard_imports_nothing_from_ashore() -> None:
    """The nodes of the vehicle included."""
    aboard = [name for name in names("insdvl") if not is_ashore(name)]
    aboard += names("ros_insdvl")
    assert len(aboard) > 40
    found = [
        f"{name} imports {other}"
        for name in aboard
        for other in sorted(ours(name))
        if package_of(other) == "ros_insdvl_sim" or is_ashore(other)
    ]
    assert found == []


def test_the_core_imports_no_node() -> None:
    assert [n for n in names("insdvl") if any(package_of(o) != "insdvl" for o in ours(n))] == []


def circles() -> list[list[str]]:
    """The circles of imports that a walk along all of them meets."""
    found, done = [], set()

    def walk(name: str, path: list[str]) -> None:
        if name in path:
            found.append([*path[path.index(name) :], name])
        elif name not in done:
            for other in sorted(ours(name) - {name}):
                walk(other, [*path, name])
            done.add(name)

    for name in modules():
        walk(name, [])
    return found


def test_no_files_import_each_other_in_a_circle() -> None:
    assert [" -> ".join(circle) for circle in circles()] == []


def test_no_folder_has_more_files_than_one_takes_in_at_a_glance() -> None:
    folders = {path.parent for path in modules().values()}
    counts = {str(f.relative_to(ROOT)): len(list(f.glob("*.py"))) for f in folders}
    assert {folder: count for folder, count in counts.items() if count > MAX_FILES} == {}


def test_no_file_is_longer_than_one_reads_in_a_sitting() -> None:
    lengths = {
        str(path.relative_to(ROOT)): len(path.read_text().splitlines())
        for path in modules().values()
    }
    long = {path for path, length in lengths.items() if length > MAX_LINES}
    assert {path: lengths[path] for path in long - TABLES.keys()} == {}
    assert TABLES.keys() - long == set(), "these are no longer long"


@pytest.mark.parametrize("name", ["Array", "Stamps", "Records"])
def test_array_types_are_defined_once(name: str) -> None:
    defining = [
        str(path.relative_to(ROOT))
        for path in modules().values()
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.Assign)
        and any(isinstance(target, ast.Name) and target.id == name for target in node.targets)
    ]
    assert defining == ["src/insdvl/arrays.py"]


def test_the_tests_mirror_the_rooms() -> None:
    tests = {path.parent.name for path in (ROOT / "test" / "core").rglob("test_*.py")}
    assert tests - {"core"} <= LEVEL.keys()
    roots = {path.stem.removeprefix("test_") for path in (ROOT / "test/core").glob("test_*.py")}
    assert {f"insdvl.{root}" for root in roots} <= modules().keys()
