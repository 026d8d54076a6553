"""A pool of workers that computes independent tasks and keeps their results.

The engines handle lost workers: Dask runs their tasks again; on one machine a dead worker ends the
computation with one sentence, and the next call continues from the `Store`.
"""

import contextlib
import re
from collections.abc import Iterator, Mapping
from typing import Any

from insdvl.jobs.backends import Loky, ThisProcess, Threads
from insdvl.jobs.cluster import connect
from insdvl.jobs.options import Workers
from insdvl.jobs.progress import Progress
from insdvl.jobs.store import Store, read_result
from insdvl.jobs.tasks import Backend, Failure, Function, Result, Work, WorkerDiedError

_NAME = re.compile(r"[^/\x00.][^/\x00]{0,199}")  # labels and tasks are names of folders and files


class TaskError(RuntimeError):
    """A task failed, or a worker died; the message is one sentence."""


class WorkerTracebackError(Exception):
    """Traceback, as text, of an exception in a worker."""

    def __str__(self) -> str:
        return f"\n{self.args[0]}"


class Pool:
    """Workers that compute tasks; made by `open_pool`."""

    def __init__(self, backend: Backend) -> None:
        self._backend = backend

    def compute(
        self,
        function: Function,
        tasks: Mapping[str, Any],
        shared: Any = None,
        store: Store | None = None,
        label: str = "tasks",
    ) -> list[Result]:
        """Results of all tasks, in their order.

        Args:
            function: At the top level of a module that workers can import; must not change
                ``shared``.
            tasks: Argument of each task by its name, which must be a valid file name.
            shared: Data that all tasks need.
            store: Keeps the results of finished tasks, also when others fail; a task whose result
                it has is not run.
            label: Name of the computation, in progress lines and in the store.

        Raises:
            TaskError: A task failed or its worker died.
            WorkersError: The workers of a cluster have other versions, or the cluster is lost.
            ValueError: A name is not a valid file name.
        """
        for name in (label, *tasks):
            if not _NAME.fullmatch(name):
                raise ValueError(f"{name!r} is not a valid file name")
        paths = {} if store is None else {name: store.path(label, name) for name in tasks}
        results: dict[str, Result] = {}
        for name, path in paths.items():
            stored = read_result(path)
            if stored is not None:
                results[name] = stored
        missing = {name: task for name, task in tasks.items() if name not in results}
        work = Work(function, shared, missing, paths)
        with Progress(label, len(tasks)) as progress:
            progress.show(len(results))
            try:
                # Closed at once when interrupted, so that the workers end.
                with contextlib.closing(self._backend.outcomes(work)) as outcomes:
                    for name, outcome in outcomes:
                        if isinstance(outcome, Failure):
                            raise TaskError(
                                f"{label}: task {name} failed: {outcome.reason}"
                            ) from WorkerTracebackError(outcome.traceback)
                        results[name] = outcome
                        progress.show(len(results))
            except WorkerDiedError as error:
                rest = "" if store is None else "; finished tasks are kept, run it again to resume"
                raise TaskError(f"{label}: a worker process died (out of memory?){rest}") from error
        return [results[name] for name in tasks]


@contextlib.contextmanager
def open_pool(workers: Workers) -> Iterator[Pool]:
    """Workers, which end with the context; an existing cluster keeps running.

    Raises:
        WorkersError: No scheduler answers.
    """
    if workers.backend == "dask":
        with contextlib.ExitStack() as stack:
            yield Pool(connect(workers, stack))
    elif workers.jobs == 1:
        yield Pool(ThisProcess())
    else:
        yield Pool((Threads if workers.backend == "threads" else Loky)(workers.jobs))
