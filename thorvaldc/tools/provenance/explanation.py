"""Explains a value of a robot, of a module or of an output: its sources, its way, and its uses."""

from __future__ import annotations

import difflib
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from thorvaldc import backends
from thorvaldc.comparison import robot_difference as difference
from thorvaldc.comparison.robot_comparison import is_derived
from thorvaldc.compiler.modules.module_parameters import ModuleChoice, Scope
from thorvaldc.compiler.modules.module_tree import Instance
from thorvaldc.compiler.pipeline import emit
from thorvaldc.compiler.source.expression_parser import ExpressionError, tokenize
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.compiler.values.value_reader import INVALID
from thorvaldc.diagnostics import DiagnosticError, Span, did_you_mean
from thorvaldc.model import Robot
from thorvaldc.model.facts import driving, electrics, size, stability
from thorvaldc.model.facts.robot_facts import facts_document
from thorvaldc.tools.provenance import influence_search, value_paths

MOST_COMPILATIONS = 600
MOST_EMISSIONS = 100
"""Most emissions of a target that search the values of the model behind an output value."""
MOST_EFFECTS = 20
MODEL_FILE = "model.json"
FACTS: dict[str, Callable[[Robot], Any]] = {
    "size": size.size_of,
    "stability": stability.stability_of,
    "driving": driving.driving_of,
    "slopes": driving.slopes_of,
    "energy": electrics.energy_of,
}
"""Parts of the facts about a robot, which are computed from its model."""
NAMES_OF_OUTPUT = 3
"""Number of names of an output value that are shown; MJCF nests dozens of bodies."""


@dataclass(frozen=True)
class OutputUse:
    """A file of a build that contains a number which follows from the value.

    - ``lines``: numbers and texts of the lines that differ if the value is another one.
    """

    file: str
    lines: tuple[tuple[int, str], ...]


@dataclass
class Explanation:
    """Where a value comes from, and where it goes.

    Attributes
    ----------
    path : full name of the value.
    value, unit : the value in SI units.
    element : span of the element of the robot that has the value, in the robot file.
    influences : values of the documents that influence the value.
    chain : nodes from the robot file to the value, for a parameter of a module.
    types : nodes that choose the module type, from the robot file to the module.
    model_values : values of the model that an output value depends on, or that a parameter of a
        module influences.
    uses : files of a build in which a number depends on the value.
    source_uses : files of a build in which a number depends on the first source of the value, and
        none on the value itself.
    is_varied : whether the value is a number, which can be changed a little.
    is_complete : false if the search for influences ended at its limit.
    """

    path: str
    value: Any
    unit: str = ""
    element: Span | None = None
    influences: list[influence_search.Influence] = field(default_factory=list)
    chain: list[Step] = field(default_factory=list)
    types: list[Step] = field(default_factory=list)
    model_values: list[str] = field(default_factory=list)
    uses: list[OutputUse] = field(default_factory=list)
    source_uses: list[OutputUse] = field(default_factory=list)
    is_varied: bool = True
    is_complete: bool = True


