"""Nodes as a process: their start, their executor, their end and the exit code."""

import os
import signal
import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import rclpy
from ament_index_python.packages import get_package_share_directory
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.executors import ExternalShutdownException

from insdvl.parameters.declaration import ParameterError
from ros_insdvl.node import InsdvlNode
from ros_insdvl.process.arguments import Help, answered, parameter_files
from ros_insdvl.process.executor import NodeExecutor

#: Environment variable that names the profiles of Fast DDS.
PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"


def run_node(factory: Callable[[], InsdvlNode[Any]], help_: Help) -> int:
    """Make a node and spin it until it finishes, see `run_nodes`."""
    return run_nodes(lambda: [factory()], help_)


def run_nodes(factory: Callable[[], Iterable[InsdvlNode[Any]]], help_: Help) -> int:
    """Make nodes and spin them until one finishes, is interrupted or is terminated.

    With ``--help`` nothing is started. Faults of parameter files are told before ROS starts, which
    would end with the first.

    Args:
        factory: Makes them, one after the other.
        help_: Of the executable.

    Returns:
        The exit code: 0 after SIGINT or SIGTERM, 2 for wrong arguments or parameters (a line on
        stderr names each), else what the node finished with. Any other exception passes, which ends
        a program with 1.
    """
    arguments = sys.argv[1:]
    code = answered(help_, arguments)
    if code is not None:
        return code
    try:
        parameter_files(arguments)
    except ParameterError as error:
        print(error, file=sys.stderr)
        return 2
    nodes: list[InsdvlNode[Any]] = []
    try:
        return _spin(factory, nodes)
    except KeyboardInterrupt:  # a second one, while the first was handled
        return 0
    finally:
        _ignore_interrupts()
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()


def _spin(factory: Callable[[], Iterable[InsdvlNode[Any]]], nodes: list[InsdvlNode[Any]]) -> int:
    """As `run_nodes`, which takes down the nodes that are put into ``nodes``."""
    try:
        _init()
    except RuntimeError as error:  # base class of rcl's errors
        print(f"cannot start ROS: {error}", file=sys.stderr)
        return 2
    try:
        executor = NodeExecutor()
        for node in factory():
            nodes.append(node)
            executor.add_node(node)
        try:
            _turn(executor, nodes)
        finally:
            executor.let_go()
        return next((int(n.finished.result()) for n in nodes if n.finished.done()), 0)
    except (ParameterError, InvalidParameterTypeException) as error:
        print(error, file=sys.stderr)
        return 2
    except (KeyboardInterrupt, ExternalShutdownException):
        _ignore_interrupts()
        return 0
    except RuntimeError:  # base class of rcl's errors
        if rclpy.ok():
            raise
        return 0  # interrupted while the node was made: the middleware is gone


def _init() -> None:
    """Start ROS, without log files if their folder cannot be written.

    With Fast DDS and no profile of the user's own, subscriptions may be as deep as they ask.
    """
    with suppress(LookupError, OSError):  # the nodes run from their sources
        share = Path(get_package_share_directory("ros_insdvl"))
        os.environ.setdefault(PROFILES, str(share / "config" / "fastdds.xml"))
    try:
        rclpy.init()
    except RuntimeError as error:
        if "logging" not in str(error):
            raise
        rclpy.try_shutdown()
        rclpy.init(args=[*sys.argv, "--ros-args", "--disable-external-lib-logs"])
        print(f"no log file, the log goes to the terminal only: {error}", file=sys.stderr)


def _turn(executor: NodeExecutor, nodes: Sequence[InsdvlNode[Any]]) -> None:
    """Handle messages until a node finishes; no message, whatever its content, ends this.

    Only here: an executor of a test raises what a callback raises. An executor does not tell whose
    callback it was: the first node counts the error.
    """
    # rclpy's own spin_until_future_complete adds such a callback with every turn and forgets none.
    for node in nodes:
        node.finished.add_done_callback(lambda future: executor.wake())
    while rclpy.ok() and not any(node.finished.done() for node in nodes):
        try:
            executor.spin_once()
        except ExternalShutdownException:
            raise
        except Exception as error:
            if not rclpy.ok():  # interrupted: the middleware is gone
                return
            nodes[0].fail(error)


def _ignore_interrupts() -> None:
    """A further Ctrl-C while the node is taken down would end in a traceback."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
