"""Odometry as bytes: bit-equal to the general encoder."""

from typing import Any

import numpy as np
import pytest

from insdvl.messages.cdr.odometry_bytes import (
    OdometryColumns,
    OdometryEncoder,
    OdometryMessage,
    decode_odometry,
    encode_odometries,
)
from insdvl.messages.convert import ODOMETRY
from insdvl.recordings.base import Raw, decode, encode
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
        assert_same(decode_odometry(data), decode(raw).message)


def assert_same(found: OdometryMessage | None, expected: Any) -> None:
    assert found is not None
    stamp, header = found.header.stamp, expected.header
    assert (*stamp, found.header.frame_id) == (
        header.stamp.sec,
        header.stamp.nanosec,
        header.frame_id,
    )
    assert found.child_frame_id == expected.child_frame_id
    for mine, theirs in (
        (found.pose.pose.position, expected.pose.pose.position),
        (found.pose.pose.orientation, expected.pose.pose.orientation),
        (found.twist.twist.linear, expected.twist.twist.linear),
        (found.twist.twist.angular, expected.twist.twist.angular),
    ):
        assert mine == tuple(getattr(theirs, axis) for axis in mine._fields)
    assert found.pose.covariance == tuple(expected.pose.covariance)
    assert found.twist.covariance == tuple(expected.twist.covariance)


def test_what_does_not_fit_is_left_to_the_general_decoder() -> None:
    given = columns(1)
    good = next(encode_odometries(("odom", "base_link"), given))
    numbers = len(good) - 8 * 85
    for length in (0, 3, 16, 20, numbers, len(good) - 8, len(good) - 1):
        assert decode_odometry(good[:length]) is None
    assert decode_odometry(good + b"\0") is None
    rng = np.random.default_rng(2)
    for _ in range(2000):
        changed = np.frombuffer(good, np.uint8).copy()
        at = int(rng.integers(0, numbers))
        changed[at] ^= int(rng.integers(1, 256))
        found = decode_odometry(changed.tobytes())
        if found is not None:  # the stamp, a letter or a filling byte
            raw = Raw("/odometry", ODOMETRY, 0, changed.tobytes())
            assert_same(found, decode(raw).message)


def test_no_state_makes_no_message() -> None:
    assert list(encode_odometries(("odom", "base_link"), columns(0))) == []
