"""A driver and a filter in one process: ``python -m live_driver TYPE...`` tells what was used.

The packages of the types must be on the path.
"""

import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu

from insdvl.messages.topics import DVL, IMU
from insdvl.navigation.events import NS
from insdvl.recordings.base import encode
from insdvl.recordings.drivers import PLAIN, Told, dvl_message, dvl_raw
from insdvl.recordings.messages import imu_message
from ros_insdvl.conversions import message_class
from ros_insdvl.filter import FilterNode

START_NS = 1_700_000_000 * NS
DEADLINE = 120.0  # s
V = np.array([1.0, 0.25, -0.125])  # forward-right-down
NONE = Told(valid=False, altitude=-1.0, good_beams=0, water=True)
PARAMETERS = {
    "initial.mode": "parameters",
    "initial.velocity": [1.0, -0.25, 0.125],
    **{f"qos_overrides./{topic}.subscription.reliability": "reliable" for topic in (IMU, DVL)},
}


def fly(kind: str) -> str:
    """What a filter makes of a second with ten good pings of a type, and ten that are none."""
    contexts = Context(), Context()
    for context in contexts:
        context.init(initialize_logging=False)
    executors = [SingleThreadedExecutor(context=context) for context in contexts]
    overrides = [Parameter(name, value=value) for name, value in PARAMETERS.items()]
    node = FilterNode(context=contexts[0], parameter_overrides=overrides)
    driver = Node("driver", context=contexts[1])
    for executor, each in zip(executors, (node, driver), strict=True):
        executor.add_node(each)
    of_imu = driver.create_publisher(Imu, IMU, 1000)
    of_dvl = driver.create_publisher(message_class(kind), DVL, 1000)

    def until(condition: Callable[[], Any]) -> None:
        start = time.monotonic()
        while not condition():
            if time.monotonic() - start > DEADLINE:
                raise TimeoutError(f"{kind}: {dict(node.received)}")
            for executor in executors:
                executor.spin_once(timeout_sec=0.01)

    until(lambda: of_imu.get_subscription_count() and of_dvl.get_subscription_count())
    rng = np.random.default_rng(1)
    for k in range(1, 101):
        stamp = START_NS + k * NS // 100
        noise = 1e-3 * rng.standard_normal(6)
        sample = imu_message(stamp, "imu", noise[:3] + np.array([0.0, 0.0, 9.8]), noise[3:])
        of_imu.publish(deserialize_message(encode(IMU, 0, sample).data, Imu))
        if k % 10 == 0:
            for told, later_ns in ((PLAIN, 0), (NONE, 1_000_000)):
                v = V + 0.01 * rng.standard_normal(3)
                raw = dvl_raw(DVL, 0, dvl_message(kind, stamp + later_ns, v, told))
                of_dvl.publish(deserialize_message(raw.data, message_class(kind)))
    until(lambda: node.received[DVL] == 20 and node.received[IMU] == 100)
    used = sum(update.report.accepted for update in node._fold.updates)
    refused = sorted(f"{key.reason} {count}" for key, count in node.rejected.items())
    for executor in executors:
        executor.shutdown()
    node.destroy_node()
    driver.destroy_node()
    for context in contexts:
        context.shutdown()
    return f"{used} used, refused {', '.join(refused)}"


if __name__ == "__main__":
    for name in sys.argv[1:]:
        print(f"{name}: {fly(name)}", flush=True)
