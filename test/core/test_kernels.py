"""The cache of the compiled functions never stops a program, whatever is in it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import insdvl
from insdvl import kernels

PROGRAM = """
import sys, warnings
{before}
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    from pathlib import Path
    from insdvl import kernels
    import kernel_of_test
    from kernel_of_test import add
    result = add(1.0, 2.0)
    kernels.kernel(add.py_func)  # a second function is no second warning
print(result)
print(kernels.cache_dir(Path(kernel_of_test.__file__)))
print(sum(add.stats.cache_hits.values()))
for warning in caught:
    if warning.category is kernels.CacheWarning:
        print(warning.message)
"""

KERNEL = """
from insdvl.kernels import kernel

@kernel
def add(a, b):
    return a + b

@kernel
def twice(a):
    return add(a, a)
"""


class Outcome:
    def __init__(self, output):
        result, folder, hits, *self.warnings = output.splitlines()
        assert float(result) == 3.0
        self.folder = None if folder == "None" else Path(folder)
        self.hits = int(hits)


TELLING = """
import sys
{before}
from insdvl import kernels
from kernel_of_test import add, twice
def say(*words):
    print(*words)
with kernels.compiling(
    lambda why: say("begins", why), lambda s: say("ends", s > 0.0), lambda text: say("warns", text)
):
    add(1.0, 2.0)
    twice(1.0)
