"""The node `insdvl_tuner`: IMU in, the process noise learned from its last samples out.

Data driven: the schedule follows from the stamps (see `insdvl.tuner.tuner`). The node publishes the
sample that closes the window with its learned covariances: a plain Imu that any consumer may use in
place of the driver's.
"""

import sys
from collections import Counter
from typing import Any

import numpy as np
from sensor_msgs.msg import Imu
from std_srvs.srv import SetBool

from insdvl.messages.topics import IMU, PROCESS_NOISE
from insdvl.parameters.declaration import ParameterError
from insdvl.tuner.models import ModelError
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.republish import set_learned, tune
from insdvl.tuner.tuner import TunedNoise, Tuner
from ros_insdvl.diagnostics import ERROR, OF_TIME, RECENT, WARN, Status, View
from ros_insdvl.node import InsdvlNode, latched_qos, run


class TunerNode(InsdvlNode[TunerParameters]):
    """The tuner as a node."""

    single_inputs = (IMU,)

    def __init__(self, **options: Any) -> None:
        """Load the model and compile the kernels, then listen.

        Raises:
            ModelError: The model cannot be used; it has been logged.
            ParameterError: A parameter is wrong, or does not go with the model.
        """
        super().__init__("insdvl_tuner", TunerParameters, **options)
        try:
            self._tuner = Tuner(self.parameters)
        except (ModelError, ParameterError) as error:
            self.get_logger().fatal(str(error))
            self.destroy_node()
            raise
        self._latest: TunedNoise | None = None
        self._process_noise = self.advertise(Imu, PROCESS_NOISE, latched_qos())
        self.create_service(SetBool, "~/enable", self._enable)
        self.listen(Imu, IMU, self._on_imu)
        self.start_diagnostics()

    def _on_imu(self, message: Imu) -> None:
        tuned = tune(self._tuner, message)
        if tuned is None:
            return
        self._latest = tuned
        set_learned(message, tuned)
        self._process_noise.send(message)

    def _enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._tuner.enabled = request.data
        response.success = True
        response.message = "enabled" if request.data else "disabled"
        self.get_logger().info(response.message)
        return response

    # Diagnostics

    def counts(self) -> Counter[str]:
        """Those of every node, and what became of the samples."""
        counts = super().counts()
        counts.update(self._tuner.counts)
        return counts

    def causes(self, view: View) -> list[Status]:
        """The IMU and its stamps, and what is learned from it."""
        return [self._imu(view), self._learned(view)]

    def _imu(self, view: View) -> Status:
        status = Status("imu", f"{view.rates[IMU]:.1f} Hz")
        view.quiet(status, IMU, ERROR, "look at the IMU's driver, its topic and the connections")
        view.refused(status, [IMU])
        view.refused(status, [IMU], OF_TIME)
        for name, remedy in (
            ("duplicates", "two senders on one topic, or a network that doubles"),
            ("out_of_order", "the network changes the order; such samples are left out"),
            (
                "gaps",
                f"samples are lost; a window that spans more than {self.parameters.max_gap:g} "
                "s is not used",
            ),
            (
                "restarts",
                f"stamps went back by more than {self.parameters.max_gap:g} s, which begins the "
                "window again: the network changes the order by more than max_gap, or a clock was "
                "set",
            ),
        ):
            status.values[name] = view.total.get(name, 0)
            if count := view.recent[name]:
                status.complain(WARN, name, f"{count} {name} in the last {RECENT:.0f} s: {remedy}")
        view.show(status, IMU)
        return status

    def _learned(self, view: View) -> Status:
        """Model, switch, and the six sigmas of Q."""
        model = self._tuner.model.card["name"]
        status = Status("process noise", f"learned by the model {model}")
        status.values["model"] = model
        status.values["enabled"] = self._tuner.enabled
        if not self._tuner.enabled:
            status.complain(
                WARN, "disabled", "disabled, process_noise is not published: call ~/enable"
            )
        elif self._learns_nothing(view):
            status.complain(
                WARN,
                "nothing",
                f"no window was usable in the last {RECENT:.0f} s: it takes "
                f"{self._tuner.model.window} samples in a row without a gap"
                + self._what_emptied(view),
            )
        if count := view.recent["too_large"]:
            status.complain(
                WARN,
                "too large",
                f"{count} windows in the last {RECENT:.0f} s had values too large to learn from: "
                "look at the IMU",
            )
        if self._latest is not None:
            sigmas = np.sqrt(self._latest.variances)
            for axis, f, w in zip("xyz", sigmas[:3], sigmas[3:], strict=True):
                status.values[f"Q sigma f_{axis} [m/s^2]"] = f"{f:.6g}"
                status.values[f"Q sigma w_{axis} [rad/s]"] = f"{w:.6g}"
        for name in ("samples", "windows", "too_large"):
            status.values[name] = view.total.get(name, 0)
        view.show(status, "process_noise")
        return status

    def _what_emptied(self, view: View) -> str:
        """What kept the window from filling, and what to do; empty where nothing did."""
        gaps, restarts = view.recent["gaps"], view.recent["restarts"]
        if not gaps + restarts:
            return ""
        return (
            f", and {gaps} gaps and {restarts} restarts emptied it: mend the network, run the "
            "tuner beside the IMU's driver, or raise max_gap "
            f"({self.parameters.max_gap:g} s) above the delays"
        )

    def _learns_nothing(self, view: View) -> bool:
        """Whether samples came all the time, for long enough, and no estimate."""
        samples = view.recent[f"received {IMU}"]
        return (
            0 < samples < view.total[f"received {IMU}"]
            and not view.recent["sent process_noise"]
            and RECENT * self.parameters.rate >= 2.0
        )


def main() -> int:
    """Run the node until it is interrupted."""
    try:
        return run(TunerNode)
    except ModelError:  # the node has logged it
        return 1


if __name__ == "__main__":
    sys.exit(main())
