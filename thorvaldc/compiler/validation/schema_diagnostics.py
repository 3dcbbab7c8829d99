"""What jsonschema finds, as diagnostics with spans."""

from __future__ import annotations

import re
from typing import Any

from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.units import QUANTITIES
from thorvaldc.diagnostics import Label, Report, Span
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.schema.documents import Kind

_TYPE_WORDS = {
    "object": "a mapping",
    "array": "a list",
    "string": "text",
    "number": "a number",
    "integer": "a whole number",
    "boolean": "`true` or `false`",
}
_AUTO = ("^auto", "^(auto")
_EXPRESSION = "^\\$\\{.*\\}$"
_ID_HINT = "names have lower-case letters, digits and `_`, and begin with a letter"


def explain(error: Any, root: Node, kind: Kind, known: set[Span], report: Report) -> None:
    """Add the diagnostics of one of jsonschema's errors.

    Spans in ``known`` have an error already; those that are reported are added.
    """
    path = list(error.absolute_path)
    node, schema = _find(root, path), error.schema
    fault = _Fault(node, path, schema, error, kind, known, report)
    if "propertyNames" in error.absolute_schema_path:
        fault.bad_name(str(error.instance))
    else:
        getattr(fault, f"_{error.validator.lower()}", fault.other)()


def _find(node: Node, path: list[str | int]) -> Node:
    for step in path:
        inner = node.value
        if isinstance(inner, dict):
            node = inner[str(step)]
        elif isinstance(inner, tuple):
            node = inner[int(step)]
    return node


