"""A document with its text, and changes of the text by source spans."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from thorvaldc.compiler.source.node import Node, edited
from thorvaldc.compiler.source.reader import read_text
from thorvaldc.compiler.values.unit_file import with_design
from thorvaldc.diagnostics import Fix, Report
from thorvaldc.schema import Kind

BYTE_ORDER_MARK = b"\xef\xbb\xbf"


@dataclass(frozen=True)
class Document:
    """A document of the language.

    - ``path``: path of the file, as the user wrote it; its text is the name in spans.
    - ``kind``: kind of the document.
    - ``data``: bytes of the document, in UTF-8.
    - ``root``: YAML tree of ``data``.
    """

    path: Path
    kind: Kind
    data: bytes
    root: Node

    @property
    def is_unit(self) -> bool:
        """Whether it is the file of a unit, which names that of its design."""
        return self.kind == "robot" and self.root.get("extends") is not None

    @cached_property
    def whole(self) -> Node:
        """The YAML tree, of a unit with the entries of its design."""
        whole = with_design(self.root, {}, self.path, Report()) if self.is_unit else None
        return whole or self.root

    @cached_property
    def text(self) -> str:
        """The text with its line breaks, without a byte order mark."""
        return self.data.decode("utf-8-sig")

    def changed(self, changes: Iterable[Fix]) -> Document | None:
        """Returns the document with changes that do not overlap.

        An alias repeats the spans of its anchor.  Returns ``None`` if there is no change, or if
        the new text is no YAML document.
        """
        replacements = {change.span: change.text for change in changes}
        text = edited(self.text, replacements)
        mark = BYTE_ORDER_MARK if self.data.startswith(BYTE_ORDER_MARK) else b""
        report, data = Report(), mark + text.encode()
        root = read_text(data, str(self.path), report) if replacements else None
        if root is None or report.has_errors:
            return None
        return Document(self.path, self.kind, data, root)
