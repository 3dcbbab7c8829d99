"""A robot that is compiled with traced numbers, and the lines of its outputs with their origins."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from thorvaldc.compiler.modules.library import forget_modules
from thorvaldc.compiler.pipeline import compile_file, emit_without_model
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.reader import read_file
from thorvaldc.diagnostics import Report, Span
from thorvaldc.model import number_origins
from thorvaldc.tools.provenance import traced_number as tn

_ANY_MARK = rf"(?:{tn.MARK}|\\{{1,2}}u007f)"  # JSON escapes it in texts, and launch its backslash
_MARK = re.compile(rf"{_ANY_MARK}(\d+){_ANY_MARK}")
_QUOTED_NUMBER = re.compile(f'"({tn.MARK}[^"]*)"')


class Line(NamedTuple):
    """A line of an output, with the origins of its numbers."""

    text: str
    origins: int


class Place(NamedTuple):
    """A scalar of a document.

    - ``place``: file, line and column, with the path of the file from the working folder.
    - ``key``: position in the document, such as ``links.body.parts[0].mass``.
    - ``reason``: text of the key `source` beside it: where the author has it from.
    """

    place: str
    key: str
    text: str
    reason: str

    @property
    def is_expression(self) -> bool:
        return self.text.startswith("${")


class Trace:
    """A robot file without errors, compiled with traced numbers.

    ``spans`` has the place of each bit of origins.
    """

    def __init__(self, path: Path, library: Sequence[Path] = (), trust: bool = False) -> None:
        self.spans: dict[Span, int] = {}
        forget_modules()
        with self.following():
            self.compilation = compile_file(path, library=library, trust=trust)
        forget_modules()
        self.robot: Any = self.compilation.model
        self.root = self.compilation.instances[path.name]

    def read(self, value: Any, span: Span) -> Any:
        return tn.traced(value, 1 << self.spans.setdefault(span, len(self.spans)))

    def derive(self, value: Any, inputs: tuple[object, ...]) -> Any:
        return tn.traced(value, tn.origins_of(inputs))

    @contextmanager
    def following(self) -> Iterator[None]:
        """Within this context, the compiler and the backends pass origins on."""
        number_origins.follower = self
        try:
            with tn.traced_functions():
                yield
        finally:
            number_origins.follower = None

    @cached_property
    def places(self) -> dict[Span, Place]:
        """The scalars of all documents of the robot."""
        places: dict[Span, Place] = {}

        def walk(node: Node, key: str, reason: str) -> None:
            source = node.get("source")
            reason = str(source.value) if source is not None else reason
            if not isinstance(node.value, dict | tuple):
                places[node.span] = Place(self.shown(node.span), key[1:], str(node.value), reason)
            for name, child in node.children():
                walk(child, key + (f"[{name}]" if isinstance(name, int) else f".{name}"), reason)

        for name, path in self.compilation.files.items():
            document = read_file(path, name, Report()) if path.suffix == ".yaml" else None
            if document is not None:
                walk(document, "", "")
        return places

    def shown(self, span: Span) -> str:
        """Returns a span with the path of its file from the working folder."""
        path = self.compilation.files.get(span.file, Path(span.file))
        is_library = span.file.startswith("<")
        return str(span if is_library else span._replace(file=os.path.normpath(path)))

    def places_of(self, origins: int) -> list[Place]:
        """Returns the numbers and expressions of origins, in the order in which they were read.

        A default of a schema has the place of its section, which is no scalar.
        """
        spans = [span for span, bit in self.spans.items() if origins >> bit & 1]
        return [self.places[span] for span in spans if span in self.places]

    def lines(self, target: str) -> dict[str, list[Line]]:
        """Returns the lines of the text files of a target by the name of the file."""
        tn.TracedNumber.writes_marks = True
        try:
            with self.following():
                files = emit_without_model(self.robot, [target])
        finally:
            tn.TracedNumber.writes_marks = False
        sets, result = tn.origin_sets(), {}
        for name, content in files.items():
            if not name.endswith((".stl", "model.json")):
                text = content.decode("utf-8", "replace")
                text = _QUOTED_NUMBER.sub(r"\1", text) if name.endswith(".json") else text
                result[name] = [_line(line, sets) for line in text.splitlines()]
        return result


def _line(text: str, sets: list[int]) -> Line:
    origins = 0
    for mark in set(_MARK.findall(text)):
        origins |= sets[int(mark)]
    return Line(_MARK.sub("", text), origins)
