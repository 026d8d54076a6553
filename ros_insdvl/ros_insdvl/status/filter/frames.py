"""The cause `frames`: axes that contradict the motion, and frame_ids that are wrong or change."""

from insdvl.messages.inputs import Inputs
from insdvl.navigation.events import Event
from insdvl.navigation.parameters import FilterParameters
from insdvl.watch.alignment.check import AlignmentCheck
from ros_insdvl.status.diagnostics import ERROR, RECENT, WARN, Status, View
from ros_insdvl.status.filter.base import Cause
from ros_insdvl.status.reasons import OF_FRAMES

CONVENTION = "frame_convention"


class Frames(Cause):
    """The axes of the sensors."""

    def __init__(self, parameters: FilterParameters, inputs: Inputs) -> None:
        self._parameters = parameters
        self._inputs = inputs
        self.reset()

    def reset(self) -> None:
        """The check starts again."""
        self._check = AlignmentCheck(self._parameters)

    def took(self, events: list[Event]) -> None:
        """Let the check see what the fold took."""
        self._check.add_events(events)

    @property
    def counts(self) -> dict[str, int]:
        """How often the frame_id of each topic changed."""
        return {_changes(topic): n for topic, n in self._inputs.frame_changes.items()}

    def status(self, view: View) -> Status:
        """Refusals, findings and changes."""
        status = Status("frames", "no contradictions")
        status.values[CONVENTION] = self._parameters.frame_convention
        view.report_refused(status, [*view.silence], OF_FRAMES)
        for finding in self._check.findings():
            status.complain(ERROR, "axes", finding)
        for topic, frame_id in self._inputs.frame_ids.items():
            status.values[f"frame_id {topic}"] = frame_id
            if count := view.events.recent[_changes(topic)]:
                status.complain(
                    WARN,
                    f"changes {topic}",
                    f"the frame_id of {topic} changed {count} times in the last {RECENT:.0f} s and "
                    f"is now '{frame_id}': if two sensors publish there, stop one, or set its "
                    "*.frame_id parameter to take one only",
                )
        return status


def _changes(topic: str) -> str:
    return f"frame_id changes {topic}"
