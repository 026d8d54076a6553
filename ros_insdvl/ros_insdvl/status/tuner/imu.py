"""The tuner's cause `imu`: samples that are absent, refused, out of order or lost."""

from insdvl.messages.topics import IMU
from ros_insdvl.status.diagnostics import ERROR, RECENT, WARN, Status, View
from ros_insdvl.status.reasons import OF_TIME

#: Events of the tuner, and what to do about each.
_EVENTS = {
    "duplicates": "two senders on one topic, or a network that duplicates messages",
    "out_of_order": "the network changes the order; these samples are not used",
    "gaps": "samples are lost; a window with a gap of more than {max_gap:g} s is not used",
    "restarts": "stamps went back by more than {max_gap:g} s, which restarts the window: the "
    "network changes the order by more than max_gap, or a clock was set",
}


def imu_status(view: View, max_gap: float) -> Status:
    """The status of the IMU.

    Args:
        view: What the tuner counted.
        max_gap: Its parameter [s].
    """
    status = Status("imu", f"{view.rate(IMU):.1f} Hz")
    view.report_silence(status, IMU, ERROR, "check the IMU's driver, its topic and the connections")
    view.report_refused(status, [IMU])
    view.report_refused(status, [IMU], OF_TIME)
    for name, text in _EVENTS.items():
        if count := view.events.recent[name]:
            remedy = text.format(max_gap=max_gap)
            status.complain(WARN, name, f"{count} {name} in the last {RECENT:.0f} s: {remedy}")
    view.show_events(status, *_EVENTS)
    view.show(status, IMU)
    return status
