"""Finds the keys of the robot file from which a value of a module document follows."""

from __future__ import annotations

import re
from typing import NamedTuple

from thorvaldc.compiler.modules.module_parameters import Scope
from thorvaldc.compiler.source.expressions import expression_of
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.value_reader import entries
from thorvaldc.diagnostics import Label, Span

_NAMES = re.compile(r"\b([A-Za-z_]\w*)(?:\.(\w+))?")


class _Use(NamedTuple):
    """A value that is used, with the scope of its expression.

    - ``name``: parameter with the value; empty for the value that is explained.
    - ``attribute``: for a module, the parameter of the module that is used.
    """

    node: Node
    scope: Scope
    name: str = ""
    attribute: str = ""


def written_keys(scope: Scope, span: Span) -> list[Label]:
    """Returns labels at the values in the robot file from which the value at ``span`` follows.

    ``span``: value in the document of the module or in one of its arguments.
    """
    documents = [(scope.module.document, scope)] if scope.module is not None else []
    uses = [
        _Use(part, names)
        for document, names in (*documents, *scope.arguments.values())
        for _, node in document.walk()
        if node.span == span and not isinstance(node.value, dict)
        for _, part in node.walk()
    ]
    labels: dict[Label, None] = {}
    visited = set()
    for use in uses:  # The list grows: a long chain of names is no deep chain of calls.
        node, names, name, attribute = use
        if (id(node), id(names), attribute) in visited:
            continue
        visited.add((id(node), id(names), attribute))
        if (text := expression_of(node)) is not None:
            uses += _uses_in(text, names, attribute)
        elif argument := entries(node.get("params")).get(attribute):
            uses.append(_Use(argument, names, attribute))
        elif name and names.module is None and not node.span.file.startswith("<"):
            labels[Label((node.get("type") or node).span, f"`{name}` is set here")] = None
    return list(labels)


def _uses_in(text: str, scope: Scope, attribute: str) -> list[_Use]:
    words = _NAMES.findall(text)
    modules = {word for word, parameter in words if parameter}  # `a` of `a.radius if a else 0`
    return [
        _Use(*origin, word, parameter or attribute)
        for word, parameter in words
        if (parameter or word not in modules) and (origin := scope.origin(word)) is not None
    ]