class Explainer:
    """Explains values of one robot file, which has no errors.

    Parameters
    ----------
    path : path of the robot file.
    robot : the robot of the file.
    library : additional folders with modules.
    trust : whether xacro files are expanded without restrictions.
    stack : temporary files are removed when the stack is closed.
    """

    def __init__(
        self, path: Path, robot: Robot, library: Sequence[Path], trust: bool, stack: ExitStack
    ) -> None:
        self.robot = robot
        self.probe = influence_search.RobotProbe(path, library, trust, stack)
        self.document = difference.model_document(robot)

    def explain(self, text: str) -> Explanation:
        """Returns the explanation of a value: of the model, of a module or of an output.

        Raises ``DiagnosticError`` (``why-path-unknown``) if there is no such value.
        """
        file, colon, query = text.rpartition(":")
        # The name of an object of a node contains a colon.
        if colon and file and not value_paths.is_model_path(self.document, text):
            return self._explain_output(file, query)
        if text.split(".")[0] == "modules":
            return self._explain_parameter(text)
        if text.split(".")[0] in FACTS:
            return self._explain_fact(text)
        return self._explain_model_value(text)

    # -- values of the model ----------------------------------------------------------------

    def _explain_model_value(self, text: str) -> Explanation:
        path = value_paths.resolve_path(self.document, text)
        value = value_paths.value_at(self.document, path)
        explanation = Explanation(".".join(path), value, difference.field_unit(path))
        explanation.element = _span_of(self.robot, path)
        explanation.types = self._types(_module_at(self.document, path))
        new = value_paths.changed_value(value, influence_search.SMALL_CHANGE)
        explanation.is_varied = new is not None
        if new is None:
            return explanation
        self._search(explanation, lambda robot: value_paths.observed_value(robot, path))
        explanation.uses = list(
            self._uses(lambda: value_paths.with_values(self.robot, {path: new}))
        )
        constants = [i.source for i in explanation.influences if not i.source.is_expression]
        changed = self._changed(constants[:1])
        if changed is not None and len(constants) == 1:
            names = [use.file for use in explanation.uses]
            uses = self._uses(lambda: changed)
            explanation.source_uses = [use for use in uses if use.file not in names]
        return explanation

    def _explain_fact(self, text: str) -> Explanation:
        """Explains a value that `thorvaldc info` shows, such as ``stability.angles.left``."""
        part = text.partition(".")[0]

        def document(robot: Robot) -> dict[str, Any]:
            facts = FACTS[part](robot)
            return {part: facts_document(facts) if facts is not None else {}}

        path = value_paths.resolve_path(document(self.robot), text)
        value = value_paths.value_at(document(self.robot), path)
        explanation = Explanation(".".join(path), value, difference.field_unit(path))
        explanation.is_varied = (
            value_paths.changed_value(explanation.value, influence_search.SMALL_CHANGE) is not None
        )
        if explanation.is_varied:
            self._search(explanation, lambda robot: value_paths.value_at(document(robot), path))
        return explanation

    def _search(self, explanation: Explanation, observe: Callable[[Robot], Any]) -> None:
        search = influence_search.InfluenceSearch(self.probe, observe, MOST_COMPILATIONS)
        explanation.influences = search.run(self.probe.values())
        explanation.is_complete = not search.is_over

    def _types(self, module: str) -> list[Step]:
        return list(chain_of_type(self.probe, module)) if module else []

    def _uses(self, changed_robot: Callable[[], Robot]) -> Iterator[OutputUse]:
        """Yields the output files that differ between the robot and a changed robot."""
        try:
            other = emit(changed_robot(), backends.DEFAULT_TARGETS)
        except Exception:  # A backend may raise anything for a robot that no compiler made.
            return
        for name, content in emit(self.robot, backends.DEFAULT_TARGETS).items():
            if other.get(name) != content and name.rpartition("/")[2] != MODEL_FILE:
                yield OutputUse(name, tuple(_changed_lines(content, other.get(name, b""))))

    # -- parameters of modules --------------------------------------------------------------

    def _explain_parameter(self, text: str) -> Explanation:
        instance, name = find_instance(self.probe, text)
        explanation = Explanation(f"modules.{instance.path}.params.{name}", None)
        explanation.chain = list(_chain(_Places(self.probe), instance.scope, name, set()))
        explanation.value = explanation.chain[-1].value
        explanation.unit = explanation.chain[-1].unit
        explanation.types = self._types(instance.path)
        sources = [
            step.source
            for step in explanation.chain
            if step.source is not None and not step.source.is_expression
        ]
        changed = self._changed(sources)
        explanation.is_varied = changed is not None
        if changed is not None:
            leaves = list(
                difference.leaf_differences(self.document, difference.model_document(changed))
            )
            leaves.sort(key=is_derived)
            explanation.model_values = [leaf.text_path for leaf in leaves]
            explanation.uses = list(self._uses(lambda: changed))
        return explanation

    def _changed(self, sources: Sequence[influence_search.SourceValue]) -> Robot | None:
        """Returns the robot with other values of some sources.

        Returns ``None`` if there are no sources, or if each change is an error.
        """
        changes: list[dict[influence_search.SourceValue, Any]] = [
            {
                source: influence_search.scaled(source.node.value, influence_search.SMALL_CHANGE)
                for source in sources
            },
            *(
                {
                    s: influence_search.incremented(s.node.value, step)
                    for s in sources
                    if s.is_integer
                }
                for step in influence_search.INTEGER_STEPS
            ),
        ]
        for change in filter(None, changes):
            robot, _ = self.probe.compile(change)
            # A scaled node id is a number with decimals, of which the whole part is used.
            if robot is not None and robot != self.robot:
                return robot
        return None

    # -- values of outputs --------------------------------------------------------------------

    def _explain_output(self, file: str, query: str) -> Explanation:
        name, target, text = self._output(file)
        output_value = value_paths.find_value(name, value_paths.output_values(name, text), query)

        def read(robot: Robot) -> Any:
            content = emit(robot, [target]).get(name, b"").decode()
            values = value_paths.output_values(name, content)
            return next((v.value for v in values if v.path == output_value.path), None)

        label = ".".join(output_value.path[-NAMES_OF_OUTPUT:])
        explanation = Explanation(f"{name}:{output_value.line} {label}", output_value.value)
        paths, explanation.is_complete = self._model_sources(read)
        explanation.model_values = [".".join(path) for path in paths]
        if paths:
            is_complete = explanation.is_complete
            self._search(
                explanation,
                lambda robot: [value_paths.observed_value(robot, path) for path in paths],
            )
            explanation.is_complete = explanation.is_complete and is_complete
            explanation.influences = list(self._with_effects(explanation.influences, read))
        modules = {_module_at(self.document, path) for path in paths} - {""}
        if len(modules) == 1:
            explanation.types = self._types(modules.pop())
        return explanation

    def _model_sources(
        self, read: Callable[[Robot], Any]
    ) -> tuple[list[difference.ValuePath], bool]:
        """Returns the values of the model that an output value is computed from.

        A robot with other numbers in all documents gives each value of the model another value.
        Group tests find those that change the output.  The second result is false if the search
        ended at its limit.
        """
        search = influence_search.InfluenceSearch(
            self.probe, lambda robot: robot, MOST_COMPILATIONS
        )
        value = read(self.robot)
        changes = {
            leaf.path: leaf.after
            for robot in search.robots_with_other_numbers(self.probe.values())
            for leaf in difference.leaf_differences(self.document, difference.model_document(robot))
            if difference.ABSENT not in (leaf.before, leaf.after)
            and difference.ORDER not in leaf.path
        }
        sources: list[difference.ValuePath] = []
        groups = [list(changes)]
        emissions = 0
        while groups and emissions < MOST_EMISSIONS:
            paths = groups.pop()
            emissions += 1
            is_robot = True
            try:
                changed = value_paths.with_values(
                    self.robot, {path: changes[path] for path in paths}
                )
                if read(changed) == value:
                    continue
            except Exception:  # A backend may raise anything for a robot that no compiler made.
                is_robot = False
            middle = len(paths) // 2
            if middle == 0:
                sources += paths if is_robot else []
            else:
                groups += [paths[middle:], paths[:middle]]
        return sources, not groups

    def _with_effects(
        self, influences: list[influence_search.Influence], read: Callable[[Robot], Any]
    ) -> Iterator[influence_search.Influence]:
        """Yields the influences with their effects on an output value."""
        value = read(self.robot)
        for number, influence in enumerate(influences):
            source = influence.source
            if source.is_expression or number >= MOST_EFFECTS:
                yield influence
                continue
            robot, _ = self.probe.compile(
                {source: influence_search.scaled(source.node.value, influence_search.SMALL_CHANGE)}
            )
            new = read(robot) if robot is not None else value
            # An integer cannot be scaled, and a value may reach the output by a large change only.
            yield influence_search.Influence(
                source,
                influence_search.relative_effect(source, influence_search.SMALL_CHANGE, value, new),
            )

    def _output(self, file: str) -> tuple[str, str, str]:
        """Returns the name, the target and the text of the file of a build that ``file`` names."""
        known: list[str] = []
        wanted_path = os.path.normpath(file).replace(os.sep, "/")
        for target in backends.names():
            if target not in backends.DEFAULT_TARGETS and target not in wanted_path.split("/"):
                continue
            for name, content in emit(self.robot, [target]).items():
                known.append(name)
                if wanted_path == name or wanted_path.endswith(f"/{name}"):
                    try:
                        return name, target, content.decode()
                    except UnicodeDecodeError:
                        raise DiagnosticError(
                            "why-path-unknown", f"{name} is no text file"
                        ) from None
        raise DiagnosticError(
            "why-path-unknown",
            f"no build of the robot has a file `{file}`",
            hint=did_you_mean(wanted_path, known, fixable=False),
        )


