"""The cause `output`: odometry that stops or is late, and how good it is."""

from collections import deque

import numpy as np

from insdvl.messages.topics import BIAS, GLOBAL_ODOMETRY, GLOBAL_POSITION, IMU, INNOVATION, ODOMETRY
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.earth import MAX_LATITUDE_DEG
from insdvl.navigation.odometry import Odometry
from insdvl.navigation.parameters import FilterParameters
from ros_insdvl.status.diagnostics import ERROR, RECENT, SILENT, WARN, Status, View
from ros_insdvl.status.filter.base import Cause, Published

#: Stamps and clock that differ by more than this belong to different times: no latency is given.
CLOCK_AGREEMENT_NS = 10 * NS
#: Output that is later than this, beyond its delay, is worth a warning.
LATE_NS = NS
#: Latencies that are kept between two looks.
KEPT_LATENCIES = 10_000

_BEYOND, _RESETS = "beyond_latitude", "odom_resets"


class Output(Cause):
    """The published odometry."""

    def __init__(self, parameters: FilterParameters, published: Published) -> None:
        self._output_delay_ns = parameters.output_delay * NS
        self._published = published
        self.reset()

    def reset(self) -> None:
        """Whether stamps and clock agree must be seen again."""
        self._latencies_ns: deque[int] = deque(maxlen=KEPT_LATENCIES)
        self._clocks_agree = False  # those of the stamps and of the node

    def published(self, output: Odometry, now_ns: int) -> None:
        """Remember how old the stamp is."""
        self._latencies_ns.append(now_ns - output.stamp_ns)

    def status(self, view: View) -> Status:
        """Rate, sigmas and latency."""
        status = Status("output", "no output yet")
        view.show(status, ODOMETRY, GLOBAL_ODOMETRY, BIAS, GLOBAL_POSITION, f"dvl{INNOVATION}")
        view.show_events(status, _RESETS)
        output = self._published.last
        if output is None:
            return status
        velocity = self._published.velocity_sigma
        status.values["velocity sigma [m/s]"] = f"{velocity:.4g}"
        heading = float(np.degrees(np.sqrt(output.pose_covariance[5, 5])))
        status.values["heading sigma [deg]"] = f"{heading:.4g}"
        position = float(np.sqrt(np.diag(output.pose_covariance)[:2].max()))
        status.values["position sigma, horizontal [m]"] = f"{position:.4g}"
        if GLOBAL_ODOMETRY in view.sent.total:
            *p, yaw = output.map_to_odom.tolist()
            status.values["map to odom, x, y, z [m]"] = ", ".join(f"{x:.4g}" for x in p)
            status.values["map to odom, yaw [deg]"] = f"{np.degrees(yaw):.4g}"
        status.summary = f"{view.rate(ODOMETRY):.1f} Hz, velocity sigma {velocity:.3f} m/s"
        samples = view.received.recent[IMU]
        if samples and not view.sent.recent[ODOMETRY] and view.silence[IMU] < SILENT:
            status.complain(
                ERROR,
                "stopped",
                f"no odometry in the last {RECENT:.0f} s although {samples} IMU messages arrived: "
                "see the other statuses, then call ~/reset",
            )
        if count := view.events.recent[_BEYOND]:
            status.complain(
                ERROR,
                _BEYOND,
                f"the position was held at {MAX_LATITUDE_DEG:g} deg of latitude {count} times in "
                f"the last {RECENT:.0f} s: the vehicle is too close to the pole to navigate",
            )
        view.show_events(status, _BEYOND)
        self._report_latency(status)
        return status

    def _report_latency(self, status: Status) -> None:
        """The age of the stamps when they are published, if stamps and clock agree at all."""
        if not self._latencies_ns:
            return
        p50, p99 = np.percentile(self._latencies_ns, [50, 99])
        self._latencies_ns.clear()
        self._clocks_agree |= bool(abs(p50) < CLOCK_AGREEMENT_NS)
        if not self._clocks_agree:
            return
        status.values["latency p50 [ms]"] = f"{p50 / 1e6:.2f}"
        status.values["latency p99 [ms]"] = f"{p99 / 1e6:.2f}"
        if p50 - self._output_delay_ns > LATE_NS:
            status.complain(
                WARN,
                "late",
                f"odometry is published {p50 / NS:.1f} s after its stamp: the machine or the "
                "network is too slow, two clocks differ, or, in the navigator, the tuner takes too "
                "long: see its status process noise",
            )
