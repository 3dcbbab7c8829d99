"""The words that an editor proposes at the cursor of a YAML document that is half typed."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache

from thorvaldc.compiler.scaffolding import presets, robot_text
from thorvaldc.compiler.source.node import KeyPath, Node, yaml_text
from thorvaldc.compiler.source.reader import read_text
from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.compiler.source.units import UnitError, parse_quantity
from thorvaldc.compiler.values.value_reader import entries
from thorvaldc.diagnostics import Report
from thorvaldc.model import Fleet, Robot, robots_by_name
from thorvaldc.tools.language_server import hover, open_document
from thorvaldc.tools.language_server.cursor import Cursor
from thorvaldc.tools.language_server.module_view import ModuleView, Parameter, Schemas, is_nested

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
        yield from _words(entries(view.document.get("buses")), "Variable", "bus")
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
    cursor's line, and other lines with errors are left out.
    """
    node = read_text(source.text.encode("utf-8", "surrogatepass"), file, Report())
    if node is not None:
        return node
    end = source.offset_of(source.line_index(offset) + 1, 1 << 30)
    word = "x" if cursor.slot != "key" and not cursor.prefix else ""
    closed = source.text[:offset] + word + cursor.quote + cursor.closing + source.text[end:]
    return open_document.tree_of(open_document.SourceText(closed), file)
