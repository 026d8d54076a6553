"""The Dask backend: a cluster that exists, or one that is started on this machine.

Dask runs the tasks of a lost worker again by itself, and gives a task up when it has lost several
workers.
"""

import contextlib
import logging
from importlib import import_module
from pathlib import Path
from typing import Any

from insdvl.jobs.options import Workers, WorkersError
from insdvl.jobs.store import environment, write_result
from insdvl.jobs.tasks import Failure, Outcomes, Work, run_task

CONNECT_TIMEOUT_S = 10.0


class Dask:
    """A Dask cluster. Its workers may be on other machines, so this process writes the results."""

    def __init__(self, client: Any, scheduler: str | None) -> None:
        """Use a cluster.

        Args:
            client: A ``distributed.Client``.
            scheduler: Address of a cluster that others started; None for our own.
        """
        self._client = client
        self._scheduler = scheduler

    def outcomes(self, work: Work) -> Outcomes:
        """See `Backend`.

        Raises:
            WorkersError: A worker has other versions than this process, or the cluster is lost.
        """
        from distributed import KilledWorker, as_completed

        if self._scheduler is not None:
            _check_versions(self._client, self._scheduler, work.function.__module__)
        # As a task, and not scattered: the cluster computes it again when its worker dies.
        shared = self._client.submit(_itself, work.shared, pure=False)
        futures = {
            self._client.submit(run_task, work.function, shared, task, None, pure=False): name
            for name, task in work.tasks.items()
        }
        completed = as_completed(list(futures), loop=self._client.loop)
        for future in completed:
            name, status = futures[future], future.status
            if status == "finished":
                outcome = future.result()
                if name in work.paths and not isinstance(outcome, Failure):
                    write_result(work.paths[name], outcome)
                yield name, outcome
            elif status == "cancelled":
                raise WorkersError("the Dask cluster no longer answers")
            elif status != "error":  # its result was lost with a worker and is computed again
                completed.add(future)
            else:
                error = future.exception()
                reason = f"{type(error).__name__}: {error}"
                if isinstance(error, KilledWorker):
                    reason = "its workers died (out of memory?)"
                yield name, Failure(reason, str(error))


def _itself(value: Any) -> Any:
    return value


def connect(workers: Workers, stack: contextlib.ExitStack) -> Dask:
    """The cluster; the stack closes the client, and the cluster if it was started here.

    Raises:
        WorkersError: No scheduler answers.
    """
    import dask
    from distributed import Client, LocalCluster
    from distributed.comm import resolve_address

    if workers.scheduler is None:
        # A worker that restarts for the second time must not be given up meanwhile.
        settings = {"distributed.deploy.lost-worker-timeout": "365 days"}
        stack.enter_context(dask.config.set(settings))
        cluster = stack.enter_context(
            LocalCluster(
                n_workers=workers.jobs,
                threads_per_worker=1,
                memory_limit=0,  # all of the memory, as with loky
                dashboard_address=None,
                preload=[
                    "import signal\nsignal.signal(signal.SIGINT, signal.SIG_IGN)"
                ],  # as with loky
                silence_logs=logging.CRITICAL,  # what matters is reported here
            )
        )
        return Dask(stack.enter_context(Client(cluster, set_as_default=False)), None)
    try:
        resolve_address(workers.scheduler)  # a Client of an invalid address hangs when closed
        client = stack.enter_context(
            Client(workers.scheduler, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
        )
    except (OSError, TimeoutError, ValueError) as error:
        raise WorkersError(f"no Dask scheduler answers at {workers.scheduler}") from error
    return Dask(client, workers.scheduler)


def _environment_of(module: str) -> dict[str, str]:
    """The `environment` of a module, by its name: its file may lie elsewhere on a worker."""
    return environment(Path(str(import_module(module).__file__)))


def _check_versions(client: Any, scheduler: str, module: str) -> None:
    """Compare the code of a computation, and the libraries, on all workers with our own.

    Raises:
        WorkersError: A worker lacks them or has others.
    """
    ours = _environment_of(module)
    for worker, theirs in client.run(_environment_of, module, on_error="return").items():
        named = f"worker {worker} of the Dask cluster at {scheduler}"
        if isinstance(theirs, Exception):
            raise WorkersError(f"{named} cannot import the insdvl of this process: {theirs}")
        for name, version_here in ours.items():
            if theirs[name] != version_here:
                raise WorkersError(
                    f"{named} has {name} {theirs[name]}, this process has {version_here}"
                )
