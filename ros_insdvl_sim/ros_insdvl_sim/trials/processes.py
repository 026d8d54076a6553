"""Processes of a graph: started as `ros2 run` does, each with a log file, and all ended."""

import json
import os
import signal
import subprocess
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_prefix

from ros_insdvl_sim.trials.environment import INTERRUPTS, TrialError
from ros_insdvl_sim.trials.witness import DEPTH, PATIENCE

#: Signals that end a process, and for how long each is waited for [s]; only a hang takes so long.
_ENDINGS = ((signal.SIGINT, 60.0), (signal.SIGTERM, 30.0), (signal.SIGKILL, 30.0))


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Another Ctrl-C must not leave processes behind."""
    handlers = [(kind, signal.signal(kind, signal.SIG_IGN)) for kind in INTERRUPTS]
    try:
        yield
    finally:
        for kind, handler in handlers:
            signal.signal(kind, handler)


@contextmanager
def _held_back() -> Iterator[None]:
    """An interrupt waits until a process that is being started is known here, to be ended."""
    held: list[int] = []
    handlers = [
        (kind, signal.signal(kind, lambda number, frame: held.append(number)))
        for kind in INTERRUPTS
    ]
    try:
        yield
    finally:
        for kind, handler in handlers:
            signal.signal(kind, handler)
        for number in held:
            signal.raise_signal(number)


def lossless(*topics: str) -> dict[str, Any]:
    """Parameters of subscriptions that lose nothing while a node is seconds behind."""
    values: dict[str, Any] = {}
    for topic in topics:
        values[f"qos_overrides.{topic}.subscription.reliability"] = "reliable"
        values[f"qos_overrides.{topic}.subscription.depth"] = DEPTH
    return values


def _arguments(values: Mapping[str, Any], remaps: Mapping[str, str]) -> list[str]:
    """ROS arguments from parameters and remaps."""
    arguments = []
    for name, value in values.items():
        arguments += ["-p", f"{name}:={json.dumps(value)}"]
    for origin, target in remaps.items():
        arguments += ["-r", f"{origin}:={target}"]
    return arguments


class Processes:
    """Processes, each with a log file; as a context it ends them all.

    Args:
        logs: Folder of the log files.
        environment: Of all processes, added to that of this one.
    """

    def __init__(self, logs: Path, environment: Mapping[str, str] | None = None) -> None:
        self._logs = logs
        self._environment = dict(environment or {})
        self._processes: dict[str, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> "Processes":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()

    def start(
        self,
        name: str,
        program: tuple[str, str],
        parameters: Mapping[str, Any] | None = None,
        remaps: Mapping[str, str] | None = None,
        *,
        parameter_file: Path | None = None,
        environment: Mapping[str, str] | None = None,
    ) -> subprocess.Popen[bytes]:
        """Start an installed executable, as `ros2 run` does.

        Args:
            name: Of the process here; one that was used before continues its log.
            program: Its package and the executable.
            parameters: Of the node.
            remaps: Of topics and node.
            parameter_file: A file of parameters; those of `parameters` take precedence.
            environment: Added to that of this process.

        Raises:
            TrialError: It is not installed.
        """
        arguments = [] if parameter_file is None else ["--params-file", str(parameter_file)]
        arguments += _arguments(parameters or {}, remaps or {})
        mode = "ab" if name in self._processes else "wb"
        with self.log(name).open(mode) as log, _held_back():
            self._processes[name] = subprocess.Popen(
                [str(_installed(*program)), "--ros-args", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=os.environ | self._environment | dict(environment or {}),
            )
        return self._processes[name]

    def log(self, name: str) -> Path:
        """Log file of a process."""
        return self._logs / f"{name}.log"

    def text(self, name: str) -> str:
        """What a process has written."""
        return self.log(name).read_text(errors="replace")

    def process(self, name: str) -> subprocess.Popen[bytes]:
        """The process of a name."""
        return self._processes[name]

    def end(self, name: str, *signals: int) -> int:
        """Send signals to a process, one after the other, and wait for its exit code.

        Raises:
            TrialError: It does not end.
        """
        for number in signals:
            self._processes[name].send_signal(number)
        try:
            return self._processes[name].wait(PATIENCE)
        except subprocess.TimeoutExpired as error:
            raise TrialError(f"{name} did not end within {PATIENCE:g} s") from error

    def check(self, *names: str) -> None:
        """Check that processes run.

        Raises:
            TrialError: One has ended.
        """
        for name in names:
            if self._processes[name].poll() is not None:
                raise self._ended(name)

    def finished(self, name: str) -> bool:
        """Whether a process has ended with exit code 0.

        Raises:
            TrialError: It has ended with another one.
        """
        if self._processes[name].poll():
            raise self._ended(name)
        return self._processes[name].returncode == 0

    def _ended(self, name: str) -> TrialError:
        tail = self.text(name).strip().splitlines()[-5:]
        code = self._processes[name].returncode
        return TrialError(f"{name} ended with exit code {code}:\n  " + "\n  ".join(tail))

    def stop(self) -> dict[str, int]:
        """End all processes, by SIGINT if they obey; their exit codes."""
        with _uninterrupted():
            for kind, patience in _ENDINGS:
                running = [p for p in self._processes.values() if p.poll() is None]
                for process in running:
                    process.send_signal(kind)
                deadline = time.monotonic() + patience
                for process in running:
                    try:
                        process.wait(max(deadline - time.monotonic(), 0.01))
                    except subprocess.TimeoutExpired:
                        continue
            return {name: process.wait() for name, process in self._processes.items()}


def _installed(package: str, executable: str) -> Path:
    try:
        path = Path(get_package_prefix(package)) / "lib" / package / executable
    except PackageNotFoundError as error:
        raise TrialError(f"the package {package} is not installed: {error}") from error
    if not path.is_file():
        raise TrialError(f"{path} is not installed")
    return path


def sent_by(text: str) -> dict[str, int]:
    """Messages by topic that the simulator or the replay says at its end that it sent.

    Raises:
        TrialError: It does not say so.
    """
    for line in reversed(text.splitlines()):
        if line.startswith("sent: "):
            pairs = (item.rsplit(" ", 1) for item in line.removeprefix("sent: ").split(", "))
            return {topic: int(count) for topic, count in pairs}
    raise TrialError(f"the process does not say what it sent: {text[-300:]!r}")
