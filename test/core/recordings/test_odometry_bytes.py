"""Odometry as rows of one array: bit-equal to the general encoder."""

import numpy as np
import pytest

from insdvl.recordings.base import decode, encode
from insdvl.recordings.messages import odometry_message
from insdvl.recordings.odometry_bytes import (
    OdometryColumns,
    decode_odometries,
    encode_odometries,
)

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
    found = list(encode_odometries("/odometry", frames, given))
    assert len(found) == 5
    for k, raw in enumerate(found):
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
        assert raw == encode("/odometry", stamp_ns, message)
        assert decode(raw).message.child_frame_id == frames[1]


@pytest.mark.parametrize("frames", FRAMES)
def test_the_numbers_come_back_and_other_messages_are_told(frames: tuple[str, str]) -> None:
    given = columns(4)
    given = given._replace(stamps_ns=given.stamps_ns // 2)
    raws = list(encode_odometries("/odometry", frames, given))
    other = next(encode_odometries("/odometry", ("another", "frame"), given))
    big_endian = b"\0\0" + raws[1].data[2:]
    data = [*(raw.data for raw in raws), other.data, raws[0].data[:-1], big_endian, b""]
    told, fit = decode_odometries(data, frames)
    assert fit.tolist() == [True] * 4 + [False] * 4
    for found, expected in zip(told, given, strict=True):
        np.testing.assert_array_equal(found[:4], expected)


def test_no_state_makes_no_message() -> None:
    assert list(encode_odometries("/odometry", ("odom", "base_link"), columns(0))) == []
