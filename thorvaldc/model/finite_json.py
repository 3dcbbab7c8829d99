"""Conversion of numbers that JSON cannot express."""

from __future__ import annotations

import math
from typing import Any


def finite(value: Any) -> Any:
    """Replace infinities and NaN by ``None`` in nested dictionaries, lists and tuples.

    JSON can express neither infinities nor NaN.
    """
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [finite(entry) for entry in value]
    return value