"""


@pytest.fixture
def execute(tmp_path):
    """The output of a program in a new interpreter, with a home and a cache of its own."""
    module = tmp_path / "module"
    module.mkdir()
    (module / "kernel_of_test.py").write_text(KERNEL)
    home = tmp_path / "home"
    home.mkdir()

    def execute(program, before="", **variables):
        environment = {
            name: value
            for name, value in os.environ.items()
            if name not in ("INSDVL_CACHE_DIR", "XDG_CACHE_HOME", "HOME")
        }
        package = Path(insdvl.__file__).parents[1]
        environment["PYTHONPATH"] = os.pathsep.join(
            [str(module), str(package), environment.get("PYTHONPATH", "")]
        )
        environment |= {"HOME": str(home), **{k: str(v) for k, v in variables.items()}}
        done = subprocess.run(
            [sys.executable, "-c", program.format(before=before)],
            env={name: value for name, value in environment.items() if value != "None"},
            cwd=tmp_path,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        return done

    return execute


@pytest.fixture
def run(execute):
    """Compile and call a function."""
    return lambda *before, **variables: Outcome(execute(PROGRAM, *before, **variables).stdout)


def files(folder):
    return [path for path in folder.rglob("*.nb[ic]") if "kernel_of_test" in path.name]


def test_named_folder_first_and_the_second_program_reads_from_it(run, tmp_path):
    cache = tmp_path / "cache" / "deep"
    first = run(INSDVL_CACHE_DIR=cache)
    assert first.folder.parent == cache
    assert not first.warnings
    assert not list((tmp_path / "home").rglob("*"))
    assert {path.suffix for path in files(cache)} == {".nbi", ".nbc"}
    assert first.hits == 0
    assert run(INSDVL_CACHE_DIR=cache).hits == 1


def test_users_folder_otherwise(run, tmp_path):
    outcome = run()
    assert outcome.folder.parent == tmp_path / "home" / ".cache" / "insdvl"
    assert files(outcome.folder)
    assert not outcome.warnings


def test_xdg_folder(run, tmp_path):
    outcome = run(XDG_CACHE_HOME=tmp_path / "xdg")
    assert outcome.folder.parent == tmp_path / "xdg" / "insdvl"
    assert not outcome.warnings


def test_users_folder_where_the_named_one_cannot_be_written(run, tmp_path):
    (tmp_path / "file").write_text("")
    outcome = run(INSDVL_CACHE_DIR=tmp_path / "file")
    assert outcome.folder.parent == tmp_path / "home" / ".cache" / "insdvl"


def test_no_folder_is_one_warning(run):
    """Below a device nobody can make a folder, root included."""
    outcome = run(INSDVL_CACHE_DIR="/dev/null/named", HOME="/dev/null")
    assert outcome.folder is None
    (warning,) = outcome.warnings
    assert "not cached" in warning
    assert "INSDVL_CACHE_DIR" in warning


def test_home_unset_and_the_user_unknown(run):
    unknown = "import pwd; pwd.getpwuid = lambda uid: {}[uid]"
    outcome = run(unknown, HOME=None)
    assert outcome.folder is None
    (warning,) = outcome.warnings
    assert "no home folder" in warning


def test_home_unset_with_a_named_folder(run, tmp_path):
    outcome = run(HOME=None, INSDVL_CACHE_DIR=tmp_path / "cache")
    assert outcome.folder.parent == tmp_path / "cache"
    assert not outcome.warnings


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: b"\x80\x04garbage" * 50,
        pytest.param(lambda content: content[: len(content) // 2], marks=pytest.mark.long),
    ],
    ids=["garbage", "half"],
)
def test_damaged_files(damage, run, tmp_path):
    """One warning, the function compiles again, and the next program finds the cache mended."""
    cache = tmp_path / "cache"
    run(INSDVL_CACHE_DIR=cache)
    contents = {path: path.read_bytes() for path in files(cache)}
    for damaged, content in contents.items():
        for path in contents:
            path.write_bytes(contents[path])
        damaged.write_bytes(damage(content))
        outcome = run(INSDVL_CACHE_DIR=cache)
        assert outcome.hits == 0
        (warning,) = outcome.warnings
        assert "damaged cache" in warning
        mended = run(INSDVL_CACHE_DIR=cache)
        assert mended.hits == 1
        assert not mended.warnings
    assert len(contents) == 2


def test_folder_that_vanishes_before_the_first_call(run, tmp_path):
    """A folder replaced by a file after it was chosen: one warning, and the right result."""
    cache = tmp_path / "cache"
    before = (
        "import kernel_of_test, shutil; from pathlib import Path; from insdvl import kernels; "
        "folder = kernels.cache_dir(Path(kernel_of_test.__file__)); shutil.rmtree(folder); "
        "folder.write_text('')"
    )
    outcome = run(before, INSDVL_CACHE_DIR=cache)
    (warning,) = outcome.warnings
    assert "not cached" in warning


def test_another_source_is_another_folder(run, tmp_path):
    """numba looks at the source of the function alone, not at what it calls."""
    outcome = run(INSDVL_CACHE_DIR=tmp_path / "cache")
    copy = tmp_path / "copy"
    package = Path(insdvl.__file__).parent
    (copy / "insdvl").mkdir(parents=True)
    for name in ("__init__.py", "kernels.py"):
        (copy / "insdvl" / name).write_bytes((package / name).read_bytes())
    (copy / "insdvl" / "kernels.py").open("a").write("\n# another\n")
    other = run(f"sys.path.insert(0, {str(copy)!r})", INSDVL_CACHE_DIR=tmp_path / "cache")
    assert other.folder != outcome.folder
    assert other.folder.parent == outcome.folder.parent


def test_an_edit_is_another_digest_where_it_is_imported_and_nowhere_else(tmp_path, monkeypatch):
    package = tmp_path / "insdvl"
    sources = {
        "__init__": "",
        "near/__init__": "",
        "near/first": "from insdvl.near.second import x",
        "near/second": "import insdvl.third",
        "third": "x = 1",
        "far": "x = 1",
    }
    for name, text in sources.items():
        file = package / f"{name}.py"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    monkeypatch.setattr(kernels, "_PACKAGE", package)

    def digest(file):
        kernels._file_digest.cache_clear()
        return kernels.source_digest.__wrapped__(file)

    before = digest(package / "near/first.py")
    (package / "far.py").write_text("x = 2")
    assert digest(package / "near/first.py") == before
    (package / "third.py").write_text("x = 2")
    assert digest(package / "near/first.py") != before


def test_a_folder_that_others_may_write_to_is_not_used(run, tmp_path):
    """What is in it is run: it is as trusted as the package itself."""
    folder = run(INSDVL_CACHE_DIR=tmp_path / "cache").folder
    folder.chmod(0o777)
    outcome = run(INSDVL_CACHE_DIR=tmp_path / "cache")
    assert outcome.folder.parent == tmp_path / "home" / ".cache" / "insdvl"
    folder.chmod(0o755)
    assert run(INSDVL_CACHE_DIR=tmp_path / "cache").folder == folder


def test_the_folder_is_its_owners_whatever_the_mask(run, tmp_path):
    folder = run("import os; os.umask(0)", INSDVL_CACHE_DIR=tmp_path / "cache").folder
    assert folder.parent == tmp_path / "cache"


#: Of a folder that has become read-only; root may write to any other.
READ_ONLY = """
import errno, os, tempfile
def refuse(*_, **__):
    raise OSError(errno.EROFS, "Read-only file system")
