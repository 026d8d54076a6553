"""Long computations: the same results everywhere, at the cost of no worker that is lost."""

import argparse
import os
import re
import signal
import socket
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from insdvl.jobs import parallel
from insdvl.jobs.parallel import Pool, Store, TaskError, Workers, WorkersError

BACKENDS = ("here", "loky", "dask")


@pytest.fixture(scope="module")
def pools():
    """One process, two of joblib, and a Dask cluster of two."""
    with (
        parallel.pool(Workers("loky", 1)) as here,
        parallel.pool(Workers("loky", 2)) as loky,
        parallel.pool(Workers("dask", 2)) as dask,
    ):
        yield {"here": here, "loky": loky, "dask": dask}


@pytest.fixture(scope="module")
def address(pools):
    return pools["dask"]._backend._client.scheduler.address


@dataclass(frozen=True)
class Trial:
    """What a task does beside giving its result."""

    seed: int
    ran: Path | None = None  # a folder, for a file of each run
    ends_worker: Path | None = None  # once: while there is no such file
    fails: bool = False
    is_interrupted: bool = False


def product(matrix, trial):
    if trial.ran is not None:
        (trial.ran / f"{trial.seed}-{os.urandom(8).hex()}").touch()
    if trial.ends_worker is not None and not trial.ends_worker.exists():
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


def runs(folder):
    return Counter(int(file.name.partition("-")[0]) for file in folder.iterdir())


def test_identical_to_the_bit_wherever_they_run(pools):
    results = {name: pools[name].run(product, trials(6), MATRIX) for name in BACKENDS}
    assert bits(results["loky"]) == bits(results["here"])
    assert bits(results["dask"]) == bits(results["here"])
    processes = {name: {int(result["process"]) for result in results[name]} for name in BACKENDS}
    assert processes["here"] == {os.getpid()}
    assert not processes["loky"] & processes["here"]
    assert not processes["dask"] & (processes["here"] | processes["loky"])


@pytest.mark.parametrize("backend", BACKENDS)
def test_one_thread_in_each_task(pools, backend):
    (result,) = pools[backend].run(threads, {"one": None})
    assert set(result["threads"]) == {1}


@pytest.mark.parametrize("backend", ["loky", "dask"])
def test_a_lost_worker_costs_nothing(pools, backend, tmp_path, capsys):
    tasks = trials(6)
    tasks["trial-3"] = replace(tasks["trial-3"], ends_worker=tmp_path / "ended")
    results = pools[backend].run(product, tasks, MATRIX)
    assert bits(results) == bits(pools["here"].run(product, trials(6), MATRIX))
    assert (tmp_path / "ended").exists()
    assert "a worker died; its tasks run again" in capsys.readouterr().err


class Fragile:
    """Workers that one task ends so many times, before anything else has a result."""

    def __init__(self, deadly, times):
        self.deadly = deadly
        self.times = times

    def outcomes(self, work):
        if self.deadly in work.tasks and self.times:
            self.times -= 1
            raise parallel._LostWorkerError
        yield from parallel._Here().outcomes(work)


def test_a_task_that_ends_every_worker_is_named(tmp_path):
    ran = tmp_path / "ran"
    ran.mkdir()
    store = Store(tmp_path / "store", {})
    with pytest.raises(TaskError, match=r"^products: task trial-2 ended 3 workers"):
        Pool(Fragile("trial-2", 100)).run(
            product, trials(4, ran=ran), MATRIX, store, label="products"
        )
    assert runs(ran) == {0: 1, 1: 1}
    assert len(Pool(Fragile("trial-2", 3)).run(product, trials(4), MATRIX)) == 4


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_failed_task_is_named_and_the_others_are_kept(pools, backend, tmp_path):
    ran = tmp_path / "ran"
    ran.mkdir()
    tasks = trials(3, ran=ran)
    tasks["trial-2"] = replace(tasks["trial-2"], fails=True)
    with pytest.raises(TaskError) as caught:
        pools[backend].run(product, tasks, MATRIX, Store(tmp_path / "s", {}), label="products")
    assert str(caught.value) == ("products: task trial-2 failed: ArithmeticError: no product for 2")
    assert "in product\n" in str(caught.value.__cause__)

    pools["here"].run(product, trials(3, ran=ran), MATRIX, Store(tmp_path / "s", {}), "products")
    # Dask may have met the failure first.
    assert runs(ran) == {0: 1, 1: 1, 2: 2} or (backend == "dask" and runs(ran)[2] == 2)


