"""Names of values: of the model, such as ``wheels.fl.radius``, and of the text files of a build.

A file of a build is YAML, JSON, XML, or any other text, whose values are the numbers of its lines.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple
from xml.parsers import expat

from thorvaldc.comparison.robot_difference import ORDER, ValuePath, element_names
from thorvaldc.diagnostics import DiagnosticError, did_you_mean
from thorvaldc.model import Robot
from thorvaldc.model.model_json import from_json, to_json

# Other names of parts of the model: of the robot itself, and of parts that lie deeper.
_ALIASES: dict[str, ValuePath] = {
    "mass": ("inertial", "mass"),
    "com": ("inertial", "com"),
    "limits": ("driver",),
    "motors": ("actuators",),
    "drives": ("actuators",),
}
_BUS_PARTS = ("nodes", "frames", "load", "bitrate")
_OTHER_PARTS = (*_BUS_PARTS, "size", "stability", "driving", "slopes", "energy")
# Keys that a path may leave out, because they only group values.
_SECTIONS = ("inertial", "properties", "options", "battery", "noise", "pose")
_AXES = {"x": "0", "y": "1", "z": "2"}
MOST_SHOWN_NAMES = 12


def resolve_path(document: dict[str, Any], text: str) -> ValuePath:
    """Returns the path of the one value that ``text`` names in a document of ``model_document``.

    Parts may be shortened: ``wheels.fl.radius`` for ``wheels.fl_wheel.radius``, ``mass`` for
    ``inertial.mass``, ``limits.linear_velocity`` for ``driver.max_linear_velocity``.  Raises
    ``DiagnosticError`` (``why-path-unknown``) if there is no such value.
    """
    parts = [part for part in text.replace("[", ".").replace("]", "").split(".") if part]
    if not parts:
        raise _unknown(text, "", list(document))
    value: Any = document
    path: ValuePath = ()
    if parts[0] in _ALIASES and parts[0] not in document:
        path = _ALIASES[parts.pop(0)]
        value = value_at(document, path)
    elif parts[0] in _BUS_PARTS and "buses" in document:
        buses = [name for name in document["buses"] if name != ORDER] if document["buses"] else []
        if len(buses) == 1:
            parts[:0] = ["buses", buses[0]]
    while parts:
        step = _step(value, parts)
        if step is None:
            names = list(_keys(value)) + ([] if path else [*_ALIASES, *_OTHER_PARTS])
            elsewhere = [] if path else _elements_named(document, parts[0])
            raise _unknown(text, ".".join(path), names, parts[0], elsewhere)
        keys, used = step
        for key in keys:
            value = _child(value, key)
        path, parts = (*path, *keys), parts[used:]
    if isinstance(value, dict):
        raise _unknown(text, ".".join(path), list(_keys(value)))
    return path


def is_model_path(document: dict[str, Any], text: str) -> bool:
    """Returns whether a text begins with the name of a part of the model."""
    first = text.partition(".")[0]
    return first in document or first in _ALIASES or first in _BUS_PARTS


def value_at(document: Any, path: ValuePath) -> Any:
    """Returns the value at a path, or ``None`` if there is none."""
    for key in path:
        try:
            document = _child(document, key)
        except (KeyError, IndexError, TypeError, ValueError):
            return None
    return document


def all_paths(document: Any, path: ValuePath = ()) -> Iterator[ValuePath]:
    """Yields the paths of all values of a document, in the order of the model."""
    if isinstance(document, dict):
        for key in document:
            if key != ORDER:
                yield from all_paths(document[key], (*path, key))
    else:
        yield path


def next_names(paths: Iterable[str], start: str) -> list[str]:
    """Returns what can follow ``start`` in the paths, up to the next point that is a choice."""
    fitting = [path for path in paths if path.startswith(start)]
    names: list[str] = []
    while not names or (len(names) == 1 and names[0].endswith(".")):
        ends = [path.find(".", len(start)) + 1 or len(path) for path in fitting]
        names = sorted({path[:end] for path, end in zip(fitting, ends, strict=True)})
        if not names:
            return []
        start = names[0]
    return names


def observed_value(robot: Robot, path: ValuePath) -> Any:
    """Returns the value of a robot at a path in its JSON form, or ``None`` if there is none.

    Reading one value from the model is ten times faster than making the document of the model.
    """
    value: Any = robot
    for key in path:
        value = _element(value, key) if isinstance(value, tuple) else getattr(value, key, None)
        if value is None:
            return None
    return _plain(value)


def _element(elements: tuple[Any, ...], key: str) -> Any:
    """Returns the element of a tuple of the model with a name, or with an index."""
    for number, element in enumerate(elements):
        if isinstance(element, tuple) and len(element) == 2 and element[0] == key:
            return element[1]  # a pair of a name and a value
        name = getattr(element, "name", getattr(element, "joint", None))
        if hasattr(element, "subindex"):
            name = f"0x{element.index:04X}:{element.subindex}"
        if name == key or (name is None and str(number) == key):
            return element
    return elements[int(key)] if key.isdigit() and int(key) < len(elements) else None


def _plain(value: Any) -> Any:
    return [_plain(item) for item in value] if isinstance(value, tuple) else value


def with_values(robot: Robot, values: Mapping[ValuePath, Any]) -> Robot:
    """Returns a copy of a robot with other values at some paths.

    Raises ``ModelFormatError`` if a value has a wrong type.
    """
    head = json.loads(to_json(robot))
    for path, value in values.items():
        container: Any = head["model"]
        for key in path[:-1]:
            container = container[_raw_key(container, key)]
            if isinstance(container, list) and len(container) == 2 and container[0] == key:
                container = container[1]  # a list of pairs of a name and a value
        last = _raw_key(container, path[-1])
        if isinstance(container, list) and isinstance(container[last], list):
            container, last = container[last], 1
        container[last] = value
    changed = from_json(json.dumps(head))
    assert isinstance(changed, Robot)
    return replace(changed, meshes=robot.meshes)


def changed_value(value: Any, change: float) -> Any:
    """Returns a value that differs a little, or ``None`` for a text, which cannot."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + 1
    if isinstance(value, float):
        return value * (1.0 + change) if value else change
    if isinstance(value, list) and value and all(isinstance(item, float) for item in value):
        return [changed_value(item, change) for item in value]
    return None


