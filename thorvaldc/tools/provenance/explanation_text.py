"""An explanation of a value as text for a terminal, and as JSON."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from thorvaldc.comparison.difference_text import shortened, value_text
from thorvaldc.compiler.modules.library import BUILTIN_LIBRARY
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.value_reader import items
from thorvaldc.diagnostics import Span
from thorvaldc.diagnostics.renderers import Excerpts
from thorvaldc.diagnostics.text_layout import paragraph, text_list
from thorvaldc.tools.provenance.explanation import Explanation, OutputUse, Step
from thorvaldc.tools.provenance.influence_search import Influence, SourceValue

WIDTH = 80  # columns
MOST_WITH_EXCERPTS = 4
MOST_ROWS = 12
MOST_LINES = 8
MOST_NUMBERS = 4
MOST_MODEL_VALUES = 8


class ExplanationText:
    """Writes explanations of values.

    Parameters
    ----------
    documents : documents of the robot by the name in spans.
    files : path of each document.
    everything : whether long lists are written in full.
    """

    def __init__(
        self,
        documents: Mapping[str, Node],
        files: Mapping[str, Path],
        *,
        everything: bool = False,
    ) -> None:
        self.documents = documents
        self.files = files
        self.everything = everything
        self.most_rows = 10**9 if everything else MOST_ROWS
        self.most_numbers = 10**9 if everything else MOST_NUMBERS
        self.most_model_values = 10**9 if everything else MOST_MODEL_VALUES
        self.excerpts = Excerpts(files, WIDTH - 4)

    def text(self, explanation: Explanation) -> str:
        """Returns an explanation as text."""
        lines = [f"{explanation.path} = {_value_text(explanation)}"]
        if explanation.element is not None:
            lines.append(f"  at {self.place(explanation.element)}")
        lines += self._sources(explanation)
        lines += _section("module types", map(self._step_lines, explanation.types))
        values = explanation.model_values
        if values:
            shown = values[: self.most_model_values]
            more = len(values) - len(shown)
            rows = [[f"  {value}"] for value in shown]
            rows += [[f"  and {more} more (--all)"]] if more else []
            title = "goes into the model" if explanation.chain else "through the model"
            lines += _section(title, rows)
        lines += _section("goes into", self._uses(explanation.uses))
        also = "its source also changes"
        return "\n".join(lines + _section(also, self._uses(explanation.source_uses))) + "\n"

    def place(self, span: Span) -> str:
        """Returns a span with the path of its file from the working folder."""
        path = self.files.get(span.file)
        if path is None or span.file.startswith(BUILTIN_LIBRARY):
            return str(span)
        return str(Span(os.path.normpath(path), *span[1:]))

    # -- sources ------------------------------------------------------------------------------

    def _sources(self, explanation: Explanation) -> list[str]:
        if explanation.chain:
            steps = explanation.chain
            lines = _section("comes from", [self._excerpt_lines(steps[0].span, steps[0])])
            return lines + _section("through", map(self._step_lines, steps[1:]))
        constants = [i for i in explanation.influences if not i.source.is_expression]
        expressions = [i for i in explanation.influences if i.source.is_expression]
        zeros = [i for i in constants if i.effect is None and _is_zero(i.source)]
        constants = [i for i in constants if i not in zeros] or zeros
        if len(constants) <= MOST_WITH_EXCERPTS:
            blocks = [self._influence_lines(influence) for influence in constants]
        else:
            blocks = [list(self._table(constants))]
        lines = _section("comes from", blocks)
        if zeros and self.everything:
            lines += _section("and of values that are 0", map(self._influence_lines, zeros))
        if not explanation.is_varied:
            text = "not a number: it was not varied to find its sources"
            lines += ["", *paragraph(text, WIDTH)]
        elif not (constants or zeros):
            text = "comes from no number in a file: it is a default of thorvaldc"
            lines += ["", *paragraph(text, WIDTH)]
        if not explanation.is_complete:
            text = "the search was ended at its limit; more values may influence it"
            lines += paragraph(text, WIDTH)
        rows = [self._step_lines(_step_of(i.source)) for i in expressions]
        return lines + _section("through", rows)

    def _influence_lines(self, influence: Influence) -> list[str]:
        source = influence.source
        lines = self._excerpt_lines(source.span, _step_of(source))
        reason = self._reason(source)
        if reason:
            lines += paragraph(reason, WIDTH, "    ")
        if influence.effect is not None:
            lines.append(f"    effect: +1 % here is {influence.effect:+.2g} % there")
        return lines

    def _table(self, influences: list[Influence]) -> Iterator[str]:
        """Yields a table of influences, the greatest first."""
        ordered = sorted(influences, key=lambda i: -abs(i.effect or 0.0))
        yield "  effect of 1 %"
        for influence in ordered[: self.most_rows]:
            effect = f"{influence.effect:+.2g} %" if influence.effect is not None else ""
            source = influence.source
            yield f"  {effect:>9}  {source.key_path}: {shortened(str(source.node.value), 24)}"
            yield f"             {self.place(source.span)}"
        if len(ordered) > self.most_rows:
            yield f"  and {len(ordered) - self.most_rows} more with a smaller effect (--all)"

    def _reason(self, source: SourceValue) -> str:
        """Returns the text of the key `source` beside a value: where the author has it from."""
        node: Node | None = self.documents.get(source.span.file)
        for key in source.keys[:-1]:
            if node is None:
                return ""
            node = node.get(key) if isinstance(key, str) else items(node)[key]
        reason = node.get("source") if node is not None else None
        return str(reason.value) if reason is not None else ""

    def _excerpt_lines(self, span: Span, step: Step) -> list[str]:
        lines = [f"  {self.place(span)}  {step.key_path}"]
        if len(lines[0]) > WIDTH:
            lines = [f"  {self.place(span)}", f"    {step.key_path}"]
        excerpt = self.excerpts.show(span, 4)
        if excerpt is not None:
            lines.append(f"  {span.line:>4} | {excerpt.text}")
            lines.append(f"       | {' ' * excerpt.start}{'^' * excerpt.length}")
        return lines

    def _step_lines(self, step: Step) -> list[str]:
        text = f"{step.key_path}: {step.text}"
        return [f"  {self.place(step.span)}", *paragraph(text, WIDTH, "      ")]

    # -- uses ---------------------------------------------------------------------------------

    def _uses(self, uses: list[OutputUse]) -> Iterator[list[str]]:
        """Yields a row for each output file; with the texts of the lines if there are few."""
        column = max((len(use.file) for use in uses), default=0) + 2
        count = len([line for use in uses for line in use.lines])
        for use in uses:
            numbers = ", ".join(str(number) for number, _ in use.lines[: self.most_numbers])
            more = ", ..." if len(use.lines) > self.most_numbers else ""
            noun = "lines" if len(use.lines) > 1 else "line"
            row = (f"  {use.file}", f"{noun} {numbers}{more}")
            rows = list(text_list([row], WIDTH, column))
            if count <= MOST_LINES:
                rows += [f"      {shortened(text, WIDTH - 6)}" for _, text in use.lines]
            yield rows


def _section(title: str, blocks: Iterable[list[str]]) -> list[str]:
    lines = [line for block in blocks for line in block]
    return ["", title, *lines] if lines else []


def explanation_document(explanation: Explanation, writer: ExplanationText) -> dict[str, Any]:
    """Returns an explanation as a JSON document."""
    return {
        "path": explanation.path,
        "value": explanation.value,
        "unit": explanation.unit,
        "element": writer.place(explanation.element) if explanation.element is not None else None,
        "sources": [
            {
                "place": writer.place(influence.source.span),
                "key": influence.source.key_path,
                "text": influence.source.node.value,
                "is_expression": influence.source.is_expression,
                "effect": influence.effect,
            }
            for influence in explanation.influences
        ],
        "chain": [_step_document(step, writer) for step in explanation.chain],
        "module_types": [_step_document(step, writer) for step in explanation.types],
        "model_values": explanation.model_values,
        "outputs": [
            {"file": use.file, "lines": [number for number, _ in use.lines]}
            for use in explanation.uses
        ],
        "outputs_of_source": [use.file for use in explanation.source_uses],
        "complete": explanation.is_complete,
    }


def _step_document(step: Step, writer: ExplanationText) -> dict[str, Any]:
    return {
        "place": writer.place(step.span),
        "key": step.key_path,
        "text": step.text,
        "value": step.value,
        "unit": step.unit,
    }


def _step_of(source: SourceValue) -> Step:
    return Step(source.span, source.key_path, str(source.node.value), None, "", source)


def _is_zero(source: SourceValue) -> bool:
    value = source.node.value
    return value == 0 or (isinstance(value, str) and value.lstrip("-").startswith(("0 ", "0.0 ")))


def _value_text(explanation: Explanation) -> str:
    text = value_text(explanation.value, explanation.unit, 12)
    if explanation.unit == "rad":
        return f"{explanation.value!r} rad ({text})"
    return text
