"""The cause `extrinsics`: what /tf_static tells of the sensors, and what it does not tell yet."""

from insdvl.messages.extrinsics import Extrinsics
from insdvl.messages.transforms import TF_STATIC
from ros_insdvl.status.diagnostics import WARN, Status, View
from ros_insdvl.status.filter.base import Cause


class OfExtrinsics(Cause):
    """Mounts and lever arms, with ``extrinsics: tf``."""

    def __init__(self, extrinsics: Extrinsics) -> None:
        self._extrinsics = extrinsics

    def status(self, view: View) -> Status:
        """What was found, or is awaited."""
        status = Status("extrinsics")
        if missing := self._extrinsics.missing():
            text = "; ".join(missing)
            status.complain(WARN, "waits", f"the filter waits for mounts and lever arms: {text}")
        else:
            status.summary = f"found: {self._extrinsics.text}"
        view.show(status, TF_STATIC)
        view.report_refused(status, [TF_STATIC])
        return status
