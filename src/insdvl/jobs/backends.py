"""Backends on this machine: this process, its threads, and worker processes of joblib (loky)."""

import itertools
import pickle
import signal
import warnings
from concurrent.futures import BrokenExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from insdvl.extras import extra
from insdvl.jobs.tasks import Function, Outcome, Outcomes, Work, WorkerDiedError, run_task

with extra("jobs"):
    import joblib
    from threadpoolctl import threadpool_limits


class ThisProcess:
    """Runs one task after another in this process."""

    def outcomes(self, work: Work) -> Outcomes:
        """See `Backend`."""
        for name, task in work.tasks.items():
            yield name, run_task(work.function, work.shared, task, work.paths.get(name))


@dataclass(frozen=True)
class Threads:
    """Threads of this process, which share its memory.

    Kernels run at the same time, all else one at a time.

    Attributes:
        jobs: Number of threads.
    """

    jobs: int

    def outcomes(self, work: Work) -> Outcomes:
        """See `Backend`."""
        # The limit of a task is that of the process, and would end with the first one.
        with threadpool_limits(1), ThreadPoolExecutor(self.jobs) as threads:
            running = {
                name: threads.submit(
                    run_task, work.function, work.shared, task, work.paths.get(name)
                )
                for name, task in work.tasks.items()
            }
            try:
                for name, future in running.items():
                    yield name, future.result()
            finally:
                threads.shutdown(cancel_futures=True)


@dataclass(frozen=True)
class Loky:
    """Worker processes of joblib. Each worker writes its results as soon as it has them.

    Data is sent through pipes: joblib would memory-map large arrays through files, and is told not
    to.

    Attributes:
        jobs: Number of processes.
    """

    jobs: int

    def outcomes(self, work: Work) -> Outcomes:
        """See `Backend`."""
        data = pickle.dumps(work.shared, pickle.HIGHEST_PROTOCOL)
        shared = _Pickled(next(_numbers), data)
        calls = (
            joblib.delayed(_run_in_worker)(work.function, shared, task, work.paths.get(name))
            for name, task in work.tasks.items()
        )
        with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
            outcomes = joblib.Parallel(
                self.jobs, return_as="generator", batch_size=1, max_nbytes=None
            )(calls)
        try:
            yield from zip(work.tasks, outcomes, strict=True)
        except BrokenExecutor as error:
            raise WorkerDiedError from error
        finally:
            with warnings.catch_warnings():  # joblib warns of tasks that are not waited for
                warnings.simplefilter("ignore")
                outcomes.close()


_numbers = itertools.count()


class _Pickled(NamedTuple):
    """Shared data, pickled once here and unpickled once in each worker.

    Attributes:
        number: Number of the computation in this process.
        data: The pickle.
    """

    number: int
    data: bytes


def _run_in_worker(function: Function, shared: _Pickled, task: Any, path: Path | None) -> Outcome:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by the process that waits
    return run_task(function, _unpickled(shared), task, path)


_last_unpickled: dict[int, Any] = {}


def _unpickled(shared: _Pickled) -> Any:
    if shared.number not in _last_unpickled:
        _last_unpickled.clear()
        _last_unpickled[shared.number] = pickle.loads(shared.data)
    return _last_unpickled[shared.number]
