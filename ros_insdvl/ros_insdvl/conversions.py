"""What only ROS has of messages: their classes, and its own type of time."""

from importlib import import_module
from typing import Any

from builtin_interfaces.msg import Time

from insdvl.messages.drivers import DRIVERS
from insdvl.navigation.events import NS
from insdvl.parameters.declaration import ParameterError


def time_of(stamp_ns: int) -> Time:
    """Integer nanoseconds as a stamp."""
    return Time(sec=stamp_ns // NS, nanosec=stamp_ns % NS)


def message_class(kind: str) -> type[Any]:
    """The class of a message type, ``package/msg/Name``.

    It is looked up when a topic is subscribed to, so that a driver's own types are needed only
    where they are used.

    Raises:
        ParameterError: The type is not installed.
    """
    package, _, name = kind.split("/")
    try:
        found: type[Any] = getattr(import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:
        raise ParameterError(
            f"message type {kind} is not installed: {_remedy(kind, package)}"
        ) from error
    return found


def new_message(kind: str) -> Any:
    """A message with the default values of its type.

    Raises:
        ParameterError: The type is not installed.
    """
    return message_class(kind)()


def _remedy(kind: str, package: str) -> str:
    """What to do where a message type is not installed."""
    driver = DRIVERS.get(kind)
    if driver is None or not driver.package:
        debian = f"ros-jazzy-{package.replace('_', '-')}"
        return f"install {debian}, or source the workspace that has {package}"
    return f"{driver.package}, then source the workspace that has package {package}"
