"""An Imu from its bytes: the numbers of the general decoder, and nothing that does not fit."""

from typing import Any

import numpy as np
import pytest

from insdvl.messages.cdr.imu_bytes import ImuMessage, decode_imu, decode_imus
from insdvl.recordings.base import Raw, decode, encode
from insdvl.recordings.messages import imu_message

FRAMES = ["", "imu", "imu_link", "ä", *("x" * n for n in range(1, 10)), "a/b" * 300]
FIELDS = [
    "orientation",
    "orientation_covariance",
    "angular_velocity",
    "angular_velocity_covariance",
    "linear_acceleration",
    "linear_acceleration_covariance",
]


def message(frame_id: str, seed: int = 0) -> Any:
    rng = np.random.default_rng(seed)
    stamp_ns = int(rng.integers(0, 2**60))
    made = imu_message(stamp_ns, frame_id, *rng.normal(size=(2, 3)), *rng.normal(size=(2, 3, 3)))
    q = made.orientation
    q.x, q.y, q.z, q.w = rng.normal(size=4).tolist()
    made.orientation_covariance = rng.normal(size=9)
    return made


def data_of(frame_id: str, seed: int = 0) -> bytes:
    return encode("/imu", 0, message(frame_id, seed)).data


def assert_same(found: ImuMessage | None, expected: Any) -> None:
    assert found is not None
    header = expected.header
    assert found.header.frame_id == header.frame_id
    assert found.header.stamp == (header.stamp.sec, header.stamp.nanosec)
    for name in FIELDS:
        mine, theirs = getattr(found, name), getattr(expected, name)
        if hasattr(mine, "_fields"):
            theirs = [getattr(theirs, axis) for axis in mine._fields]
        assert mine == tuple(theirs), name


@pytest.mark.parametrize("frame_id", FRAMES)
def test_the_numbers_are_those_of_the_general_decoder(frame_id: str) -> None:
    expected = message(frame_id)
    raw = encode("/imu", 0, expected)
    assert_same(decode_imu(raw.data), expected)
    assert_same(decode_imu(raw.data), decode(raw).message)


def damaged() -> dict[str, bytes]:
    good = data_of("imu_link")
    return {
        "nothing": b"",
        "encapsulation only": good[:4],
        "head only": good[:16],
        "short": good[:-1],
        "long": good + b"\0",
        "eight short": good[:-8],
        "eight long": good + bytes(8),
        "big-endian": b"\0\0\0\0" + good[4:],
        "XCDR2": b"\0\7\0\0" + good[4:],
        "length of another frame": good[:12] + (12).to_bytes(4, "little") + good[16:],
        "length of no frame": good[:12] + bytes(4) + good[16:],
        "huge length": good[:12] + b"\xff\xff\xff\xff" + good[16:],
        "no zero at the end": good[:24] + b"x" + good[25:],
        "zero inside": good[:18] + b"\0" + good[19:],
        "not UTF-8": good[:18] + b"\xff" + good[19:],
    }


@pytest.mark.parametrize("name", damaged())
def test_what_does_not_fit_is_left_to_the_general_decoder(name: str) -> None:
    data = damaged()[name]
    assert decode_imu(data) is None
    found = decode_imus([data_of("imu_link"), data, data_of("imu")])
    assert found.fits.tolist() == [True, False, True]
    assert not found.numbers[1].any() and found.seconds[1] == found.nanoseconds[1] == 0


def test_many_at_once_are_as_one_by_one() -> None:
    messages = [data_of(frame_id, k) for k, frame_id in enumerate([*FRAMES, *FRAMES])]
    messages[3:3] = [*damaged().values()]
    found = decode_imus(messages)
    assert found.fits.sum() == 2 * len(FRAMES)
    assert sorted(found.frame_ids) == sorted(FRAMES)
    frame_ids = list(found.frame_ids)
    for k, data in enumerate(messages):
        one = decode_imu(data)
        assert found.fits[k] == (one is not None)
        if one is None:
            continue
        assert frame_ids[found.frames[k]] == one.header.frame_id
        assert (found.seconds[k], found.nanoseconds[k]) == one.header.stamp
        assert found.numbers[k].tobytes() == np.array(one.numbers).tobytes()


def test_infinities_and_nans_are_kept() -> None:
    made = message("imu")
    made.linear_acceleration.x, made.angular_velocity.y = float("nan"), float("inf")
    found = decode_imu(encode("/imu", 0, made).data)
    assert found is not None
    assert np.isnan(found.linear_acceleration.x) and np.isinf(found.angular_velocity.y)


def test_no_message_makes_no_row() -> None:
    found = decode_imus([])
    assert found.fits.size == 0 and found.numbers.shape == (0, 37) and found.frame_ids == {}


def test_random_bytes_never_raise() -> None:
    rng, good = np.random.default_rng(5), np.frombuffer(data_of("imu_link"), np.uint8)
    messages = []
    for _ in range(2000):
        changed = good.copy()
        changed[rng.integers(0, 40, 3)] = rng.integers(0, 256, 3)
        messages.append(changed.tobytes()[: rng.integers(0, 400)])
    found = decode_imus(messages)
    ones = [decode_imu(data) for data in messages]
    assert found.fits.tolist() == [one is not None for one in ones]
    for k, one in enumerate(ones):
        if one is not None:
            raw = Raw("/imu", "sensor_msgs/msg/Imu", 0, messages[k])
            assert decode(raw).message.header.frame_id == one.header.frame_id
