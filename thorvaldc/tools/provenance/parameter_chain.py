"""The way of a parameter: from the robot file through defaults, assemblies and expressions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from thorvaldc.compiler.modules.module_parameters import ModuleChoice, Scope
from thorvaldc.compiler.modules.module_tree import Instance
from thorvaldc.compiler.source.expression_parser import ExpressionError, tokenize
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.compiler.values.value_reader import INVALID
from thorvaldc.diagnostics import Span
from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.diagnostics.suggest import nearest
from thorvaldc.tools.provenance.robot_probe import RobotProbe
from thorvaldc.tools.provenance.source_values import SourceValue, key_path

MOST_STEPS = 40


@dataclass(frozen=True)
class Step:
    """A node of a document on the way to a value.

    Attributes
    ----------
    span : span of the node.
    key_path : position of the node in its document, such as ``modules.frame.params.width``.
    text : the node as it is written.
    value, unit : the value of the node in SI units.
    source : the number or expression of the node, or ``None`` for a text or a module.
    """

    span: Span
    key_path: str
    text: str
    value: Any
    unit: str
    source: SourceValue | None


def find_instance(probe: RobotProbe, text: str) -> tuple[Instance, str]:
    """Returns the module and the name of the parameter of ``modules.MODULE.params.NAME``.

    ``params`` may be left out, and the module may be inside assemblies.  Raises
    ``DiagnosticError`` (``why-path-unknown``) if there is no such module or parameter.
    """
    parts = [part for part in text.split(".")[1:] if part not in ("params", "modules")]
    instance = probe.instances
    while len(parts) > 1 and parts[0] in instance.children:
        instance = instance.children[parts.pop(0)]
    if len(parts) == 1 and parts[0] in instance.children:
        instance = instance.children[parts.pop(0)]
    names = list(instance.type.section("params")) if instance.type is not None else []
    if len(parts) == 1 and parts[0] in names:
        return instance, parts[0]
    known = names if len(parts) == 1 and instance.type is not None else list(instance.children)
    place = f"`{instance.path}`" if instance.path else "the robot"
    word = parts[0] if parts else ""
    kind = "parameter" if known is names else "module"
    message = f"{place} has no {kind} `{word}`" if word else f"`{text}` names no parameter"
    similar = nearest(word, known) if word else None
    shown = ", ".join(names or known)
    raise DiagnosticError(
        "why-path-unknown",
        message,
        hint=f"did you mean `{similar}`?" if similar is not None else f"known: {shown}",
    )


def chain_of_parameter(probe: RobotProbe, instance: Instance, name: str) -> Iterator[Step]:
    """Yields the nodes that give a parameter its value: the sources first, the parameter last."""
    yield from _chain(_Places(probe), instance.scope, name, set())


def chain_of_type(probe: RobotProbe, path: str) -> Iterator[Step]:
    """Yields the nodes that choose the type of a module and of the assemblies around it."""
    places = _Places(probe)
    instance = probe.instances
    for name in path.split("."):
        child = instance.children.get(name)
        node = child.entry.get("type") if child is not None else None
        if child is None or node is None:
            return
        value = child.type.name if child.type is not None else ""
        for scope_name in _names(node, instance.scope):
            yield from _chain(places, instance.scope, scope_name, set())
        yield places.step(node, value, "")
        instance = child


def _chain(places: _Places, scope: Scope, name: str, seen: set[Span]) -> Iterator[Step]:
    origin = scope.origin(name)
    if origin is None or len(seen) >= MOST_STEPS:
        return
    node, written_in = origin
    if node.span in seen:
        return
    seen.add(node.span)
    for used in _names(node, written_in):
        yield from _chain(places, written_in, used, seen)
    value = scope.get(name)
    yield places.step(node, _shown(value), _unit(scope, name))


def _names(node: Node, scope: Scope) -> list[str]:
    """Returns the parameters and `let` values in the expression of a node."""
    text = node.value
    if not (isinstance(text, str) and text.startswith("${") and text.endswith("}")):
        return []
    try:
        tokens = tokenize(text[2:-1])
    except ExpressionError:
        return []
    words = [token.text for token in tokens if token.kind == "name"]
    return list(dict.fromkeys(word for word in words if scope.origin(word) is not None))


class _Places:
    """The position of each node in its document."""

    def __init__(self, probe: RobotProbe) -> None:
        self._sources = {value.span: value for value in probe.values()}
        self._keys: dict[Span, str] = {}
        for document in probe.documents.values():
            self._add(document, ())

    def _add(self, node: Node, keys: tuple[str | int, ...]) -> None:
        self._keys[node.span] = key_path(keys)
        if isinstance(node.value, dict):
            for key, item in node.value.items():
                self._add(item, (*keys, key))
        elif isinstance(node.value, tuple):
            for index, item in enumerate(node.value):
                self._add(item, (*keys, index))

    def step(self, node: Node, value: Any, unit: str) -> Step:
        text = node.value
        if isinstance(text, dict):
            text = str(node.plain())
        elif isinstance(text, tuple):
            text = ", ".join(str(item.value) for item in text)
        return Step(
            node.span,
            self._keys.get(node.span, ""),
            str(text),
            value,
            unit,
            self._sources.get(node.span),
        )


def _shown(value: Any) -> Any:
    if isinstance(value, ModuleChoice):
        return value.module.name
    if isinstance(value, tuple):
        return [_shown(item) for item in value]
    return None if value is INVALID else value


def _unit(scope: Scope, name: str) -> str:
    declaration = scope.module.section("params").get(name) if scope.module is not None else None
    quantity = declaration.get("quantity") if declaration is not None else None
    unit = QUANTITIES[str(quantity.value)].unit if quantity is not None else ""
    return "" if unit == "1" else unit