def _changed_lines(content: bytes, other: bytes) -> Iterator[tuple[int, str]]:
    """Yields the lines of a file that differ in another version of the file."""
    lines, other_lines = (text.decode("utf-8", "replace").splitlines() for text in (content, other))
    if len(lines) == len(other_lines):
        for number, pair in enumerate(zip(lines, other_lines, strict=True), start=1):
            if pair[0] != pair[1]:
                yield number, pair[0].strip()
        return
    matcher = difflib.SequenceMatcher(None, lines, other_lines, autojunk=False)
    for tag, first, last, _, _ in matcher.get_opcodes():
        if tag != "equal":
            yield from ((number + 1, lines[number].strip()) for number in range(first, last))


def _span_of(robot: Robot, path: difference.ValuePath) -> Span | None:
    """Returns the span of the innermost element of the model at a path."""
    element: Any = robot
    span: Span | None = robot.span
    for key in path:
        if isinstance(element, tuple):
            element = next((e for e in element if getattr(e, "name", None) == key), None)
        else:
            element = getattr(element, key, None)
        if element is None:
            break
        span = getattr(element, "span", span)
    return span


def _module_at(document: Any, path: difference.ValuePath) -> str:
    """Returns the path of the module that an element of the model belongs to, or an empty text."""
    module = ""
    for key in path:
        document = document.get(key) if isinstance(document, dict) else None
        if isinstance(document, dict) and isinstance(document.get("module"), str):
            module = document["module"]
    return module


