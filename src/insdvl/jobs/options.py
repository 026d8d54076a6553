"""Where long computations run: the backend and the number of workers."""

import argparse
from dataclasses import dataclass, field

from insdvl.extras import extra
from insdvl.jobs.arguments import contradictions, worker_faults

with extra("jobs"):
    import joblib


class WorkersError(ValueError):
    """The requested workers are not available; the message has a line for each fault."""


@dataclass(frozen=True)
class Workers:
    """Where tasks run.

    Attributes:
        backend: One of `BACKENDS` of the options. ``loky`` is this process for one job, else worker
            processes of joblib; ``threads`` are those of this process; ``dask`` is an existing
            cluster, or else one that is started on this machine.
        jobs: Number of tasks at the same time; all cores by default. Not used with an existing
            cluster.
        scheduler: Address of an existing Dask cluster, such as ``tcp://host:8786``.

    Raises:
        WorkersError: The backend is unknown or not installed, or the other values do not fit it.
    """

    backend: str = "loky"
    jobs: int = field(default_factory=joblib.cpu_count)
    scheduler: str | None = None

    def __post_init__(self) -> None:
        if faults := list(contradictions(self.backend, self.jobs, self.scheduler)):
            raise WorkersError("\n".join(faults))


def workers_from(arguments: argparse.Namespace) -> Workers:
    """The workers that the options ask for.

    Raises:
        WorkersError: The options contradict each other or are out of range.
    """
    if faults := list(worker_faults(arguments)):
        raise WorkersError("\n".join(faults))
    if arguments.jobs is None:
        return Workers(backend=arguments.backend, scheduler=arguments.scheduler)
    return Workers(arguments.backend, arguments.jobs)
