"""What the commands write: facts as text, and a comparison as a web page."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from typing import TYPE_CHECKING

from thorvaldc.diagnostics import text_layout
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.facts.fact_page import escape, table_html
from thorvaldc.model.facts.fact_tables import FactTable, fact_tables
from thorvaldc.model.facts.robot_facts import RobotFacts

if TYPE_CHECKING:
    from thorvaldc.comparison.robot_difference import Difference

WIDTH = 80
_LONG = ("modules", "sources")
"""Tables that the text leaves out by default, because the bill of modules sums them up."""


def facts_text(facts: RobotFacts, *, everything: bool) -> str:
    """Returns the facts as text for a terminal of ``WIDTH`` columns.

    ``everything``: whether the text has the tables of every module and source.
    """
    lines = [facts.name, *textwrap.wrap(facts.description, WIDTH)]
    for table in fact_tables(facts):
        if everything or table.key not in _LONG:
            text = text_layout.text_table(_rows(table), WIDTH - len(text_layout.GAP), table.numeric)
            lines += ["", table.title, textwrap.indent(text, text_layout.GAP)]
            for note in table.notes:
                lines += text_layout.paragraph(note, WIDTH, text_layout.GAP)
    return "\n".join(lines) + "\n"


def _rows(table: FactTable) -> list[tuple[str, ...]]:
    """Returns the titles of the columns, empty for a list of names and values, and the rows."""
    return [table.columns or ("",) * len(table.rows[0]), *table.rows]


def difference_page(difference: Difference, before: Robot | Fleet, after: Robot | Fleet) -> str:
    """Returns an HTML document with both robots in 3D and a table of their differences.

    The robot ``before`` is translucent.  Both models must contain the data of their meshes.
    """
    # The page is imported only when it is used, because it imports numpy.
    from thorvaldc.simulation.web_viewer import view_page

    return view_page(after, before, "\n".join(_panel(difference)))


def _panel(difference: Difference) -> Iterator[str]:
    # Facts of one robot need no comparison.
    from thorvaldc.comparison.difference_text import EQUAL, headline, sections_of, summaries_of

    title = escape(headline(difference))
    if difference.is_equal:
        yield f"<p>{title}: {EQUAL}</p>"
        return
    yield f"<p>{title}. The robot before is translucent.</p>"
    for number, section in enumerate(sections_of(difference)):
        rows = tuple((f"{row.mark} {row.name}", row.text) for row in section.rows)
        yield table_html(FactTable(f"difference-{number}", section.title, (), rows))
    for summary in summaries_of(difference):
        yield f"<p>{escape(summary)}</p>"
