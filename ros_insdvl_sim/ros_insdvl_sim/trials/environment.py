"""What a trial's graph needs around it: its ROS environment, and a command that ends cleanly."""

import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from rclpy.executors import ExternalShutdownException

#: Signals that end a command.
INTERRUPTS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class TrialError(RuntimeError):
    """The trial cannot continue; the message says why."""


def graph_environment() -> dict[str, str]:
    """The environment variables of a graph on this machine, also for a second terminal.

    Raises:
        TrialError: The packages are not installed in AMENT_PREFIX_PATH.
    """
    try:
        profile = Path(get_package_share_directory("ros_insdvl")) / "config/fastdds_localhost.xml"
    except (PackageNotFoundError, LookupError) as error:
        raise TrialError(
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
    """Use a ROS domain of our own, on this machine only, in this process and its children.

    Raises:
        TrialError: See `graph_environment`.
    """
    os.environ.setdefault("ROS_DOMAIN_ID", "91")
    os.environ.update(graph_environment())


def exit_code_of(program: str, command: Callable[[], int], failed: int) -> int:
    """Run a command to its exit code.

    An error that it raises is printed as one line, with the exit code `failed`. SIGTERM and SIGHUP
    end it as Ctrl-C does, so that its processes end with it; further ones are ignored meanwhile.
    """

    def interrupt(number: int, frame: Any) -> None:
        for kind in INTERRUPTS:
            signal.signal(kind, signal.SIG_IGN)
        raise KeyboardInterrupt

    for kind in INTERRUPTS:
        signal.signal(kind, interrupt)
    try:
        return command()
    except (TrialError, ValueError, OSError) as error:  # the last of files
        print(f"{program}: {error}", file=sys.stderr)
        return failed
    except (KeyboardInterrupt, ExternalShutdownException):
        print(f"{program}: interrupted", file=sys.stderr)
        return 130