@pytest.mark.parametrize("backend", BACKENDS)
def test_only_what_is_missing_runs(pools, backend, tmp_path, capsys):
    ran = tmp_path / "ran"
    ran.mkdir()
    store = Store(tmp_path / "store", {"seed": 1})
    first = pools[backend].run(product, trials(3, ran=ran), MATRIX, store, "products")
    assert "earlier run" not in capsys.readouterr().err
    again = Store(tmp_path / "store", {"seed": 1})
    all_of_them = pools["here"].run(product, trials(5, ran=ran), MATRIX, again, "products")
    assert runs(ran) == dict.fromkeys(range(5), 1)
    assert bits(all_of_them[:3]) == bits(first)
    assert bits(all_of_them) == bits(pools["here"].run(product, trials(5), MATRIX))
    assert "products: 3/5 from an earlier run" in capsys.readouterr().err


def test_an_interrupt_leaves_what_was_finished(pools, tmp_path):
    ran = tmp_path / "ran"
    ran.mkdir()
    tasks = trials(4, ran=ran)
    tasks["trial-2"] = replace(tasks["trial-2"], is_interrupted=True)
    store = Store(tmp_path / "store", {})
    with pytest.raises(KeyboardInterrupt):
        pools["here"].run(product, tasks, MATRIX, store)
    pools["here"].run(product, trials(4, ran=ran), MATRIX, store)
    assert runs(ran) == {0: 1, 1: 1, 2: 2, 3: 1}


