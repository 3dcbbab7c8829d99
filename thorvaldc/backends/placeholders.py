"""Texts with placeholders, ``@NAME@``, for the files of a ROS 2 package."""

from __future__ import annotations

import re
from collections.abc import Mapping

_PLACEHOLDER = re.compile(r"@([A-Z][A-Z0-9_]*)@")


def fill(text: str, values: Mapping[str, str]) -> str:
    """Return the text with each placeholder ``@NAME@`` replaced by its value.

    All placeholders are replaced in one pass, so that the order of the values has no effect, and
    text of a robot file that looks like a placeholder stays as it is. A value that contains
    placeholders itself is filled before. Raises ``KeyError`` for a placeholder without a value.
    """
    return _PLACEHOLDER.sub(lambda match: values[match[1]], text)
