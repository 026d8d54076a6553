"""A node that turns for long keeps nothing of its turns."""

import gc
import os
import subprocess
import sys
from typing import Any

from insdvl.navigation.parameters import FilterParameters
from ros_insdvl.node import InsdvlNode
from ros_insdvl.process.arguments import Help
from ros_insdvl.process.execution import run_node

WARM, TURNS = 200, 2000


class Ticking(InsdvlNode[FilterParameters]):
    """Counts the turns of its timer, and what lives in the process after them."""

    def __init__(self, **options: Any) -> None:
        super().__init__("ticking", FilterParameters, **options)
        self._ticks = 0
        self._before = 0
        self.create_timer(0.001, self._tick)

    def _tick(self) -> None:
        self._ticks += 1
        if self._ticks == WARM:
            self._before = _living()
        elif self._ticks == WARM + TURNS:
            print(_living() - self._before)
            self.finish(0)


def _living() -> int:
    gc.collect()
    return len(gc.get_objects())


def test_turns_leave_nothing_behind() -> None:
    environment = {**os.environ, "ROS_LOG_DIR": "/proc/none/log"}
    command = [sys.executable, __file__]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert result.returncode == 0, result.stderr
    assert int(result.stdout.split()[-1]) < TURNS / 4


if __name__ == "__main__":
    sys.exit(run_node(Ticking, Help("none", "ticking", "/ticking", "", ())))
