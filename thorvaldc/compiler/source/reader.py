"""YAML text to a tree of nodes with spans.

PyYAML composes the tree; what a plain scalar means is decided here, by YAML
1.2's core schema, with an error where YAML readers differ (``on``, ``010``).
A fault in a single value does not end the reading: the value gets the most
likely meaning, so that the faults of later stages are found in the same run.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from thorvaldc.compiler.source import yaml_errors
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.scalars import key_kind, plain_scalar
from thorvaldc.diagnostics import Label, Report, Span

MAX_BYTES = 1_000_000
MAX_VALUES = 100_000
MAX_DEPTH = 50


def read_file(path: Path, display: str, report: Report) -> Node | None:
    """The document in ``path``, called ``display`` in messages; ``None`` if there is none."""
    try:
        with path.open("rb") as file:
            # One byte more than allowed tells "too large" without reading all of it.
            data = file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        report.add("file-not-found", f"`{display}` does not exist", Span(display))
        return None
    except IsADirectoryError:
        report.add(
            "file-is-a-directory",
            f"`{display}` is a folder; a file is wanted",
            Span(display),
            hint="name the file in it, such as `robot.yaml`",
        )
        return None
    except (OSError, ValueError) as error:
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
        report.add("file-unreadable", f"`{display}` cannot be read: {reason}", Span(display))
        return None
    return read_text(data, display, report)


def read_text(data: bytes, file: str, report: Report) -> Node | None:
    """The document in ``data``; ``None`` where it is no YAML document at all.

    ``file`` is the name for spans.  Faults go to ``report``; a node may come
    back although there were some.
    """
    root = compose(data, file, report, hint_if_empty=_EMPTY_HINT)
    if root is None:
        return None
    try:
        return _Reader(file, report, b"&" in data).node(root, None)
    except _Refused as refused:
        report.add(refused.code, refused.message, _point(refused.mark, file), hint=refused.hint)
        return None


def compose(
    data: bytes, file: str, report: Report, *, hint_if_empty: str | None = None
) -> Any | None:
    """PyYAML's tree of the document in ``data``, within bounds; ``None`` with the fault reported.

    What the scalars mean is left to the caller: only explicit tags are set.
    """
    text = _decode(data, file, report)
    if text is None:
        return None
    loader = _Loader(text)
    try:
        root = loader.get_single_node()
    except yaml.MarkedYAMLError as error:
        yaml_errors.explain(error, text, file, report)
        return None
    except _Refused as refused:
        report.add(refused.code, refused.message, _point(refused.mark, file), hint=refused.hint)
        return None
    finally:
        loader.dispose()
    if root is None or (root.id == "scalar" and root.value == "" and not root.style):
        report.add("yaml-empty", f"`{file}` is empty", Span(file), hint=hint_if_empty)
        return None
    return root


_EMPTY_HINT = "a document begins with `thorvaldc: 1`"

# -- characters -------------------------------------------------------------------

# C0 and C1 controls, the line breaks that only YAML 1.1 knows (U+0085, U+2028, U+2029:
# editors do not count them), surrogates, a byte order mark inside, and non-characters.
_FORBIDDEN = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff\ufeff\ufffe\uffff]"
)
_CHARACTER_NAMES = {
    "\x00": "a NUL character",
    "\x85": "a next-line character",
    "\u2028": "a line separator",
    "\u2029": "a paragraph separator",
    "\ufeff": "a byte order mark",
}


def _decode(data: bytes, file: str, report: Report) -> str | None:
    if len(data) > MAX_BYTES:
        report.add(
            "yaml-file-too-large",
            f"`{file}` is larger than {MAX_BYTES} bytes, the most that a document may have",
            Span(file),
            hint="meshes and other data belong in files of their own",
        )
        return None
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        report.add("yaml-encoding", "the file is UTF-16", Span(file), hint="save it as UTF-8")
        return None
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = data[: error.start].decode("utf-8-sig", "replace")
        report.add(
            "yaml-encoding",
            f"the byte 0x{data[error.start]:02x} is not UTF-8",
            _at(before, len(before), file),
            hint="save the file as UTF-8",
        )
        return None
    found = _FORBIDDEN.search(text)
    if found:
        name = _CHARACTER_NAMES.get(found[0], "a control character")
        report.add(
            "yaml-character",
            f"{name} (U+{ord(found[0]):04X}) is not allowed in YAML",
            _at(text, found.start(), file),
            hint="remove it; in double quotes it can be written as an escape",
        )
        return None
    return text


_LINE_BREAK = re.compile(r"\r\n|\r|\n")


def _at(text: str, index: int, file: str) -> Span:
    """The span of one character."""
    line, start = 1, 0
    for found in _LINE_BREAK.finditer(text, 0, index):
        line, start = line + 1, found.end()
    column = index - start + 1
    return Span(file, line, column, line, column + 1)


# -- composing ----------------------------------------------------------------------


class _Refused(Exception):
    def __init__(self, code: str, message: str, mark: Any, hint: str) -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        self.mark = mark
        self.hint = hint


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """Composes without resolving tags (so that a tag means an explicit one), within bounds.

    The composer recurses in C, hence the depth is bounded while it runs.
    """

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = 0
        self._count = 0

    def resolve(self, kind: Any, value: Any, implicit: Any) -> str:
        return ""

    def descend_resolver(self, parent: Any, index: Any) -> None:
        self._depth += 1
        self._count += 1
        if self._depth > MAX_DEPTH:
            raise _Refused(
                "yaml-too-deep",
                f"the document is nested more than {MAX_DEPTH} levels deep",
                parent.start_mark,
                "no robot needs that; look for a bracket that is opened by mistake",
            )
        if self._count > MAX_VALUES:
            raise _too_many(parent.start_mark)

    def ascend_resolver(self) -> None:
        self._depth -= 1


def _too_many(mark: Any) -> _Refused:
    return _Refused(
        "yaml-too-many-values",
        f"the document has more than {MAX_VALUES} values, aliases expanded",
        mark,
        "split it, or let an assembly describe what repeats",
    )


def _point(mark: Any, file: str) -> Span:
    line, column = mark.line + 1, mark.column + 1
    return Span(file, line, column, line, column + 1)


class _Reader:
    """Turns composed nodes into ours.

    Where the text has ``aliases``, a node may be met again: it is read once, and
    what it holds counts each time.
    """

    def __init__(self, file: str, report: Report, aliases: bool) -> None:
        self.file = file
        self.report = report
        self.node = self._shared if aliases else self._made
        self.done: dict[int, tuple[Node, int]] = {}  # by id, with the number of values in it
        self.open: set[int] = set()
        self.total = 0

    def _shared(self, raw: Any, key_span: Span | None) -> Node:
        known = self.done.get(id(raw))
        if known is not None:
            made, values = known
            self._count(values, raw)
            return Node(made.value, made.span, key_span, made.quoted)
        if id(raw) in self.open:
            raise _Refused(
                "yaml-recursive-alias",
                "an alias refers to a value that contains it",
                raw.start_mark,
                "write the value out",
            )
        self.open.add(id(raw))
        before = self.total
        self._count(1, raw)
        made = self._made(raw, key_span)
        self.open.discard(id(raw))
        self.done[id(raw)] = made, self.total - before
        return made

    def _count(self, values: int, raw: Any) -> None:
        self.total += values
        if self.total > MAX_VALUES:
            raise _too_many(raw.start_mark)

    def _made(self, raw: Any, key_span: Span | None) -> Node:
        if raw.tag:
            self._refuse_tag(raw)
        if raw.id == "mapping":
            return self._mapping(raw, key_span)
        if raw.id == "sequence":
            return self._sequence(raw, key_span)
        span = self._span(raw)
        if raw.style:
            return Node(raw.value, span, key_span, True)
        return Node(plain_scalar(raw.value, span, self.report), span, key_span)

    def _span(self, raw: Any) -> Span:
        start, end = raw.start_mark, raw.end_mark
        return Span(self.file, start.line + 1, start.column + 1, end.line + 1, end.column + 1)

    def _collection_span(self, raw: Any, last: Span | None) -> Span:
        """A block collection ends with its last value; YAML's mark is at the next token."""
        span = self._span(raw)
        # The value of an alias lies elsewhere.
        if raw.flow_style or last is None or last[1:3] < span[1:3]:
            return span
        return Span(self.file, span.line, span.column, last.end_line, last.end_column)

    def _sequence(self, raw: Any, key_span: Span | None) -> Node:
        values = tuple([self.node(item, None) for item in raw.value])
        span = self._collection_span(raw, values[-1].span if values else None)
        return Node(values, span, key_span)

    def _mapping(self, raw: Any, key_span: Span | None) -> Node:
        values: dict[str, Node] = {}
        last: Node | None = None
        for raw_key, raw_value in raw.value:
            where = self._span(raw_key)
            key = self._key(raw_key, where)
            last = self.node(raw_value, where)
            if key is None:
                continue
            if key in values:
                first = values[key].where
                self.report.add(
                    "yaml-duplicate-key",
                    f"the key `{key}` occurs twice",
                    where,
                    hint="keep one of them",
                    labels=[Label(first, "first used here")],
                )
                continue
            values[key] = last
        span = self._collection_span(raw, last.span if last else None)
        return Node(values, span, key_span)

    def _key(self, raw: Any, where: Span) -> str | None:
        """The text of a key; ``None`` where it is unusable."""
        if raw.id != "scalar":
            self.report.add(
                "yaml-key-not-text",
                f"a {'list' if raw.id == 'sequence' else 'mapping'} cannot be a key",
                where,
                hint='in a value, quote braces that are meant as text, as in `"${width}"`',
            )
            return None
        text: str = raw.value
        if raw.tag:
            self._refuse_tag(raw)
        if raw.style:
            return text
        if text == "<<":
            self.report.add(
                "yaml-merge-key",
                "merge keys (`<<`) are not part of YAML 1.2",
                where,
                hint="write the entries out, or put what modules share under `defaults`",
            )
            return None
        kind = key_kind(text)
        if kind is not None:
            self.report.add(
                "yaml-key-not-text",
                f"the key `{text}` is {kind}; keys are text" if text else "a key is empty",
                where,
                hint=f'write `"{text}"` if this is its name' if text else None,
            )
        return text

    def _refuse_tag(self, raw: Any) -> None:
        tag = raw.tag.replace("tag:yaml.org,2002:", "!!")
        self.report.add(
            "yaml-tag",
            f"the tag `{tag}` is not part of the language",
            _point(raw.start_mark, self.file),
            hint="leave it off; quote the value if it is text",
        )
