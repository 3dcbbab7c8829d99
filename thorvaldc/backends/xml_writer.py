"""A small XML writer: the same tree always gives the same text.

The attributes and children of an XML element are written in the order in which they were added. A
number is written in XML as the shortest text that reads back as the same number. The XML writer
escapes special characters in all text. The backends use this module instead of ``xml.etree``,
because this module is smaller and faster.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Iterable, Iterator

Number = float | int
Value = str | Number | bool | tuple[Number, ...]

_ESCAPES = {
    "&": "&amp;",
    "<": "&lt;",
    ">": "&gt;",
    '"': "&quot;",
    "\n": "&#10;",
    "\t": "&#9;",
    "\r": "&#13;",
}
_SPECIAL = re.compile('[&<>"\n\t\r]')


class XmlValueError(ValueError):
    """A number that an XML file cannot contain: infinity or NaN."""


def number(value: Number) -> str:
    """Return the shortest text that reads back as the same floating-point number, such as ``0.1``
    or ``1e-09``.

    Raises ``XmlValueError`` for infinite numbers and NaN.
    """
    text = repr(value if value else abs(value))  # 0 in place of -0
    if text.endswith(".0"):
        return text[:-2]
    if text[-1] in "nf":  # nan, inf
        raise XmlValueError(f"an XML file cannot contain the number {text}")
    return text


def numbers(values: Iterable[Number]) -> str:
    """Return numbers as XML text, separated by single spaces."""
    return " ".join(map(number, values))


@functools.lru_cache(maxsize=1 << 14)
def escape(text: str) -> str:
    """Return the text with XML escapes, for use in an attribute or between tags."""
    if _SPECIAL.search(text) is None:
        return text
    return _SPECIAL.sub(lambda match: _ESCAPES[match[0]], text)


@functools.cache
def _head(name: str) -> str:
    return f' {name.removesuffix("_")}="'


# The targets write the same names, poses and colours many times. The cache distinguishes the types,
# because ``True`` is equal to 1.
@functools.lru_cache(maxsize=1 << 14, typed=True)
def _format(value: Value) -> str:
    if isinstance(value, str):
        return escape(value)
    if isinstance(value, tuple):
        return numbers(value)
    if isinstance(value, bool):
        return "true" if value else "false"
    return number(value)


def _attributes_text(attributes: dict[str, Value | None]) -> str:
    text = ""
    for name, value in attributes.items():
        if value is not None:
            text += f'{_head(name)}{_format(value)}"'
    return text


class Element:
    """An XML element with attributes and either children or text.

    ``attributes`` contains the attributes of the XML element with their text in the file.
    """

    __slots__ = ("attributes", "children", "tag", "text")

    def __init__(self, tag: str, /, **attributes: Value | None) -> None:
        self.tag = tag
        self.attributes = _attributes_text(attributes) if attributes else ""
        self.children: list[Element] = []
        self.text = ""

    def set(self, **attributes: Value | None) -> None:
        """Add attributes to the XML element. XML attributes with the value ``None`` are omitted.

        A trailing underscore is removed from the name of an XML attribute. A trailing underscore
        allows XML attribute names that are keywords of Python, such as ``class_``.
        """
        self.attributes += _attributes_text(attributes)

    def add(self, tag: str, /, **attributes: Value | None) -> Element:
        """Append a new child element to the XML element and return the child."""
        child = Element(tag)
        if attributes:
            child.attributes = _attributes_text(attributes)
        self.children.append(child)
        return child

    def fill(self, **texts: Value | None) -> Element:
        """Append a child element for the text of each value but ``None``; return this element."""
        for tag, value in texts.items():
            if value is not None:
                self.add(tag).text = value if isinstance(value, str) else _format(value)
        return self

    def append(self, child: Element) -> Element:
        self.children.append(child)
        return child


Rename = Callable[[str, str, str], str]


def parse(text: str, rename: Rename | None = None) -> Element:
    """Parse an XML text and return its root element. Tags such as ``a:b`` keep the prefix of the
    XML name space.

    The function ``rename`` receives the tag, the attribute name and the value of each XML
    attribute, and returns the new value. For the text of an XML element, ``rename`` receives an
    empty attribute name. The XML parser omits comments and text beside child elements. Raises
    ``ValueError`` if the text is not well-formed XML.
    """
    from xml.parsers import expat

    top = Element("")
    stack = [top]

    def start(tag: str, attributes: list[str]) -> None:
        child = Element(tag)
        for name, value in zip(attributes[::2], attributes[1::2], strict=True):
            if rename is not None:
                value = rename(tag, name, value)
            child.attributes += f' {name}="{escape(value)}"'
        stack.append(stack[-1].append(child))

    def end(tag: str) -> None:
        element = stack.pop()
        if element.children or not element.text.strip():
            element.text = ""
        elif rename is not None:
            element.text = rename(tag, "", element.text.strip())

    def data(text: str) -> None:
        stack[-1].text += text

    parser = expat.ParserCreate()
    parser.ordered_attributes = True
    parser.buffer_text = True
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = data
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise ValueError(f"not well-formed XML: {error}") from error
    return top.children[0]


def to_bytes(root: Element) -> bytes:
    """Return the XML document as UTF-8, indented by two spaces, with an XML declaration."""
    return to_text(root).encode("utf-8")


def to_text(root: Element) -> str:
    """Return the XML document as text, indented by two spaces, with an XML declaration."""
    lines = ['<?xml version="1.0" encoding="utf-8"?>']
    _write(lines, root, "")
    lines.append("")
    return "\n".join(lines)


def add_to_root(document: str, root: str, children: Iterable[Element]) -> str:
    """Return an XML document with more child elements at the end of its root element.

    ``document`` is the result of ``to_text`` for an element with the tag ``root`` and children.
    """
    lines: list[str] = []
    for child in children:
        _write(lines, child, "  ")
    end = f"</{root}>\n"
    return "".join([document.removesuffix(end), *(f"{line}\n" for line in lines), end])


def _write(lines: list[str], root: Element, indent: str) -> None:
    # The function uses a stack and no recursion, because a long chain of links is nested deeper
    # than Python's recursion limit.
    stack: list[tuple[Iterator[Element], str, str]] = []
    siblings: Iterator[Element] = iter((root,))
    while True:
        for element in siblings:
            head = f"{indent}<{element.tag}{element.attributes}"
            if element.children:
                lines.append(head + ">")
                stack.append((siblings, indent, f"{indent}</{element.tag}>"))
                siblings, indent = iter(element.children), indent + "  "
                break
            if element.text:
                lines.append(f"{head}>{escape(element.text)}</{element.tag}>")
            else:
                lines.append(head + "/>")
        else:
            if not stack:
                return
            siblings, indent, end = stack.pop()
            lines.append(end)
