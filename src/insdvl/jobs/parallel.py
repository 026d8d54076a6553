"""Where every long computation runs: many independent tasks, on the cores here or on a cluster.

A computation is a function of what all tasks share and of one task's argument; it gives named
arrays. The results are the same to the bit wherever and however many at a time the tasks run: each
has one thread for its linear algebra, and what it gives back is laid out the same way everywhere.

Backend ``loky`` is this process for one job, else worker processes of joblib. Backend ``dask`` is a
cluster that exists already, whose workers must have the same insdvl and libraries installed as this
process, else a cluster of processes here that is made and closed.

A worker that dies costs no result: its tasks run again. Finished tasks are kept in a `Store`, so
that interrupted work, started again, does only what is missing.
"""

import argparse
import contextlib
import hashlib
import itertools
import json
import logging
import pickle
import platform
import re
import shutil
import signal
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import BrokenExecutor
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from insdvl.extras import extra
from insdvl.files import archive, arrays, read, write
from insdvl.kernels import source_digest

with extra("jobs"):
    import joblib
    from threadpoolctl import threadpool_limits

#: What a task gives.
Result = Mapping[str, NDArray[Any]]
#: ``function(shared, argument)``, defined at the top of a module, which must not change ``shared``.
Function = Callable[[Any, Any], Result]

BACKENDS = ("loky", "dask")
LOSSES = 3  # workers that one task may lose while it runs alone
CONNECT_TIMEOUT_S = 10.0
MAX_RESULT_BYTES = 2**28  # of a kept one; those of a recording's windows have some megabytes

_LIBRARIES = ("numpy", "scipy", "numba", "scikit-learn")
_DIGEST = re.compile(r"[0-9a-f]{16}")  # folders of a store
_NAME = re.compile(r"[^/\x00.][^/\x00]{0,199}")  # labels and tasks name folders and files


class WorkersError(ValueError):
    """The workers that were asked for cannot be had; the message is one sentence."""


class TaskError(RuntimeError):
    """A task failed, or lost its worker again and again; the message names it."""


class WorkerTracebackError(Exception):
    """The traceback, as text, of what a task raised in its worker."""

    def __str__(self) -> str:
        return f"\n{self.args[0]}"


