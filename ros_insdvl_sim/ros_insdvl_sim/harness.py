"""What demo, fault rows and soak share: processes, and a witness that listens."""

import json
import os
import signal
import struct
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import rclpy
from ament_index_python.packages import (
    PackageNotFoundError,
    get_package_prefix,
    get_package_share_directory,
)
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from insdvl.navigation.events import NS
from ros_insdvl.node import publisher_qos, subscribe

PATIENCE = 300.0  # s of the wall that anything may take; without a cache, programs compile first
QUIET_TIME = 3.0  # s of the wall without anything new after which nothing more comes

#: Package and executable.
FILTER, TUNER = ("ros_insdvl", "filter"), ("ros_insdvl", "tuner")
SIMULATOR, RELAY = ("ros_insdvl_sim", "simulator"), ("ros_insdvl_sim", "relay")
DEPTH = 4500  # messages that may wait for a consumer

IMU, DVL, Q = "imu/data_raw", "dvl/velocity", "process_noise"
TRUTH, ODOMETRY, INNOVATION = "ground_truth/odometry", "odometry/filtered", "dvl/innovation"

_STAMP = struct.Struct("<iI")  # of a header, behind the four bytes of encapsulation


class HarnessError(RuntimeError):
    """The graph cannot go on; the message says why."""


def graph_environment() -> dict[str, str]:
    """What the processes of a graph on this machine, and a second terminal, need in theirs.

    Raises:
        HarnessError: The packages are not installed where the environment points to.
    """
    try:
        profile = Path(get_package_share_directory("ros_insdvl")) / "config/fastdds_localhost.xml"
    except (PackageNotFoundError, LookupError) as error:
        raise HarnessError(
            f"the package ros_insdvl is not in AMENT_PREFIX_PATH "
            f"({os.environ.get('AMENT_PREFIX_PATH', 'not set')})"
        ) from error
    variables = {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(profile),
    }
    for name in ("ROS_DOMAIN_ID", "RMW_IMPLEMENTATION", "FASTRTPS_DEFAULT_PROFILES_FILE"):
        if name in os.environ:
            variables[name] = os.environ[name]
    return variables


def isolate() -> None:
    """A ROS domain of our own, on this machine only, for this process and its children.

    Raises:
        HarnessError: As `graph_environment`.
    """
    os.environ.setdefault("ROS_DOMAIN_ID", "91")
    os.environ.update(graph_environment())


