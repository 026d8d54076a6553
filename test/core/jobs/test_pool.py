"""Long computations: the same results everywhere, and no finished task is computed again."""

import os
import re
import signal
import socket
import time
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from insdvl import kernels
from insdvl.jobs import cluster, store
from insdvl.jobs.options import Workers, WorkersError
from insdvl.jobs.pool import TaskError, open_pool
from insdvl.jobs.store import Store, environment
from insdvl.kernels import source_digest

BACKENDS = ("here", "threads", "loky", "dask")


@pytest.fixture(scope="module")
def pools():
    """One process, two threads of it, two processes of joblib, and a Dask cluster of two."""
    with (
        open_pool(Workers("loky", 1)) as here,
        open_pool(Workers("threads", 2)) as threads_,
        open_pool(Workers("loky", 2)) as loky,
        open_pool(Workers("dask", 2)) as dask,
    ):
        yield {"here": here, "threads": threads_, "loky": loky, "dask": dask}


@pytest.fixture(scope="module")
def address(pools):
    return pools["dask"]._backend._client.scheduler.address


@dataclass(frozen=True)
class Trial:
    """What a task does beside giving its result."""

    seed: int
    ran: Path | None = None  # a folder, for a file of each run
    ends_worker: Path | None = None  # once: while there is no such file
    waits_for: int = 0  # results in the store, before it ends its worker
    fails: bool = False
    is_interrupted: bool = False


def product(matrix, trial):
    if trial.ran is not None:
        (trial.ran / f"{trial.seed}-{os.urandom(8).hex()}").touch()
    if trial.ends_worker is not None and not trial.ends_worker.exists():
        stored = trial.ends_worker.parent / "store"
        while len(list(stored.glob("*/*/*.npz"))) < trial.waits_for:
            time.sleep(0.01)
        trial.ends_worker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if trial.fails:
        raise ArithmeticError(f"no product for {trial.seed}")
    if trial.is_interrupted:
        raise KeyboardInterrupt
    random = np.random.default_rng(trial.seed).standard_normal(matrix.shape)
    return {"product": (random @ matrix)[:, ::2], "mean": random.mean(), "process": os.getpid()}


def threads(shared, task):
    return {"threads": [library["num_threads"] for library in threadpool_info()]}


def objects(shared, task):
    return {"objects": np.array([object()])}


MATRIX = np.random.default_rng(0).standard_normal((150, 150))


def trials(number, **fields):
    return {f"trial-{seed}": Trial(seed, **fields) for seed in range(number)}


def bits(results):
    return [
        (name, array.dtype, array.shape, array.strides, array.tobytes())
        for result in results
        for name, array in result.items()
        if name != "process"
    ]


def kept(folder, settings=None):
    return Store(folder / "store", settings or {}, Path(__file__))


def runs(folder):
    return Counter(int(file.name.partition("-")[0]) for file in folder.iterdir())


def test_identical_to_the_bit_wherever_they_run(pools):
    results = {name: pools[name].compute(product, trials(6), MATRIX) for name in BACKENDS}
    assert bits(results["threads"]) == bits(results["here"])
    assert bits(results["loky"]) == bits(results["here"])
    assert bits(results["dask"]) == bits(results["here"])
    processes = {name: {int(result["process"]) for result in results[name]} for name in BACKENDS}
    assert processes["here"] == processes["threads"] == {os.getpid()}
    assert not processes["loky"] & processes["here"]
    assert not processes["dask"] & (processes["here"] | processes["loky"])


@pytest.mark.parametrize("backend", BACKENDS)
def test_one_thread_in_each_task(pools, backend):
    (result,) = pools[backend].compute(threads, {"one": None})
    assert set(result["threads"]) == {1}


def test_dask_runs_the_tasks_of_a_lost_worker_again(pools, tmp_path):
    tasks = trials(6)
    tasks["trial-3"] = replace(tasks["trial-3"], ends_worker=tmp_path / "ended")
    results = pools["dask"].compute(product, tasks, MATRIX)
    assert bits(results) == bits(pools["here"].compute(product, trials(6), MATRIX))
    assert (tmp_path / "ended").exists()


