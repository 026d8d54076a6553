"""Progress of a computation on stderr: one line that changes on a terminal, else a few lines."""

import shutil
import sys
import time


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
        self._terminal = sys.stderr.isatty()
        self._line_is_open = False
        self._start = time.monotonic()
        self._shown: int | None = None
        self._first: int | None = None  # tasks whose result was stored before
        self._next = 0.0  # number of tasks at which the next line is due without a terminal

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, *_: object) -> None:
        if self._line_is_open:
            _print_line("")
        self._line_is_open = False

    def show(self, done: int) -> None:
        """Show that this many tasks have a result; without a terminal at most every tenth."""
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
            _print_line(text)
            self._next = min(done + max(0.1 * self._total, 1.0), self._total)


def _print_line(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
