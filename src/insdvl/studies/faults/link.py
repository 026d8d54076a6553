"""A bad link: which messages it loses, how much it delays the others, and which it duplicates."""

from dataclasses import dataclass

import numpy as np

from insdvl.messages.topics import DVL, IMU
from insdvl.parameters.declaration import ParameterError, parameter


@dataclass(frozen=True)
class RelayParameters:
    """Parameters of the relay: a link that loses, delays, reorders and duplicates messages."""

    topics: tuple[str, ...] = parameter(
        (IMU, DVL),
        "Topics that are relayed: inputs of the filter, or the simulator's truth.",
    )
    prefix: str = parameter(
        "sent/", "Each topic is received under this prefix and its name, and sent under its name."
    )
    loss: float = parameter(0.0, "Probability that a message is lost.", low=0.0, high=1.0)
    duplication: float = parameter(
        0.0, "Probability that a message that is not lost is duplicated.", low=0.0, high=1.0
    )
    delay: float = parameter(
        0.0, "Smallest delay of each message, in wall time.", unit="s", low=0.0, high=60.0
    )
    jitter: float = parameter(
        0.0,
        "Largest further delay. It is uniformly distributed and drawn for each copy of a message: "
        "messages that are closer than this may overtake each other.",
        unit="s",
        low=0.0,
        high=60.0,
    )
    seed: int = parameter(
        1, "Random seed; it decides what happens to the n-th message of each topic.", low=0
    )

    def __post_init__(self) -> None:
        if not self.prefix:
            raise ParameterError(
                "parameter 'prefix' must not be empty: the relay would receive its own messages"
            )


class Link:
    """What happens to the messages of one topic, one after the other.

    Every message draws the same four numbers, whatever the parameters are. So a seed decides what
    happens to the n-th message, and two sets of parameters can be compared on the same draws.

    Args:
        parameters: Parameters of the link.
        rng: Random numbers of this topic alone.
    """

    def __init__(self, parameters: RelayParameters, rng: np.random.Generator) -> None:
        self._parameters = parameters
        self._rng = rng

    def delays(self) -> tuple[float, ...]:
        """Delay of each copy of the next message [s]; empty where it is lost."""
        chance_of_loss, chance_of_copy, *shares = self._rng.random(4).tolist()
        if chance_of_loss < self._parameters.loss:
            return ()
        copies = 2 if chance_of_copy < self._parameters.duplication else 1
        return tuple(
            self._parameters.delay + share * self._parameters.jitter for share in shares[:copies]
        )


def links(parameters: RelayParameters) -> dict[str, Link]:
    """A link for each topic; their random numbers are independent and follow from the seed."""
    generators = np.random.default_rng(parameters.seed).spawn(len(parameters.topics))
    return {
        topic: Link(parameters, generator)
        for topic, generator in zip(parameters.topics, generators, strict=True)
    }