def test_a_task_that_ends_its_workers_on_dask_is_named(pools, tmp_path, monkeypatch):
    scheduler = pools["dask"]._backend._client.cluster.scheduler
    monkeypatch.setattr(scheduler, "allowed_failures", 0)
    tasks = {"trial-0": Trial(0, ends_worker=tmp_path / "ended")}
    sentence = r"^products: task trial-0 failed: its workers died \(out of memory\?\)$"
    with pytest.raises(TaskError, match=sentence):
        pools["dask"].compute(product, tasks, MATRIX, label="products")


def test_a_dead_process_ends_the_call_and_the_next_one_resumes(pools, tmp_path):
    """The task that ends its worker waits until the others are finished."""
    ran = tmp_path / "ran"
    ran.mkdir()
    tasks = trials(4, ran=ran)
    tasks["trial-3"] = replace(tasks["trial-3"], ends_worker=tmp_path / "ended", waits_for=3)
    sentence = (
        r"^products: a worker process died \(out of memory\?\); finished tasks are kept, "
        "run it again to resume$"
    )
    with pytest.raises(TaskError, match=sentence):
        pools["loky"].compute(product, tasks, MATRIX, kept(tmp_path), "products")
    again = pools["loky"].compute(product, tasks, MATRIX, kept(tmp_path), "products")
    assert bits(again) == bits(pools["here"].compute(product, trials(4), MATRIX))
    assert runs(ran) == {0: 1, 1: 1, 2: 1, 3: 2}


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_failed_task_is_named_and_the_others_are_kept(pools, backend, tmp_path):
    ran = tmp_path / "ran"
    ran.mkdir()
    tasks = trials(3, ran=ran)
    tasks["trial-2"] = replace(tasks["trial-2"], fails=True)
    with pytest.raises(TaskError) as caught:
        pools[backend].compute(product, tasks, MATRIX, kept(tmp_path), label="products")
    assert str(caught.value) == ("products: task trial-2 failed: ArithmeticError: no product for 2")
    assert "in product\n" in str(caught.value.__cause__)

    pools["here"].compute(product, trials(3, ran=ran), MATRIX, kept(tmp_path), "products")
    # Dask may have met the failure first.
    assert runs(ran) == {0: 1, 1: 1, 2: 2} or (backend == "dask" and runs(ran)[2] == 2)


@pytest.mark.parametrize("backend", BACKENDS)
def test_only_what_is_missing_runs(pools, backend, tmp_path, capsys):
    ran = tmp_path / "ran"
    ran.mkdir()
    store = kept(tmp_path, {"seed": 1})
    first = pools[backend].compute(product, trials(3, ran=ran), MATRIX, store, "products")
    assert "earlier run" not in capsys.readouterr().err
    again = kept(tmp_path, {"seed": 1})
    all_of_them = pools["here"].compute(product, trials(5, ran=ran), MATRIX, again, "products")
    assert runs(ran) == dict.fromkeys(range(5), 1)
    assert bits(all_of_them[:3]) == bits(first)
    assert bits(all_of_them) == bits(pools["here"].compute(product, trials(5), MATRIX))
    assert "products: 3/5 from an earlier run" in capsys.readouterr().err


