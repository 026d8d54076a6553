"""Odometries from bytes at once: the numbers that were written, and what does not fit is told."""

import numpy as np
import pytest

from insdvl.messages.cdr.odometries import decode_odometries
from insdvl.messages.cdr.odometry_bytes import OdometryColumns, encode_odometries

FRAMES = [("odom", "base_link"), ("", ""), ("o", "ä"), ("abc", "abcdefg"), ("abcd", "ef")]


@pytest.mark.parametrize("frames", FRAMES)
def test_the_numbers_come_back_and_other_messages_are_told(frames: tuple[str, str]) -> None:
    rng = np.random.default_rng(7)
    shapes = (3,), (4,), (6, 6), (3,), (3,), (6, 6)
    numbers = [rng.normal(size=(4, *shape)) for shape in shapes]
    given = OdometryColumns(rng.integers(0, 2**60, 4), *numbers)
    messages = list(encode_odometries(frames, given))
    other = next(encode_odometries(("another", "frame"), given))
    big_endian = b"\0\0" + messages[1][2:]
    late = messages[2][:8] + (10**9).to_bytes(4, "little") + messages[2][12:]
    wrong = [other, messages[0][:-1], big_endian, b"", late]
    told, fits = decode_odometries([*messages, *wrong], frames)
    assert fits.tolist() == [True] * 4 + [False] * 5
    for found, expected in zip(told, given, strict=True):
        np.testing.assert_array_equal(found[:4], expected)
