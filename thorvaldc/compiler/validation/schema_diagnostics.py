"""Converts schema errors of the package jsonschema to diagnostics with source spans and hints."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

from thorvaldc.compiler.source.node import (
    Node,
    describe_node,
    insertion,
    whole_number_hint,
    with_decimal_points,
    yaml_text,
)
from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.compiler.validation.meant_keys import meant_key, misspelt_keys
from thorvaldc.compiler.validation.schema_walk import SchemaWalk
from thorvaldc.diagnostics import Label, Proposal, Report, Span, did_you_mean
from thorvaldc.schema import Kind
from thorvaldc.schema.old_words import old_keys

_TYPE_WORDS = {
    "object": "a mapping",
    "array": "a list",
    "string": "text",
    "number": "a number",
    "integer": "a whole number",
    "boolean": "`true` or `false`",
}
_AUTO = ("^auto", "^(auto")
# Required keys of mappings for which people write the path of a module type or a file alone.
_PATH_KEYS = (["type"], ["robot"], ["scenario"], ["xacro"], ["file"])
_NAME_PATTERN = re.compile(r"\^(\(\?!\.\*__\))?\(?\[a-z\]")
"""Patterns of names and of paths of names; the description says what others mean."""
_EXPRESSION = "^\\$\\{.*\\}$"
_ID_HINT = (
    "a name has lower-case letters, digits and `_`, begins with a letter, and has at most 64"
    " characters"
)


def explain(error: Any, root: Node, kind: Kind, reported: set[Span], report: Report) -> None:
    """Adds the diagnostics for one error of the package jsonschema to ``report``.

    - ``root``: root node of the document.
    - ``reported``: source spans that already have a diagnostic.  Errors at source spans in
      ``reported`` are not reported again.  The source spans of new diagnostics are added to
      ``reported``.
    """
    path = list(error.absolute_path)
    node, schema = _find(root, path), error.schema if isinstance(error.schema, dict) else {}
    if isinstance(node.value, dict) and set(node.value) == {"value", "unit"}:
        text = f"{_text(node.value['value'])} {_text(node.value['unit'])}"
        if node.span not in reported:
            reported.add(node.span)
            message = "expected a number with a unit, got a mapping with `value` and `unit`"
            report.add("wrong-type", message, node.span, hint=Proposal(f"write `{text}`", text))
        return
    explanation = _Explanation(node, path, schema, error, kind, reported, report)
    if explanation.is_part_of_module():
        explanation.part_of_module()
    elif "propertyNames" in error.absolute_schema_path:
        explanation.bad_name(str(error.instance))
    else:
        method = f"_{error.validator.lower()}"
        getattr(explanation, method, explanation.unspecific)()


def _find(node: Node, path: list[str | int]) -> Node:
    for step in path:
        inner = node.value
        if isinstance(inner, dict):
            node = inner[str(step)]
        elif isinstance(inner, tuple):
            node = inner[int(step)]
    return node


@dataclass
class _Explanation:
    """Reports the diagnostics for one schema error of the package jsonschema.

    A method such as ``_required`` reports the errors of the JSON Schema keyword ``required``.
    """

    node: Node
    path: list[str | int]
    schema: dict[str, Any]
    error: Any
    kind: Kind
    reported: set[Span]
    report: Report

    def add(
        self,
        code: str,
        message: str,
        span: Span,
        hint: str | None = None,
        labels: tuple[Label, ...] = (),
    ) -> None:
        if span not in self.reported:
            self.reported.add(span)
            self.report.add(code, message, span, hint=hint, labels=labels)

    @property
    def value_name(self) -> str:
        """Name of the invalid value in error messages.

        The name of a value in a YAML mapping is its key.  The name of an element of a YAML list is
        derived from the key of the list.
        """
        names = [step for step in self.path if isinstance(step, str)]
        if not names:
            return f"the {self.kind} document"
        name = f"`{names[-1]}`"
        return name if isinstance(self.path[-1], str) else f"an element of {name}"

    @property
    def start(self) -> Span:
        """Source span for a diagnostic about a YAML mapping.

        Returns the source span of the key of the YAML mapping.  If the YAML mapping has no key,
        returns the source span of its first character.
        """
        if self.node.key_span is not None:
            return self.node.key_span
        span = self.node.span
        return Span(span.file, span.line, span.column, span.line, span.column + 1)

    def is_part_of_module(self) -> bool:
        """Returns whether a key of a module, such as `params`, stands in the column of modules."""
        is_entry = self.path[:-1] == ["modules"] and self.node.get("type") is None
        return is_entry and self.path[-1] in self.schema.get("properties", {})

    def part_of_module(self) -> None:
        self.add(
            "unknown-key",
            f"{self.value_name} is in the column of the modules",
            self.node.where,
            "indent it to the column of the `type` of its module",
        )
        self.reported.update(
            span for _, node in self.node.walk() for span in (node.span, node.where)
        )

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
                    f"{self.value_name} has no key `{key}`",
                    entry.where,
                    self._key_hint(key, properties),
                )

    def _key_hint(self, key: str, properties: dict[str, Any]) -> str | None:
        entry = self._entries()[key]
        for word in old_keys(self.kind, [*self.path, key]):
            return Proposal(word.hint, word.new) if word.new else word.hint
        if self.path[:-1] == ["modules"] and entry.get("type") is not None:
            return (
                f"`{key}` looks like a module: a module begins in the column of {self.value_name},"
                " not below it"
            )
        meant = self._misspelt().get(key)
        meant = meant or meant_key(key, self._entries(), properties, ())
        if meant is not None:
            if SchemaWalk(self.kind).fits(properties[meant], entry):
                return Proposal(f"did you mean `{meant}`?", meant, word=key)
            return self._other_entry(entry, meant, properties[meant])
        for name, inner in properties.items():
            if key in inner.get("properties", {}):
                return f"`{key}` belongs under `{name}`"
        if "params" in properties:
            return "parameters of the module's type belong under `params`"
        return "known keys are " + ", ".join(f"`{name}`" for name in properties)

    def _other_entry(self, entry: Node, meant: str, schema: dict[str, Any]) -> str:
        """Returns the hint for an unknown key whose value does not fit the key that was meant."""
        example, start, value = _example(schema), entry.where, entry.span
        if example not in ("true", "false") or not isinstance(entry.value, str | bool):
            return f"did you mean `{meant}`?"
        span = Span(start.file, start.line, start.column, value.end_line, value.end_column)
        entry_text = f"{meant}: {example}"
        return Proposal(f"write `{entry_text}`", entry_text, span=span, is_example=True)

    def _misspelt(self) -> dict[str, str]:
        """Returns the missing required key that each unknown key of the YAML mapping means."""
        properties = self.schema.get("properties")
        if not properties:
            return {}
        required = list(self.schema.get("required", ()))
        if self.kind == "scenario" and not self.path:
            required.append("robots")
        return misspelt_keys(self._entries(), properties, required)

    def _entries(self) -> dict[str, Node]:
        return self.node.value if isinstance(self.node.value, dict) else {}

    def _required(self) -> None:
        entries = self._entries()
        # A misspelled key is reported as an unknown key, and not also as a missing key.
        misspelt = set(self._misspelt().values())
        for key in self.error.validator_value:
            if key in entries or f"'{key}'" not in self.error.message or key in misspelt:
                continue
            span = self.start
            # `self.add` reports one error per source span, but several keys can be missing in a
            # YAML mapping.
            self.report.add(
                "missing-key",
                f"{self.value_name} has no `{key}`",
                span,
                hint=self._missing_key_hint(key),
            )
            self.reported.add(span)

    def _missing_key_hint(self, key: str) -> str:
        schema = self.schema.get("properties", {}).get(key, {})
        example = _example(schema)
        if example is None and "const" in schema:
            example = yaml_text(schema["const"])
        if example is None:
            return f"add `{key}`"
        hint = f"add it, as in `{key}: {example}`"
        return insertion(hint, self.node, key, example, is_example="const" not in schema)

    def _dependentrequired(self) -> None:
        entries = self._entries()
        for key, required_keys in self.error.validator_value.items():
            for required in required_keys:
                if key in entries and required not in entries:
                    self.add(
                        "missing-key",
                        f"`{key}` requires `{required}` in the same mapping",
                        entries[key].where,
                        self._missing_key_hint(required),
                    )

    def _not(self) -> None:
        entries = self._entries()
        keys = [key for key in self.error.validator_value.get("required", []) if key in entries]
        if len(keys) < 2:
            self.unspecific()
            return
        first, second = sorted(entries[key].where for key in keys)[:2]
        self.add(
            "conflicting-keys",
            f"`{keys[0]}` and `{keys[1]}` exclude each other",
            second,
            "keep one of them",
            (Label(first, "the other key"),),
        )

    def _minproperties(self) -> None:
        if self.schema.get("maxProperties") == 1:
            self._one_key()
            return
        self.add(
            "wrong-length", f"{self.value_name} is empty", self.start, "add at least one entry"
        )

    def _one_key(self) -> None:
        keys = ", ".join(f"`{key}`" for key in self.schema.get("properties", {}))
        entries = list(self._entries().values())
        self.add(
            "conflicting-keys",
            f"{self.value_name} has {len(entries)} of {keys}; expected exactly one",
            entries[1].where if len(entries) > 1 else self.start,
            None,
            (Label(entries[0].where, "the first"),) if len(entries) > 1 else (),
        )

    _maxproperties = _one_key

    def bad_name(self, name: str) -> None:
        entry = self._entries().get(name)
        self.add(
            "bad-id",
            f"`{name}` is not a valid name",
            entry.where if entry is not None else self.start,
            self.schema.get("description") or _id_hint(name),
        )

    # -- values --------------------------------------------------------------------------

    def _type(self) -> None:
        if self.node.value is None:
            example = self.example_hint()
            if any(str(other).startswith("#") for other in self.schema.get("examples", ())):
                # YAML takes the rest of the line for a comment, so that it is not known here.
                hint = 'put a text that begins with # in quotes, as in `"#2b2b2b"`'
                self.add("wrong-type", f"{self.value_name} has no value", self.start, hint)
                return
            hint = f"remove the key, or give it a value{f', {example}' if example else ''}"
            if isinstance(example, Proposal):
                end = self.node.span  # the position after the colon
                text = f" {example.replacements[0]}"
                hint = Proposal(hint, text, span=end, is_example=True)
            self.add("wrong-type", f"{self.value_name} has no value", self.start, hint)
        else:
            self.wrong_type()

    def wrong_type(self) -> None:
        message = f"expected {_expected(self.schema)}, got {_actual(self.node)}"
        self.add("wrong-type", message, self.node.span, self._corrected() or self.example_hint())

    def _corrected(self) -> str | None:
        """Returns the hint with the value in the expected form, or ``None`` if it is not known."""
        value = self.node.value
        if self.schema.get("type") == "array" or "array" in self.schema.get("type", ()):
            elements = _elements(value)
            kinds = self.schema.get("items", {}).get("type", ())
            texts = kinds == "string" or ("string" in kinds and "number" not in kinds)
            if elements is None and texts and isinstance(value, str):
                elements = f"[{yaml_text(value)}]"
            if elements is not None:
                return Proposal(f"write `{elements}`", elements)
        if self.schema.get("type") == "integer" or "integer" in self.schema.get("type", ()):
            return whole_number_hint(self.node)
        required = self.schema.get("required")
        is_path = isinstance(value, str) and ("/" in value or PurePath(value).suffix)
        if is_path and required in _PATH_KEYS:
            mapping = yaml_text({required[0]: value})
            return Proposal(f"write `{mapping}`", mapping)
        return None

    def example_hint(self) -> str | None:
        example = _example(self.schema)
        if example is None:
            return None
        numbers = re.findall(r"\d[\d.]*", str(self.node.plain()))
        is_whole = len(numbers) == 1 and re.fullmatch(r"\d+(\.0*)?", numbers[0])
        if is_whole and example.isdigit():
            example = numbers[0].partition(".")[0]
        elif numbers or "${" in example:  # only the user knows them: no fix replaces them
            return f"as in `{example}`"
        return Proposal(f"as in `{example}`", example, is_example=True)

    def _enum(self, values: list[Any] | None = None) -> None:
        values = values if values is not None else list(self.error.validator_value)
        if not isinstance(self.node.value, str | int | float | bool):
            shown = ", ".join(f"`{v}`" for v in values)
            self.add(
                "wrong-type",
                f"expected one of {shown}, got {_actual(self.node)}",
                self.node.span if self.node.value is not None else self.start,
            )
            return
        listed = ", ".join(f"`{value}`" for value in values[:12])
        if len(values) > 12:
            listed += " and others"
        self.add(
            "unknown-value",
            f"{self.value_name} cannot be `{_text(self.node)}`",
            self.node.span,
            did_you_mean(
                _text(self.node), [str(v) for v in values], f"allowed values are {listed}"
            ),
        )

    def _const(self) -> None:
        version, value = int(self.error.validator_value), self.node.value
        message = f"version {_actual(self.node)} of the language is not supported"
        hint: str = Proposal(f"write `thorvaldc: {version}`", str(version))
        if isinstance(value, int | float) and value > version:
            message = (
                f"the file is in version {value} of the language; this program reads {version}"
            )
            hint = "install a newer thorvaldc: it reads this file, and older ones"
        span = self.node.span if value is not None else self.start
        self.add("language-version", message, span, hint)

    def _anyof(self) -> None:
        branches = self.error.validator_value
        if "enum" in branches[0]:
            self._enum(branches[0]["enum"])
            return
        keys = [f"`{key}`" for branch in branches for key in branch.get("required", [])]
        if not keys:
            self.unspecific()
            return
        self.add(
            "conflicting-keys",
            f"{self.value_name} has none of {', '.join(keys)}; one is required",
            self.start,
            f"add {' or '.join(keys)}",
        )

    def _pattern(self) -> None:
        pattern, text = str(self.error.validator_value), _text(self.node)
        span = self.node.span
        types = self.schema.get("type")
        if pattern == _EXPRESSION or pattern.startswith(_AUTO):
            self.wrong_type()
        elif pattern.startswith("^(datasheet"):
            self.add(
                "unknown-value",
                f"{self.value_name} does not name the source of the number",
                span,
                "start with `datasheet:`, `measured:`, `published:`, `estimated:`, `chosen:` "
                "or `derived:`",
            )
        elif not _NAME_PATTERN.match(pattern) and "description" in self.schema:
            what = str(self.schema["description"])
            message = (
                f"{self.value_name} cannot be `{text}`: {what[0].lower()}{what[1:].rstrip('.')}"
            )
            self.add("unknown-value", message, span, self.example_hint())
        elif "\\." in pattern:
            self.add("bad-id", f"`{text}` is not a path of names", span, _path_hint(text))
        else:
            expected = (
                "name or mapping" if isinstance(types, list) and "object" in types else "name"
            )
            self.add("bad-id", f"`{text}` is not a valid {expected}", span, _id_hint(text))

    def _minlength(self) -> None:
        self.add("wrong-length", f"{self.value_name} is empty text", self.node.span)

    def _minitems(self) -> None:
        value = self.node.value
        if isinstance(value, tuple) and len(value) == 1:
            elements = _elements(value[0].value)
            if elements is not None:
                self.add(
                    "wrong-length",
                    f"the elements of {self.value_name} are not separated by commas",
                    self.node.span,
                    Proposal(f"write `{elements}`", elements),
                )
                self.reported.add(value[0].span)
                return
        minimum, maximum = self.schema.get("minItems"), self.schema.get("maxItems")
        count = len(self.node.value) if isinstance(self.node.value, tuple) else 0
        texts = with_decimal_points(self.node)
        hint = self.example_hint()
        if count != len(texts) == minimum == maximum:
            text = f"[{', '.join(texts)}]"
            hint = Proposal(f"write decimal points: `{text}`", text)
        plural = "" if count == 1 else "s"
        expected = f"{minimum}" if minimum == maximum else f"at least {minimum}"
        self.add(
            "wrong-length",
            f"{self.value_name} has {count} element{plural}; expected {expected}",
            self.node.span,
            hint,
        )

    _maxitems = _minitems

    def _minimum(self) -> None:
        self.out_of_range("at least")

    def _maximum(self) -> None:
        self.out_of_range("at most")

    def out_of_range(self, comparison: str) -> None:
        message = f"{self.value_name} is {_text(self.node)}"
        message += f"; it must be {comparison} {self.error.validator_value}"
        self.add("out-of-range", message, self.node.span)

    def unspecific(self) -> None:
        """Reports an error of a JSON Schema keyword for which this class has no method."""
        self.add("wrong-type", f"{self.value_name} does not match the schema", self.start)


def _elements(value: object) -> str | None:
    """Returns a list in YAML of the numbers in a text or in the keys x, y and z, or ``None``."""
    if isinstance(value, dict) and list(value) in (["x", "y", "z"], ["roll", "pitch", "yaw"]):
        texts = [_text(node) for node in value.values()]
    elif isinstance(value, str):
        texts = [text for text in re.split(r"[\s;,()\[\]]+", value) if text]
        if len(texts) < 2 or not all(re.fullmatch(r"[-+]?[\d.]+", text) for text in texts):
            return None
    else:
        return None
    return f"[{', '.join(texts)}]"


def _id_hint(name: str) -> str:
    similar = similar_name(name)
    # ROS 2 allows no `__` in a namespace, which the name of a robot in a fleet is.
    rule = _ID_HINT.replace("`_`", "single `_`") if "__" in name else _ID_HINT
    return rule if similar is None else Proposal(f"{rule}, as in `{similar}`", similar)


def similar_name(text: str) -> str | None:
    """Returns the valid name that is most similar to a text, or ``None`` if there is none."""
    german = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss", "å": "aa", "ø": "oe"})
    latin = unicodedata.normalize("NFKD", text.strip().lower().translate(german))
    fixed = re.sub(r"[^a-z0-9]+", "_", re.sub(r"[\u0300-\u036f]", "", latin)).strip("_")
    return fixed if re.fullmatch(r"[a-z][a-z0-9_]{0,63}", fixed) else None


def _path_hint(text: str) -> str:
    fixed = ".".join(re.findall(r"[a-z0-9_]+", text.lower().replace("-", "_")))
    hint = "write names joined by dots, as in"
    if re.fullmatch(r"[a-z][a-z0-9_]*(\.[a-z][a-z0-9_]*)+", fixed) is None:
        return f"{hint} `frame.front_left`"
    return Proposal(f"{hint} `{fixed}`", fixed)


def _expected(schema: dict[str, Any]) -> str:
    """Returns the types of value that a schema allows, such as ``a length or a mapping``."""
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
    """Returns the first example in a JSON Schema as YAML text.

    Returns ``None`` if the JSON Schema has no example, or if the first example is an expression.
    """
    examples = schema.get("examples")
    if not examples or (isinstance(examples[0], str) and examples[0].startswith("${")):
        return None
    return yaml_text(examples[0])


def _text(node: Node) -> str:
    text = node.value if isinstance(node.value, str) else yaml_text(node.value)
    return text if len(text) <= 60 else text[:57] + "..."


def _actual(node: Node) -> str:
    """Returns a description of an invalid value for an error message, such as ``a list``."""
    is_text = isinstance(node.value, str)
    return f"the text {describe_node(node)}" if is_text else describe_node(node)
