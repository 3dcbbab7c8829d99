"""Functions of arrays with the same bits as the functions of single numbers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def exact(function: Callable[[float], float], values: Array) -> Array:
    """Returns ``function`` of each value, with the shape of ``values``.

    ``function`` is a function of the module ``math``.  The functions of numpy differ from it in the
    last bit, depending on the processor and on the version of numpy.
    """
    flat = values.ravel().tolist()
    return np.fromiter(map(function, flat), np.float64, len(flat)).reshape(values.shape)
