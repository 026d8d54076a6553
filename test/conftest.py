"""The environment of every test, set before anything imports rclpy.

Tests share the machine with other graphs and with each other (`colcon test` runs the packages side
by side): each session has a ROS domain of its own, on this machine only.
"""

import atexit
import os
import shutil
import socket
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

ROOT = Path(__file__).parents[1]
FIRST_DOMAIN, LAST_DOMAIN = 1, 101
FIRST_PORT = 21400  # TCP, one port per domain; DDS itself uses UDP


def _reserve_domain() -> tuple[int, socket.socket]:
    """A free domain, and the socket that keeps it: only one session can listen on its port."""
    for domain in range(FIRST_DOMAIN, LAST_DOMAIN + 1):
        lock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            lock.bind(("127.0.0.1", FIRST_PORT + domain))
            lock.listen()
        except OSError:
            lock.close()
            continue
        return domain, lock
    raise RuntimeError("all ROS domains are taken by other test sessions")


_log_dir = tempfile.mkdtemp(prefix="insdvl-test-log-")
atexit.register(shutil.rmtree, _log_dir, ignore_errors=True)
_domain, _domain_lock = _reserve_domain()
os.environ.update(
    FASTRTPS_DEFAULT_PROFILES_FILE=str(ROOT / "ros_insdvl" / "config" / "fastdds_localhost.xml"),
    ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
    ROS_DOMAIN_ID=str(_domain),
    ROS_LOG_DIR=_log_dir,
    ROS_PYTHON_CHECK_FIELDS="1",
)

# The machine's load must not decide a test, and no test may depend on an earlier run.
settings.register_profile("insdvl", database=None, deadline=None)
settings.load_profile("insdvl")


@pytest.fixture
def managed() -> Iterator[Callable[[Any], Any]]:
    """Closes what it is given when the test is over."""
    with ExitStack() as stack:
        yield lambda thing: stack.enter_context(closing(thing))