@dataclass(frozen=True)
class Workers:
    """Where tasks run.

    Attributes:
        backend: One of BACKENDS.
        jobs: Tasks at the same time; all cores by default. Of no meaning for an existing cluster.
        scheduler: Address of an existing Dask cluster, ``tcp://host:8786``; else one is made here.

    Raises:
        WorkersError: There is no such backend, it is not installed, or the others do not fit it.
    """

    backend: str = "loky"
    jobs: int = field(default_factory=joblib.cpu_count)
    scheduler: str | None = None

    def __post_init__(self) -> None:
        if self.backend not in BACKENDS:
            raise WorkersError(
                f"--backend must be one of {', '.join(BACKENDS)}, got {self.backend!r}"
            )
        if self.jobs < 1:
            raise WorkersError(f"--jobs must be >= 1, got {self.jobs}")
        if self.scheduler is not None and self.backend != "dask":
            raise WorkersError(
                f"--scheduler {self.scheduler} needs --backend dask, got {self.backend}"
            )
        if self.backend == "dask" and find_spec("distributed") is None:
            raise WorkersError("--backend dask needs the extra packages of insdvl[dask]")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of every long command."""
    parser.add_argument(
        "--jobs",
        type=int,
        metavar="N",
        help="processes; the results do not depend on it (default: all cores)",
    )
    parser.add_argument(
        "--backend",
        default=BACKENDS[0],
        choices=BACKENDS,
        help="loky: processes here (default); dask: a Dask cluster, made here or existing",
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="of an existing Dask cluster, whose workers have insdvl installed",
    )


def workers_of(arguments: argparse.Namespace) -> Workers:
    """The workers that the options ask for.

    Raises:
        WorkersError: They contradict each other, or are out of their range.
    """
    if arguments.jobs is None:
        return Workers(backend=arguments.backend, scheduler=arguments.scheduler)
    if arguments.scheduler is not None:
        raise WorkersError(
            f"--jobs {arguments.jobs} has no meaning with --scheduler: a cluster has its own number"
        )
    return Workers(arguments.backend, arguments.jobs)


@cache
def environment() -> dict[str, str]:
    """What a result depends on beside its settings: our sources, and versions of the rest."""
    return {
        "insdvl": source_digest(),
        "python": platform.python_version(),
        **{name: version(name) for name in _LIBRARIES},
    }


class Store:
    """Results on disk: ``folder/<digest>/<label>/<task>.npz``.

    The digest is of the settings, of our sources and of the libraries' versions, so that a result
    is found only by the computation that would give it again. Results of other settings are
    removed. Two programs may use one store at a time.

    Attributes:
        folder: Of the results; exists.
    """

    def __init__(self, folder: Path, fingerprint: Mapping[str, Any]) -> None:
        """Make the folder.

        Args:
            folder: Belongs to this store alone.
            fingerprint: The settings on which results depend, as JSON would have them.

        Raises:
            OSError: The folder cannot be made.
        """
        text = json.dumps([fingerprint, environment()], sort_keys=True)
        self._root = Path(folder)
        self.folder = self._root / hashlib.sha256(text.encode()).hexdigest()[:16]
        self.folder.mkdir(parents=True, exist_ok=True)
        for other in self._root.iterdir():
            if other != self.folder and _DIGEST.fullmatch(other.name):
                _remove(other)

    def path(self, label: str, task: str) -> Path:
        """File of a result."""
        return self.folder / label / f"{task}.npz"

    def clear(self) -> None:
        """Remove all results, and the folder unless it holds anything else."""
        _remove(self.folder)
        with contextlib.suppress(OSError):  # another program's results are in it
            self._root.rmdir()


def _remove(folder: Path) -> None:
    # Another program may add to the folder, or remove it, at the same time: both are in order.
    shutil.rmtree(folder, ignore_errors=True)


def _keep(path: Path, result: Result) -> None:
    """Write a result; the file is complete when it takes its name."""
    data = archive(result)
    try:
        _write(path, data)
    except FileNotFoundError:  # another program removed the folder after we had made it
        _write(path, data)


def _write(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write(path, data)


def _kept(path: Path) -> Result | None:
    """The result in a file, or None where it is missing or damaged."""
    try:
        data = read(path, MAX_RESULT_BYTES)
        return arrays(data, len(data))  # they are kept without compression
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        _say(f"{path} is damaged ({error}) and computed again")
        return None


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


@dataclass(frozen=True)
class _Failure:
    """What a task raised, as text: not every exception survives the way between processes."""

    reason: str
    traceback: str


_Outcome = Result | _Failure
_Outcomes = Generator[tuple[str, _Outcome], None, None]


@dataclass(frozen=True)
class _Work:
    """Tasks that wait to be run.

    Attributes:
        function: See `Function`.
        shared: See `Function`.
        tasks: Name and argument.
        paths: Name, and the file that keeps the result; empty where none is kept.
    """

    function: Function
    shared: Any
    tasks: Mapping[str, Any]
    paths: Mapping[str, Path]

    def only(self, names: list[str]) -> "_Work":
        tasks = {name: self.tasks[name] for name in names}
        return _Work(self.function, self.shared, tasks, self.paths)


def _outcome(function: Function, shared: Any, task: Any, path: Path | None) -> _Outcome:
    """Run a task wherever this is called, and keep its result where there is a path."""
    try:
        with threadpool_limits(1):
            result = _named_arrays(function(shared, task))
        if path is not None:
            _keep(path, result)
    except Exception as error:
        return _Failure(f"{type(error).__name__}: {error}", traceback.format_exc())
    return result


def _named_arrays(result: Result) -> Result:
    """The arrays, contiguous: a sum over them then has one order, wherever they come from."""
    named = {name: np.asarray(array, order="C") for name, array in result.items()}
    for name, array in named.items():
        if array.dtype.hasobject:
            raise TypeError(f"{name} is no array of numbers or text")
    return named


class _LostWorkerError(Exception):
    """A worker died, and its tasks have no outcome."""


class _Backend(Protocol):
    def outcomes(self, work: _Work) -> _Outcomes:
        """Name and outcome of each task; those that are no failures have been kept.

        Raises:
            _LostWorkerError: Tasks have no outcome because their worker died.
        """


class _Here:
    """One task after the other, in this process."""

    def outcomes(self, work: _Work) -> _Outcomes:
        for name, task in work.tasks.items():
            yield name, _outcome(work.function, work.shared, task, work.paths.get(name))


@dataclass(frozen=True)
class _Loky:
    """Worker processes of joblib. They keep the results, and so each as soon as there is one.

    What they are sent goes through pipes: joblib would put large arrays in files, and is told not
    to.
    """

    jobs: int

    def outcomes(self, work: _Work) -> _Outcomes:
        data = pickle.dumps(work.shared, pickle.HIGHEST_PROTOCOL)
        shared = _Pickled(next(_numbers), data)
        calls = (
            joblib.delayed(_outcome_on_loky)(work.function, shared, task, work.paths.get(name))
            for name, task in work.tasks.items()
        )
        with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
            outcomes = joblib.Parallel(
                self.jobs, return_as="generator", batch_size=1, max_nbytes=None
            )(calls)
        try:
            yield from zip(work.tasks, outcomes, strict=True)
        except BrokenExecutor as error:
            raise _LostWorkerError from error
        finally:
            with warnings.catch_warnings():  # joblib warns of tasks that are not waited for
                warnings.simplefilter("ignore")
                outcomes.close()


_numbers = itertools.count()


class _Pickled(NamedTuple):
    """What tasks share, pickled once here, and unpickled once in each worker.

    Attributes:
        number: Another one for each computation of this process.
        data: The pickle.
    """

    number: int
    data: bytes


def _outcome_on_loky(
    function: Function, shared: _Pickled, task: Any, path: Path | None
) -> _Outcome:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is answered by the process that waits
    return _outcome(function, _unpickled(shared), task, path)


_last_unpickled: dict[int, Any] = {}


def _unpickled(shared: _Pickled) -> Any:
    if shared.number not in _last_unpickled:
        _last_unpickled.clear()
        _last_unpickled[shared.number] = pickle.loads(shared.data)
    return _last_unpickled[shared.number]


class _Dask:
    """A Dask cluster. Its workers may be anywhere: this process keeps the results."""

    def __init__(self, client: Any) -> None:
        self._client = client

    def outcomes(self, work: _Work) -> _Outcomes:
        from distributed import KilledWorker, as_completed

        # As a task, and not scattered: the cluster makes it again when its worker dies.
        shared = self._client.submit(_itself, work.shared, pure=False)
        futures = {
            self._client.submit(_outcome, work.function, shared, task, None, pure=False): name
            for name, task in work.tasks.items()
        }
        worker_died = False
        completed = as_completed(list(futures), loop=self._client.loop)
        for future in completed:
            name, status = futures[future], future.status
            if status == "finished":
                outcome = future.result()
                if name in work.paths and not isinstance(outcome, _Failure):
                    _keep(work.paths[name], outcome)
                yield name, outcome
            elif status == "cancelled":
                raise WorkersError("the Dask cluster no longer answers")
            elif status != "error":  # its result was lost with a worker, and is computed again
                completed.add(future)
            elif isinstance(error := future.exception(), KilledWorker):
                worker_died = True
            else:
                yield name, _Failure(f"{type(error).__name__}: {error}", str(error))
        if worker_died:
            raise _LostWorkerError


def _itself(value: Any) -> Any:
    return value


class Pool:
    """Runs tasks; see `pool`."""

    def __init__(self, backend: _Backend) -> None:
        self._backend = backend

    def run(
        self,
        function: Function,
        tasks: Mapping[str, Any],
        shared: Any = None,
        store: Store | None = None,
        label: str = "tasks",
    ) -> list[Result]:
        """The results of all tasks, in their order.

        Args:
            function: Of a module that the workers can import; must not change ``shared``.
            tasks: Name, which can be a file's, and argument of each.
            shared: What all tasks need; sent with each of them.
            store: Keeps finished tasks, also when others fail; what it has is not run again.
            label: What is being done, for the progress line and the store.

        Raises:
            TaskError: A task failed, or its worker died LOSSES times while it ran alone.
        """
        for name in (label, *tasks):
            if not _NAME.fullmatch(name):
                raise ValueError(f"{name!r} cannot be the name of a file")
        paths = {} if store is None else {name: store.path(label, name) for name in tasks}
        work = _Work(function, shared, tasks, paths)
        results: dict[str, Result] = {}
        losses: Counter[str] = Counter()
        alone = False  # after a loss without any result: only so it is known whose worker died
        with _Progress(label, len(tasks)) as progress:
            while True:
                for name in paths.keys() - results.keys():
                    kept = _kept(paths[name])
                    if kept is not None:
                        results[name] = kept
                progress.show(len(results))
                waiting = [name for name in tasks if name not in results]
                if not waiting:
                    return [results[name] for name in tasks]
                before = len(results)
                try:
                    # Closed at once when interrupted, so that the workers end.
                    with contextlib.closing(
                        self._backend.outcomes(work.only(waiting[:1] if alone else waiting))
                    ) as outcomes:
                        for name, outcome in outcomes:
                            if isinstance(outcome, _Failure):
                                raise TaskError(
                                    f"{label}: task {name} failed: {outcome.reason}"
                                ) from WorkerTracebackError(outcome.traceback)
                            results[name] = outcome
                            progress.show(len(results))
                    alone = False
                except _LostWorkerError as error:
                    progress.say("a worker died; its tasks run again")
                    losses[waiting[0]] += alone
                    if losses[waiting[0]] == LOSSES:
                        raise TaskError(
                            f"{label}: task {waiting[0]} ended {LOSSES} workers that ran nothing "
                            "else (out of memory?)"
                        ) from error
                    alone = len(results) == before


class _Progress:
    """How far a computation is, on stderr: one line that changes on a terminal, else a few."""

    def __init__(self, label: str, total: int) -> None:
        self._label = label
        self._total = total
        self._terminal = sys.stderr.isatty()
        self._line_is_open = False
        self._start = time.monotonic()
        self._shown: int | None = None
        self._first: int | None = None  # tasks that needed no work
        self._next = 0.0  # tasks at which there is something to say, where there is no terminal

    def __enter__(self) -> "_Progress":
        return self

    def __exit__(self, *_: object) -> None:
        self._close_line()

    def show(self, done: int) -> None:
        """Say, unless too much would be said, that so many tasks have a result."""
        if done == self._shown:
            return
        self._shown = done
        elapsed = time.monotonic() - self._start
        text = f"{self._label}: {done}/{self._total}"
        if self._first is None:
            self._first = done
            if done:
                text += " from an earlier run"
        elif done > self._first:
            left = elapsed / (done - self._first) * (self._total - done)
            text += f", {_clock(elapsed)} elapsed, {_clock(left)} left"
        if self._terminal:
            width = shutil.get_terminal_size().columns - 1
            print(f"\r{text[:width]:{width}}", end="", file=sys.stderr, flush=True)
            self._line_is_open = True
        elif done >= self._next:
            _say(text)
            self._next = min(done + max(0.1 * self._total, 1.0), self._total)

    def say(self, text: str) -> None:
        """A line of its own."""
        self._close_line()
        _say(f"{self._label}: {text}")

    def _close_line(self) -> None:
        if self._line_is_open:
            _say("")
        self._line_is_open = False


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


@contextlib.contextmanager
def pool(workers: Workers) -> Iterator[Pool]:
    """Workers, which end with the context; an existing cluster goes on without this process.

    Raises:
        WorkersError: There is no scheduler, or a worker of the cluster lacks insdvl or has it, or
            the libraries, in another version.
    """
    if workers.backend == "dask":
        with contextlib.ExitStack() as stack:
            yield Pool(_Dask(_client(workers, stack)))
    else:
        yield Pool(_Here() if workers.jobs == 1 else _Loky(workers.jobs))


def _client(workers: Workers, stack: contextlib.ExitStack) -> Any:
    """Client of the cluster; it, and the cluster if it was made here, are closed by the stack."""
    import dask
    from distributed import Client, LocalCluster
    from distributed.comm import resolve_address

    if workers.scheduler is None:
        # Which losses are too many is decided here, for both backends. A worker may be restarting,
        # for the second time, when Dask looks whether it came back, and must not be given up then.
        settings = {
            "distributed.scheduler.allowed-failures": 0,
            "distributed.deploy.lost-worker-timeout": "365 days",
        }
        stack.enter_context(dask.config.set(settings))
        cluster = stack.enter_context(
            LocalCluster(
                n_workers=workers.jobs,
                threads_per_worker=1,
                memory_limit=0,  # as with loky: what memory there is
                dashboard_address=None,
                preload=[
                    "import signal\nsignal.signal(signal.SIGINT, signal.SIG_IGN)"
                ],  # as on loky
                silence_logs=logging.CRITICAL,  # lost workers are reported here
            )
        )
        return stack.enter_context(Client(cluster, set_as_default=False))
    try:
        resolve_address(workers.scheduler)  # a Client that was made of no address hangs at its end
        client = stack.enter_context(
            Client(workers.scheduler, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
        )
    except (OSError, TimeoutError, ValueError) as error:
        raise WorkersError(f"no Dask scheduler answers at {workers.scheduler}") from error
    ours = environment()
    for worker, theirs in client.run(environment, on_error="return").items():
        if isinstance(theirs, Exception):
            raise WorkersError(
                f"worker {worker} of the Dask cluster at {workers.scheduler} has no insdvl like "
                f"that of this process: {theirs}"
            )
        for name, version_here in ours.items():
            if theirs[name] != version_here:
                raise WorkersError(
                    f"worker {worker} of the Dask cluster at {workers.scheduler} has {name} "
                    f"{theirs[name]}, and this process {version_here}"
                )
    return client