def guarded(program: str, run: Callable[[], int], failed: int) -> int:
    """Run a command to its exit code.

    What it refuses is a line, with the code `failed`. SIGTERM and SIGHUP end it as Ctrl-C does, so
    that its processes end with it.
    """

    def interrupt(number: int, frame: Any) -> None:
        raise KeyboardInterrupt

    for kind in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(kind, interrupt)
    try:
        return run()
    except (HarnessError, ValueError, OSError) as error:  # the last of files
        print(f"{program}: {error}", file=sys.stderr)
        return failed
    except (KeyboardInterrupt, ExternalShutdownException):
        print(f"{program}: interrupted", file=sys.stderr)
        return 130


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Another Ctrl-C must not leave processes behind."""
    kinds = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    handlers = [(kind, signal.signal(kind, signal.SIG_IGN)) for kind in kinds]
    try:
        yield
    finally:
        for kind, handler in handlers:
            signal.signal(kind, handler)


def lossless(*topics: str) -> dict[str, Any]:
    """Parameters of subscriptions that lose nothing while a consumer is seconds behind.

    The depth stays below what Fast DDS keeps for a reader (5000): a reader that is full refuses
    messages, and the sender repeats them until the machine does little else.
    """
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


def stamp_of(data: bytes) -> int:
    """Stamp [ns] of a message with a header, from its bytes."""
    sec, nanosec = _STAMP.unpack_from(data, 4)
    return int(sec) * NS + int(nanosec)


class Witness:
    """A node of this process that keeps what is published, and what the nodes say of themselves.

    Attributes:
        node: The node.
        counts: Messages received, by topic.
        values: All values of the last diagnostics of every node, by its name.
        statuses: Level and message of every status, by its name.
        tellings: How often each node has told its statuses.
        told: Every level and message that was new, with the time of the wall: (time, name, level,
            message).
    """

    def __init__(self, prefix: str = "") -> None:
        self.context = Context()
        rclpy.init(args=[], context=self.context)
        self.node = Node(f"{prefix}witness", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.counts: Counter[str] = Counter()
        self.values: dict[str, dict[str, str]] = {}
        self.statuses: dict[str, tuple[int, str]] = {}
        self.tellings: Counter[str] = Counter()
        self.told: list[tuple[float, str, int, str]] = []
        subscribe(self.node, DiagnosticArray, "/diagnostics", self._on_diagnostics, publisher_qos())

    def listen(self, message_type: type[Any], topic: str, handle: Callable[[bytes], None]) -> None:
        """Take the bytes of every message of a topic; none is lost."""
        qos = publisher_qos()
        qos.depth = DEPTH

        def count(data: bytes) -> None:
            self.counts[topic] += 1
            handle(data)

        subscribe(self.node, message_type, topic, count, qos, raw=True)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        now = time.monotonic()
        fresh: dict[str, dict[str, str]] = {}
        for status in message.status:
            level, name = int.from_bytes(status.level, "little"), status.name
            if self.statuses.get(name) != (level, status.message):
                self.statuses[name] = (level, status.message)
                self.told.append((now, name, level, status.message))
            values = fresh.setdefault(name.split(": ")[0], {})
            values.update({item.key: item.value for item in status.values})
        self.values.update(fresh)
        self.tellings.update(fresh.keys())

    def value(self, node: str, key: str) -> int:
        """A count of a node's last diagnostics, 0 where it tells none."""
        return int(self.values.get(node, {}).get(key, 0))

    def spin(self, seconds: float) -> None:
        """Handle messages for a time of the wall."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            # The executor takes turns between topics only while the time-out stays the same.
            self.executor.spin_once(timeout_sec=0.05)

    def until(self, condition: Callable[[], Any], what: str, patience: float = PATIENCE) -> None:
        """Handle messages until something holds.

        Raises:
            HarnessError: It does not within a time.
        """
        deadline = time.monotonic() + patience
        while not condition():
            if time.monotonic() > deadline:
                raise HarnessError(f"{what}: not within {patience:g} s")
            self.executor.spin_once(timeout_sec=0.05)

    def settle(self, state: Callable[[], Any], quiet: float = QUIET_TIME) -> None:
        """Handle messages until something has not changed for a while."""
        last, since = state(), time.monotonic()
        while time.monotonic() - since < quiet:
            self.spin(0.1)
            now = state()
            if now != last:
                last, since = now, time.monotonic()

    def close(self) -> None:
        """Take the node down."""
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


class Processes:
    """Processes, each with a log file; a context that ends them all.

    Args:
        logs: Folder of the log files.
        environment: Of all processes, beside that of this one.
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
            name: Of the process here; one that was used before goes on in its log.
            program: Its package and the executable.
            parameters: Of the node.
            remaps: Of topics and node.
            parameter_file: Of parameters, which those of `parameters` overrule.
            environment: Beside that of this process.

        Raises:
            HarnessError: It is not installed.
        """
        arguments = [] if parameter_file is None else ["--params-file", str(parameter_file)]
        arguments += _arguments(parameters or {}, remaps or {})
        with self.log(name).open("ab" if name in self._processes else "wb") as log:
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
        """Send signals to a process, one after the other, and wait for its end; its exit code.

        Raises:
            HarnessError: It does not end.
        """
        for number in signals:
            self._processes[name].send_signal(number)
        try:
            return self._processes[name].wait(PATIENCE)
        except subprocess.TimeoutExpired as error:
            raise HarnessError(f"{name} did not end within {PATIENCE:g} s") from error

    def check(self, *names: str) -> None:
        """Check that processes live.

        Raises:
            HarnessError: One does not.
        """
        for name in names:
            if self._processes[name].poll() is not None:
                raise self._ended(name)

    def finished(self, name: str) -> bool:
        """Whether a process has come to its end.

        Raises:
            HarnessError: To a bad one.
        """
        if self._processes[name].poll():
            raise self._ended(name)
        return self._processes[name].returncode == 0

    def _ended(self, name: str) -> HarnessError:
        tail = self.text(name).strip().splitlines()[-5:]
        code = self._processes[name].returncode
        return HarnessError(f"{name} ended with exit code {code}:\n  " + "\n  ".join(tail))

    def stop(self) -> dict[str, int]:
        """End all processes, first kindly; their exit codes."""
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


#: Signals that end a process, and for how long each is waited for [s].
_ENDINGS = ((signal.SIGINT, 8.0), (signal.SIGTERM, 4.0), (signal.SIGKILL, 4.0))


def _installed(package: str, executable: str) -> Path:
    try:
        path = Path(get_package_prefix(package)) / "lib" / package / executable
    except PackageNotFoundError as error:
        raise HarnessError(f"the package {package} is not installed: {error}") from error
    if not path.is_file():
        raise HarnessError(f"{path} is not installed")
    return path


def sent_by(text: str) -> dict[str, int]:
    """What the simulator or the replay said at its end that it had sent, by topic.

    Raises:
        HarnessError: It said nothing.
    """
    for line in reversed(text.splitlines()):
        if line.startswith("sent: "):
            pairs = (item.rsplit(" ", 1) for item in line.removeprefix("sent: ").split(", "))
            return {topic: int(count) for topic, count in pairs}
    raise HarnessError(f"it did not say what it sent: {text[-300:]!r}")
