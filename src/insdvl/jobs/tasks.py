"""A task: a function of shared data and one argument, run anywhere with the same bits.

Each task runs its linear algebra on one thread, and its arrays have the same layout everywhere, so
results do not depend on where, or how many at a time, the tasks run.
"""

import traceback
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from insdvl.extras import extra
from insdvl.jobs.store import write_result

with extra("jobs"):
    from threadpoolctl import threadpool_limits

#: Result of a task: named arrays of numbers or text.
Result = Mapping[str, NDArray[Any]]
#: ``function(shared, argument)``, at the top level of an importable module. It must not change
#: ``shared``.
Function = Callable[[Any, Any], Result]


@dataclass(frozen=True)
class Failure:
    """An exception of a task as text: not every exception can be sent between processes."""

    reason: str
    traceback: str


Outcome = Result | Failure
Outcomes = Generator[tuple[str, Outcome], None, None]


class WorkerDiedError(Exception):
    """A worker process died, and the backend cannot go on."""


@dataclass(frozen=True)
class Work:
    """The tasks of one computation that have no result yet.

    Attributes:
        function: See `Function`.
        shared: Data that all tasks need.
        tasks: Argument of each task by its name.
        paths: File of each result by the name of its task; empty where none is stored.
    """

    function: Function
    shared: Any
    tasks: Mapping[str, Any]
    paths: Mapping[str, Path]


class Backend(Protocol):
    """Runs the tasks of a `Work`."""

    def outcomes(self, work: Work) -> Outcomes:
        """Name and outcome of each task; results are in their files when they are yielded.

        Raises:
            WorkerDiedError: A worker process died.
        """


def run_task(function: Function, shared: Any, argument: Any, path: Path | None) -> Outcome:
    """Run a task in this process, and write its result to its file, if it has one."""
    try:
        with threadpool_limits(1):
            result = _contiguous(function(shared, argument))
        if path is not None:
            write_result(path, result)
    except Exception as error:
        return Failure(f"{type(error).__name__}: {error}", traceback.format_exc())
    return result


def _contiguous(result: Result) -> Result:
    """The arrays in C order: a sum over them then has one order of additions everywhere."""
    named = {name: np.asarray(array, order="C") for name, array in result.items()}
    for name, array in named.items():
        if array.dtype.hasobject:
            raise TypeError(f"{name} is not an array of numbers or text")
    return named
