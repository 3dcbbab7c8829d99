"""Reads YAML documents, and keeps the line and column of each value (source span).

The package PyYAML parses the text of a YAML document.  The module ``node`` converts unquoted
YAML scalars by the core schema of YAML 1.2.  Values such as ``on`` and ``010`` are reported,
because YAML 1.1 and YAML 1.2 interpret them differently.  If a YAML value has an error, the reader
returns the most likely value.  With the most likely value, later stages of the compiler can
continue and report further errors in the same run.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from thorvaldc.compiler.source.input_file import read_bytes
from thorvaldc.compiler.source.node import (
    Node,
    is_decimal_comma,
    join_split_values,
    key_kind,
    plain_scalar,
    report_decimal_comma,
)
from thorvaldc.diagnostics import FIRST_USE, Label, Proposal, Report, Span

MAX_BYTES = 1_000_000
MAX_VALUES = 100_000
MAX_DEPTH = 50


def read_file(path: Path, display: str, report: Report) -> Node | None:
    """Reads a YAML file.  Returns ``None`` if the YAML file is not readable.

    - ``display``: name of the file in messages.
    """
    # The reader reads one byte more than the size limit, to detect a file that is too large.
    hint = "name the file in it, such as `robot.yaml`"
    data = read_bytes(path, display, report, limit=MAX_BYTES + 1, cut=True, folder_hint=hint)
    if data is None:
        return None
    return read_text(data, display, report)


def read_text(data: bytes, file: str, report: Report) -> Node | None:
    """Parses a YAML document.  Returns ``None`` if ``data`` is not a YAML document.

    - ``file``: file name in source spans.
    - ``report``: report that receives the errors.

    If some YAML values have errors, returns the document with the most likely values.
    """
    root = compose(data, file, report, hint_if_empty=_EMPTY_HINT)
    if root is None:
        return None
    try:
        return _Reader(file, report, b"&" in data).node(root, None)
    except _YamlError as error:
        report.add(error.code, error.message, _character_span(error.mark, file), hint=error.hint)
        return None


def compose(
    data: bytes, file: str, report: Report, *, hint_if_empty: str | None = None
) -> Any | None:
    """Parses a YAML document and returns PyYAML's tree of nodes.

    If the YAML document has an error, adds a diagnostic to ``report`` and returns ``None``.  The
    size and the nesting depth of a YAML document are limited.  YAML scalars are returned as text.
    A PyYAML node has a tag only if the document contains an explicit tag.
    """
    text = None if _is_other_format(data, file, report) else _decode(data, file, report)
    if text is None:
        return None
    try:
        root = _root_of(text)
    except yaml.MarkedYAMLError as error:
        from thorvaldc.compiler.source.yaml_errors import explain

        explain(error, text, file, report)
        return None
    except _YamlError as error:
        report.add(error.code, error.message, _character_span(error.mark, file), hint=error.hint)
        return None
    if root is None or (root.id == "scalar" and root.value == "" and not root.style):
        report.add("yaml-empty", f"`{file}` is empty", Span(file), hint=hint_if_empty)
        return None
    return root


_COLON_WITHOUT_SPACE = r"([a-z_][a-z0-9_]*):(\S.*)"
_EMPTY_HINT = "a document starts with `thorvaldc: 1`"


# -- files of other formats in place of YAML ----------------------------------------

_START = re.compile(
    rb"(?:\xef\xbb\xbf)?\s*(?:;.*\s+)*"
    rb"(?:(<)(?:[?!]|\w+[\s/>])|(\[(?:FileInfo|DeviceInfo)\])|VERSION \")"
)
_OF_DEVICES = "the module of a device describes its objects and frames; `build -t can` writes"
_ROOT = rb"<(robot|sdf|mujoco)[\s/>]"
_HEAD = 100_000  # bytes in which the root element is searched; comments can stand before it
_AUDIT = "`thorvaldc audit DIR` checks the files of any robot"
_KINDS = {b"robot": "a URDF file", b"sdf": "an SDF file", b"mujoco": "an MJCF file"}


def _is_other_format(data: bytes, file: str, report: Report) -> bool:
    """Reports an error and returns ``True`` if a document is XML, EDS, DCF or DBC, and not YAML."""
    start = _START.match(data)
    if start is None:
        return False
    root = re.search(_ROOT, data[:_HEAD])
    name = root[1] if root is not None else b""
    if start[1] is None:
        kind, target = (
            ("an EDS or DCF file", "DCF files") if start[2] else ("a DBC file", "a DBC file")
        )
        message = f"this is {kind}; expected YAML"
        report.add("other-document", message, Span(file), hint=f"{_OF_DEVICES} {target}")
        return True
    hint = _AUDIT
    if name == b"robot":
        hint = (
            "a robot file joins it to its modules: "
            f"`extras: [{{xacro: {file}, parent: frame}}]`; {_AUDIT}"
        )
    kind = _KINDS.get(name, "an XML file")
    report.add("other-document", f"this is {kind}; expected YAML", Span(file), hint=hint)
    return True


# -- characters -------------------------------------------------------------------

# A YAML document must not contain control characters (C0 and C1), surrogates, U+FFFE, U+FFFF, or a
# byte order mark inside the text.  The Unicode line separators U+0085, U+2028 and U+2029 are also
# forbidden in a YAML document.  YAML 1.1 reads Unicode line separators as line breaks, but editors
# do not, so the line numbers in messages would be wrong.
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
    """Returns the text of a YAML document.

    If the size, the encoding or a character of the document is not allowed, adds a diagnostic to
    ``report`` and returns ``None``.
    """
    if len(data) > MAX_BYTES:
        report.add(
            "yaml-file-too-large",
            f"`{file}` is larger than the limit of {MAX_BYTES} bytes for a document",
            Span(file),
            hint="move meshes and other data to separate files",
        )
        return None
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        report.add("yaml-encoding", "the file is UTF-16", Span(file), hint="save it as UTF-8")
        return None
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        valid_text = data[: error.start].decode("utf-8-sig", "replace")
        report.add(
            "yaml-encoding",
            f"the byte 0x{data[error.start]:02x} is not UTF-8",
            _span_at(valid_text, len(valid_text), file),
            hint="save the file as UTF-8",
        )
        return None
    match = _FORBIDDEN.search(text)
    if match:
        name = _CHARACTER_NAMES.get(match[0], "a control character")
        report.add(
            "yaml-character",
            f"{name} (U+{ord(match[0]):04X}) is not allowed in YAML",
            _span_at(text, match.start(), file),
            hint=Proposal("remove it, or write it as an escape in double quotes", ""),
        )
        return None
    if not text.isascii():
        from thorvaldc.compiler.source.yaml_errors import STRUCTURAL_SPACE, report_space

        space = STRUCTURAL_SPACE.search(text)
        if space is not None:
            index = space.start(space.lastgroup or 0)
            report_space(text[index], _span_at(text, index, file), report)
            return None
    return text


_LINE_BREAK = r"\r\n|\r|\n"


def _span_at(text: str, index: int, file: str) -> Span:
    """Returns the source span of the character at position ``index`` (from 0) of a text."""
    line, start = 1, 0
    for line_break in re.finditer(_LINE_BREAK, text[:index]):
        line, start = line + 1, line_break.end()
    column = index - start + 1
    return Span(file, line, column, line, column + 1)


# -- composing ----------------------------------------------------------------------


class _YamlError(Exception):
    """Raised if a YAML document exceeds a size limit or contains a recursive alias.

    - ``mark``: position of the error as a PyYAML ``Mark``.
    """

    def __init__(self, code: str, message: str, mark: Any, hint: str) -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        self.mark = mark
        self.hint = hint


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """A YAML loader with limits on the nesting depth and the number of values.

    The YAML composer of libyaml is recursive C code, so a deeply nested document would overflow the
    stack.  To prevent a stack overflow, the loader checks the nesting depth while the YAML composer
    runs.  The loader sets the tag of a YAML node only if the document contains an explicit tag.
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
            raise _YamlError(
                "yaml-too-deep",
                f"the document is nested more than {MAX_DEPTH} levels deep",
                parent.start_mark,
                "a robot does not need this depth; look for an unclosed bracket",
            )
        if self._count > MAX_VALUES:
            raise _too_many(parent.start_mark)

    def ascend_resolver(self) -> None:
        self._depth -= 1


