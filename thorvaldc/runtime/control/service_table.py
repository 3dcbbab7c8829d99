"""What can be asked of a running driver, by name, with checked arguments and plain answers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.diagnostics.suggest import did_you_mean

_KINDS: dict[str, tuple[tuple[type, ...], str]] = {
    "number": ((int, float), "a number"),
    "integer": ((int,), "a whole number"),
    "flag": ((bool,), "true or false"),
    "text": ((str,), "text"),
    "mapping": ((dict,), "a mapping"),
}
_REQUIRED = object()


class ServiceError(ValueError):
    """A call cannot be done; the message is one line."""


@dataclass(frozen=True, slots=True)
class Argument:
    """``kind``: ``number``, ``integer``, ``flag``, ``text`` or ``mapping`` (names to numbers)."""

    name: str
    kind: str
    default: Any = _REQUIRED

    @property
    def required(self) -> bool:
        return self.default is _REQUIRED

    def check(self, value: Any) -> Any:
        """The value as the service takes it.  Raises ``ServiceError``."""
        types, wanted = _KINDS[self.kind]
        fits = isinstance(value, types) and (self.kind == "flag" or not isinstance(value, bool))
        if value is None and not self.required and self.default is None:
            return None
        if not fits:
            raise ServiceError(f"`{self.name}` is {_shown(value)}; {wanted} is wanted")
        if self.kind == "number":
            return _finite(self.name, value)
        if self.kind == "mapping":
            number = Argument(self.name, "number")
            return {str(key): number.check(entry) for key, entry in value.items()}
        return value


@dataclass(frozen=True, slots=True)
class Service:
    """``call`` takes the time (s) and the arguments by name; its result is plain JSON values.

    It raises ``ServiceError``, ``ValueError`` or ``DiagnosticError`` where it cannot be done.
    """

    name: str
    summary: str
    call: Callable[..., Any]
    arguments: tuple[Argument, ...] = ()


class Services:
    """Services by name, in the order in which they were given; the last of a name counts."""

    def __init__(self, services: Iterable[Service]) -> None:
        self._services = {service.name: service for service in services}
        self._services["services"] = Service("services", "List the services.", self._list)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self._services)

    def call(self, name: str, given: Mapping[str, Any], now: float) -> Any:
        """Call one; ``-`` in its name is as ``_``.  Raises ``ServiceError``."""
        service = self._services.get(name.replace("-", "_"))
        if service is None:
            hint = did_you_mean(name, self.names, f"there are {', '.join(self.names)}")
            raise ServiceError(f"there is no service `{name}`; {hint}")
        known = {argument.name: argument for argument in service.arguments}
        for key in given:
            if key not in known:
                listed = ", ".join(known) or "none"
                raise ServiceError(f"`{service.name}` has no argument `{key}`; it has {listed}")
        taken = {}
        for argument in service.arguments:
            if argument.name in given:
                taken[argument.name] = argument.check(given[argument.name])
            elif argument.required:
                raise ServiceError(f"`{service.name}` needs the argument `{argument.name}`")
            else:
                taken[argument.name] = argument.default
        try:
            return service.call(now, **taken)
        except DiagnosticError as fault:
            raise ServiceError(_one_line(fault)) from None
        except ValueError as fault:
            raise ServiceError(" ".join(str(fault).split())) from None

    def _list(self, now: float) -> list[dict[str, Any]]:
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


def _one_line(fault: DiagnosticError) -> str:
    found = fault.diagnostic
    return f"{found.message}; {found.hint}" if found.hint else found.message


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
