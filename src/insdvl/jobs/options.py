"""Where long computations run: the backend and the number of workers."""

import argparse
from dataclasses import dataclass, field
from importlib.util import find_spec

from insdvl.extras import extra
from insdvl.jobs.arguments import BACKENDS

with extra("jobs"):
    import joblib


class WorkersError(ValueError):
    """The requested workers are not available; the message is one sentence."""


@dataclass(frozen=True)
class Workers:
    """Where tasks run.

    Attributes:
        backend: One of BACKENDS. ``loky`` is this process for one job, else worker processes of
            joblib; ``threads`` are those of this process; ``dask`` is an existing cluster, or else
            one that is started on this machine.
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
            raise WorkersError("--backend dask needs the optional packages: install insdvl[dask]")


def workers_from(arguments: argparse.Namespace) -> Workers:
    """The workers that the options ask for.

    Raises:
        WorkersError: The options contradict each other or are out of range.
    """
    if arguments.jobs is None:
        return Workers(backend=arguments.backend, scheduler=arguments.scheduler)
    if arguments.scheduler is not None:
        raise WorkersError(
            f"--jobs {arguments.jobs} cannot be used with --scheduler: the cluster sets the number "
            "of its workers"
        )
    return Workers(arguments.backend, arguments.jobs)
