"""Plain values that JSON can express."""

from __future__ import annotations

import math
from typing import Any


def finite(value: Any) -> Any:
    """Replaces infinities and NaN by ``None``, because JSON has neither."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [finite(entry) for entry in value]
    return value
