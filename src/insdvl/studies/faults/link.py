"""A bad link: which messages it loses, how long it takes for the others, and which come twice."""

from dataclasses import dataclass

import numpy as np

from insdvl.parameters.declaration import ParameterError, parameter


@dataclass(frozen=True)
class RelayParameters:
    """Parameters of the relay, a link that loses, delays, reorders and doubles messages."""

    topics: tuple[str, ...] = parameter(
        ("imu/data_raw", "dvl/velocity"),
        "What is sent on: topics that the filter takes, or the simulator's truth.",
    )
    prefix: str = parameter(
        "sent/", "Each topic is taken from this and its name, and sent on by its name alone."
    )
    loss: float = parameter(0.0, "Probability that a message is lost.", low=0.0, high=1.0)
    duplication: float = parameter(
        0.0, "Probability that a message that is not lost arrives twice.", low=0.0, high=1.0
    )
    delay: float = parameter(
        0.0, "Time that every message takes at least, of the wall.", unit="s", low=0.0, high=60.0
    )
    jitter: float = parameter(
        0.0,
        "Largest further delay; each copy of a message has one of its own, evenly distributed, so "
        "messages that are closer than that overtake each other.",
        unit="s",
        low=0.0,
        high=60.0,
    )
    seed: int = parameter(
        1, "Of all that is random: it decides what becomes of a topic's n-th message.", low=0
    )

    def __post_init__(self) -> None:
        if not self.prefix:
            raise ParameterError(
                "parameter 'prefix' must not be empty: the relay would hear itself"
            )


class Link:
    """What becomes of the messages of one topic, one after the other.

    Every message draws the same four numbers, whatever the settings are. So a seed decides what
    becomes of the n-th message, and two settings can be compared on the same draws.

    Args:
        parameters: Of the link.
        rng: Of this topic alone.
    """

    def __init__(self, parameters: RelayParameters, rng: np.random.Generator) -> None:
        self._parameters = parameters
        self._rng = rng

    def delays(self) -> tuple[float, ...]:
        """Delay of each copy of the next message that arrives [s]; none where it is lost."""
        chance_of_loss, chance_of_copy, *shares = self._rng.random(4).tolist()
        if chance_of_loss < self._parameters.loss:
            return ()
        copies = 2 if chance_of_copy < self._parameters.duplication else 1
        return tuple(
            self._parameters.delay + share * self._parameters.jitter for share in shares[:copies]
        )


def links(parameters: RelayParameters) -> dict[str, Link]:
    """A link for each topic; their randomness is independent, and all of it follows the seed."""
    generators = np.random.default_rng(parameters.seed).spawn(len(parameters.topics))
    return {
        topic: Link(parameters, generator)
        for topic, generator in zip(parameters.topics, generators, strict=True)
    }
