"""The cause `state file`: whether the state is kept for the next start."""

from insdvl.navigation.events import NS
from insdvl.timeline.state_file import StateFile
from ros_insdvl.status.diagnostics import WARN, Status, View
from ros_insdvl.status.filter.base import Cause


class KeptState(Cause):
    """The state file, None if it is off."""

    def __init__(self, file: StateFile | None) -> None:
        self._file = file

    def status(self, view: View) -> Status:
        """What the file has, and why it could not be written or used."""
        status = Status("state file", "off: the parameter state_file is empty")
        file = self._file
        if file is None:
            return status
        status.summary = "not yet written"
        if file.stamp_ns is not None:
            status.summary = f"holds the state at stamp {file.stamp_ns / NS:.3f} s"
        if file.error is not None:
            status.complain(
                WARN,
                "writing",
                f"the state cannot be written to {file.path}: {file.error}; free the disk or "
                "correct the folder, writing is tried again; a filter started now does not "
                "continue from here",
            )
        if file.unused is not None:
            status.complain(
                WARN,
                "unused",
                f"{file.path} was not used, {file.unused}: send the filter its position if it "
                "cannot know it",
            )
        status.values["state file"] = file.path
        status.values["state file writes"] = file.writes
        status.values["state file failures"] = file.failures
        return status
