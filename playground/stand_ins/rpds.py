"""A stand-in for the package ``rpds-py``, which has no wheel for browsers.

It has what the package ``referencing`` uses.
"""

from __future__ import annotations

from typing import Any


class HashTrieMap(dict):  # type: ignore[type-arg]
    """A mapping that is never changed: its methods return changed copies."""

    @classmethod
    def convert(cls, value: Any) -> HashTrieMap:
        return value if isinstance(value, cls) else cls(value)

    def insert(self, key: Any, value: Any) -> HashTrieMap:
        return HashTrieMap({**self, key: value})

    def remove(self, key: Any) -> HashTrieMap:
        rest = dict(self)
        del rest[key]
        return HashTrieMap(rest)

    def update(self, *others: Any, **values: Any) -> HashTrieMap:  # type: ignore[override]
        new = dict(self)
        for other in others:
            new.update(other)
        return HashTrieMap({**new, **values})


class HashTrieSet(frozenset):  # type: ignore[type-arg]
    """A set whose methods return changed copies."""

    def insert(self, value: Any) -> HashTrieSet:
        return HashTrieSet(self | {value})

    def remove(self, value: Any) -> HashTrieSet:
        return HashTrieSet(self - {value})

    def update(self, *others: Any) -> HashTrieSet:
        return HashTrieSet(self.union(*others))


class List(tuple):  # type: ignore[type-arg]
    """A list whose first element is the newest."""

    def __new__(cls, *values: Any) -> List:
        items = values[0] if len(values) == 1 and not isinstance(values[0], str) else values
        return super().__new__(cls, items)

    def push_front(self, value: Any) -> List:
        return List((value, *self))

    @property
    def first(self) -> Any:
        return self[0]

    @property
    def rest(self) -> List:
        return List(self[1:])
