"""Reads XML files, and makes the URDF elements of models in other formats.

Models in SDF and MJCF become URDF elements first, so that one reader reads all three.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.parsers import expat

from thorvaldc.compiler.descriptions.facts import UNLIMITED, UnreadableFileError
from thorvaldc.compiler.extras.plugin_facts import numbers
from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.diagnostics import Span
from thorvaldc.model import Pose, Vec3

# -- XML files, without document types and entities -------------------------------------

MAX_ELEMENTS = 200_000
MAX_DEPTH = 100


def read_xml(data: bytes, display: str, path: Path) -> Element:
    """Returns the root element of an XML document.

    Raises ``UnreadableFileError`` if the text is not XML, has a document type with entities, is
    nested more than ``MAX_DEPTH`` levels deep or has more than ``MAX_ELEMENTS`` elements.
    """
    parser = expat.ParserCreate()
    # The open elements: attributes, place, children and texts of each.
    stack: list[tuple[dict[str, str], Span, list[Element], list[str]]] = [({}, Span(""), [], [])]
    count = 0

    def here(length: int = 1) -> Span:
        line, column = parser.CurrentLineNumber, parser.CurrentColumnNumber + 1
        return Span(display, line, column, line, column + length)

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if count > MAX_ELEMENTS:
            raise UnreadableFileError(f"it has more than {MAX_ELEMENTS} elements", here())
        if len(stack) > MAX_DEPTH:
            raise UnreadableFileError(f"it is nested more than {MAX_DEPTH} levels deep", here())
        stack.append((attributes, here(len(tag) + 1), [], []))

    def end(tag: str) -> None:
        attributes, span, children, texts = stack.pop()
        text = "".join(texts).strip()
        stack[-1][2].append(Element(tag, attributes, tuple(children), text, span, (), path))

    def refuse(*_: Any) -> None:
        raise UnreadableFileError("it defines entities", here())

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = lambda text: stack[-1][3].append(text)
    parser.EntityDeclHandler = refuse
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        span = Span(display, error.lineno, error.offset + 1, error.lineno, error.offset + 2)
        text = expat.ErrorString(error.code)
        raise UnreadableFileError(f"line {error.lineno}: {text}", span) from None
    except LookupError as error:  # an encoding that Python does not know
        raise UnreadableFileError(str(error), here()) from None
    return stack[0][2][0]


def vector(text: str | None, default: Vec3 = (0.0, 0.0, 0.0)) -> Vec3:
    """Returns the vector in a text, or the default if the text does not contain three numbers."""
    values = numbers(text, 3)
    return default if values is None else (values[0], values[1], values[2])


# -- URDF elements ----------------------------------------------------------------------


class UrdfElements:
    """Makes the URDF elements of a model in another format, at one place of the file."""

    def __init__(self, source: Element) -> None:
        self.source = source

    def element(self, tag: str, /, *children: Element | None, **attributes: str) -> Element:
        inner = tuple(child for child in children if child is not None)
        return Element(tag, attributes, inner, "", self.source.span, (), self.source.file)

    def origin(self, pose: Pose) -> Element:
        return self.element("origin", xyz=_text(pose.xyz), rpy=_text(pose.rpy()))

    def joint(
        self,
        name: str,
        kind: str,
        parent: str,
        child: str,
        pose: Pose,
        axis: Vec3 = (0.0, 0.0, 1.0),
        limits: Mapping[str, float] | None = None,
        limit_source: Element | None = None,
        dynamics: Mapping[str, str] | None = None,
    ) -> Element:
        """Returns a joint.

        - ``limits``, ``dynamics``: values of the attributes of ``<limit>`` and ``<dynamics>``.
        - ``limit_source``: element that states the limits, if it is not the joint.
        """
        known = {n: v for n, v in (limits or {}).items() if n in _UNLIMITED}
        stated = {n: repr(v) for n, v in known.items() if abs(v) < UNLIMITED}
        if kind == "revolute" and not {"lower", "upper"} & stated.keys():
            kind = "continuous"
        if kind in ("revolute", "prismatic"):
            stated = _UNLIMITED | stated  # URDF requires all of them
        limit = UrdfElements(limit_source or self.source).element("limit", **stated)
        return self.element(
            "joint",
            self.origin(pose),
            self.element("parent", link=parent),
            self.element("child", link=child),
            self.element("axis", xyz=_text(axis)),
            limit if stated else None,
            self.element("dynamics", **dynamics) if dynamics else None,
            name=name,
            type=kind,
        )


_UNLIMITED = {"lower": "-1e16", "upper": "1e16", "velocity": "1e16", "effort": "1e16"}


def _text(values: Sequence[float]) -> str:
    return " ".join(map(repr, values))
