"""Many sensor_msgs/Imu from bytes at once: one alone takes the general decoder 40 us.

The layout of the message in CDR is fixed but for the frame_id, which is the same in nearly all
messages of a topic. So messages of one length are the rows of one array.
"""

from collections.abc import Sequence

import numpy as np

from insdvl.messages.convert import ImuArrays
from insdvl.recordings.base import ENCAPSULATION_BYTES

_LITTLE_ENDIAN = b"\x00\x01"  # CDR, of an encapsulation of four bytes
_NUMBERS = 37  # of eight bytes, behind the header
_STAMP, _TEXT = ENCAPSULATION_BYTES, ENCAPSULATION_BYTES + 8


def imu_arrays(messages: Sequence[bytes], frame_id: str) -> ImuArrays:
    """The numbers of messages.

    One that is not little-endian, has another frame_id or not the length that it should have is all
    zeros, so that its stamp cannot be used: `base.decode` tells what it is.

    Args:
        messages: (N,) in CDR.
        frame_id: Of the messages.
    """
    text = frame_id.encode() + b"\0"
    text = len(text).to_bytes(4, "little") + text
    numbers = ENCAPSULATION_BYTES + (len(text) + 15) // 8 * 8  # they begin at a multiple of 8
    size = numbers + 8 * _NUMBERS
    fit = [
        k
        for k, data in enumerate(messages)
        if len(data) == size and data[:2] == _LITTLE_ENDIAN and data.startswith(text, _TEXT)
    ]
    dtype = np.dtype(
        {
            "names": ["sec", "nanosec", "numbers"],
            "formats": ["<i4", "<u4", ("<f8", _NUMBERS)],
            "offsets": [_STAMP, _STAMP + 4, numbers],
            "itemsize": size,
        }
    )
    joined = b"".join([messages[k] for k in fit])
    rows = np.frombuffer(joined, dtype) if fit else np.empty(0, dtype)
    count, at = len(messages), np.array(fit, dtype=np.intp)
    sec, nanosec = np.zeros(count, np.int32), np.zeros(count, np.uint32)
    values = np.zeros((count, _NUMBERS))
    sec[at], nanosec[at], values[at] = rows["sec"], rows["nanosec"], rows["numbers"]
    return ImuArrays(
        frame_id=frame_id,
        sec=sec,
        nanosec=nanosec,
        f=values[:, 25:28],
        w=values[:, 13:16],
        f_variance=values[:, 28],
        w_variance=values[:, 16],
        orientation_variances=values[:, 4:13],
    )
