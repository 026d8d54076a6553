"""Mounts and lever arms from the /tf_static of a recording, as the filter node takes them."""

from pathlib import Path

from insdvl.messages.convert import RejectedMessage
from insdvl.messages.extrinsics import Extrinsics
from insdvl.messages.topics import taken
from insdvl.messages.transforms import TF_MESSAGE, TF_STATIC
from insdvl.navigation.parameters import FilterParameters
from insdvl.recordings.bag_reader import BagReader
from insdvl.recordings.base import BagError, decode
from insdvl.recordings.played import Recording


def with_extrinsics(
    path: Path, recording: Recording, parameters: FilterParameters
) -> FilterParameters:
    """The filter's parameters, with what /tf_static tells where ``extrinsics`` asks for it.

    Args:
        path: The recording.
        recording: What is played of it, on the topics of the nodes.
        parameters: Of the filter.

    Raises:
        BagError: The recording has no /tf_static, or that does not tell all.
    """
    if parameters.extrinsics != "tf":
        return parameters
    topics = taken(parameters)
    extrinsics = Extrinsics(parameters, topics)
    with BagReader(path) as bag:
        bag.require(TF_STATIC, TF_MESSAGE)
        for raw in bag.raw([TF_STATIC]):
            try:
                extrinsics.add(decode(raw).message)
            except RejectedMessage as error:
                raise BagError(f"{TF_STATIC} of {path}: {error}") from error
    names = {name.lstrip("/"): name for name in topics}
    to_hear = recording.topics.intersection(names)
    for raw in recording.on(to_hear):
        if raw.topic in to_hear:
            to_hear -= {raw.topic}
            extrinsics.hear(names[raw.topic], decode(raw).message)
        if not to_hear:
            break
    if missing := extrinsics.missing():
        raise BagError(f"extrinsics is 'tf': {'; '.join(missing)}")
    return extrinsics.applied(parameters)