# -- the way of a parameter through defaults, assemblies and expressions ----------------

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
    source: influence_search.SourceValue | None


def find_instance(probe: influence_search.RobotProbe, text: str) -> tuple[Instance, str]:
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
    shown = f"known: {', '.join(names or known)}"
    raise DiagnosticError(
        "why-path-unknown",
        message,
        hint=did_you_mean(word, known, shown, fixable=False) if word else shown,
    )


def chain_of_type(probe: influence_search.RobotProbe, path: str) -> Iterator[Step]:
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
    """Yields the nodes that give a parameter its value: the sources first, the parameter last."""
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

    def __init__(self, probe: influence_search.RobotProbe) -> None:
        self._sources = {value.span: value for value in probe.values()}
        self._nodes = {
            value.span: value
            for document in probe.documents.values()
            for value in influence_search.all_nodes(document)
        }

    def step(self, node: Node, value: Any, unit: str) -> Step:
        text = node.value
        if isinstance(text, dict):
            text = str(node.plain())
        elif isinstance(text, tuple):
            text = ", ".join(str(item.value) for item in text)
        place, source = self._nodes.get(node.span), self._sources.get(node.span)
        key_path = place.key_path if place is not None else ""
        return Step(node.span, key_path, str(text), value, unit, source)


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


# -- names for completion in a shell ----------------------------------------------------

_HIDDEN = ("meshes", "modules", "inertial")
"""Parts of the model whose numbers have other names, or none that a person would type."""


def known_paths(explainer: Explainer) -> Iterator[str]:
    """Yields the names of all numbers of a robot: of the model, of the facts and of the modules."""
    model = {key: part for key, part in explainer.document.items() if key not in _HIDDEN}
    facts = {name: compute(explainer.robot) for name, compute in FACTS.items()}
    documents = {name: facts_document(part) for name, part in facts.items() if part is not None}
    yield "mass"
    yield from (f"com.{axis}" for axis in "xyz")
    for document in (model, documents):
        for path in value_paths.all_paths(document):
            if value_paths.changed_value(value_paths.value_at(document, path), 1e-3) is not None:
                yield ".".join(path)
    yield from _parameters(explainer.probe.instances)


def _parameters(instance: Instance) -> Iterator[str]:
    if instance.type is not None:
        for name in instance.type.section("params"):
            yield f"modules.{instance.path}.params.{name}"
    for child in instance.children.values():
        yield from _parameters(child)