def _root_of(text: str) -> Any:
    """Returns the root node of the only document in ``text``, or ``None`` if there is none."""
    loader = _Loader(text)
    try:
        return loader.get_single_node()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        if mark is None or "maximum nesting depth" not in str(error.problem):
            raise
        # libyaml from 0.2.6 on (PyYAML 6.0.4) has a limit of its own, 1000 levels, and its scanner
        # can be there before the composer is at MAX_DEPTH.  The text before that place has the
        # error that a libyaml without the limit reports.
        return _root_of(text[: mark.index])
    finally:
        loader.dispose()


def _too_many(mark: Any) -> _YamlError:
    return _YamlError(
        "yaml-too-many-values",
        f"the document has more than {MAX_VALUES} values, aliases expanded",
        mark,
        "split the document, or use an assembly for repeated modules",
    )


def _character_span(mark: Any, file: str) -> Span:
    line, column = mark.line + 1, mark.column + 1
    return Span(file, line, column, line, column + 1)


class _Reader:
    """Converts the nodes of PyYAML to objects of the class ``Node``.

    - ``aliases``: whether the document can contain aliases.

    A PyYAML node with YAML aliases occurs several times in the tree of nodes.  Each PyYAML node is
    converted only once, even if YAML aliases refer to the node.  Each use of a YAML alias adds the
    number of values in the aliased node to the total, which is limited to ``MAX_VALUES``.  The
    limit ``MAX_VALUES`` protects against a small YAML document that expands to billions of values
    ("billion laughs" attack).
    """

    def __init__(self, file: str, report: Report, aliases: bool) -> None:
        self.file = file
        self.report = report
        self.node = self._convert_once if aliases else self._convert
        self.converted: dict[int, tuple[Node, int]] = {}  # id -> node, number of values in it
        self.open: set[int] = set()  # ids of the nodes that contain the current one
        self.total = 0

    def _convert_once(self, raw: Any, key_span: Span | None) -> Node:
        if id(raw) in self.converted:
            node, values = self.converted[id(raw)]
            self._count(values, raw)
            return Node(node.value, node.span, key_span, node.quoted)
        if id(raw) in self.open:
            raise _YamlError(
                "yaml-recursive-alias",
                "an alias refers to a value that contains it",
                raw.start_mark,
                "write the value in full",
            )
        self.open.add(id(raw))
        count_before = self.total
        self._count(1, raw)
        node = self._convert(raw, key_span)
        self.open.discard(id(raw))
        self.converted[id(raw)] = node, self.total - count_before
        return node

    def _count(self, values: int, raw: Any) -> None:
        self.total += values
        if self.total > MAX_VALUES:
            raise _too_many(raw.start_mark)

    def _convert(self, raw: Any, key_span: Span | None) -> Node:
        if raw.tag:
            self._report_tag(raw)
        if raw.id == "mapping":
            name = _template_name(raw)
            return self._template(raw, name, key_span) if name else self._mapping(raw, key_span)
        if raw.id == "sequence":
            return self._sequence(raw, key_span)
        span = self._span(raw)
        if raw.style:
            return Node(raw.value, span, key_span, True)
        text = self._corrected(raw.value, span)
        return Node(plain_scalar(text, span, self.report), span, key_span)

    def _template(self, raw: Any, name: str, key_span: Span | None) -> Node:
        """Reports ``{{ name }}``, which YAML reads as two mappings, and returns ``${name}``."""
        span, expression = self._span(raw), f"${{{name}}}"
        self.report.add(
            "yaml-key-not-text",
            f"`{{{{ {name} }}}}` is the template of another tool; YAML reads it as a mapping",
            span,
            hint=f'write the value itself; in a module, an expression is `"{expression}"`',
        )
        return Node(expression, span, key_span, True)

    def _span(self, raw: Any) -> Span:
        start, end = raw.start_mark, raw.end_mark
        return Span(self.file, start.line + 1, start.column + 1, end.line + 1, end.column + 1)

    def _collection_span(self, raw: Any, last: Span | None) -> Span:
        """Returns the source span of a YAML list or mapping.

        - ``last``: source span of the last value in the list or mapping.

        PyYAML ends a YAML list or mapping at the next token, which can be several lines later.  The
        returned source span ends at the end of the last value in the list or mapping.
        """
        span = self._span(raw)
        # If the last value of a YAML list is an alias, the source span of the value can lie before
        # the list.
        if raw.flow_style or last is None or last[1:3] < span[1:3]:
            return span
        return Span(self.file, span.line, span.column, last.end_line, last.end_column)

    def _sequence(self, raw: Any, key_span: Span | None) -> Node:
        items = self._with_decimal_points(raw.value) if raw.flow_style else raw.value
        values = tuple([self.node(item, None) for item in items])
        span = self._collection_span(raw, values[-1].span if values else None)
        return Node(values, span, key_span)

    def _with_decimal_points(self, items: list[Any]) -> list[Any]:
        """Returns the elements of a list in brackets, in which ``-0,1`` and ``0,07`` are numbers.

        A list with ``-0`` or ``07`` has decimal commas: these are no elements that people write.
        """
        if not any(item.id == "scalar" and re.match(r"-0$|0\d", item.value) for item in items):
            return items
        joined: list[Any] = []
        for item in items:
            last = joined[-1] if joined else item
            if is_decimal_comma(last.value, self._span(last), item.value, self._span(item)):
                number = f"{last.value}.{item.value}"
                joined[-1] = yaml.ScalarNode("", number, last.start_mark, item.end_mark)
                report_decimal_comma(number, "elements", self._span(joined[-1]), self.report)
            else:
                joined.append(item)
        return joined

    def _mapping(self, raw: Any, key_span: Span | None) -> Node:
        values: dict[str, Node] = {}
        merged: dict[str, Node] = {}
        last: Node | None = None
        numbers: dict[str, Span] = {}  # keys without a value, which may be parts of a list
        for raw_key, raw_value in raw.value:
            entry_span = self._span(raw_key)
            is_part = raw.flow_style and raw_value.value == "" and not raw_value.style
            if is_part and raw_key.id == "scalar" and key_kind(raw_key.value) == "a number":
                key = raw_key.value
                numbers.setdefault(key, entry_span)
            else:
                key = self._key(raw_key, entry_span)
            last = self.node(raw_value, entry_span)
            if key is not None and ":" in key:
                key, last = self._without_missing_space(raw_key, key, last)
            if key is None:
                if isinstance(last.value, dict):  # of a merge key
                    merged |= last.value
                continue
            if key in values:
                first = values[key].where
                self.report.add(
                    "yaml-duplicate-key",
                    f"the key `{key}` occurs twice",
                    entry_span,
                    hint="keep one of them",
                    labels=[Label(first, FIRST_USE)],
                )
                continue
            values[key] = last
        span = self._collection_span(raw, last.span if last else None)
        if raw.flow_style:
            values = join_split_values(values, self.report)
        for key, entry_span in numbers.items():
            if key in values:
                self._report_key(key, "a number", entry_span)
        return Node({**merged, **values}, span, key_span)

    def _without_missing_space(self, raw_key: Any, key: str, value: Node) -> tuple[str, Node]:
        """Reports an entry without a space after the colon, such as ``{type:frame/tube}``.

        Returns the most likely key and value of the entry.
        """
        match = re.fullmatch(_COLON_WITHOUT_SPACE, key)
        if match is None or raw_key.style or value.value is not None:
            return key, value
        span = self._span(raw_key)
        column = span.column + match.end(1)
        after_colon = Span(self.file, span.line, column + 1, span.line, column + 1)
        self.report.add(
            "yaml-syntax",
            "a space is missing after this `:`",
            Span(self.file, span.line, column, span.line, column + 1),
            hint=Proposal(f"write `{match[1]}: {match[2]}`", " ", span=after_colon),
        )
        key_span = Span(self.file, span.line, span.column, span.line, column)
        value_span = Span(self.file, span.line, column + 1, *span[3:5])
        return match[1], Node(plain_scalar(match[2], value_span, self.report), value_span, key_span)

    def _key(self, raw: Any, key_span: Span) -> str | None:
        """Returns the text of a YAML mapping key, or ``None`` if the key is invalid.

        A YAML key that is a list, a mapping or the merge key ``<<`` is an error.
        """
        if raw.id != "scalar":
            self.report.add(
                "yaml-key-not-text",
                f"a {'list' if raw.id == 'sequence' else 'mapping'} cannot be a key",
                key_span,
                hint='quote a value that contains braces, as in `"${width}"`',
            )
            return None
        text: str = raw.value
        if raw.tag:
            self._report_tag(raw)
        if raw.style:
            return text
        text = self._corrected(text, key_span)
        if text == "<<":
            self.report.add(
                "yaml-merge-key",
                "merge keys (`<<`) are not part of YAML 1.2",
                key_span,
                hint="write the entries in full, or put shared values of modules under `defaults`",
            )
            return None
        kind = key_kind(text)
        if kind is not None:
            self._report_key(text, kind, key_span)
        return text

    def _corrected(self, text: str, span: Span) -> str:
        """Returns an unquoted scalar without characters that only look like spaces and quotes."""
        if text.isascii():
            return text
        from thorvaldc.compiler.source.yaml_errors import corrected

        return corrected(text, span, self.report)

    def _report_key(self, text: str, kind: str, key_span: Span) -> None:
        """Reports an unquoted key that YAML reads as a number or another value, and not as text."""
        hint: str | None = None
        if kind != "a number" and text:
            hint = Proposal(f'if this is the name, write `"{text}"`', f'"{text}"')
        elif text:
            hint = "a name begins with a letter"
        self.report.add(
            "yaml-key-not-text",
            f"the key `{text}` is {kind}; expected text" if text else "a key is empty",
            key_span,
            hint=hint,
        )

    def _report_tag(self, raw: Any) -> None:
        tag = raw.tag.replace("tag:yaml.org,2002:", "!!")
        self.report.add(
            "yaml-tag",
            f"the language has no tags such as `{tag}`",
            _character_span(raw.start_mark, self.file),
            hint="remove the tag; quote the value if it is text",
        )


def _template_name(raw: Any) -> str:
    """Returns the name in ``{{ name }}``, or an empty text for any other mapping."""
    for _ in range(2):
        if raw.id != "mapping" or not raw.flow_style or len(raw.value) != 1:
            return ""
        raw, value = raw.value[0]
        if value.value or value.id != "scalar" or value.style:
            return ""
    return raw.value if raw.id == "scalar" and not raw.style else ""