class _Fault:
    """One error; its methods are named after the schema's keywords."""

    def __init__(
        self,
        node: Node,
        path: list[str | int],
        schema: Any,
        error: Any,
        kind: Kind,
        known: set[Span],
        report: Report,
    ) -> None:
        self.node = node
        self.path = path
        self.schema: dict[str, Any] = schema if isinstance(schema, dict) else {}
        self.error = error
        self.kind = kind
        self.known = known
        self.report = report

    def add(
        self,
        code: str,
        message: str,
        span: Span,
        hint: str | None = None,
        labels: tuple[Label, ...] = (),
    ) -> None:
        if span not in self.known:
            self.known.add(span)
            self.report.add(code, message, span, hint=hint, labels=labels)

    @property
    def place(self) -> str:
        """What the value is called in a message: its key, or what holds it."""
        names = [step for step in self.path if isinstance(step, str)]
        if not names:
            return f"the {self.kind} document"
        name = f"`{names[-1]}`"
        return name if isinstance(self.path[-1], str) else f"an element of {name}"

    @property
    def start(self) -> Span:
        """Where a mapping can be pointed at: its key, else its first character."""
        if self.node.key_span is not None:
            return self.node.key_span
        span = self.node.span
        return Span(span.file, span.line, span.column, span.line, span.column + 1)

    # -- keys ---------------------------------------------------------------------------

    def _additionalproperties(self) -> None:
        entries = self.node.value
        if not isinstance(entries, dict):
            return
        properties = self.schema.get("properties", {})
        for key, entry in entries.items():
            if key not in properties:
                self.add(
                    "unknown-key",
                    f"{self.place} has no key `{key}`",
                    entry.where,
                    self._key_hint(key, properties),
                )

    def _key_hint(self, key: str, properties: dict[str, Any]) -> str | None:
        near = did_you_mean(key, [name for name in properties if name not in self._present()])
        if near is not None:
            return near
        for name, inner in properties.items():
            if key in inner.get("properties", {}):
                return f"`{key}` belongs under `{name}`"
        if "params" in properties:
            return "parameters of the module's type belong under `params`"
        return "known keys are " + ", ".join(f"`{name}`" for name in properties)

    def _present(self) -> dict[str, Node]:
        return self.node.value if isinstance(self.node.value, dict) else {}

    def _required(self) -> None:
        present = self._present()
        for key in self.error.validator_value:
            if key in present or f"'{key}'" not in self.error.message:
                continue
            span = self.start
            # Two keys may be missing at one place.
            self.report.add(
                "missing-key",
                f"{self.place} has no `{key}`",
                span,
                hint=self._add_hint(key),
            )
            self.known.add(span)

    def _add_hint(self, key: str) -> str:
        wanted = self.schema.get("properties", {}).get(key, {})
        example = next(iter(wanted.get("examples", [])), wanted.get("const"))
        if isinstance(example, str | int | float) and not isinstance(example, bool):
            return f"add it, as in `{key}: {example}`"
        return f"add `{key}`"

    def _dependentrequired(self) -> None:
        present = self._present()
        for key, needed in self.error.validator_value.items():
            for other in needed:
                if key in present and other not in present:
                    self.add(
                        "missing-key",
                        f"`{key}` needs `{other}` beside it",
                        present[key].where,
                        self._add_hint(other),
                    )

    def _not(self) -> None:
        present = self._present()
        keys = [key for key in self.error.validator_value.get("required", []) if key in present]
        if len(keys) < 2:
            self.other()
            return
        first, second = sorted(present[key].where for key in keys)[:2]
        self.add(
            "conflicting-keys",
            f"`{keys[0]}` and `{keys[1]}` exclude each other",
            second,
            "keep one of them",
            (Label(first, "the other one"),),
        )

    def _minproperties(self) -> None:
        if self.schema.get("maxProperties") == 1:
            self._one_key()
            return
        self.add(
            "wrong-length", f"{self.place} is empty", self.start, "it needs at least one entry"
        )

    def _maxproperties(self) -> None:
        self._one_key()

    def _one_key(self) -> None:
        keys = ", ".join(f"`{key}`" for key in self.schema.get("properties", {}))
        present = list(self._present().values())
        self.add(
            "conflicting-keys",
            f"{self.place} has {len(present)} of {keys}; one is wanted",
            present[1].where if len(present) > 1 else self.start,
            None,
            (Label(present[0].where, "the first"),) if len(present) > 1 else (),
        )

    def bad_name(self, name: str) -> None:
        entry = self._present().get(name)
        fixed = re.sub(r"[^a-z0-9_]+", "_", name.lower()).strip("_")
        usable = re.fullmatch(r"[a-z][a-z0-9_]*", fixed)
        self.add(
            "bad-id",
            f"`{name}` is not a name",
            entry.where if entry is not None else self.start,
            f"{_ID_HINT}, as in `{fixed}`" if usable else _ID_HINT,
        )

    # -- values --------------------------------------------------------------------------

    def _type(self) -> None:
        example = _example(self.schema)
        hint = f"as in `{example}`" if example is not None else None
        if self.node.value is None:
            hint = f"leave the key out, or give it a value{f', {hint}' if hint else ''}"
            self.add("wrong-type", f"{self.place} has no value", self.start, hint)
            return
        message = f"{_wanted(self.schema)} is wanted, not {_found(self.node)}"
        self.add("wrong-type", message, self.node.span, hint)

    def _enum(self, values: list[Any] | None = None) -> None:
        values = values if values is not None else list(self.error.validator_value)
        if not isinstance(self.node.value, str | int | float | bool):
            shown = ", ".join(f"`{v}`" for v in values)
            self.add(
                "wrong-type",
                f"one of {shown} is wanted, not {_found(self.node)}",
                self.node.span if self.node.value is not None else self.start,
            )
            return
        known = ", ".join(f"`{value}`" for value in values[:12])
        more = " and others" if len(values) > 12 else ""
        self.add(
            "unknown-value",
            f"{self.place} cannot be `{_text(self.node)}`",
            self.node.span,
            did_you_mean(_text(self.node), [str(v) for v in values], f"it is one of {known}{more}"),
        )

    def _const(self) -> None:
        wanted = self.error.validator_value
        self.add(
            "language-version",
            f"version {_found(self.node)} of the language is not known",
            self.node.span if self.node.value is not None else self.start,
            f"write `thorvaldc: {wanted}`; a newer compiler may know more",
        )

    def _anyof(self) -> None:
        branches = self.error.validator_value
        if "enum" in branches[0]:
            self._enum(branches[0]["enum"])
            return
        keys = [f"`{key}`" for branch in branches for key in branch.get("required", [])]
        if not keys:
            self.other()
            return
        self.add(
            "conflicting-keys",
            f"{self.place} has none of {', '.join(keys)}; one is wanted",
            self.start,
            f"add {' or '.join(keys)}",
        )

    def _pattern(self) -> None:
        pattern, text = str(self.error.validator_value), _text(self.node)
        span = self.node.span
        types = self.schema.get("type")
        if pattern == _EXPRESSION or pattern.startswith(_AUTO):
            example = _example(self.schema)
            self.add(
                "wrong-type",
                f"{_wanted(self.schema)} is wanted, not {_found(self.node)}",
                span,
                f"as in `{example}`" if example is not None else None,
            )
        elif pattern.startswith("^(datasheet"):
            self.add(
                "unknown-value",
                f"{self.place} does not say where the number comes from",
                span,
                "begin with `datasheet:`, `measured:`, `published:`, `estimated:`, `chosen:` "
                "or `derived:`",
            )
        elif "\\." in pattern or pattern.startswith("^[A-Za-z"):
            self.add(
                "bad-id",
                f"`{text}` does not name a part",
                span,
                "write names joined by dots, as in `frame.front_left`",
            )
        else:
            what = "name or mapping" if isinstance(types, list) and "object" in types else "name"
            self.add("bad-id", f"`{text}` is not a {what}", span, _ID_HINT)

    def _minlength(self) -> None:
        self.add("wrong-length", f"{self.place} is empty text", self.node.span)

    def _minitems(self) -> None:
        least, most = self.schema.get("minItems"), self.schema.get("maxItems")
        count = len(self.node.value) if isinstance(self.node.value, tuple) else 0
        wanted = f"{least}" if least == most else f"at least {least}"
        example = _example(self.schema)
        self.add(
            "wrong-length",
            f"{self.place} has {count} element{'' if count == 1 else 's'}; {wanted} are wanted",
            self.node.span,
            f"as in `{example}`" if example is not None else None,
        )

    def _maxitems(self) -> None:
        self._minitems()

    def _minimum(self) -> None:
        least = self.error.validator_value
        self.add(
            "out-of-range",
            f"{self.place} is {_text(self.node)}; it must be at least {least}",
            self.node.span,
        )

    def _maximum(self) -> None:
        most = self.error.validator_value
        self.add(
            "out-of-range",
            f"{self.place} is {_text(self.node)}; it must be at most {most}",
            self.node.span,
        )

    def other(self) -> None:
        """A keyword that has no words of its own here."""
        self.add("wrong-type", f"{self.place} is not as the schema wants it", self.start)


