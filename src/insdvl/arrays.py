"""Types of numpy arrays that all rooms share."""

import numpy as np
from numpy.typing import NDArray

#: Real numbers; the docstring that names one gives its shape and unit.
Array = NDArray[np.float64]
#: (N,) stamps in integer nanoseconds.
Stamps = NDArray[np.int64]
#: (N,) structured records, see navigation/state.py.
Records = NDArray[np.void]
