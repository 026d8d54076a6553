"""The options of every long command: where it runs."""

import argparse

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
