"""Reads JSON that other programs or people have written."""

from __future__ import annotations

import json
from typing import Any


def read_json(text: str | bytes) -> Any:
    """Returns the value of a JSON text.

    Raises ``ValueError`` if the text is not JSON, also for brackets that are nested deeper than
    Python can read, for which the module ``json`` raises ``RecursionError``.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("brackets are nested too deeply") from None
