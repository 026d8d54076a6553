"""A bad link: which messages it loses, how long it takes for the others, and which come twice."""

import numpy as np

from insdvl.parameters import RelayParameters


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
