"""Odometry as bytes: bit-equal to the general encoder."""

import numpy as np
import pytest

from insdvl.messages.cdr.odometry_bytes import (
    OdometryColumns,
    OdometryEncoder,
    encode_odometries,
)
from insdvl.recordings.base import decode, encode
from insdvl.recordings.messages import odometry_message

FRAMES = [("odom", "base_link"), ("", ""), ("o", "ä"), ("abc", "abcdefg"), ("abcd", "ef")]


def columns(count: int) -> OdometryColumns:
    rng = np.random.default_rng(7)
    return OdometryColumns(
        rng.integers(0, 2**61, count),
        rng.normal(size=(count, 3)),
        rng.normal(size=(count, 4)),
        rng.normal(size=(count, 6, 6)),
        rng.normal(size=(count, 3)),
        rng.normal(size=(count, 3)),
        rng.normal(size=(count, 6, 6)),
    )


@pytest.mark.parametrize("frames", FRAMES)
def test_the_bytes_are_those_of_the_general_encoder(frames: tuple[str, str]) -> None:
    given = columns(5)
    found = list(encode_odometries(frames, given))
    encoder = OdometryEncoder(*frames)
    assert len(found) == 5
    for k, data in enumerate(found):
        stamp_ns = int(given.stamps_ns[k])
        message = odometry_message(
            stamp_ns,
            frames,
            given.position[k],
            given.quaternion_xyzw[k],
            given.linear[k],
            given.angular[k],
            given.pose_covariance[k],
            given.twist_covariance[k],
        )
        raw = encode("/odometry", stamp_ns, message)
        assert data == raw.data
        assert encoder.encode(stamp_ns, *(column[k] for column in given[1:])) == raw.data
        assert decode(raw).message.child_frame_id == frames[1]


def test_no_state_makes_no_message() -> None:
    assert list(encode_odometries(("odom", "base_link"), columns(0))) == []
