"""The rules of ``thorvaldc upgrade``: one for each change of the language.

A rule finds what an older file means in another way.  It returns changes of the text that keep the
meaning, or decisions that a person must take, because the file does not say which meaning is right.
``docs/upgrade.md`` lists the rules; the words that the language had are in ``schema/old_words.py``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from thorvaldc.compiler.catalogue import check_module
from thorvaldc.compiler.modules.library import module_library
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.compiler.source.input_file import unsaved_texts
from thorvaldc.compiler.source.node import Node, Value
from thorvaldc.compiler.values.value_reader import entries
from thorvaldc.diagnostics import Diagnostic, Fix, Report, Span
from thorvaldc.model import Robot
from thorvaldc.schema import Kind
from thorvaldc.schema.old_words import OldWord, old_keys, old_value
from thorvaldc.tools.upgrade.document import Document


class Decision(NamedTuple):
    """What a person must decide about a place of a file."""

    span: Span
    message: str
    hint: str


@dataclass(frozen=True)
class Context:
    """What a rule may look at besides the document.

    - ``folders``: library folders of the command line.
    - ``robots``: robot, fleet and scenario files of the command line, in which the expressions of a
      module are computed with the values of a robot.
    """

    folders: tuple[Path, ...] = ()
    robots: tuple[Path, ...] = ()


Findings = Iterable[Fix | Decision | Diagnostic]


class Rule(NamedTuple):
    """A change of the language.

    - ``name``: name in messages and in ``docs/upgrade.md``.
    - ``kinds``: kinds of documents in which it can occur.
    - ``find``: returns changes of the text, decisions, and errors that only a person can correct.
    """

    name: str
    kinds: tuple[Kind, ...]
    find: Callable[[Document, Context], Findings]


# -- words that have another name -------------------------------------------------------------


def find_old_words(document: Document, context: Context) -> Iterator[Fix | Decision]:
    """Yields the words that the language had: renamed ones as changes, others as decisions."""
    for path, node in document.root.walk():
        if path and document.is_unit:  # its first key can be a dotted path
            path = (*str(path[0]).split("."), *path[1:])
        if node.key_span is not None:
            for word in old_keys(document.kind, path):
                siblings = _at(document.root, path[:-1])
                if not word.types or _type_of(document.whole, path) in word.types:
                    yield _renamed(word, node.key_span, word.new in siblings)
        word_of_value = old_value(document.kind, path, node.value)
        if word_of_value is not None:
            yield _renamed(word_of_value, node.span, False)


def _renamed(word: OldWord, span: Span, is_taken: bool) -> Fix | Decision:
    old = word.value or word.path[-1]
    if word.new and not is_taken:
        return Fix(span, word.new)
    hint = f"keep one of `{old}` and `{word.new}`" if word.new else word.advice
    return Decision(span, f"`{old}` is not a word of the language any more", hint)


def _at(root: Node, path: Sequence[str | int]) -> dict[str, Node]:
    node: Node | None = root
    for key in path:
        node = entries(node).get(str(key))
    return entries(node)


def _type_of(root: Node, path: Sequence[str | int]) -> object:
    """Returns the type of the module to whose ``params`` a path belongs."""
    node = _at(root, path[:-2]).get("type")
    return node.value if node is not None else None


# -- dimensions of expressions ----------------------------------------------------------------

_EXPRESSION = re.compile(r"""(["']?)\$\{.*\}\1""", re.DOTALL)
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")


def find_dimensions(document: Document, context: Context) -> Iterator[Fix | Diagnostic]:
    """Yields the units that the numbers of expressions need.

    Before expressions had dimensions, every number was in SI units.  With the SI unit that a number
    needs, the expression keeps its value for all values of the parameters.
    """
    for diagnostic in _errors_of_module(document, context):
        if diagnostic.code.name != "wrong-dimension":
            continue
        # A hint at another value, such as `5 kg` for a rate, proposes what the user may have meant.
        fixes = [
            Fix(fix.span, _in_style_of(document.text_at(fix.span), fix.text))
            for fix in diagnostic.fixes
            if not fix.is_example and _has_old_value(document.text_at(fix.span))
        ]
        yield fixes[0] if len(fixes) == 1 else diagnostic


def _has_old_value(text: str) -> bool:
    return bool(_EXPRESSION.fullmatch(text) or _NUMBER.fullmatch(text))


def _in_style_of(old: str, new: str) -> str:
    """Returns a new expression with the quotes of the old one."""
    quote = old[0] if old[0] in "\"'" else ""
    if quote == '"' or not _EXPRESSION.fullmatch(new):
        return new
    return quote + new.strip('"') + quote


def _errors_of_module(document: Document, context: Context) -> Iterator[Diagnostic]:
    """Yields the errors in a module document, alone and as a part of the robots."""
    name, library = module_library(document.path.absolute(), context.folders)
    report, sources = Report(), {}
    with unsaved_texts({document.real_path: document.data}):
        if library.exists(name):
            check_module(name, library, report, _values_without_default(document))
            sources.update(library.files)
        for robot in context.robots:
            compilation = compile_file(robot, library=context.folders)
            report.extend(compilation.report.errors)
            sources.update(compilation.sources)
    here = {display for display, path in sources.items() if _is_same(path, document)}
    for diagnostic in report.errors:
        if diagnostic.span is not None and diagnostic.span.file in here:
            yield diagnostic


def _is_same(path: Path, document: Document) -> bool:
    try:
        return path.samefile(document.path)
    except OSError:
        return False


def _values_without_default(document: Document) -> dict[str, Node]:
    """Returns values for the parameters that have no default, so that expressions have values."""
    values: dict[str, Node] = {}
    for name, declaration in entries(document.root.get("params")).items():
        value = _value_for(declaration) if declaration.get("default") is None else None
        if value is not None:
            values[name] = value
    return values


def _value_for(declaration: Node) -> Node | None:
    choices = declaration.get("choices")
    if choices is not None and isinstance(choices.value, tuple) and choices.value:
        first: Node = choices.value[0]
        return first
    for key in ("minimum", "maximum"):
        bound = declaration.get(key)
        if bound is not None:
            return bound
    kind = declaration.get("type")
    words: dict[str, Value] = {"boolean": True, "text": "text", "integer": 1}
    plain = words.get(str(kind.value)) if kind is not None else 1
    return Node(plain, declaration.span) if plain is not None else None


# -- defaults that have changed ---------------------------------------------------------------


class Default(NamedTuple):
    """A key with another default or another meaning than before.

    - ``path``: keys from the top of the document; ``*`` is any key.  The decision is taken when the
      last key is stated.
    - ``message``, ``hint``: what has changed, and what to write.
    - ``requires``: further keys beside the last one, one of which the document must state.
    """

    path: tuple[str, ...]
    message: str
    hint: str
    requires: tuple[str, ...] = ()

    def find(self, document: Document, context: Context) -> Iterator[Decision]:
        """Yields a decision for each mapping that does not state the key."""
        for owner, span in _owners(document.whole, self.path[:-1]):
            if span.file != document.root.span.file:
                continue  # of the design of a unit
            stated = entries(owner)
            if self.path[-1] in stated:
                continue
            if not self.requires or any(key in stated for key in self.requires):
                yield Decision(span, self.message, self.hint)


def _owners(root: Node, path: Sequence[str]) -> Iterator[tuple[Node | None, Span]]:
    """Yields the mappings at a path.  The place of ``driver``, if it is missing, is the name."""
    if "*" not in path:
        start = root.get("name") or root
        node: Node | None = root
        for key in path:
            node = entries(node).get(key)
        yield node, (node or start).where if node is not root else start.where
        return
    outer = tuple(path[: path.index("*")])
    for entry in _at(root, outer).values():
        if isinstance(entry.value, dict):  # the motor of an assembly is the name of another
            yield entry, entry.where


def find_batteries(document: Document, context: Context) -> Iterator[Decision]:
    """Yields a decision if several batteries are connected in an unknown way."""
    batteries = [
        module
        for module in entries(document.whole.get("modules")).values()
        if (kind := module.get("type")) is not None
        and str(kind.value).startswith("battery/")
        and not _is_empty(module)
    ]
    here = len(batteries) > 1 and batteries[1].where.file == document.root.span.file
    if here and document.whole.get("batteries") is None:
        yield Decision(
            batteries[1].where,
            "the robot has several batteries and does not state how they are connected",
            "state `batteries: parallel` if they supply the robot together, or"
            " `batteries: separate` if each supplies its own modules",
        )


def _is_empty(module: Node) -> bool:
    with_battery = entries(module.get("params")).get("with_battery")
    return with_battery is not None and with_battery.value is False


HOMING = Default(
    ("driver", "homing"),
    "the steering finds its home position when the robot is armed; it turned at the start before",
    "state `homing: on_arming` in `driver`, or `homing: at_start` for the old"
    " behaviour, in which the steering turns without a command",
)


def find_homing(document: Document, context: Context) -> Iterator[Decision]:
    """Yields the decision about homing, unless the robot has no steering."""
    with unsaved_texts({document.real_path: document.data}):
        robot = compile_file(document.path, library=context.folders).model
    if not isinstance(robot, Robot) or any(wheel.steered for wheel in robot.wheels):
        yield from HOMING.find(document, context)


BRAKES = Default(
    ("motors", "*", "brake"),
    "a motor without power and without a brake is released: the joint turns against"
    " `back_driving_torque` alone; the simulation held it before",
    "state `brake: {torque: 2 N m, closing_time: 30 ms}` with the values of the real brake, or"
    " `brake: none`",
)
ARMING = Default(
    ("driver", "arming"),
    "the robot moves only after it was armed; it moved with the first twist before",
    "state `arming: required` in `driver`, or `arming: automatic`",
)
FIRST_COMMAND = Default(
    ("driver", "twist_sources", "*", "first_command"),
    "a source commands zero before it moves the robot; its first twist moved it before",
    "state `first_command: zero`, or `first_command: any` for the old behaviour",
)
RADIUS_ERROR = Default(
    ("driver", "noise", "radius_error"),
    "all of `speed_ratio` may last for the whole drive; it was random before",
    "state `radius_error`, the part that lasts, such as `radius_error: 0.2 %`",
    requires=("speed_ratio",),
)
STEERING_OFFSET_ERROR = Default(
    ("driver", "noise", "steering_offset_error"),
    "all of `angle` may last for the whole drive; it was random before",
    "state `steering_offset_error`, the part that lasts, such as `steering_offset_error: 0.1 deg`",
    requires=("angle",),
)

_DOCUMENTS: tuple[Kind, ...] = (
    "robot",
    "module",
    "fleet",
    "scenario",
    "study",
    "calibration",
    "bus_faults",
)
RULES = (
    Rule("old words", _DOCUMENTS, find_old_words),
    Rule("dimensions", ("module",), find_dimensions),
    Rule("homing", ("robot",), find_homing),
    Rule("brakes", ("module",), BRAKES.find),
    Rule("arming", ("robot",), ARMING.find),
    Rule("first command", ("robot",), FIRST_COMMAND.find),
    Rule("batteries", ("robot",), find_batteries),
    Rule("lasting radius error", ("robot",), RADIUS_ERROR.find),
    Rule("lasting steering error", ("robot",), STEERING_OFFSET_ERROR.find),
)
