"""The one loop: a message becomes events, the fold takes them, and refusals are counted.

The filter node, `insdvl replay`, the fault flights and the soak all feed their filter by this.
"""

from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

from insdvl.messages.convert import ImuSamples, RejectedMessage
from insdvl.messages.inputs import Inputs
from insdvl.messages.refusals import Refused
from insdvl.messages.topics import IMU, taken
from insdvl.navigation.events import Event, Measurement
from insdvl.navigation.parameters import FilterParameters
from insdvl.timeline.fold import Fold


class Fed(NamedTuple):
    """An event that was given to the fold.

    Attributes:
        event: The event.
        refusal: Why the fold does not use it; None where it does.
    """

    event: Event
    refusal: str | None


class Feed:
    """A filter that takes messages.

    Attributes:
        inputs: The topics and their converters.
        fold: The filter's timeline; ``fold.take()`` gives what is to be published.
        has_map: Whether an input tells heading or position against the Earth: then map is not odom.
        recovered: Events that the last message made the fold use after all, itself among them; see
            `Fold.add`.
        refused: Messages that are not used, by topic and reason. A measurement in a message of the
            IMU is refused by its own name: the sample may be used.
    """

    def __init__(
        self,
        parameters: FilterParameters,
        *,
        capacity: int = 512,
        on_refused: Callable[[str, str, str], None] | None = None,
    ) -> None:
        """Make an empty fold.

        Args:
            parameters: Of the filter.
            capacity: Number of IMU samples to make room for at first; there will be as much as
                max_delay needs.
            on_refused: Called with topic, reason and detail of each message that is not used.

        Raises:
            ParameterError: Two parameters name one topic, or one frame.
        """
        self.fold = Fold(parameters, capacity)
        models, topics = self.fold.filter.models, taken(parameters).values()
        self.has_map = any(models[t.measurement].absolute for t in topics if t.measurement)
        self.inputs = Inputs(parameters, has_map=self.has_map)
        self.recovered: list[Event] = []
        self.refused: Counter[Refused] = Counter()
        self._on_refused = on_refused

    def give(self, topic: str, message: Any) -> list[Fed]:
        """Give a message to the filter.

        Args:
            topic: One of ``inputs.topics``.
            message: Of one of the topic's types.

        Returns:
            The events of the message. It never raises on what is in a message.
        """
        fed: list[Fed] = []
        self.recovered = []
        times_left = len(self.fold.left)
        try:
            for event in self.inputs.events(topic, message, self.fold):
                refusal = self.fold.add(event)
                fed.append(Fed(event, refusal))
                self.recovered += self.fold.recovered
                if refusal is not None:
                    of_imu = self.inputs.topics[topic].name == IMU
                    where = event.name if of_imu and isinstance(event, Measurement) else topic
                    self._refuse(where, refusal, f"{refusal}: stamp {event.stamp_ns} ns")
        except RejectedMessage as rejection:
            self._refuse(rejection.measurement or topic, rejection.reason, str(rejection))
        if len(self.fold.left) > times_left:  # a time jump
            self.inputs.reset()
        return fed

    def give_samples(self, topic: str, samples: ImuSamples, part: slice) -> int:
        """Give the filter many messages of the IMU at once; to the same state as by `give`.

        Args:
            topic: Of the IMU.
            samples: See `Inputs.imu_samples`.
            part: Which of them follow.

        Returns:
            How many of the first it has taken. The next one must be given by `give`.
        """
        count = self.inputs.sample_count(topic, samples, part, self.fold)
        count = self.fold.following(samples.stamps_ns[part.start : part.start + count])
        if count:
            taken = slice(part.start, part.start + count)
            arrays = samples.stamps_ns[taken], samples.f_b[taken], samples.w_ib_b[taken]
            self.fold.add_samples(*arrays)
        return count

    def reset(self) -> bool:
        """Start again, with the origin of odom as it is; see `Fold.reset`."""
        self.inputs.reset()
        return self.fold.reset()

    def _refuse(self, topic: str, reason: str, detail: str) -> None:
        self.refused[Refused(topic, reason)] += 1
        if self._on_refused is not None:
            self._on_refused(topic, reason, detail)
