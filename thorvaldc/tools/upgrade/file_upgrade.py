"""Applies the rules to a file, in memory."""

from __future__ import annotations

import difflib
import re
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

from thorvaldc.compiler.source.input_file import read_bytes
from thorvaldc.compiler.source.reader import MAX_BYTES, read_text
from thorvaldc.compiler.validation.document_check import check, kind_of, report_wrong_kind
from thorvaldc.diagnostics import Diagnostic, Fix, Report, Span
from thorvaldc.schema import Kind
from thorvaldc.tools.upgrade.document import Document
from thorvaldc.tools.upgrade.rules import RULES, Context, Decision, Rule

MOST_ROUNDS = 1000
"""Greatest number of times that a rule is applied to a file.  One round changes each place once."""


@dataclass
class Upgrade:
    """What the rules do with one file.

    - ``path``: path of the file.
    - ``before``: the document as it is, or ``None`` if it cannot be upgraded.
    - ``after``: the document in the present language.
    - ``changes``: number of changes by each rule.
    - ``report``: errors, and what a person must decide.
    """

    path: Path
    before: Document | None = None
    after: Document | None = None
    changes: Counter[str] = field(default_factory=Counter)
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


def upgrade_file(path: Path, context: Context) -> Upgrade:
    """Returns what the rules do with a file.  Nothing is written."""
    upgrade = Upgrade(path)
    upgrade.before = upgrade.after = read_document(path, upgrade.report)
    for rule in RULES:
        if upgrade.after is not None and upgrade.after.kind in rule.kinds:
            upgrade.after = _applied(rule, upgrade.after, context, upgrade)
    return upgrade


def _applied(rule: Rule, document: Document, context: Context, upgrade: Upgrade) -> Document:
    """Applies a rule until it changes nothing, and adds what is left to the report."""
    for _ in range(MOST_ROUNDS):
        findings = list(rule.find(document, context))
        fixes = list(dict.fromkeys(f for f in findings if isinstance(f, Fix)))
        changed = document.changed(fixes)
        if changed is None:
            break
        upgrade.changes[rule.name] += len({fix.span for fix in fixes})
        document = changed
    for item in findings:
        if isinstance(item, Decision):
            upgrade.report.add("upgrade-decision", item.message, item.span, hint=item.hint)
        elif isinstance(item, Diagnostic) and item.span is not None:
            # The file has a name of its own in the library.
            span = Span(str(document.path), *item.span[1:])
            upgrade.report.put(replace(item, span=span, fixes=()))
    return document


def kind_of_file(path: Path) -> Kind | None:
    """Returns the kind of the document in a file, or ``None``."""
    document = read_document(path, Report())
    return document.kind if document is not None else None
