"""Converts the facts about a robot to JSON values."""

from __future__ import annotations

import dataclasses
from typing import Any

from thorvaldc.model.spatial import clean


def facts_document(facts: Any) -> dict[str, Any]:
    """Return facts as JSON values, with the names of the fields as keys.

    ``facts`` is a ``RobotFacts`` or a part of it.
    All values are in SI units and angles in rad, rounded to 12 significant digits.
    """
    return {
        field.name: json_value(getattr(facts, field.name)) for field in dataclasses.fields(facts)
    }


def json_value(value: Any) -> Any:
    """Return one fact, or a part of a ``RobotFacts``, as a JSON value, as ``facts_document``."""
    if dataclasses.is_dataclass(value):
        return facts_document(value)
    if isinstance(value, tuple):
        if value and all(_is_pair(item) for item in value):
            return {key: json_value(item) for key, item in value}
        return [json_value(item) for item in value]
    return clean(value) if isinstance(value, float) else value


def _is_pair(value: Any) -> bool:
    return isinstance(value, tuple) and len(value) == 2 and isinstance(value[0], str)