def _raw_key(container: Any, key: str) -> Any:
    if not isinstance(container, list):
        return key
    names = element_names(container)
    return names.index(key) if names is not None else int(key)


def _child(value: Any, key: str) -> Any:
    return value[key] if isinstance(value, dict) else value[int(key)]


def _keys(value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        yield from (key for key in value if key != ORDER)
    elif isinstance(value, list):
        yield from map(str, range(len(value)))


def _step(value: Any, parts: list[str]) -> tuple[ValuePath, int] | None:
    """Returns the keys that the next parts name, and how many parts they are."""
    keys = list(_keys(value))
    modules = {  # the module of each element of a mapping of elements
        key: item["module"]
        for key, item in (value.items() if isinstance(value, dict) else ())
        if isinstance(item, dict) and isinstance(item.get("module"), str)
    }
    for length in range(len(parts), 0, -1):  # a name may contain dots, such as that of a mesh
        name = ".".join(parts[:length])
        if name in keys:
            return (name,), length
        of_module = [key for key, module in modules.items() if module == name]
        if len(of_module) == 1:
            return (of_module[0],), length
    part = parts[0]
    if isinstance(value, list) and len(value) == 3 and part in _AXES:
        return (_AXES[part],), 1
    if f"max_{part}" in keys:
        return (f"max_{part}",), 1
    starting = [key for key in keys if key.startswith(f"{part}_") and key in modules]
    if len(starting) == 1:
        return (starting[0],), 1
    if isinstance(value, dict):
        deeper = [key for key in keys if isinstance(value[key], dict) and part in value[key]]
        if len(deeper) == 1 and deeper[0] in _SECTIONS:
            return (deeper[0], part), 1
    return None


def _elements_named(document: dict[str, Any], word: str) -> list[str]:
    """Returns the paths of the elements whose names have a word, such as ``wheels.fl_wheel``."""
    paths = [
        f"{section}.{name}"
        for section, elements in sorted(document.items(), key=lambda item: item[0] != "wheels")
        if isinstance(elements, dict) and ORDER in elements
        for name in elements
        if name != ORDER and word in name.split("_")
    ]
    return [f"`{path}`" for path in paths]


def _unknown(
    text: str, path: str, keys: list[str], part: str = "", elsewhere: Sequence[str] = ()
) -> DiagnosticError:
    place = f"`{path}`" if path else "the model of the robot"
    shown = _listed(keys, MOST_SHOWN_NAMES)
    known = f"known: {shown}" if shown else None
    hint = did_you_mean(part, keys, known, fixable=False) if part else known
    if elsewhere:
        hint = f"there are {_listed(elsewhere, MOST_SHOWN_VALUES)}"
    message = f"{place} has no value `{part}`" if part else f"`{text}` is not a single value"
    return DiagnosticError("why-path-unknown", message, hint=hint)


def _listed(names: Sequence[str], most: int) -> str:
    return ", ".join(names[:most]) + (", ..." if len(names) > most else "")


# -- values in the text files of a build ------------------------------------------------

YAML_SUFFIXES = ("yaml", "yml", "json")
XML_SUFFIXES = ("xml", "urdf", "sdf", "xacro")
MOST_SHOWN_VALUES = 6
_NUMBER = re.compile(r"(?<![\w.])[-+]?(?:0x[0-9a-fA-F]+|\d+\.?\d*(?:[eE][-+]?\d+)?|\.\d+)")


class OutputValue(NamedTuple):
    """A value in a file of a build.

    - ``path``: names of the elements and keys around the value, and of the value.
    - ``text``: the value as it stands in the file.
    - ``line``: line of the value, from 1.
    """

    path: tuple[str, ...]
    text: str
    line: int

    @property
    def value(self) -> Any:
        """The value as a number if it is one."""
        try:
            return int(self.text, 0)
        except ValueError:
            pass
        try:
            return float(self.text)
        except ValueError:
            return self.text

    @property
    def name(self) -> str:
        return ".".join(self.path)


def output_values(name: str, text: str) -> list[OutputValue]:
    """Returns the values of a file of a build, in the order of the file."""
    suffix = name.rpartition(".")[2]
    if suffix in YAML_SUFFIXES:
        return list(_yaml_values(text))
    if suffix in XML_SUFFIXES:
        return _xml_values(text)
    return list(_line_values(text))


def find_value(name: str, values: list[OutputValue], query: str) -> OutputValue:
    """Returns the one value that a query names.

    The query is a number of a line, or names of the path in their order, such as
    ``fl_wheel_tyre.mass``; names may be left out.  Raises ``DiagnosticError``
    (``why-path-unknown``) if there is no such value or more than one.
    """
    line, _, rest = query.partition(".")
    candidates = values
    if line.isdigit():
        candidates = [value for value in values if value.line == int(line)]
        query = rest
    parts = [part for part in query.split(".") if part]
    matching = [value for value in candidates if _matches(value.path, parts)]
    exact = (
        [value for value in matching if value.path[-len(parts) :] == tuple(parts)] if parts else []
    )
    if len(matching) != 1 and len(exact) == 1:
        matching = exact
    if len(matching) == 1:
        return matching[0]
    if matching:
        shown = [f"`{value.name}` (line {value.line})" for value in matching]
        raise DiagnosticError(
            "why-path-unknown",
            f"{len(matching)} values of {name} match `{line if not parts else query}`",
            hint=_listed(shown, MOST_SHOWN_VALUES),
        )
    if line.isdigit() and not candidates:
        nearest = sorted(values, key=lambda value: abs(value.line - int(line)))
        near = [f"{n} (`{value.name}`)" for n, value in {v.line: v for v in nearest[::-1]}.items()]
        raise DiagnosticError(
            "why-path-unknown",
            f"line {line} of {name} has no value",
            hint=f"the next lines with one: {_listed(near[::-1], 3)}" if near else None,
        )
    inner = [value for value in candidates if parts and _matches(value.path[:-1], parts)]
    if inner:
        names = ", ".join(value.path[-1] for value in inner[:MOST_SHOWN_VALUES])
        raise DiagnosticError(
            "why-path-unknown", f"`{query}` of {name} is not a single value", hint=f"known: {names}"
        )
    words = {word: None for value in values for word in value.path}
    missing = next((part for part in parts if part not in words), query or line)
    raise DiagnosticError(
        "why-path-unknown",
        f"{name} has no value `{query or line}`",
        hint=did_you_mean(missing, words, fixable=False),
    )


def _matches(path: tuple[str, ...], parts: list[str]) -> bool:
    """Returns whether the parts are names of the path in the same order, with the last one last."""
    if not parts:
        return True
    if not path or path[-1] != parts[-1]:
        return False
    names = iter(path[:-1])
    return all(part in names for part in parts[:-1])


def _yaml_values(text: str) -> Iterator[OutputValue]:
    import yaml

    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    for root in yaml.compose_all(text, Loader=loader):
        if root is not None:
            yield from _yaml_node_values(root, ())


def _yaml_node_values(node: Any, path: tuple[str, ...]) -> Iterator[OutputValue]:
    if isinstance(node.value, str):
        yield OutputValue(path, node.value, node.start_mark.line + 1)
        return
    for number, item in enumerate(node.value):
        if isinstance(item, tuple):
            key, child = item
            yield from _yaml_node_values(child, (*path, str(key.value)))
        else:
            yield from _yaml_node_values(item, (*path, _item_name(item, number)))


def _item_name(node: Any, number: int) -> str:
    """Returns the name of an item of a list, or its number."""
    for item in node.value if isinstance(node.value, list) else ():
        if isinstance(item, tuple) and item[0].value == "name" and isinstance(item[1].value, str):
            return str(item[1].value)
    return str(number)


def _xml_values(text: str) -> list[OutputValue]:
    values: list[OutputValue] = []
    path: list[str] = []
    texts: list[str] = []
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        path.append(attributes.get("name", tag))
        texts.append("")
        for name, value in attributes.items():
            if name != "name":
                values.append(OutputValue((*path, name), value, parser.CurrentLineNumber))

    def end(tag: str) -> None:
        content = texts.pop().strip()
        if content:
            values.append(OutputValue((*path,), content, parser.CurrentLineNumber))
        path.pop()

    def characters(data: str) -> None:
        if texts:
            texts[-1] += data

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = characters
    parser.Parse(text, True)
    return values


def _line_values(text: str) -> Iterator[OutputValue]:
    """Yields the numbers of each line; the name of a number is its position in the line."""
    for number, line in enumerate(text.splitlines(), start=1):
        for position, match in enumerate(_NUMBER.finditer(line), start=1):
            yield OutputValue((str(number), str(position)), match[0], number)
