"""Reads XML files as elements with source spans, without document types and entities."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.parsers import expat

from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.diagnostics import Span
from thorvaldc.model import Vec3

MAX_ELEMENTS = 200_000
MAX_DEPTH = 100


class XmlError(Exception):
    """Raised if a file is not XML that is read here; ``span`` is the place of the error."""

    def __init__(self, text: str, span: Span) -> None:
        super().__init__(text)
        self.span = span


class _OpenElement:
    def __init__(self, tag: str, attributes: dict[str, str], span: Span) -> None:
        self.tag = tag
        self.attributes = attributes
        self.span = span
        self.children: list[Element] = []
        self.texts: list[str] = []


def read_xml(data: bytes, display: str, path: Path) -> Element:
    """Returns the root element of an XML document.

    Raises ``XmlError`` if the text is not XML, has a document type with entities, is nested more
    than ``MAX_DEPTH`` levels deep or has more than ``MAX_ELEMENTS`` elements.
    """
    parser = expat.ParserCreate()
    open_elements = [_OpenElement("", {}, Span(display))]
    count = 0

    def here(length: int = 1) -> Span:
        line, column = parser.CurrentLineNumber, parser.CurrentColumnNumber + 1
        return Span(display, line, column, line, column + length)

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if count > MAX_ELEMENTS:
            raise XmlError(f"it has more than {MAX_ELEMENTS} elements", here())
        if len(open_elements) > MAX_DEPTH:
            raise XmlError(f"it is nested more than {MAX_DEPTH} levels deep", here())
        open_elements.append(_OpenElement(tag, attributes, here(len(tag) + 1)))

    def end(tag: str) -> None:
        raw = open_elements.pop()
        text = "".join(raw.texts).strip()
        element = Element(raw.tag, raw.attributes, tuple(raw.children), text, raw.span, (), path)
        open_elements[-1].children.append(element)

    def refuse(*_: Any) -> None:
        raise XmlError("it defines entities", here())

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = lambda text: open_elements[-1].texts.append(text)
    parser.EntityDeclHandler = refuse
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        span = Span(display, error.lineno, error.offset + 1, error.lineno, error.offset + 2)
        text = expat.ErrorString(error.code)
        raise XmlError(f"line {error.lineno}: {text}", span) from None
    except LookupError as error:  # an encoding that Python does not know
        raise XmlError(str(error), here()) from None
    return open_elements[0].children[0]


def numbers(text: str | None, count: int) -> tuple[float, ...] | None:
    """Returns the ``count`` numbers of a text, or ``None`` if it does not contain them."""
    if text is None:
        return None
    try:
        values = tuple(float(word) for word in text.split())
    except ValueError:
        return None
    return values if len(values) == count and all(abs(v) < 1e300 for v in values) else None


def vector(text: str | None, default: Vec3 = (0.0, 0.0, 0.0)) -> Vec3:
    """Returns the vector in a text, or the default if the text does not contain three numbers."""
    values = numbers(text, 3)
    return default if values is None else (values[0], values[1], values[2])


def walk(element: Element) -> list[Element]:
    """Returns an element and all elements in it, in the order of the file."""
    elements = [element]
    for child in element.children:
        elements += walk(child)
    return elements
