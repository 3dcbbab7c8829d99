"""Rewrites the words of a file that have another name, in memory.

A word that has gone, or stands beside its new name, is a decision for a person.
``docs/upgrade.md`` lists the words, which are in ``schema/old_words.py``.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from thorvaldc.compiler.source.input_file import read_bytes
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.reader import MAX_BYTES, read_text
from thorvaldc.compiler.validation.document_check import check, kind_of, report_wrong_kind
from thorvaldc.compiler.values.value_reader import entries
from thorvaldc.diagnostics import Fix, Report, Span
from thorvaldc.schema.old_words import OldWord, old_keys, old_value
from thorvaldc.tools.upgrade.document import Document


@dataclass
class Upgrade:
    """What happens to the words of one file.

    - ``path``: path of the file.
    - ``before``: the document as it is, or ``None`` if it cannot be upgraded.
    - ``after``: the document in the present language.
    - ``changes``: number of words that were renamed.
    - ``report``: errors, and what a person must decide.
    """

    path: Path
    before: Document | None = None
    after: Document | None = None
    changes: int = 0
    report: Report = field(default_factory=Report)

    @property
    def is_changed(self) -> bool:
        """Whether the file is to be rewritten."""
        return self.before is not None and self.after is not None and bool(self.changes)

    def difference(self) -> str:
        """Returns the unified difference of the old and the new text."""
        if self.before is None or self.after is None:
            return ""
        old, new = (_lines(document.text) for document in (self.before, self.after))
        return "".join(difflib.unified_diff(old, new, str(self.path), str(self.path)))


def _lines(text: str) -> list[str]:
    """Returns the lines of a text, with ``\\n`` at their ends."""
    lines = re.split(r"\r\n|\r|\n", text)
    ended = [f"{line}\n" for line in lines[:-1]]
    return [*ended, f"{lines[-1]}\n\\ No newline at end of file\n"] if lines[-1] else ended


def read_document(path: Path, report: Report) -> Document | None:
    """Reads a document, and returns ``None`` if it cannot be upgraded."""
    name = str(path)
    hint = "name the files in it, such as `robot.yaml`"
    data = read_bytes(path, name, report, limit=MAX_BYTES + 1, cut=True, folder_hint=hint)
    root = read_text(data, name, report) if data is not None else None
    if root is None or data is None or report.has_errors:
        return None
    kind = kind_of(data.decode("utf-8-sig"), path.name)
    if kind is None:
        if not report_wrong_kind(root, report):
            message = f"`{name}` is no document of thorvaldc: it has no key `thorvaldc`"
            report.add("other-document", message, Span(name), hint="it begins with `thorvaldc: 1`")
        return None
    if not _has_present_version(Document(path, kind, data, root), report):
        return None
    return Document(path, kind, data, root)


def _has_present_version(document: Document, report: Report) -> bool:
    """Reports a version of the language that this program does not read."""
    schema_report = Report()
    check(document.root, document.kind, schema_report)
    versions = [d for d in schema_report if d.code.name == "language-version"]
    report.extend(versions)
    return not versions


class Decision(NamedTuple):
    """What a person must decide about a place of a file."""

    span: Span
    message: str
    hint: str


def upgrade_file(path: Path) -> Upgrade:
    """Returns what happens to a file.  Nothing is written."""
    upgrade = Upgrade(path)
    upgrade.before = upgrade.after = read_document(path, upgrade.report)
    if upgrade.before is None:
        return upgrade
    fixes = [item for item in find_old_words(upgrade.before) if isinstance(item, Fix)]
    changed = upgrade.before.changed(fixes)
    if changed is not None:
        upgrade.after, upgrade.changes = changed, len({fix.span for fix in fixes})
    for item in find_old_words(changed or upgrade.before):
        if isinstance(item, Decision):
            upgrade.report.add("upgrade-decision", item.message, item.span, hint=item.hint)
    return upgrade


def find_old_words(document: Document) -> Iterator[Fix | Decision]:
    """Yields the words that the language had: renamed ones as changes, others as decisions."""
    for path, node in document.root.walk():
        if path and document.is_unit:  # its first key can be a dotted path
            path = (*str(path[0]).split("."), *path[1:])
        if node.key_span is not None:
            for word in old_keys(document.kind, path):
                siblings = _at(document.root, path[:-1])
                if not word.types or _type_of(document.whole, path) in word.types:
                    yield _renamed(word, node.key_span, word.new in siblings)
        word_of_value = old_value(document.kind, path, node.value)
        if word_of_value is not None:
            yield _renamed(word_of_value, node.span, False)


def _renamed(word: OldWord, span: Span, is_taken: bool) -> Fix | Decision:
    old = word.value or word.path[-1]
    if word.new and not is_taken:
        return Fix(span, word.new)
    hint = f"keep one of `{old}` and `{word.new}`" if word.new else word.advice
    return Decision(span, f"`{old}` is not a word of the language any more", hint)


def _at(root: Node, path: Sequence[str | int]) -> dict[str, Node]:
    node: Node | None = root
    for key in path:
        node = entries(node).get(str(key))
    return entries(node)


def _type_of(root: Node, path: Sequence[str | int]) -> object:
    """Returns the type of the module to whose ``params`` a path belongs."""
    node = _at(root, path[:-2]).get("type")
    return node.value if node is not None else None
