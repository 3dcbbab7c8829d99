"""The text that an editor shows for the word under the mouse pointer."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from thorvaldc.compiler.modules.library import ModuleType
from thorvaldc.compiler.source.node import KeyPath, yaml_text
from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.compiler.source.units import UnitError, parse_any, parse_quantity
from thorvaldc.compiler.values.value_reader import INVALID
from thorvaldc.diagnostics import Span, plain
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.facts.robot_facts import robot_facts
from thorvaldc.model.sums import float_sum
from thorvaldc.schema import bounds_in_words
from thorvaldc.tools.language_server.module_references import Reference, reference_at
from thorvaldc.tools.language_server.module_view import ModuleView, Parameter, Port, Schemas
from thorvaldc.tools.language_server.open_document import Place

Hover = tuple[str, Span]
"""Text in Markdown, and the span that it describes."""


def hover_at(view: ModuleView, model: Robot | Fleet | None, line: int, column: int) -> Hover | None:
    """Returns the text for a line and column, which start at 1, or ``None``.

    - ``model``: model of the last analysis without errors.
    """
    place = view.place_at(line, column)
    if place is None:
        return None
    reference = reference_at(view, place, column)
    if reference is not None:
        text = _reference_text(view, reference, model)
        if text:
            return text, reference.span
    if place.part == "key":
        text = _key_text(view, place, model)
    else:
        text = "\n\n".join(filter(None, (_value_text(view, place), _key_text(view, place, None))))
    return (text, place.span) if text else None


def _key_text(view: ModuleView, place: Place, model: Robot | Fleet | None) -> str:
    parameter = view.parameter_at(place.path)
    if parameter is not None:
        return parameter_text(parameter)
    if place.path[:1] == ("modules",) and place.path[-2:-1] == ("params",):
        return ""  # the module has no such parameter
    if place.path[:1] == ("modules",) and len(place.path) == 2:
        return module_text(view, str(place.path[1]), model)
    text = schema_text(place.path, view.schemas(place.path))
    if not text and isinstance(place.path[-1], int):  # an element, such as x of a position
        path = place.path[:-1]
        text = schema_text(path, view.schemas(path))
    return text


def _reference_text(view: ModuleView, reference: Reference, model: Robot | Fleet | None) -> str:
    if reference.kind == "type":
        module = view.load(reference.name)
        if module is None:
            return ""
        return f"**{module.name}**: {module.description}\n\n" + "\n".join(_type_facts(module))
    if reference.kind == "port":
        port = view.port(reference.whole)
        return port_text(port) if port is not None else ""
    if reference.kind == "module":
        return module_text(view, reference.name, model)
    return ""


# -- parts ------------------------------------------------------------------------------


def schema_text(path: KeyPath, schemas: Schemas) -> str:
    """Returns the description of a key, its kind, default, allowed values and examples."""
    description = schemas.first("description")
    name = next((str(key) for key in reversed(path) if isinstance(key, str)), "")
    if not description:
        return ""
    rows = [f"**{name}**: {description}"]
    quantities = schemas.quantities
    if quantities:
        kinds = " or ".join(f"{QUANTITIES[q].name.replace('_', ' ')}" for q in quantities)
        units = " or ".join(dict.fromkeys(f"`{QUANTITIES[q].unit}`" for q in quantities))
        rows.append(f"- {kinds}, in {units}")
    rows += [f"- {bound}" for schema in schemas.schemas for bound in bounds_in_words(schema)]
    default = schemas.first("default")
    if default is not None:
        rows.append(f"- default: `{yaml_text(default)}`")
    values, examples = schemas.values, schemas.all("examples")
    if values:
        rows.append("- values: " + ", ".join(f"`{yaml_text(value)}`" for value in values))
    if examples and not values:
        rows.append(f"- example: `{yaml_text(examples[0])}`")
    return "\n".join(rows)


def parameter_text(parameter: Parameter) -> str:
    """Returns the description of a parameter, its unit, default, range and source."""
    rows = [f"**{parameter.name}** of `{parameter.module.name}`: {parameter.get('description')}"]
    kind = str(parameter.get("type") or "quantity")
    if parameter.quantity:
        quantity = QUANTITIES[parameter.quantity]
        many = "list of values, each " if kind == "list" else ""
        rows.append(f"- {many}{quantity.name.replace('_', ' ')}, in `{quantity.unit}`")
    elif kind == "module":
        rows.append(f"- a module of the category `{parameter.get('category') or 'any'}`, or `none`")
    else:
        rows.append(f"- {kind}")
    default = parameter.declaration.get("default")
    rows.append(f"- default: {_value(default.plain())}" if default is not None else "- required")
    for keyword, words in (("minimum", "at least"), ("maximum", "at most")):
        if parameter.get(keyword) is not None:
            rows.append(f"- {words} {_value(parameter.get(keyword))}")
    choices = parameter.declaration.get("choices")
    if choices is not None:
        rows.append("- one of " + ", ".join(_value(choice) for choice in choices.plain()))
    if parameter.get("source"):
        rows.append(f"- source: {parameter.get('source')}")
    return "\n".join(rows)


def _value(value: Any) -> str:
    """Returns a value as YAML, with the SI value of a quantity that is written in another unit."""
    text = f"`{yaml_text(value)}`"
    if isinstance(value, str):
        si = si_text(value)
        return f"{text} ({si})" if si else text
    return text


def si_text(text: str) -> str:
    """Returns a quantity in SI, such as ``0.65 m``, or an empty text."""
    try:
        value = parse_any(text)
    except UnitError:
        return ""
    for quantity in QUANTITIES.values():
        try:
            if parse_quantity(text, quantity.name) == value:
                shown = quantity.format_value(value)
                return "" if shown.replace(" ", "") == text.replace(" ", "") else shown
        except UnitError:
            continue
    return f"{value:.6g} in SI units"


def port_text(port: Port) -> str:
    """Returns the kind and the position of a port, and the module that is mounted there."""
    x, y, z = (f"{value:.4g}" for value in port.pose.xyz)
    rows = [f"**{port.reference}**: a port of the kind `{port.kind}`"]
    rows.append(f"- at x = {x}, y = {y}, z = {z} m of the link `{port.link}`")
    if any(port.pose.rpy()):
        angles = ", ".join(f"{math.degrees(angle):.4g}" for angle in port.pose.rpy())
        rows.append(f"- roll, pitch, yaw: {angles} deg")
    if port.occupant:
        rows.append(f"- `{port.occupant}` is mounted here")
    return "\n".join(rows)


def module_text(view: ModuleView, name: str, model: Robot | Fleet | None) -> str:
    """Returns the type of a module of the document, and the facts of the module in the model."""
    module = view.type_of(("modules", name))
    if module is None:
        return ""
    rows = [f"**{name}**: `{module.name}`: {module.description}"]
    if isinstance(model, Robot):
        rows += _facts(model, name)
    return "\n".join(rows)


def _type_facts(module: ModuleType) -> Iterator[str]:
    """Yields the mount kinds, ports and parts of a module type as list entries."""
    document = module.document.plain()
    if kinds := (document.get("mount") or {}).get("kinds"):
        yield f"- mounts on: {', '.join(kinds)}"
    ports = [
        f"{name} ({port['kind']})" if isinstance(port, dict) else f"{name} = {port}"
        for name, port in document.get("ports", {}).items()
    ]
    if ports:
        yield f"- ports: {', '.join(ports)}"
    for key in ("links", "joints", "motors", "channels", "modules"):
        if document.get(key):
            yield f"- {key}: {', '.join(document[key])}"


def _facts(robot: Robot, name: str) -> list[str]:
    facts = robot_facts(robot)
    rows = []
    masses = [part for part in facts.modules if _is_part(part.module, name)]
    if masses:
        rows.append(
            f"- mass: {float_sum(part.mass for part in masses if part.mass is not None):.4g} kg"
        )
    for wheel in facts.wheels:
        if not _is_part(wheel.module, name):
            continue
        kinds = [word for word in ("driven", "steered") if getattr(wheel, word)]
        rows.append(
            f"- wheel `{wheel.name}`: {' and '.join(kinds) or 'follows'}, radius"
            f" {plain(wheel.radius, 4)} m, at x = {plain(wheel.x, 4)}, y = {plain(wheel.y, 4)} m,"
            f" load {wheel.load:.4g} N ({wheel.share:.0%} of the weight)"
        )
    return rows


def _is_part(path: str, name: str) -> bool:
    return path == name or path.startswith(f"{name}.")


def _value_text(view: ModuleView, place: Place) -> str:
    """Returns the value of a quantity or expression in SI units."""
    value = place.node.value
    if not isinstance(value, str):
        return ""
    if "${" in value:
        if not (value.startswith("${") and value.endswith("}")):
            return ""
        result = view.scope.value(place.node)
        if result is INVALID or result is None:
            return ""
        if not isinstance(result, bool | int | float | str | list | tuple):
            return ""
        unit = _unit_of(view, place)
        shown = f"{result:.6g}" if isinstance(result, float) else str(result)
        return f"`{shown}{unit}` with the default parameters"
    si = si_text(value)
    return f"`{si}`" if si else ""


def _unit_of(view: ModuleView, place: Place) -> str:
    quantities = view.schemas(place.path).quantities
    parameter = view.parameter_at(place.path)
    if parameter is not None and parameter.quantity:
        quantities = [parameter.quantity]
    if len(place.path) == 3 and place.path[0] == "params":
        declared = view.tree.get("params")
        node = declared.get(str(place.path[1])) if declared is not None else None
        quantity = node.get("quantity") if node is not None else None
        quantities = [str(quantity.value)] if quantity is not None else []
    units = {QUANTITIES[name].unit for name in quantities if name in QUANTITIES}
    return f" {units.pop()}" if len(units) == 1 and units != {"1"} else ""
