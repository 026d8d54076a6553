"""Rows of the network: quality of service, losses, delays and duplicates."""

from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu

from insdvl.messages.topics import IMU
from insdvl.studies.faults.expectation import Check
from ros_insdvl_sim.trials.names import RELAY_NODE
from ros_insdvl_sim.trials.process_rows.checks import (
    complained,
    error_below,
    lost_before_the_filter,
    lost_in_life,
    lost_of_all_arrived,
    passed_by_relay,
)
from ros_insdvl_sim.trials.process_rows.flight import DURATION, LiveFlight, live_flight
from ros_insdvl_sim.trials.process_rows.judgement import Flown
from ros_insdvl_sim.trials.process_rows.row import AFTER, NETWORK, LiveRow
from ros_insdvl_sim.trials.process_rows.steps import (
    THROUGH_RELAY,
    complaint,
    finish,
    recovery,
    start_filter,
    start_relay,
    start_simulator,
    the_fault_begins,
)

DELAY = 5.0  # s of the mission, that the filter waits and holds back
DELAYS = {"max_delay": DELAY, "output_delay": DELAY}


def _publish_best_effort(flight: LiveFlight) -> None:
    qos = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    the_fault_begins(flight)
    flight.notes["publisher"] = flight.witness.node.create_publisher(Imu, IMU, qos)


def _stop_publishing(flight: LiveFlight) -> None:
    flight.witness.node.destroy_publisher(flight.notes["publisher"])


def _all_that_arrives(flown: Flown) -> tuple[str, bool]:
    flight = flown.flight
    sent, passed, published = flight.sent[IMU], passed_by_relay(flight), len(flight.odometry)
    seen = f"lost by the relay {sent - passed} of {sent}, in the output {published} of {passed}"
    return seen, published == passed == flight.count(f"received {IMU}")


def _lossy(loss: float, *, short: bool = False) -> LiveRow:
    return LiveRow(
        NETWORK,
        f"relay: {100.0 * loss:g} % of the messages lost",
        (start_relay(loss=loss), start_filter(), start_simulator(remaps=THROUGH_RELAY), finish()),
        (
            Check("every sample that arrives is in the output, none is refused", _all_that_arrives),
            error_below(1.0, AFTER),
        ),
        begin=0.0,
        end=DURATION - AFTER - 5.0,
        lost=lost_of_all_arrived,
        short=short,
    )


def _fly_directly(flight: LiveFlight) -> None:
    """The same mission without the relay, behind this one."""
    flight.notes["doubled"] = flight.count(f"doubled {IMU}", RELAY_NODE)
    flight.notes["refused"] = flight.count(f"rejected {IMU}: duplicate")
    flight.processes.stop()
    with live_flight(flight.rate_factor, flight.parameters) as direct:
        for step in (start_filter(), start_simulator(), finish()):
            step(direct)
        flight.notes["direct"] = dict(direct.odometry)


def _same_bits(flown: Flown) -> tuple[str, bool]:
    behind, direct = dict(flown.flight.odometry), flown.flight.notes["direct"]
    same = sum(behind.get(stamp) == data for stamp, data in direct.items())
    return f"{same} of {len(direct)} messages equal", same == len(direct) == len(behind) > 5000


def _duplicates_are_counted(flown: Flown) -> tuple[str, bool]:
    refused, doubled = flown.flight.notes["refused"], flown.flight.notes["doubled"]
    return f"{refused} of {doubled}", refused == doubled > 0


def _lost_behind_the_relay(flight: LiveFlight) -> int:
    return lost_before_the_filter(flight) + lost_in_life(DELAY)(flight)


ROWS = (
    LiveRow(
        NETWORK,
        "QoS: a best-effort IMU, and the filter asks for reliable",
        (
            start_filter(),
            _publish_best_effort,
            complaint("connections"),
            _stop_publishing,
            recovery("connections"),
        ),
        (
            complained(
                "named in the log and in `connections` within 5 s, and recovered without it",
                "connections",
                5.0,
                word=IMU,
                logged=f"/{IMU}",
            ),
        ),
    ),
    _lossy(0.001),
    _lossy(0.01),
    _lossy(0.1, short=True),
    LiveRow(
        NETWORK,
        "relay: 20 % doubled, all delayed by 20 to 120 ms of the wall and reordered",
        (
            start_relay(duplication=0.2, delay=0.02, jitter=0.1),
            start_filter(),
            start_simulator(remaps=THROUGH_RELAY),
            finish(),
            _fly_directly,
        ),
        (
            Check("output equal to the bit to that without the relay", _same_bits),
            Check("each second copy counted as `duplicate`", _duplicates_are_counted),
            error_below(1.0, AFTER),
        ),
        begin=0.0,
        end=DURATION - AFTER - 5.0,
        lost=_lost_behind_the_relay,
        parameters=DELAYS,
    ),
)