tempfile.TemporaryFile = os.replace = refuse
"""


def test_what_the_installation_compiled_comes_first(tmp_path, monkeypatch):
    monkeypatch.setenv("INSDVL_CACHE_DIR", str(tmp_path / "named"))
    monkeypatch.setattr(kernels, "_PACKAGE", tmp_path / "insdvl")
    assert kernels._candidates("kernels-1")[0] == tmp_path / "named" / "kernels-1"
    installed = tmp_path / "insdvl" / "__pycache__" / "kernels-1"
    installed.mkdir(parents=True)
    assert kernels._candidates("kernels-1")[:2] == [installed, tmp_path / "named" / "kernels-1"]
    assert installed not in kernels._candidates("kernels-2")


def test_a_filled_folder_may_be_read_only(run, tmp_path):
    """As in the image of a vehicle's computer."""
    run(INSDVL_CACHE_DIR=tmp_path / "cache")
    outcome = run(READ_ONLY, INSDVL_CACHE_DIR=tmp_path / "cache")
    assert outcome.folder.parent == tmp_path / "cache"
    assert outcome.hits == 1
    assert not outcome.warnings


def test_an_empty_folder_that_is_read_only_is_not_used(run, tmp_path):
    outcome = run(READ_ONLY, INSDVL_CACHE_DIR=tmp_path / "cache")
    assert outcome.folder is None
    (warning,) = outcome.warnings
    assert "Read-only file system" in warning


def test_a_compilation_is_told_once_and_only_where_one_is_needed(execute, tmp_path):
    first = execute(TELLING, INSDVL_CACHE_DIR=tmp_path / "cache")
    assert first.stdout.splitlines() == [f"begins {kernels.FIRST}", "ends True"]
    assert execute(TELLING, INSDVL_CACHE_DIR=tmp_path / "cache").stdout == ""


def test_another_processor_compiles_again_and_that_is_told(execute, tmp_path):
    cache = tmp_path / "cache"
    execute(TELLING, INSDVL_CACHE_DIR=cache, NUMBA_CPU_NAME="generic", NUMBA_CPU_FEATURES="")
    here = execute(TELLING, INSDVL_CACHE_DIR=cache)
    assert here.stdout.splitlines() == [f"begins {kernels.OTHER_PROCESSOR}", "ends True"]
    assert execute(TELLING, INSDVL_CACHE_DIR=cache).stdout == ""


def test_who_is_told_of_the_compilation_is_told_why_it_is_not_cached(execute):
    done = execute(TELLING, INSDVL_CACHE_DIR="/dev/null/named", HOME="/dev/null")
    begins, warns, ends = done.stdout.splitlines()
    assert (begins, ends) == (f"begins {kernels.FIRST}", "ends True")
    assert warns.startswith("warns compiled functions are not cached (/dev/null")
    assert done.stderr == ""


def test_otherwise_the_warning_is_one_line(execute):
    program = "import kernel_of_test\n{before}\nkernel_of_test.add(1.0, 2.0)"
    done = execute(program, INSDVL_CACHE_DIR="/dev/null/named", HOME="/dev/null")
    (line,) = done.stderr.splitlines()
    assert "CacheWarning: compiled functions are not cached" in line
