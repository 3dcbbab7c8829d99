"""The values in a text file of a build: YAML, JSON, XML, and the lines of any other file."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, NamedTuple
from xml.parsers import expat

from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.diagnostics.suggest import nearest

YAML_SUFFIXES = ("yaml", "yml", "json")
XML_SUFFIXES = ("xml", "urdf", "sdf", "xacro")
MOST_SHOWN = 6
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
        shown = ", ".join(f"`{value.name}` (line {value.line})" for value in matching[:MOST_SHOWN])
        more = ", ..." if len(matching) > MOST_SHOWN else ""
        raise DiagnosticError(
            "why-path-unknown",
            f"{len(matching)} values of {name} match `{line if not parts else query}`",
            hint=f"{shown}{more}",
        )
    inner = [value for value in candidates if parts and _matches(value.path[:-1], parts)]
    if inner:
        names = ", ".join(value.path[-1] for value in inner[:MOST_SHOWN])
        raise DiagnosticError(
            "why-path-unknown", f"`{query}` of {name} is not a single value", hint=f"known: {names}"
        )
    words = {word: None for value in values for word in value.path}
    missing = next((part for part in parts if part not in words), query or line)
    known = nearest(missing, list(words))
    raise DiagnosticError(
        "why-path-unknown",
        f"{name} has no value `{query or line}`",
        hint=f"did you mean `{known}`?" if known is not None else None,
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
