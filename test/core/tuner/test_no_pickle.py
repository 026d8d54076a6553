"""No pickle comes from a file: a pickle can run anything, and a file may be anybody's."""

import ast
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import insdvl

ROOT = Path(__file__).parents[3]
PACKAGES = ("src/insdvl", "ros_insdvl/ros_insdvl", "ros_insdvl_sim/ros_insdvl_sim")

#: What runs code that it finds in data.
LOADERS = {
    "pickle": {"load", "loads", "Unpickler"},
    "joblib": {"load"},
    "torch": {"load"},
    "yaml": {"load", "load_all", "full_load", "full_load_all", "unsafe_load", "unsafe_load_all"},
    "marshal": {"load", "loads"},
}
MODULES = {"shelve", "dill", "cloudpickle", "_pickle"}
#: The one that may: what a worker gets through the pipe of the process that made it.
ALLOWED = {("backends.py", "pickle.loads")}


def loaders(tree: ast.AST) -> Iterator[str]:
    """Calls, by any import, of what runs code that it finds in data."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in MODULES)
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = {alias.name for alias in node.names}
            if node.module in MODULES or names & LOADERS.get(node.module, set()):
                yield node.module
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            if node.attr in LOADERS.get(node.value.id, set()):
                yield f"{node.value.id}.{node.attr}"
        elif isinstance(node, ast.Call):
            if isinstance(node.func, ast.Name) and node.func.id in ("eval", "exec"):
                yield node.func.id
            if isinstance(node.func, ast.Attribute) and ast.unparse(node.func) == "np.load":
                safe = {k.arg: ast.unparse(k.value) for k in node.keywords}
                if safe.get("allow_pickle") != "False":
                    yield "np.load"


def test_the_sources_call_no_loader_that_runs_what_it_reads() -> None:
    files = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    assert len(files) > 50
    found = {(path.name, name) for path in files for name in loaders(ast.parse(path.read_text()))}
    assert found == ALLOWED


@pytest.mark.parametrize(
    "source",
    [
        "import pickle\npickle.load(file)",
        "from pickle import loads",
        "import numpy as np\nnp.load(file)",
        "import numpy as np\nnp.load(file, allow_pickle=True)",
        "import yaml\nyaml.load(text, Loader=yaml.Loader)",
        "import dill",
        "eval(text)",
    ],
)
def test_the_search_finds_them(source: str) -> None:
    assert list(loaders(ast.parse(source)))


#: Imported by every interpreter that starts, workers included: tells which files are opened that
#: hold a pickle. numba's own, compiled code in the user's own folder, are left out.
TRIPWIRE = """
import os, stat, sys

def is_pickle(path):
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except OSError:
        return False
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            return False
        begin = os.read(descriptor, 2)
    finally:
        os.close(descriptor)
    return len(begin) == 2 and begin[0] == 0x80 and begin[1] <= 5

asking = False

def hook(event, arguments):
    global asking
    if event != "open" or asking or not isinstance(arguments[0], (str, bytes)):
        return
    asking = True
    path = os.fsdecode(arguments[0])
    if not path.endswith((".nbi", ".nbc")) and is_pickle(path):
        with open(os.environ["TRIPWIRE"], "a") as log:
            log.write(path + chr(10))
    asking = False

sys.addaudithook(hook)
"""

TASKS = """
import numpy as np

def product(matrix, task):
    return {"product": matrix[: len(task)] @ task}
"""

PROGRAM = """
import sys
import numpy as np
from pathlib import Path
from insdvl.jobs.options import Workers
from insdvl.jobs.pool import open_pool
from insdvl.jobs.store import Store
from tasks_of_test import product

matrix = np.random.default_rng(0).standard_normal((400, 400))  # joblib would put it in a file
tasks = {f"{k}": matrix + k for k in range(4)}
results = {}
for jobs in (1, 2):
    with open_pool(Workers("loky", jobs)) as pool:
        store = Store(Path(sys.argv[1], f"{jobs}"), {}, Path(__file__))
        kept = pool.compute(product, tasks, matrix, store)
        assert [r["product"].tobytes() for r in pool.compute(product, tasks, matrix, store)] == [
            r["product"].tobytes() for r in kept]
        results[jobs] = [r["product"].tobytes() for r in kept]
assert results[1] == results[2]
"""


@pytest.fixture
def program(tmp_path: Path) -> Path:
    """A folder with the programs."""
    folder = tmp_path / "program"
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(TRIPWIRE)
    (folder / "tasks_of_test.py").write_text(TASKS)
    (folder / "program.py").write_text(PROGRAM)
    (folder / "interrupted.py").write_text(INTERRUPTED)
    return folder


def environment(folder: Path) -> dict[str, str]:
    package = Path(insdvl.__file__).parents[1]
    paths = [str(folder), str(package), os.environ.get("PYTHONPATH", "")]
    return os.environ | {
        "PYTHONPATH": os.pathsep.join(paths),
        "TRIPWIRE": str(folder / "opened"),
    }


def test_a_run_opens_no_file_that_holds_a_pickle(program: Path, tmp_path: Path) -> None:
    import joblib

    command = [sys.executable, str(program / "program.py"), str(tmp_path)]
    done = subprocess.run(command, env=environment(program), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert not (program / "opened").exists(), (program / "opened").read_text()

    # The tripwire works.
    joblib.dump({"a": 1}, tmp_path / "pickle")
    load = f"import joblib; joblib.load({str(tmp_path / 'pickle')!r})"
    subprocess.run([sys.executable, "-c", load], env=environment(program), check=True)
    assert set((program / "opened").read_text().split()) == {str(tmp_path / "pickle")}


INTERRUPTED = """
import os, signal, time
import numpy as np
from insdvl.jobs.options import Workers
from insdvl.jobs.pool import open_pool

def sleep(shared, task):
    open(os.path.join(os.environ["STARTED"], str(os.getpid())), "w").close()
    time.sleep(600)

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in a background job
    with open_pool(Workers("loky", 2)) as pool:
        pool.compute(sleep, {f"{k}": k for k in range(9)}, np.zeros(1_000_000))
"""


def is_running(pid: int) -> bool:
    """Whether there is such a process that is no zombie."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


def test_an_interrupt_ends_all_processes(program: Path, tmp_path: Path) -> None:
    started = tmp_path / "started"
    started.mkdir()
    process = subprocess.Popen(
        [sys.executable, str(program / "interrupted.py")],
        env=environment(program) | {"STARTED": str(started)},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    while len(list(started.iterdir())) < 2:
        assert process.poll() is None
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)  # as Ctrl-C does, to the workers as well
    _, said = process.communicate(timeout=60)
    assert process.returncode == -signal.SIGINT
    assert said.count("Traceback") == 1, said  # of the program itself, which does not catch it
    workers = [int(path.name) for path in started.iterdir()]
    deadline = time.monotonic() + 30.0
    while any(map(is_running, workers)) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not any(map(is_running, workers))
