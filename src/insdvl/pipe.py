"""Standard output whose reader may close it, as `head` does when it has seen enough."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class ReaderGone(BaseException):
    """Nobody reads standard output any more.

    It is no OSError: commands take that for input that is refused, and tell it.
    """


class _Output:
    """Standard output that raises `ReaderGone`; all else is that of the stream."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        try:
            return int(self._stream.write(text))
        except BrokenPipeError:
            raise ReaderGone from None

    def flush(self) -> None:
        try:
            self._stream.flush()
        except BrokenPipeError:
            raise ReaderGone from None


@contextmanager
def guarded() -> Iterator[None]:
    """Standard output raises `ReaderGone` within, at the latest at the end.

    What is left in its buffer then goes nowhere: Python flushes it once more when it ends.
    """
    stream = sys.stdout
    if stream is None:  # closed by the caller
        yield
        return
    output: Any = _Output(stream)
    sys.stdout = output
    try:
        try:
            yield
        finally:
            output.flush()
    except ReaderGone:
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        raise
    finally:
        sys.stdout = stream
