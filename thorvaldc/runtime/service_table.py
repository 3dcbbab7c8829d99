"""Table of services that can be called by name with JSON arguments."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from thorvaldc.diagnostics import DiagnosticError, did_you_mean
from thorvaldc.runtime.permission import THIS_PROGRAM

_KINDS: dict[str, tuple[tuple[type, ...], str]] = {
    "number": ((int, float), "a number"),
    "integer": ((int,), "a whole number"),
    "flag": ((bool,), "true or false"),
    "text": ((str,), "text"),
    "mapping": ((dict,), "a mapping"),
}
_KIND_OF = {
    "float": "number",
    "int": "integer",
    "bool": "flag",
    "str": "text",
    "dict[str, float]": "mapping",
}
"""Kind of an argument by the annotation of its parameter."""


class ServiceError(ValueError):
    """Error: a service call was refused.

    The message of the exception is the reason in one line.
    """


@dataclass(frozen=True, slots=True)
class Caller:
    """The program that calls a service.

    - ``name``: name of the program, different for each connection;
    - ``age``: time (s) since the program has sent the request, as far as it is known;
    - ``void``: reason why the request does not count, or an empty text.  A request does not count
      if it may have waited during a gap in time, or if its program has ended.
    """

    name: str
    age: float = 0.0
    void: str = ""


LOCAL = Caller(THIS_PROGRAM)
"""Caller of services in the process of the base driver."""


@dataclass(frozen=True, slots=True)
class Argument:
    """Definition of one argument of a service: name, type and default value.

    ``kind``: type of the argument, which is ``number``, ``integer``, ``flag``, ``text`` or
    ``mapping``.  An argument of the type ``mapping`` is a dictionary of numbers by name.
    """

    name: str
    kind: str
    default: Any = inspect.Parameter.empty

    @property
    def required(self) -> bool:
        return self.default is inspect.Parameter.empty

    def check(self, value: Any) -> Any:
        """Checks the type of a service argument and returns the value.

        Raises ``ServiceError`` if the argument value has a wrong type or is not finite.
        """
        types, description = _KINDS[self.kind]
        # Boolean values are excluded from the numbers, because in Python `bool` is a subclass of
        # `int`.
        matches = isinstance(value, types) and (self.kind == "flag" or not isinstance(value, bool))
        if value is None and not self.required and self.default is None:
            return None
        if not matches:
            raise ServiceError(f"`{self.name}` is {_shorten(value)}; it must be {description}")
        if self.kind == "number":
            return _finite(self.name, value)
        if self.kind == "mapping":
            number = Argument(self.name, "number")
            return {str(key): number.check(entry) for key, entry in value.items()}
        return value


@dataclass(frozen=True, slots=True)
class Service:
    """Service: a function of the base driver that other programs can call by name.

    The function ``call`` takes the service arguments by name, and returns JSON values.  The names,
    types and defaults of its parameters are those of the arguments; a parameter ``now`` takes the
    time (s), and a parameter ``caller`` the ``Caller``.  It raises ``ServiceError``, ``ValueError``
    or ``DiagnosticError`` to refuse a service request.

    - ``more``: arguments that ``call`` takes as ``**arguments``;
    - ``valid_late``: ``True`` for a service that only reads or stops, so that its requests count
      also if they have waited or if their program has ended.
    """

    name: str
    summary: str
    call: Callable[..., Any]
    more: tuple[Argument, ...] = ()
    valid_late: bool = False
    parameters: Mapping[str, inspect.Parameter] = field(init=False)
    arguments: tuple[Argument, ...] = field(init=False)

    def __post_init__(self) -> None:
        parameters = inspect.signature(self.call).parameters
        arguments = (
            Argument(p.name, _KIND_OF[p.annotation.removesuffix(" | None")], p.default)
            for p in parameters.values()
            if p.name not in ("now", "caller") and p.kind is not p.VAR_KEYWORD
        )
        object.__setattr__(self, "parameters", parameters)
        object.__setattr__(self, "arguments", (*arguments, *self.more))


class Services:
    """Table of the services of a base driver by name.

    If two services have the same name, the last of the two services is used.
    """

    def __init__(self, services: Iterable[Service]) -> None:
        self._services = {service.name: service for service in services}
        listing = Service("services", "List the services.", self._list, valid_late=True)
        self._services[listing.name] = listing

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self._services)

    def call(
        self, name: str, arguments: Mapping[str, Any], now: float, caller: Caller = LOCAL
    ) -> Any:
        """Checks the arguments, calls a service and returns the result.

        A hyphen in the service name is read as an underscore.  Raises ``ServiceError`` if the
        service call is refused.
        """
        service = self._services.get(name.replace("-", "_"))
        if service is None:
            hint = did_you_mean(name, self.names, f"there are {', '.join(self.names)}")
            raise ServiceError(f"there is no service `{name}`; {hint}")
        known = {argument.name: argument for argument in service.arguments}
        for key in arguments:
            if key not in known:
                listed = ", ".join(known) or "none"
                raise ServiceError(f"`{service.name}` has no argument `{key}`; it has {listed}")
        checked = {}
        for argument in service.arguments:
            if argument.name in arguments:
                checked[argument.name] = argument.check(arguments[argument.name])
            elif argument.required:
                raise ServiceError(f"`{service.name}` needs the argument `{argument.name}`")
            else:
                checked[argument.name] = argument.default
        if caller.void and not service.valid_late:
            raise ServiceError(caller.void)
        context: dict[str, Any] = {"now": now, "caller": caller}
        context = {name: value for name, value in context.items() if name in service.parameters}
        try:
            return service.call(**context, **checked)
        except DiagnosticError as error:
            raise ServiceError(error.one_line) from None
        except ValueError as error:
            raise ServiceError(" ".join(str(error).split())) from None

    def _list(self) -> list[dict[str, Any]]:
        return [
            {
                "name": service.name,
                "summary": service.summary,
                "arguments": [
                    {"name": a.name, "kind": a.kind, "required": a.required}
                    for a in service.arguments
                ],
            }
            for service in self._services.values()
        ]


def _finite(name: str, value: float) -> float:
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ServiceError(f"`{name}` is {number}; it must be finite")
    return number


def _shorten(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