def _wanted(schema: dict[str, Any]) -> str:
    quantity = schema.get("x-quantity")
    words: list[str] = []
    if quantity is not None and quantity != "any":
        names = [quantity] if isinstance(quantity, str) else quantity
        words = [str(QUANTITIES[name]) for name in names]
        words += [f"`{word}`" for word in schema.get("x-words", [])]
    types = schema.get("type", [])
    for name in [types] if isinstance(types, str) else types:
        if name == "string":
            pattern = schema.get("pattern", "")
            if pattern.startswith(_AUTO):
                words.append("`auto`")
            elif pattern != _EXPRESSION and quantity is None:
                words.append("text")
        elif name != "number" or quantity is None:
            words.append(_TYPE_WORDS[name])
    if len(words) < 2:
        return "".join(words)
    return ", ".join(words[:-1]) + f" or {words[-1]}"


def _example(schema: dict[str, Any]) -> str | None:
    examples = schema.get("examples")
    if not examples or (isinstance(examples[0], str) and examples[0].startswith("${")):
        return None
    shown = _shown(examples[0])
    # Text that would be read as a number is shown as it must be written.
    return f'"{shown}"' if isinstance(examples[0], str) and shown.startswith("0x") else shown


def _shown(value: Any) -> str:
    """A value as YAML writes it in one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k}: {_shown(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_shown(item) for item in value) + "]"
    return str(value)


def _text(node: Node) -> str:
    text = _shown(node.value)
    return text if len(text) <= 60 else text[:57] + "..."


def _found(node: Node) -> str:
    if isinstance(node.value, dict):
        return "a mapping"
    if isinstance(node.value, tuple):
        return "a list"
    if node.value is None:
        return "nothing"
    if isinstance(node.value, str):
        return f"the text `{_text(node)}`"
    return f"`{_text(node)}`"