def test_an_interrupt_leaves_what_was_finished(pools, tmp_path):
    ran = tmp_path / "ran"
    ran.mkdir()
    tasks = trials(4, ran=ran)
    tasks["trial-2"] = replace(tasks["trial-2"], is_interrupted=True)
    store = kept(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        pools["here"].compute(product, tasks, MATRIX, store)
    pools["here"].compute(product, trials(4, ran=ran), MATRIX, store)
    assert runs(ran) == {0: 1, 1: 1, 2: 2, 3: 1}


@pytest.mark.parametrize("damage", ["one bit", "half", "empty", "pickle"])
def test_a_damaged_result_is_computed_again(pools, damage, tmp_path, capsys):
    store = kept(tmp_path)
    results = pools["here"].compute(product, trials(2), MATRIX, store, "products")
    path = store.path("products", "trial-1")
    content = bytearray(path.read_bytes())
    if damage == "one bit":
        content[len(content) // 2] ^= 1
    elif damage == "pickle":
        np.savez(path, product=np.array([{}]))
        content = path.read_bytes()
    path.write_bytes(content[: {"half": len(content) // 2, "empty": 0}.get(damage)])
    capsys.readouterr()
    assert bits(pools["here"].compute(product, trials(2), MATRIX, store, "products")) == bits(
        results
    )
    said = capsys.readouterr().err
    assert f"{path} is damaged" in said
    assert "products: 1/2 from an earlier run" in said
    pools["here"].compute(product, trials(2), MATRIX, store, "products")
    assert "damaged" not in capsys.readouterr().err


def test_results_belong_to_settings_sources_and_versions(tmp_path, monkeypatch):
    folder = kept(tmp_path, {"a": 1, "b": 2}).folder
    assert kept(tmp_path, {"b": 2, "a": 1}).folder == folder
    others = {kept(tmp_path, {"a": 1, "b": 3}).folder}
    for name in ("insdvl", "python", "numpy", "scipy", "numba", "scikit-learn"):
        changed = {**environment(Path(__file__)), name: "another"}
        monkeypatch.setattr(store, "environment", lambda source, changed=changed: changed)
        others.add(kept(tmp_path, {"a": 1, "b": 2}).folder)
        monkeypatch.undo()
    assert len(others - {folder}) == 7


def test_results_depend_on_the_files_of_their_code_only(tmp_path):
    def digest(name):
        for cached in (kernels._imported, kernels._file_digest, source_digest, environment):
            cached.cache_clear()
        return Store(tmp_path / f"of {name}", {}, tmp_path / name).folder.name

    (tmp_path / "one.py").write_text("from insdvl.jobs import options\n")
    (tmp_path / "two.py").write_text("from insdvl.jobs import options\n")
    one, two = digest("one.py"), digest("two.py")
    (tmp_path / "two.py").write_text("from insdvl.jobs import progress\n")
    assert digest("one.py") == one
    assert digest("two.py") != two


def test_a_store_removes_its_own_and_nothing_else(pools, tmp_path):
    old = kept(tmp_path, {"seed": 1})
    pools["here"].compute(product, trials(1), MATRIX, old)
    (tmp_path / "store" / "notes.txt").write_text("not ours")
    store = kept(tmp_path, {"seed": 2})
    assert not old.folder.exists()
    # A program that still uses the old one goes on.
    pools["here"].compute(product, trials(1), MATRIX, old)
    assert old.path("tasks", "trial-0").is_file()
    store.clear()
    old.clear()
    assert [path.name for path in (tmp_path / "store").iterdir()] == ["notes.txt"]
    (tmp_path / "store" / "notes.txt").unlink()
    kept(tmp_path).clear()
    assert not (tmp_path / "store").exists()


def test_only_arrays_without_objects_are_results(pools):
    with pytest.raises(TaskError, match="task one failed: TypeError: objects is not an array"):
        pools["here"].compute(objects, {"one": None})


@pytest.mark.parametrize("name", ["", "a/b", ".hidden", "..", "x" * 300])
def test_names_are_file_names(pools, name):
    with pytest.raises(ValueError, match="is not a valid file name"):
        pools["here"].compute(product, {name: Trial(0)}, MATRIX)


def test_progress_in_a_few_lines(pools, capsys):
    pools["here"].compute(product, trials(60), MATRIX, label="products")
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "products: 0/60"
    assert re.fullmatch(r"products: 60/60, \d+:\d\d elapsed, 0:00 left", lines[-1])
    assert len(lines) == 11


def test_an_existing_cluster(pools, address):
    with open_pool(Workers("dask", scheduler=address)) as pool:
        results = pool.compute(product, trials(3), MATRIX)
    assert bits(results) == bits(pools["here"].compute(product, trials(3), MATRIX))
    assert len(pools["dask"].compute(product, trials(1), MATRIX)) == 1  # it goes on


@pytest.mark.parametrize("name", ["insdvl", "numpy"])
def test_a_cluster_with_other_versions_is_refused(address, name, monkeypatch):
    monkeypatch.setitem(environment(Path(__file__)), name, "another")
    with (
        open_pool(Workers("dask", scheduler=address)) as pool,
        pytest.raises(WorkersError, match=rf"has {name} \S+, this process has another$"),
    ):
        pool.compute(product, trials(3), MATRIX)


def test_no_scheduler_is_one_sentence(monkeypatch):
    monkeypatch.setattr(cluster, "CONNECT_TIMEOUT_S", 0.3)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        nobody = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    for scheduler in (nobody, "nonsense"):
        with (
            pytest.raises(WorkersError, match=f"^no Dask scheduler answers at {scheduler}$"),
            open_pool(Workers("dask", scheduler=scheduler)),
        ):
            pass
