"""Every difference of two models, as differences of values in their JSON form.

The JSON form contains every field of the model, so that no difference is lost, also in a field that
the rest of the comparison does not know.  Source spans are left out: they are positions in a file
and not a property of the robot.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any, Final, NamedTuple

from thorvaldc.model import Fleet, Robot
from thorvaldc.model.model_json import to_json

ValuePath = tuple[str, ...]


class _Absent:
    def __repr__(self) -> str:
        return "ABSENT"


ABSENT: Final = _Absent()
"""Placeholder for the value of an element that one of the two models does not have."""


class LeafDifference(NamedTuple):
    """A value that differs between two models.

    - ``path``: names of the fields and elements from the root of the model to the value, for
      example ``("wheels", "fl_wheel", "radius")``.
    - ``before``, ``after``: values in the JSON form, or ``ABSENT``.  An element that only one model
      has is one difference, with the whole element as its value.
    """

    path: ValuePath
    before: Any
    after: Any

    @property
    def text_path(self) -> str:
        return ".".join(self.path)

    @property
    def is_rounding(self) -> bool:
        """True for numbers that differ by less than 1e-9 of their size."""
        return _differ_by_rounding(self.before, self.after)


def model_document(model: Robot | Fleet) -> dict[str, Any]:
    """Returns the model in its JSON form, with mappings by name instead of lists of elements.

    The key ``order`` of a mapping that was a list contains the names in the order of the list.
    """
    document = _keyed(json.loads(to_json(model))["model"])
    return dict(document)


def leaf_differences(before: Any, after: Any, path: ValuePath = ()) -> Iterator[LeafDifference]:
    """Yields the differences of two documents of ``model_document``, in the order of the model."""
    if isinstance(before, dict) or isinstance(after, dict):
        # A list of elements is a mapping; an empty list has no elements to tell this from.
        before, after = ({} if side == [] else side for side in (before, after))
    if isinstance(before, dict) and isinstance(after, dict):
        for key in [*before, *(key for key in after if key not in before)]:
            inner = (*path, key)
            if key == ORDER:
                yield from _order_difference(before, after, inner)
            elif key not in before or key not in after:
                yield LeafDifference(inner, before.get(key, ABSENT), after.get(key, ABSENT))
            else:
                yield from leaf_differences(before[key], after[key], inner)
    elif type(before) is not type(after) or before != after:
        yield LeafDifference(path, before, after)


ORDER = "(order)"
"""Key of the order of the elements in a mapping that was a list of elements."""


def _order_difference(
    before: dict[str, Any], after: dict[str, Any], path: ValuePath
) -> Iterator[LeafDifference]:
    """Yields a difference if the elements that both models have are in another order."""
    common = [
        [name for name in side.get(ORDER, ()) if name in other]
        for side, other in ((before, after), (after, before))
    ]
    if common[0] != common[1]:
        yield LeafDifference(path, common[0], common[1])


def _keyed(value: Any) -> Any:
    """Replaces lists of elements by mappings of names to elements, and removes source spans."""
    if isinstance(value, dict):
        return {key: _keyed(item) for key, item in value.items() if key != "span"}
    if not isinstance(value, list) or not value:
        return value
    names = element_names(value)
    if names is None:
        return value
    elements = [item[1] if isinstance(item, list) else item for item in value]
    by_name = {name: _keyed(item) for name, item in zip(names, elements, strict=True)}
    return {**by_name, ORDER: names}


def element_names(items: list[Any]) -> list[str] | None:
    """Returns a unique name for each element of a list.

    Returns ``None`` for a list of plain values, which is compared as a whole.
    """
    if all(isinstance(i, list) and len(i) == 2 and isinstance(i[0], str) for i in items):
        names = [item[0] for item in items]
    elif all(isinstance(item, dict) for item in items):
        names = [_name_of(item, number) for number, item in enumerate(items)]
        if len(set(names)) < len(names):
            names = [str(number) for number in range(len(items))]
    else:
        return None
    return names if len(set(names)) == len(names) and ORDER not in names else None


def _name_of(item: dict[str, Any], number: int) -> str:
    if "subindex" in item:
        return f"0x{item['index']:04X}:{item['subindex']}"
    for key in ("name", "joint"):
        if isinstance(item.get(key), str):
            return str(item[key])
    return str(number)


def _differ_by_rounding(before: Any, after: Any) -> bool:
    if isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        size = max((abs(v) for v in (*before, *after) if isinstance(v, float)), default=0.0)
        return all(
            a == b
            or (isinstance(a, float) and isinstance(b, float) and abs(a - b) <= 1e-9 * size + 1e-12)
            for a, b in zip(before, after, strict=True)
        )
    if isinstance(before, float) and isinstance(after, float):
        return abs(before - after) <= 1e-9 * max(abs(before), abs(after)) + 1e-12
    return False
