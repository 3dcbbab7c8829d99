"""Explains a value of a robot, a line of an output or a line of a document."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Any

from thorvaldc import backends
from thorvaldc.comparison.robot_difference import field_unit
from thorvaldc.compiler.modules.module_parameters import ModuleChoice, Scope
from thorvaldc.compiler.modules.module_tree import Instance
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.diagnostics import Span, did_you_mean
from thorvaldc.model.facts.robot_facts import fact_sections, json_value
from thorvaldc.tools.provenance.trace import Line, Place, Trace
from thorvaldc.tools.provenance.traced_number import origins_of, plain
from thorvaldc.tools.provenance.value_names import Value, find_value, unknown, values_of

FACTS = ("size", "stability", "driving", "slopes", "energy")
"""Parts of the facts about a robot, which are computed from its model."""
_FILE = re.compile(r"(.*/.*|.*\.(?:yaml|yml|xml|urdf|sdf|json|dcf|dbc|md|h|sh|html)):(.*)")
_WORD = re.compile(r"\w+")


Explanation = dict[str, Any]
"""Where a value or a line comes from, and where it goes, as a JSON document.

- ``name``: full name of the value, or file and line.
- ``value``, ``unit``: the value in SI units, the text of a line of an output, or ``None``.
- ``elements``: places of the elements of the robot that have the value or are in the line.
- ``comes_from``, ``through``: numbers and expressions of the documents that it follows from.
- ``module_types``: places that choose the module type, from the robot file to the module.
- ``goes_into_the_model``: names of values of the model that follow from a line of a document.
- ``goes_into``: lines of outputs that follow from it, by file and number.
"""


class Explainer:
    """Explains values and lines of one robot file, which has no errors."""

    def __init__(self, trace: Trace) -> None:
        self.trace = trace

    def explain(self, text: str) -> Explanation:
        """Returns the explanation of a value, or of a line of an output or a document.

        Raises ``DiagnosticError`` (``why-path-unknown``) if there is no such value or line.
        """
        match = _FILE.fullmatch(text)
        if match is None:
            return self._value(text)
        for name, path in self.trace.compilation.files.items():
            is_file = match[1] == name or os.path.abspath(match[1]) == os.path.abspath(path)
            if is_file:
                return self._document_line(name, match[2])
        return self._output_line(os.path.normpath(match[1]).replace(os.sep, "/"), match[2])

    def _value(self, text: str) -> Explanation:
        known = dict(known_values(self.trace, text.partition(".")[0]))
        name = find_value(known, text)
        value, span, module, unit = known[name]
        origins = origins_of(value)
        value = list(value) if isinstance(value, tuple) else value
        return {
            "name": name,
            "value": value.module.name if isinstance(value, ModuleChoice) else plain(value),
            "unit": unit or field_unit(tuple(name.split("."))),
            **self._origins({module or self.trace.robot.name: span}, self.trace.places_of(origins)),
            "module_types": list(self._types(module)) if module else [],
            "goes_into": self._uses(lambda line: origins and line.origins & origins == origins),
        }

    def _document_line(self, file: str, line: str) -> Explanation:
        def is_here(span: Span) -> bool:
            return (span.file, str(span.line)) == (file, line)

        origins = sum(1 << bit for span, bit in self.trace.spans.items() if is_here(span))
        elements = {name: span for name, span in self._elements.items() if is_here(span)}
        places = [place for span, place in self.trace.places.items() if is_here(span)]
        if not places and not elements:
            raise unknown(f"line `{line}` of {file} has no value")
        values = values_of(self.trace.robot)
        uses = self._uses(
            lambda line: line.origins & origins or elements.keys() & _WORD.findall(line.text)
        )
        names = [name for name, (value, *_) in values if origins_of(value) & origins]
        origin = self._origins(elements, places)
        return {"name": f"{file}:{line}", "goes_into_the_model": names, "goes_into": uses} | origin

    def _output_line(self, file: str, line: str) -> Explanation:
        """Explains a line of the file of a build that ``file`` names."""
        outputs = dict(self._outputs)
        for target in set(file.split("/")).intersection(backends.names()):
            outputs |= self.trace.lines(target)
        name = next((n for n in outputs if f"/{file}".endswith(f"/{n}")), "")
        if not name:
            hint = did_you_mean(file, outputs, fixable=False)
            raise unknown(f"no build of the robot has a text file `{file}`", hint)
        if not line.isdigit() or not 1 <= int(line) <= len(outputs[name]):
            raise unknown(f"{name} has the lines 1 to {len(outputs[name])}, and no `{line}`")
        text, origins = outputs[name][int(line) - 1]
        elements = {w: self._elements[w] for w in _WORD.findall(text) if w in self._elements}
        origin = self._origins(elements, self.trace.places_of(origins))
        return {"name": f"{name}:{line}", "value": text.strip()} | origin

    def _origins(self, elements: dict[str, Any], places: list[Place]) -> Explanation:
        return {
            "elements": {n: self.trace.shown(span) for n, span in elements.items() if span},
            "comes_from": [place._asdict() for place in places if not place.is_expression],
            "through": [place._asdict() for place in places if place.is_expression],
        }

    @cached_property
    def _outputs(self) -> dict[str, list[Line]]:
        targets = map(self.trace.lines, backends.DEFAULT_TARGETS)
        return {name: lines for files in targets for name, lines in files.items()}

    @cached_property
    def _elements(self) -> dict[str, Span]:
        """The spans of the elements of the robot by their names; a short name is also a word."""
        values = values_of(self.trace.robot)
        return {
            v.value: v.span for n, v in values if n.endswith(".name") and v.span and "_" in v.value
        }

    def _uses(self, is_use: Callable[[Line], object]) -> dict[str, dict[int, str]]:
        uses = {
            name: {n: line.text.strip() for n, line in enumerate(lines, 1) if is_use(line)}
            for name, lines in self._outputs.items()
        }
        return {name: lines for name, lines in uses.items() if lines}

    def _types(self, path: str) -> Iterator[Explanation]:
        """Yields the places that choose the type of a module and of the assemblies around it."""
        instance = self.trace.root
        for name in path.split("."):
            child = instance.children.get(name)
            if child is None:
                return  # such as the file of an extra
            for node in _way(child.entry.get("type"), instance.scope):
                if node.span in self.trace.places:
                    yield self.trace.places[node.span]._asdict()
            instance = child


def _way(node: Node | None, scope: Scope) -> Iterator[Node]:
    """Yields the nodes that a node with an expression follows from, and the node itself."""
    text = str(node.value) if node is not None else ""
    for word in dict.fromkeys(_WORD.findall(text)) if text.startswith("${") else ():
        origin = scope.origin(word)
        if origin is not None and origin[0] is not node:
            yield from _way(*origin)
    if node is not None:
        yield node


def known_values(trace: Trace, first: str = "") -> Iterator[tuple[str, Value]]:
    """Yields the values of a robot by name: of the model, the facts and the parameters of modules.

    ``first``: first part of the name; without it, all values are computed.
    """
    if first not in ("modules", *FACTS):
        yield from values_of(trace.robot)
    for name in FACTS if not first else {first}.intersection(FACTS):
        with trace.following():
            facts = json_value(fact_sections(trace.robot, [name])[name])
        yield from values_of({name: facts})
    if first in ("modules", ""):
        yield from _parameters(trace.root)


def _parameters(instance: Instance) -> Iterator[tuple[str, Value]]:
    params = instance.type.section("params") if instance.type is not None else {}
    for name, declaration in params.items():
        origin, quantity = instance.scope.origin(name), declaration.get("quantity")
        unit = QUANTITIES[str(quantity.value)].unit if quantity is not None else ""
        span = origin[0].span if origin is not None else None
        value = Value(instance.scope.get(name), span, instance.path, "" if unit == "1" else unit)
        yield f"modules.{instance.path}.params.{name}", value
    for child in instance.children.values():
        yield from _parameters(child)
