"""All causes of the filter: each sees what the node does, and gives its status."""

from collections import Counter

from insdvl.messages.extrinsics import Extrinsics
from insdvl.messages.inputs import Inputs
from insdvl.navigation.events import Event
from insdvl.navigation.odometry import Odometry
from insdvl.navigation.parameters import FilterParameters
from insdvl.timeline.fold import Fold
from insdvl.timeline.jumps import TimeJump
from insdvl.timeline.output import AppliedUpdate
from insdvl.timeline.state_file import StateFile
from ros_insdvl.status.diagnostics import Status, View
from ros_insdvl.status.filter.base import Cause, Published
from ros_insdvl.status.filter.extrinsics import OfExtrinsics
from ros_insdvl.status.filter.frames import Frames
from ros_insdvl.status.filter.imu import Imu
from ros_insdvl.status.filter.initialisation import Initialisation
from ros_insdvl.status.filter.measurement import MeasurementCause
from ros_insdvl.status.filter.measurement_noise import MeasurementNoise
from ros_insdvl.status.filter.output import Output
from ros_insdvl.status.filter.process_noise import ProcessNoise
from ros_insdvl.status.filter.state_file import KeptState
from ros_insdvl.status.filter.time import Time

#: Events that are looked at together: as they come, it costs the filter more than the events.
TOGETHER = 50


class FilterWatch:
    """Tells the causes what happens.

    Args:
        parameters: Of the filter.
        inputs: Of the filter.
        fold: Of the filter.
        state_file: Where its state is kept, None for nowhere.
        extrinsics: Where the sensors are, None where the parameters say it.
    """

    def __init__(
        self,
        parameters: FilterParameters,
        inputs: Inputs,
        fold: Fold,
        state_file: StateFile | None = None,
        extrinsics: Extrinsics | None = None,
    ) -> None:
        self._fold = fold
        self._published = Published()
        self._taken: list[Event] = []  # that no cause has seen yet
        self._imu = Imu(parameters)
        self._frames = Frames(parameters, inputs)
        self._output = Output(parameters, self._published)
        self._noises = MeasurementNoise.of(parameters, fold)
        self._causes: tuple[Cause, ...] = (
            Initialisation(parameters, inputs, fold, self._published),
            self._imu,
            *(
                MeasurementCause(name, topics, fold, self._published)
                for name, topics in inputs.measured.items()
            ),
            *self._noises,
            ProcessNoise(parameters, fold),
            Time(fold),
            self._frames,
            self._output,
            KeptState(state_file),
            *([] if extrinsics is None else [OfExtrinsics(extrinsics)]),
        )

    @property
    def counts(self) -> Counter[str]:
        """Events that are counted here and in the fold."""
        self._look()
        return Counter({**self._fold.counts, **self._imu.counts, **self._frames.counts})

    def reset(self) -> None:
        """Another time begins: what was remembered by stamps is forgotten."""
        self._look()
        self._published.reset()
        for cause in self._causes:
            cause.reset()

    def jumped(self, jump: TimeJump) -> None:
        """The fold has followed the samples into another time."""
        for cause in self._causes:
            cause.jumped(jump)

    def took(self, event: Event) -> None:
        """The fold took an event."""
        self._taken.append(event)
        if len(self._taken) >= TOGETHER:
            self._look()

    def _look(self) -> None:
        """Let the causes see the events since the last look."""
        self._imu.took(self._taken)
        self._frames.took(self._taken)
        for noise in self._noises:
            noise.took(self._taken)
        self._taken.clear()

    def updated(self, update: AppliedUpdate) -> None:
        """A measurement was used or rejected."""
        for cause in self._causes:
            cause.updated(update)

    def published(self, output: Odometry, now_ns: int) -> None:
        """Odometry was published at a time of the node's clock."""
        self._published.add(output)
        self._output.published(output, now_ns)

    def causes(self, view: View) -> list[Status]:
        """All statuses, as of now."""
        self._look()
        return [cause.status(view) for cause in self._causes]
