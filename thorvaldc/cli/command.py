"""What every command shares: the border for faults, and parsing without pydantic."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, ParamSpec

import typer
from typer.core import TyperCommand, TyperGroup

from thorvaldc.cli.exits import protect

P = ParamSpec("P")


class _PlainText:
    """Takes text, or a list of texts, as it stands on the command line."""

    def coerce(self, value: Any, param: Any, ctx: Any) -> Any:
        if value is None or isinstance(value, str | bool):
            return value
        return list(value)


def _lightened(parameters: list[Any]) -> list[Any]:
    for parameter in parameters:
        parameter._runtime_param = _PlainText()
    return parameters


class LightCommand(TyperCommand):
    """A command whose parameters are text, lists of text and flags.

    Typer converts by pydantic, whose import takes longer than to compile a robot;
    text needs no conversion.  A typer that works otherwise does not look at
    the attribute set here.
    """

    def get_params(self, ctx: Any) -> list[Any]:
        return _lightened(super().get_params(ctx))


class LightGroup(TyperGroup):
    """A group of commands, for the same reason."""

    def get_params(self, ctx: Any) -> list[Any]:
        return _lightened(super().get_params(ctx))


def guarded(function: Callable[P, int]) -> Callable[P, None]:
    """The function's result, or its way to fail, as the exit status."""

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> None:
        raise typer.Exit(protect(lambda: function(*args, **kwargs)))

    return call
