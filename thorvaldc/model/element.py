"""What all parts of the model have in common: equality, hash and text."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Hashable
from typing import Any, cast


@functools.cache
def _compared(cls: Hashable) -> tuple[str, ...]:
    return tuple(f.name for f in dataclasses.fields(cast(Any, cls)) if f.compare)


class Element:
    """Base of the model's frozen dataclasses, equal where all their compared fields are.

    The methods are here, once, and not generated for each of thirty classes:
    making those takes longer than to compile a robot.
    """

    __slots__ = ()

    def _key(self) -> tuple[Any, ...]:
        return tuple(getattr(self, name) for name in _compared(cast(Hashable, type(self))))

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other):
            return NotImplemented
        return self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def __repr__(self) -> str:
        shown = ", ".join(
            f"{name}={getattr(self, name)!r}" for name in _compared(cast(Hashable, type(self)))
        )
        return f"{type(self).__name__}({shown})"
