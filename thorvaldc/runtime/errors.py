"""Errors of the runtime that concern single values."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    pass


class NotFiniteError(ValueError):
    """A twist or a joint state holds a NaN or an infinity; nothing was changed."""


class ParameterError(ValueError):
    """A parameter cannot have that value; nothing was changed."""
