"""Progress of a computation on stderr: a bar in a terminal (insdvl[cli]), else a few lines."""

import sys
import time
from typing import TYPE_CHECKING

from insdvl.terminal import console_of

if TYPE_CHECKING:
    from rich.progress import Progress as Bar


class Progress:
    """How many tasks of a computation have a result."""

    def __init__(self, label: str, total: int) -> None:
        """Start the clock.

        Args:
            label: Name of the computation.
            total: Number of its tasks.
        """
        self._label = label
        self._total = total
        self._bar = _bar(label, total)
        self._start = time.monotonic()
        self._shown: int | None = None
        self._first: int | None = None  # tasks whose result was stored before
        self._next = 0.0  # number of tasks at which the next line is due

    def __enter__(self) -> "Progress":
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def show(self, done: int) -> None:
        """Show that this many tasks have a result; without a bar at most every tenth."""
        if done == self._shown:
            return
        self._shown = done
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], completed=done)
            return
        elapsed = time.monotonic() - self._start
        text = f"{self._label}: {done}/{self._total}"
        if self._first is None:
            self._first = done
            if done:
                text += " from an earlier run"
        elif done > self._first:
            left = elapsed / (done - self._first) * (self._total - done)
            text += f", {_clock(elapsed)} elapsed, {_clock(left)} left"
        if done >= self._next:
            print(text, file=sys.stderr, flush=True)
            self._next = min(done + max(0.1 * self._total, 1.0), self._total)


def _bar(label: str, total: int) -> "Bar | None":
    """A bar in the terminal; None where there is none."""
    console = console_of(sys.stderr)
    if console is None:
        return None
    from rich import progress

    bar = progress.Progress(
        "{task.description}",
        progress.BarColumn(complete_style="default", finished_style="default"),
        progress.MofNCompleteColumn(),
        progress.TimeRemainingColumn(elapsed_when_finished=True),
        console=console,
        redirect_stdout=False,
    )
    bar.add_task(label, total=total)
    return bar


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
