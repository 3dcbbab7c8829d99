"""Exceptions of the runtime for invalid values."""

from __future__ import annotations


class NotFiniteError(ValueError):
    """A twist or a joint state contains a NaN or an infinity.

    The function that raises ``NotFiniteError`` changes nothing.
    """


class ParameterError(ValueError):
    """The name or the value of a driver parameter is invalid.

    The function that raises ``ParameterError`` changes nothing.
    """


class RequestRefused(ValueError):
    """A service of the robot refused a request and changed nothing.

    The message of the exception contains the reason for the refusal.
    """
