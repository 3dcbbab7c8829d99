"""A comparison as a web page that shows both robots at the same place."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape

from thorvaldc.comparison.difference_rows import headline, sections_of
from thorvaldc.comparison.difference_text import EQUAL, summaries_of
from thorvaldc.comparison.robot_difference import Difference
from thorvaldc.model import Fleet, Robot
from thorvaldc.simulation.web_viewer import view_page


def difference_page(difference: Difference, before: Robot | Fleet, after: Robot | Fleet) -> str:
    """Returns an HTML document with both robots in 3D and a table of their differences.

    The robot ``before`` is translucent.  Both models must contain the data of their meshes.
    """
    return view_page(after, before, "\n".join(_panel(difference)))


def _panel(difference: Difference) -> Iterator[str]:
    title = escape(headline(difference))
    if difference.is_equal:
        yield f"<p>{title}: {EQUAL}</p>"
        return
    yield f"<p>{title}. The robot before is translucent.</p>"
    for section in sections_of(difference):
        yield f'<details open class="difference"><summary>{escape(section.title)}</summary><table>'
        for row in section.rows:
            cells = (row.mark, row.name, row.text)
            yield f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in cells)}</tr>"
        yield "</table></details>"
    for summary in summaries_of(difference):
        yield f"<p>{escape(summary)}</p>"
