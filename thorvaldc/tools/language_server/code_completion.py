"""The words that an editor proposes at the cursor of a YAML document that is half typed.

A YAML parser refuses a document such as ``fl: {type: ass``.  ``cursor_at`` reads only the text
before the cursor: the indentation of block mappings and the brackets of flow mappings say in which
mapping and at which key the cursor is.  Text that is no valid YAML is skipped.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Literal

from thorvaldc.compiler.scaffolding import presets, robot_text
from thorvaldc.compiler.source.node import KeyPath, Node, yaml_text
from thorvaldc.compiler.source.reader import read_text
from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.compiler.source.units import UnitError, parse_quantity
from thorvaldc.compiler.values.value_reader import entries
from thorvaldc.diagnostics import Report
from thorvaldc.model import Fleet, Robot, robots_by_name
from thorvaldc.tools.language_server import hover, open_document
from thorvaldc.tools.language_server.module_view import ModuleView, Parameter, Schemas, is_nested

_KEY = re.compile(
    r"""(?:"((?:[^"\\]|\\.)*)"|'((?:[^']|'')*)'|([^\s\-?#{}\[\],&*!|>'"%@`:][^#\n]*?|-[^\s#:]+))"""
    r"""[ \t]*:(?=[ \t]|$)"""
)
_BLOCK_SCALAR = re.compile(r"[|>][-+0-9]*[ \t]*(?:#.*)?$")
_CLOSING = {"{": "}", "[": "]"}


@dataclass(frozen=True)
class Cursor:
    """The place of the cursor in a document.

    Attributes
    ----------
    path : path of the mapping that receives a key, or of the value.
    slot : ``key`` in a mapping, ``value`` after a colon.  ``either`` at the start of an element of
        a list or of an indented line, which can become a mapping or a value.
    prefix : text before the cursor that belongs to the key or value.
    start : offset of ``prefix`` in the text.
    quote : the quote that is open, or an empty text.
    closing : brackets that close the flow mappings and lists around the cursor.
    """

    path: KeyPath
    slot: Literal["key", "value", "either"]
    prefix: str
    start: int
    quote: str = ""
    closing: str = ""

    @property
    def in_flow(self) -> bool:
        """Whether the cursor is inside of braces or brackets."""
        return bool(self.closing)


@dataclass
class _Frame:
    """A mapping or list that is open: at an indentation, or in brackets (``bracket``)."""

    indent: int
    key: str | int | None
    bracket: str = ""


@dataclass
class _Scanner:
    text: str
    offset: int
    frames: list[_Frame] = field(default_factory=list)
    scalar_indent: int | None = None  # of the key of a block scalar
    # The token that is open at the end of the text.
    token_start: int = 0
    token_quote: str = ""
    slot: Literal["key", "value", "either"] = "key"

    def run(self) -> Cursor:
        for line in open_document.LINE.finditer(self.text, 0, self.offset):
            if line.start() == line.end() and line.start() < self.offset:
                continue
            self._line(line.start(), line.end())
            if line.end() == self.offset and not line[0].endswith(("\n", "\r")):
                break
        prefix = self.text[self.token_start : self.offset]
        path = [frame.key for frame in self.frames if frame.key is not None]
        if self.slot == "key" and self.frames and self.frames[-1].key is not None:
            path.pop()
        closing = "".join(_CLOSING[f.bracket] for f in reversed(self.frames) if f.bracket)
        return Cursor(tuple(path), self.slot, prefix, self.token_start, self.token_quote, closing)

    # -- block style ------------------------------------------------------------------

    def _line(self, start: int, end: int) -> None:
        line = self.text[start:end].rstrip("\r\n")
        is_last = end >= self.offset and not self.text[start:end].endswith(("\r", "\n"))
        content = line.lstrip(" ")
        indent = len(line) - len(content)
        if self.scalar_indent is not None:
            if not content or indent > self.scalar_indent:
                self._set_token(start + len(line), "value")
                return
            self.scalar_indent = None
        if self.frames and self.frames[-1].bracket:
            outer = max((f.indent for f in self.frames if not f.bracket), default=-1)
            ends_early = indent <= outer and _KEY.match(content)
            if not ends_early or content[:1] in ("}", "]"):
                self._flow(start, start + len(line))
                return
            while self.frames and self.frames[-1].bracket:
                self.frames.pop()
        if not content and not is_last:
            return
        if content.startswith("#"):
            if is_last:
                self._set_token(start + len(line), "value")
            return
        self._block_content(start, indent, line)

    def _block_content(self, start: int, column: int, line: str) -> None:
        while (item := re.match(r"-(?:[ \t]+|$)", line[column:])) is not None:
            self._close(column, keep_list=True)
            top = self.frames[-1] if self.frames else None
            if top is not None and top.indent == column and isinstance(top.key, int):
                top.key += 1
            else:
                self.frames.append(_Frame(column, 0))
            column += item.end()
            self._set_token(start + column, "either")
        key = _KEY.match(line, column)
        if key is None:
            if column >= len(line) or "-" not in line[:column]:
                self._close(column, keep_list="-" in line[:column])
            self._open_token(start + column, line[column:])
            return
        self._close(column)
        name = next(group for group in key.groups() if group is not None)
        top = self.frames[-1] if self.frames else None
        if top is not None and top.indent == column and not isinstance(top.key, int):
            top.key = name
        else:
            self.frames.append(_Frame(column, name))
        rest = line[key.end() :]
        value = rest.lstrip(" \t")
        value_start = start + len(line) - len(value)
        self._set_token(value_start, "value")
        if not rest and value_start == self.offset:
            self._set_token(self.offset, "value")
        if _BLOCK_SCALAR.match(value):
            self.scalar_indent = column
        elif value[:1] in _CLOSING:
            self._flow(value_start, start + len(line))
        elif value[:1] in ("'", '"'):
            self._set_token(value_start + 1, "value", value[0])

    def _close(self, column: int, *, keep_list: bool = False) -> None:
        """Closes the mappings and lists that are indented more than ``column``.

        - ``keep_list``: whether a list at the column stays open.
        """
        while self.frames and self.frames[-1].indent > column:
            self.frames.pop()
        top = self.frames[-1] if self.frames else None
        if top is not None and top.indent == column and isinstance(top.key, int) and not keep_list:
            self.frames.pop()

    def _open_token(self, start: int, token: str) -> None:
        """Sets the token of a line without a colon: a key that is being typed, or a value."""
        column = self._column(start)
        top = self.frames[-1] if self.frames else None
        slot: Literal["key", "either"] = "key"
        if top is not None and (top.indent < column or isinstance(top.key, int)):
            slot = "either"
        if token[:1] in _CLOSING:
            self.slot = "value"
            self._flow(start, start + len(token))
            return
        quote = token[:1] if token[:1] in ("'", '"') else ""
        self._set_token(start + len(quote), slot, quote)

    def _column(self, offset: int) -> int:
        return offset - max(self.text.rfind("\n", 0, offset), self.text.rfind("\r", 0, offset)) - 1

    def _set_token(
        self, start: int, slot: Literal["key", "value", "either"], quote: str = ""
    ) -> None:
        self.token_start, self.slot, self.token_quote = min(start, self.offset), slot, quote

    # -- flow style -------------------------------------------------------------------

    def _flow(self, start: int, end: int) -> None:
        """Reads brackets, quotes and commas in a part of a line."""
        if self.frames and self.frames[-1].bracket and not self.token_quote:
            # The text of a flow mapping goes on in a new line.
            self._skip_space(start)
        index = start
        quote = self.token_quote if self.frames and self.frames[-1].bracket else ""
        while index < end:
            character = self.text[index]
            if quote:
                if character == "\\" and quote == '"':
                    index += 1
                elif character == quote:
                    quote = self.token_quote = ""
            elif character in _CLOSING:
                self.frames.append(_Frame(-1, 0 if character == "[" else None, character))
                self._skip_space(index + 1)
            elif character in "}]":
                self._end_flow(index)
                if not self.frames or not self.frames[-1].bracket:
                    return
            elif character == ",":
                top = self.frames[-1]
                top.key = top.key + 1 if isinstance(top.key, int) else None
                self._skip_space(index + 1)
            elif character == "#" and (index == start or self.text[index - 1] in " \t"):
                return
            elif character == ":" and self._ends_key(index, end):
                self._flow_key(index)
            elif character in "'\"" and self.text[self.token_start : index].strip() == "":
                quote = character
                self._set_token(index + 1, self.slot, quote)
            index += 1

    def _ends_key(self, index: int, end: int) -> bool:
        if self.frames[-1].bracket != "{" or self.frames[-1].key is not None:
            return False
        after_quote = self.text[index - 1] in "'\""
        return after_quote or index + 1 >= end or self.text[index + 1] in " \t,{}[]"

    def _flow_key(self, index: int) -> None:
        name = self.text[self.token_start : index].strip()
        self.frames[-1].key = name.strip("'\"")
        self._skip_space(index + 1)

    def _skip_space(self, index: int) -> None:
        while index < self.offset and self.text[index] in " \t":
            index += 1
        top = self.frames[-1]
        is_key = top.bracket == "{" and top.key is None
        self._set_token(index, "key" if is_key else "value" if top.bracket == "{" else "either")

    def _end_flow(self, index: int) -> None:
        while self.frames and self.frames[-1].bracket:
            if _CLOSING[self.frames.pop().bracket] == self.text[index]:
                break
        self._set_token(index + 1, "value")


def cursor_at(text: str, offset: int) -> Cursor:
    """Returns the place of the cursor at an offset of a text."""
    return _Scanner(text, offset).run()


# -- proposals --------------------------------------------------------------------------

MAX_IDS = 16
"""Greatest number of free CAN ids that are proposed."""

_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_UNITS = (
    *("m", "mm", "cm", "km", "in", "ft", "m^2", "cm^2", "m^3", "g", "kg", "t", "lb"),
    *("s", "ms", "min", "h", "rad", "deg", "rev", "m/s", "mm/s", "km/h", "mph", "m/s^2"),
    *("rad/s", "deg/s", "rpm", "rad/s^2", "deg/s^2", "N", "kN", "lbf", "N m", "N cm", "kg m^2"),
    *("N/m", "N/mm", "kN/m", "N s/m", "N m/rad", "N m/deg", "N m s/rad", "Hz", "kHz"),
    *("V", "mV", "A", "mA", "ohm", "Ah", "mAh", "J", "kJ", "Wh", "kWh", "W", "kW"),
    *("kg/m^3", "g/cm^3", "Pa", "kPa", "bar", "kbit/s", "Mbit/s", "byte", "K", "degC", "%"),
)


@dataclass(frozen=True)
class Proposed:
    """A proposed word.

    - ``label``: the word as the editor shows it.
    - ``text``: text that replaces the word at the cursor; a snippet has tab stops (``$1``).
    - ``kind``: name of the kind in the protocol, such as ``Property``.
    - ``detail``: short text beside the word.
    - ``documentation``: longer text in Markdown.
    - ``is_snippet``: whether ``text`` is a snippet.
    - ``start``: number of characters of the prefix that stay, such as ``1.5 `` before a unit.
    """

    label: str
    text: str
    kind: str = "Value"
    detail: str = ""
    documentation: str = ""
    is_snippet: bool = False
    start: int = 0


def proposals_at(
    view: ModuleView, cursor: Cursor, models: Mapping[str, Robot | Fleet]
) -> list[Proposed]:
    """Returns the proposals at the cursor, the most useful ones first.

    - ``models``: models of the open documents without errors, by the path of the document.
    """
    proposals: list[Proposed] = []
    if cursor.slot in ("key", "either"):
        proposals += _keys(view, cursor)
    if cursor.slot in ("value", "either"):
        proposals += _values(view, cursor, models)
    unique: dict[str, Proposed] = {}
    for proposal in proposals:
        unique.setdefault(proposal.label, proposal)
    return list(unique.values())


# -- keys -------------------------------------------------------------------------------


def _keys(view: ModuleView, cursor: Cursor) -> Iterator[Proposed]:
    mapping = open_document.node_at(view.tree, cursor.path)
    present = set(mapping.value) if mapping is not None and isinstance(mapping.value, dict) else ()
    if not cursor.path and not present:
        yield from _whole_documents(view)
    for parameter in view.parameters_at(cursor.path):
        if parameter.name not in present:
            text = hover.parameter_text(parameter)
            detail = str(parameter.get("quantity") or parameter.get("type") or "")
            yield _entry(parameter.name, "Property", detail, text, cursor)
    if cursor.path == ("defaults",):
        for category in view.categories():
            yield _entry(category, "Class", "category of modules", "", cursor, nested=True)
    if cursor.path[:1] == ("modules",) and cursor.path[2:] == ("channels",):
        module = view.type_of(cursor.path[:2])
        for channel in module.section("channels") if module is not None else ():
            yield _entry(channel, "Field", "channel", "", cursor)
    schemas = view.schemas(cursor.path)
    required, keys = schemas.all("required"), schemas.keys
    for key in sorted(keys, key=lambda key: key not in required):
        if key not in present:
            text = hover.schema_text((key,), Schemas([keys[key]]))
            detail = "required" if key in required else ""
            yield _entry(key, "Property", detail, text, cursor, nested=is_nested(keys[key]))


def _entry(
    key: str, kind: str, detail: str, documentation: str, cursor: Cursor, *, nested: bool = False
) -> Proposed:
    after = ":" if nested and not cursor.in_flow else ": "
    text = key if cursor.quote else key + after
    return Proposed(key, text, kind, detail, documentation)


def _whole_documents(view: ModuleView) -> Iterator[Proposed]:
    if view.kind == "robot":
        for preset in presets():
            text = robot_text("@NAME@", preset).replace("$", "\\$").replace("}", "\\}")
            yield Proposed(
                f"robot {preset}",
                text.replace("@NAME@", "${1:my_robot}"),
                "Snippet",
                "a whole robot, as `thorvaldc new` writes it",
                is_snippet=True,
            )


# -- values -----------------------------------------------------------------------------


def _values(
    view: ModuleView, cursor: Cursor, models: Mapping[str, Robot | Fleet]
) -> Iterator[Proposed]:
    path = cursor.path
    if "${" in cursor.prefix:
        yield from _names(view, cursor)
        return
    parameter = view.parameter_at(path)
    schemas = view.schemas(path)
    quantities = schemas.quantities
    if parameter is not None:
        quantities = [parameter.quantity] if parameter.quantity else []
    units = list(_units(cursor, quantities))
    if units:
        yield from units
        return
    if parameter is not None:
        yield from _parameter_values(view, parameter)
    yield from _references(view, path, models)
    for value in schemas.values:
        yield Proposed(yaml_text(value), yaml_text(value), "EnumMember")
    if not parameter:
        default = schemas.first("default")
        examples = [] if default is None else [default]
        examples += [e for e in schemas.all("examples") if not isinstance(e, dict | list)]
        for example in examples if quantities else ():
            detail = "default" if example is default else "example"
            yield Proposed(yaml_text(example), yaml_text(example), "Value", detail)


def _parameter_values(view: ModuleView, parameter: Parameter) -> Iterator[Proposed]:
    default = parameter.declaration.get("default")
    choices = parameter.declaration.get("choices")
    kind = parameter.get("type")
    if default is not None and not isinstance(default.value, tuple | dict):
        text = yaml_text(default.value)
        if "${" not in text:
            yield Proposed(text, text, "Value", "default")
    for choice in choices.plain() if choices is not None else ():
        yield Proposed(yaml_text(choice), yaml_text(choice), "EnumMember")
    if kind == "boolean":
        for word in ("true", "false"):
            yield Proposed(word, word, "EnumMember")
    if kind == "module":
        yield from _types(view, parameter.get("category"))
        yield Proposed("none", "none", "EnumMember", "no module")
    if parameter.quantity:
        example = QUANTITIES[parameter.quantity].example
        yield Proposed(example, example, "Value", "example")


def _references(
    view: ModuleView, path: KeyPath, models: Mapping[str, Robot | Fleet]
) -> Iterator[Proposed]:
    """Yields the names that a value can refer to."""
    inside = path[2:] if path[:1] == ("modules",) else ()
    if inside in (("mount",), ("mount", "port")):
        yield from _ports(view, str(path[1]))
    elif inside == ("mount", "parent"):
        for name, child in view.root.children.items():
            free = child.type is not None and child.type.document.get("free_mount") is not None
            if name != path[1] and free:
                yield Proposed(name, name, "Module", child.type.name if child.type else "")
    elif inside == ("type",):
        yield from _types(view, None)
    elif inside in (("can",), ("can", "id")):
        for number in view.free_ids(str(path[1]))[:MAX_IDS]:
            yield Proposed(str(number), str(number), "Value", "free id")
    elif len(inside) == 2 and inside[0] == "channels":
        yield from _words(view.motors(), "Field", "motor")
    elif path[-1:] == ("bus",):
        yield from _words(entries(view.tree.get("buses")), "Variable", "bus")
    elif path[-1:] == ("color",):
        yield from _words(view.library.palette(), "Color", "colour of the palette")
    elif path == ("base_calculator",) or path == ("base_calculator", "name"):
        yield from _words(_calculators(), "Class", "base calculator")
    elif path[-1:] in (("port",), ("parent",)) or (len(path) == 2 and path[0] == "ports"):
        yield from _words((port.reference for port in view.ports()), "Interface", "port")
    else:
        yield from _names_of_models(view, path, models)


def _names_of_models(
    view: ModuleView, path: KeyPath, models: Mapping[str, Robot | Fleet]
) -> Iterator[Proposed]:
    """Yields names of the open robots, for documents that no robot names."""
    key = path[-1] if path else ""
    robots = [robot for model in models.values() for robot in robots_by_name(model).values()]
    if view.kind == "scenario" and key == "robot" and len(path) > 1 and path[0] != "robots":
        yield from _words(entries(view.tree.get("robots")), "Variable", "robot")
    elif key == "wheel":
        yield from _words((w.name for r in robots for w in r.wheels), "Field", "wheel")
    elif view.kind == "bus_faults" and key == "node":
        names = (node.name for r in robots for bus in r.buses for node in bus.nodes)
        yield from _words(names, "Field", "device")
    elif view.kind == "calibration" and path == ("robot",):
        yield from _words((robot.name for robot in robots), "Variable", "robot")


def _words(words: Iterable[str], kind: str, detail: str) -> Iterator[Proposed]:
    for word in dict.fromkeys(words):
        yield Proposed(word, yaml_text(word), kind, detail)


def _types(view: ModuleView, category: object) -> Iterator[Proposed]:
    for name in view.library.names():
        module = view.load(name)
        if module is not None and category in (None, module.category):
            yield Proposed(name, name, "Class", module.summary)


def _ports(view: ModuleView, module: str) -> Iterator[Proposed]:
    """Yields the ports that a module fits, the free ones first."""
    kinds = view.fitting_kinds(module)
    ports = [
        port
        for port in view.ports()
        if (kinds is None or port.kind in kinds) and port.reference.split(".")[0] != module
    ]
    for port in sorted(ports, key=lambda port: bool(port.occupant)):
        own = port.occupant.split(".")[0] in ("", module)
        detail = port.kind if own else f"{port.kind}, taken by {port.occupant}"
        yield Proposed(port.reference, port.reference, "Interface", detail, hover.port_text(port))


def _units(cursor: Cursor, quantities: list[str]) -> Iterator[Proposed]:
    """Yields the units after a number, such as ``mm`` after ``650``."""
    number = _NUMBER.match(cursor.prefix)
    if number is None:
        return
    rest = cursor.prefix[number.end() :]
    start = number.end() + len(rest) - len(rest.lstrip())
    for quantity in quantities:
        for unit in units_of(quantity):
            space = "" if start > number.end() else " "
            yield Proposed(unit, space + unit, "Unit", quantity.replace("_", " "), start=start)


@cache
def units_of(quantity: str) -> tuple[str, ...]:
    """Returns common units of a kind of quantity, the SI unit first."""
    unit, example = QUANTITIES[quantity].unit, QUANTITIES[quantity].example.partition(" ")[2]
    units = []
    for candidate in (unit, example, *_UNITS):
        try:
            parse_quantity(f"1 {candidate}", quantity)
        except UnitError:
            continue
        units.append(candidate)
    return tuple(dict.fromkeys(u for u in units if u not in ("", "1")))


@cache
def _calculators() -> tuple[str, ...]:
    from thorvaldc.runtime.calculators import calculator_names

    return tuple(calculator_names())


def _names(view: ModuleView, cursor: Cursor) -> Iterator[Proposed]:
    """Yields the parameters and `let` values in an expression."""
    word = re.search(r"\w*$", cursor.prefix)
    start = word.start() if word is not None else len(cursor.prefix)
    for section, detail in (("params", "parameter"), ("let", "value")):
        for name, node in entries(view.tree.get(section)).items():
            description = node.get("description")
            text = str(description.value) if description is not None else ""
            yield Proposed(name, name, "Variable", detail, text, start=start)


def tree_around(
    source: open_document.SourceText, cursor: Cursor, offset: int, file: str
) -> Node | None:
    """Returns the YAML tree of a document in which a user types.

    If the document is not valid YAML, the brackets around the cursor are closed at the end of the
    cursor's line.
    """
    node = read_text(source.text.encode("utf-8", "surrogatepass"), file, Report())
    if node is not None or len(source.text) > open_document.MAX_REPAIRED:
        return node
    end = source.offset_of(source.line_index(offset) + 1, 1 << 30)
    word = "x" if cursor.slot != "key" and not cursor.prefix else ""
    closed = source.text[:offset] + word + cursor.quote + cursor.closing + source.text[end:]
    node = read_text(closed.encode("utf-8", "surrogatepass"), file, Report())
    return node if node is not None else open_document.tree_of(source, file)
