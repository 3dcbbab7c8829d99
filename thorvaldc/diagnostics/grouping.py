"""Groups warnings and notes that differ only in a name or a number."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace

from thorvaldc.diagnostics.report import Diagnostic, Label, Severity

_NAME = re.compile(r"`([^`]*)`")
_NUMBER = re.compile(r"\d[\d.]*(e[+-]?\d+)?")
_SHOWN_PLACES, _SHOWN_NAMES = 3, 3


def grouped(diagnostics: Iterable[Diagnostic]) -> list[Diagnostic]:
    """Returns the diagnostics, with one diagnostic for similar warnings and notes.

    A file of others can give the same warning for each joint of an arm.  Diagnostics are similar if
    they have the same code and hint, and messages that differ only in names and numbers.  The first
    one stands for them: its message has their count and further names, and its labels show the
    first places.  Errors are not grouped, because each one must be corrected.
    """
    groups: dict[tuple[object, ...], list[Diagnostic]] = {}
    for number, diagnostic in enumerate(diagnostics):
        pattern = _NUMBER.sub("0", _NAME.sub("`", diagnostic.message))
        key: tuple[object, ...] = (diagnostic.code, pattern, diagnostic.hint)
        if diagnostic.severity is Severity.ERROR:
            key = (number,)
        groups.setdefault(key, []).append(diagnostic)
    return [_merged(group) if len(group) > 1 else group[0] for group in groups.values()]


def _merged(group: list[Diagnostic]) -> Diagnostic:
    first = group[0]
    message = f"{first.message} ({len(group)} places"
    first_names = _NAME.findall(first.message)
    others = {name: None for d in group for name in _NAME.findall(d.message)}
    names = [f"`{name}`" for name in others if name not in first_names]
    if names:
        more = ", ..." if len(names) > _SHOWN_NAMES else ""
        message += f"; also {', '.join(names[:_SHOWN_NAMES])}{more}"
    labels = list(first.labels)
    for diagnostic in group[1:]:
        # A macro gives the same span for each call; its calls differ.
        places = [diagnostic.span, *(label.span for label in diagnostic.labels)]
        seen = [first.span, *(label.span for label in labels)]
        place = next((p for p in places if p is not None and p not in seen), None)
        if place is not None and len(labels) < len(first.labels) + _SHOWN_PLACES - 1:
            labels.append(Label(place, "and here"))
    return replace(first, message=f"{message})", labels=tuple(labels))
