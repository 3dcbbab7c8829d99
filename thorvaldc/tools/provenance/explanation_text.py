"""An explanation as text for a terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from thorvaldc.comparison.difference_text import shortened, value_text
from thorvaldc.diagnostics.text_layout import paragraph, text_list
from thorvaldc.tools.provenance.explanation import Explanation

WIDTH = 80  # columns
MOST_ROWS, MOST_LINES, MOST_NUMBERS = 12, 8, 4
UNKNOWN = (
    "not known: no number in a file leads to it in a way that `why` follows. It is a default of"
    " thorvaldc, a text, or computed by a choice"
)


def explanation_text(explanation: Explanation, *, everything: bool = False) -> str:
    """Returns an explanation as text.  ``everything``: whether long lists are written in full."""
    value, unit = explanation.get("value"), explanation.get("unit", "")
    head = "" if value is None else f" = {value_text(value, unit, 12)}"
    head = f" = {value!r} rad ({head[3:]})" if unit == "rad" else head
    lines = [explanation["name"] + head]
    lines += [f"  {name} at {place}" for name, place in explanation["elements"].items()]
    if not explanation["comes_from"] and not explanation["through"]:
        lines += ["", *paragraph(UNKNOWN, WIDTH)]
    titles = ("comes_from", "through", "module_types", "goes_into_the_model", "goes_into")
    for title in titles:
        items = explanation.get(title, [])
        blocks = (
            _use_rows(items, everything) if isinstance(items, dict) else list(map(_rows, items))
        )
        shown = blocks if everything else blocks[:MOST_ROWS]
        rows = [row for block in shown for row in block]
        if len(shown) < len(blocks):
            rows.append(f"  and {len(blocks) - len(shown)} more (--all)")
        lines += ["", title.replace("_", " "), *rows] if rows else []
    return "\n".join(lines) + "\n"


def _rows(item: Any) -> list[str]:
    if isinstance(item, str):
        return [f"  {item}"]
    text = paragraph(f"{item['key']}: {item['text']}", WIDTH, "      ")
    reason = paragraph(item["reason"], WIDTH, "      ") if "${" not in item["text"] else []
    return [f"  {item['place']}", *text, *(reason if item["reason"] else [])]


def _use_rows(uses: Mapping[str, Mapping[int, str]], everything: bool) -> list[list[str]]:
    """Returns the rows of each output file; with the texts of the lines if there are few."""
    column = max(map(len, uses), default=0) + 2
    are_few = len([n for numbers in uses.values() for n in numbers]) <= MOST_LINES
    blocks = []
    for name, lines in uses.items():
        numbers = list(map(str, lines))
        if len(numbers) > MOST_NUMBERS and not everything:
            numbers[MOST_NUMBERS:] = ["..."]
        row = (f"  {name}", f"{'lines' if len(lines) > 1 else 'line'} {', '.join(numbers)}")
        texts = [f"      {shortened(t, WIDTH - 6)}" for t in lines.values()] if are_few else []
        blocks.append([*text_list([row], WIDTH, column), *texts])
    return blocks
