"""The options of every long command: where it runs."""

import argparse
from collections.abc import Iterator
from importlib.util import find_spec

BACKENDS = ("loky", "threads", "dask")


def add_worker_options(parser: argparse.ArgumentParser) -> None:
    """Declare the worker options of every long command."""
    parser.add_argument(
        "--jobs",
        type=int,
        metavar="N",
        help="number of workers; results do not depend on it (default: all cores)",
    )
    parser.add_argument(
        "--backend",
        default=BACKENDS[0],
        choices=BACKENDS,
        help="loky: processes on this machine (default); threads: of one process, which need less "
        "memory and are slower; dask: a Dask cluster, local or existing",
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="address of an existing Dask cluster; its workers need the same insdvl",
    )


def worker_faults(arguments: argparse.Namespace) -> Iterator[str]:
    """What is wrong with the worker options."""
    yield from contradictions(arguments.backend, arguments.jobs, arguments.scheduler)
    if arguments.jobs is not None and arguments.scheduler is not None:
        yield (
            f"--jobs {arguments.jobs} cannot be used with --scheduler: the cluster sets the number "
            "of its workers"
        )


def contradictions(backend: str, jobs: int | None, scheduler: str | None) -> Iterator[str]:
    """What is wrong with the place of long computations; `insdvl.jobs.options.Workers` has it."""
    if backend not in BACKENDS:
        yield f"--backend must be one of {', '.join(BACKENDS)}, got {backend!r}"
    if jobs is not None and jobs < 1:
        yield f"--jobs must be >= 1, got {jobs}"
    if scheduler is not None and backend != "dask":
        yield f"--scheduler {scheduler} needs --backend dask, got {backend}"
    if backend == "dask" and find_spec("distributed") is None:
        yield "--backend dask needs the optional packages: install insdvl[dask]"
