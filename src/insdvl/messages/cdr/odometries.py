"""nav_msgs/Odometry from bytes, many messages at once; the layout is in odometry_bytes.py.

Every message is checked. One that does not fit, such as one with other frames than the others, is
no fault: the general decoder knows what to do with it.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from insdvl.messages.cdr.layout import ENCAPSULATION, encoded_text
from insdvl.messages.cdr.odometry_bytes import OdometryColumns
from insdvl.navigation.events import NS

#: Shapes of the numbers, in the order of `OdometryColumns`.
_SHAPES = (3,), (4,), (6, 6), (3,), (3,), (6, 6)
_STAMP, _FRAME = len(ENCAPSULATION), len(ENCAPSULATION) + 8


def decode_odometries(
    messages: Sequence[bytes], frames: tuple[str, str]
) -> tuple[OdometryColumns, NDArray[np.bool_]]:
    """The numbers of messages, and whether each (N,) has the layout; they are zero where not.

    Args:
        messages: (N,) their bytes in CDR.
        frames: frame_id and child_frame_id that they should have.
    """
    frame, child = (encoded_text(name) for name in frames)
    second = _FRAME + len(frame) + -len(frame) % 4
    end = second + len(child)
    start = end + (len(ENCAPSULATION) - end) % 8
    count = sum(map(math.prod, _SHAPES))
    layout = np.dtype(
        {
            "names": ["seconds", "nanoseconds", "numbers"],
            "formats": ["<i4", "<u4", ("<f8", (count,))],
            "offsets": [_STAMP, _STAMP + 4, start],
            "itemsize": start + 8 * count,
        }
    )
    fits = np.array(
        [
            len(data) == layout.itemsize
            and data.startswith(ENCAPSULATION)
            and data.startswith(frame, _FRAME)
            and data.startswith(child, second)
            for data in messages
        ],
        dtype=np.bool_,
    )
    rows = np.zeros(len(messages), layout)
    joined = b"".join([data for data, is_fit in zip(messages, fits, strict=True) if is_fit])
    if joined:
        rows[fits] = np.frombuffer(joined, layout)
    seconds, nanoseconds = rows["seconds"].astype(np.int64), rows["nanoseconds"]
    fits &= (seconds >= 0) & (nanoseconds < NS)
    at, parts = 0, []
    for shape in _SHAPES:
        size = math.prod(shape)
        parts.append(rows["numbers"][:, at : at + size].reshape(-1, *shape))
        at += size
    return OdometryColumns(seconds * NS + nanoseconds, *parts), fits