@pytest.mark.parametrize("damage", ["one bit", "half", "empty", "pickle"])
def test_a_damaged_result_is_computed_again(pools, damage, tmp_path, capsys):
    store = Store(tmp_path / "store", {})
    results = pools["here"].run(product, trials(2), MATRIX, store, "products")
    path = store.path("products", "trial-1")
    content = bytearray(path.read_bytes())
    if damage == "one bit":
        content[len(content) // 2] ^= 1
    elif damage == "pickle":
        np.savez(path, product=np.array([{}]))
        content = path.read_bytes()
    path.write_bytes(content[: {"half": len(content) // 2, "empty": 0}.get(damage)])
    capsys.readouterr()
    assert bits(pools["here"].run(product, trials(2), MATRIX, store, "products")) == bits(results)
    said = capsys.readouterr().err
    assert f"{path} is damaged" in said
    assert "products: 1/2 from an earlier run" in said
    pools["here"].run(product, trials(2), MATRIX, store, "products")
    assert "damaged" not in capsys.readouterr().err


def test_results_belong_to_settings_sources_and_versions(tmp_path, monkeypatch):
    folder = Store(tmp_path / "store", {"a": 1, "b": 2}).folder
    assert Store(tmp_path / "store", {"b": 2, "a": 1}).folder == folder
    others = {Store(tmp_path / "store", {"a": 1, "b": 3}).folder}
    for name in ("insdvl", "python", "numpy", "scipy", "numba", "scikit-learn"):
        changed = {**parallel.environment(), name: "another"}
        monkeypatch.setattr(parallel, "environment", lambda changed=changed: changed)
        others.add(Store(tmp_path / "store", {"a": 1, "b": 2}).folder)
        monkeypatch.undo()
    assert len(others - {folder}) == 7


def test_a_store_removes_its_own_and_nothing_else(pools, tmp_path):
    old = Store(tmp_path / "store", {"seed": 1})
    pools["here"].run(product, trials(1), MATRIX, old)
    (tmp_path / "store" / "notes.txt").write_text("not ours")
    store = Store(tmp_path / "store", {"seed": 2})
    assert not old.folder.exists()
    # A program that still uses the old one goes on.
    pools["here"].run(product, trials(1), MATRIX, old)
    assert old.path("tasks", "trial-0").is_file()
    store.clear()
    old.clear()
    assert [path.name for path in (tmp_path / "store").iterdir()] == ["notes.txt"]
    (tmp_path / "store" / "notes.txt").unlink()
    Store(tmp_path / "store", {}).clear()
    assert not (tmp_path / "store").exists()


def test_only_arrays_without_objects_are_results(pools):
    with pytest.raises(TaskError, match="task one failed: TypeError: objects is no array"):
        pools["here"].run(objects, {"one": None})


@pytest.mark.parametrize("name", ["", "a/b", ".hidden", "..", "x" * 300])
def test_names_are_file_names(pools, name):
    with pytest.raises(ValueError, match="cannot be the name of a file"):
        pools["here"].run(product, {name: Trial(0)}, MATRIX)


def test_progress_in_a_few_lines(pools, capsys):
    pools["here"].run(product, trials(60), MATRIX, label="products")
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "products: 0/60"
    assert re.fullmatch(r"products: 60/60, \d+:\d\d elapsed, 0:00 left", lines[-1])
    assert len(lines) == 11


def test_an_existing_cluster(pools, address):
    with parallel.pool(Workers("dask", scheduler=address)) as pool:
        results = pool.run(product, trials(3), MATRIX)
    assert bits(results) == bits(pools["here"].run(product, trials(3), MATRIX))
    assert len(pools["dask"].run(product, trials(1), MATRIX)) == 1  # it goes on


@pytest.mark.parametrize("name", ["insdvl", "numpy"])
def test_a_cluster_with_other_versions_is_refused(address, name, monkeypatch):
    ours = parallel.environment()
    monkeypatch.setitem(ours, name, "another")
    with (
        pytest.raises(WorkersError, match=rf"has {name} \S+, and this process another$"),
        parallel.pool(Workers("dask", scheduler=address)),
    ):
        pass


def test_no_scheduler_is_one_sentence(monkeypatch):
    monkeypatch.setattr(parallel, "CONNECT_TIMEOUT_S", 0.3)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        nobody = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    for scheduler in (nobody, "nonsense"):
        with (
            pytest.raises(WorkersError, match=f"^no Dask scheduler answers at {scheduler}$"),
            parallel.pool(Workers("dask", scheduler=scheduler)),
        ):
            pass


def workers_of(*options):
    parser = argparse.ArgumentParser()
    parallel.add_arguments(parser)
    return parallel.workers_of(parser.parse_args(options))


def test_options():
    assert workers_of() == Workers("loky", len(os.sched_getaffinity(0)))
    assert workers_of("--jobs", "3", "--backend", "dask") == Workers("dask", 3)
    scheduler = "tcp://host:8786"
    assert workers_of("--backend", "dask", "--scheduler", scheduler).scheduler == scheduler


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--jobs", "0"], "--jobs must be >= 1, got 0"),
        (["--scheduler", "host:1"], "--scheduler host:1 needs --backend dask, got loky"),
        (["--backend", "dask", "--scheduler", "host:1", "--jobs", "2"], "--jobs 2 has no meaning"),
    ],
)
def test_bad_options(options, sentence):
    with pytest.raises(WorkersError, match=sentence):
        workers_of(*options)


def test_dask_that_is_not_installed(monkeypatch):
    monkeypatch.setattr(parallel, "find_spec", lambda name: None)
    with pytest.raises(WorkersError, match=r"insdvl\[dask\]"):
        workers_of("--backend", "dask")
    assert workers_of("--jobs", "2") == Workers("loky", 2)
