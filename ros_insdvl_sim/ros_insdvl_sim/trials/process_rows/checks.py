"""What is expected of a row, and how the lost messages are counted."""

from collections.abc import Callable

from insdvl.messages.topics import IMU
from insdvl.studies.faults.expectation import Check
from ros_insdvl_sim.trials.names import FILTER_NODE, RELAY_NODE
from ros_insdvl_sim.trials.process_rows.flight import LiveFlight
from ros_insdvl_sim.trials.process_rows.judgement import Flown, samples_without_output


def error_below(limit: float, after: float) -> Check[Flown]:
    """No velocity error above a limit, from so long after the fault on.

    Args:
        limit: Of the error [m/s].
        after: Time of the mission after the end of the fault [s].
    """

    def judge(flown: Flown) -> tuple[str, bool]:
        if flown.fault is None:
            raise ValueError("the row has no time of its fault")
        worst = flown.errors.largest_from(flown.fault[1] + after)
        return f"largest {worst:.2f} m/s", worst < limit

    return Check(f"error below {limit:g} m/s from {after:g} s after it on", judge)


def every_sample_in_the_output() -> Check[Flown]:
    """One odometry for every sample."""

    def judge(flown: Flown) -> tuple[str, bool]:
        published, sent = len(flown.flight.odometry), flown.flight.sent[IMU]
        return f"{published} of {sent}", published == sent

    return Check("every sample is in the output: nothing waits for the clock", judge)


def complained(
    text: str, cause: str, within: float, *, word: str, logged: str = ""
) -> Check[Flown]:
    """The filter complained of a cause, soon enough, by a word, and perhaps in its log.

    Args:
        text: The expectation in words.
        cause: The status.
        within: Wall time from the beginning of the fault [s].
        word: In the complaint.
        logged: In the filter's log as well; empty for no matter.
    """

    def judge(flown: Flown) -> tuple[str, bool]:
        flight = flown.flight
        change = flight.complaints[cause]
        after, message = change.at - flight.since, change.status.message
        in_log = not logged or logged in flight.processes.text("filter")
        log = f", {'logged' if in_log else 'not logged'}" if logged else ""
        met = after < within and word in message and in_log
        return f"after {after:.1f} s{log}: {message[:90]}; then well again", met

    return Check(text, judge)


def counted(text: str, name: str, expected: int, seen: str) -> Check[Flown]:
    """A count of the filter is as expected.

    Args:
        text: The expectation in words.
        name: Of the count in the diagnostics.
        expected: Its value.
        seen: What is seen, with `{count}`.
    """

    def judge(flown: Flown) -> tuple[str, bool]:
        count = flown.flight.count(name)
        return seen.format(count=count), count == expected

    return Check(text, judge)


# ---------------------------------------------------------------- lost messages


def lost_of_all_sent(flight: LiveFlight) -> int:
    """Samples that were sent and are in no output."""
    return flight.sent[IMU] - len(flight.odometry)


def lost_of_all_arrived(flight: LiveFlight) -> int:
    """Samples that the relay let pass and that are in no output."""
    return passed_by_relay(flight) - len(flight.odometry)


def passed_by_relay(flight: LiveFlight) -> int:
    """Samples that the relay did not lose."""
    return flight.sent[IMU] - flight.count(f"lost {IMU}", RELAY_NODE)


def lost_in_life(output_delay: float = 0.0) -> Callable[[LiveFlight], int]:
    """Samples without output while a filter lived, see `samples_without_output`.

    Args:
        output_delay: What the filter holds back at the end [s].
    """

    def count(flight: LiveFlight) -> int:
        published = [stamp for stamp, _ in flight.odometry if stamp in flight.truth]
        # The first output of the next filter begins its life.
        lives = () if flight.restart is None else (flight.restart.first_s - 0.001,)
        return samples_without_output(list(flight.truth), published, lives, output_delay)

    return count


def lost_before_the_filter(flight: LiveFlight) -> int:
    """Samples that did not reach the filter, whose doubles are counted once."""
    doubled = flight.count(f"doubled {IMU}", RELAY_NODE)
    return flight.sent[IMU] - (flight.count(f"received {IMU}", FILTER_NODE) - doubled)
