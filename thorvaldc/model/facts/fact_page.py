"""Facts as HTML: tables, and pages without scripts and other files.

``page.html`` beside this file is the template of the pages.
"""

from __future__ import annotations

import html
import re
from collections.abc import Collection
from pathlib import Path
from string import Template

from thorvaldc.model import Robot
from thorvaldc.model.facts.fact_tables import FactTable, fact_tables
from thorvaldc.model.facts.robot_facts import RobotFacts, robot_facts

_PAGE = Template(Path(__file__).with_name("page.html").read_text(encoding="utf-8"))
_LONG = 24
"""A table with more rows may be broken between two printed pages."""


def facts_html(facts: RobotFacts, keys: Collection[str] = ()) -> str:
    """Returns tables of the facts for a notebook: those of some keys, or all."""
    tables = (table for table in fact_tables(facts) if not keys or table.key in keys)
    parts = (table_html(table, level=4) for table in tables)
    return f"<h3>{escape(facts.name)}</h3>{''.join(parts)}"


def robot_html(robot: Robot) -> str:
    """Returns the most important facts about a robot for a notebook."""
    return facts_html(robot_facts(robot), ("size", "mass", "wheels", "stability", "driving"))


def page(title: str, heading: str, about: str, main: str, style: str = "") -> str:
    """Returns an HTML document.

    - ``title``, ``heading``, ``about``: texts; ``about`` is the line below the heading.
    - ``main``: content in HTML; ``style``: rules of style for it.
    """
    texts = {"title": escape(title), "heading": escape(heading), "about": escape(about)}
    return _PAGE.substitute(texts, main=main, style=style)


def table_html(table: FactTable, faults: Collection[str] = (), level: int = 2) -> str:
    """Returns a table with its title and notes as a section of a page.

    - ``faults``: texts of cells that are marked as faults.
    - ``level``: level of the heading.
    """

    def kind(index: int, text: str) -> str:
        kinds = {"number": index in table.numeric, "fault": text in faults}
        names = " ".join(name for name, applies in kinds.items() if applies)
        return f' class="{names}"' if names else ""

    # Only a table with columns can be too wide, and is scrolled with the keyboard.
    scrolled = f' tabindex="0" aria-labelledby="{table.key}"' if table.columns else ""
    lines = [
        f'<section class="{"long" if len(table.rows) > _LONG else "short"}"{scrolled}>',
        f'<h{level} id="{table.key}">{escape(table.title)}</h{level}>',
        f'<table class="{"columns" if table.columns else "list"}" aria-labelledby="{table.key}">',
    ]
    if table.columns:
        titles = enumerate(table.columns)
        cells = (f'<th scope="col"{kind(i, "")}>{escape(title)}</th>' for i, title in titles)
        lines += ["<thead>", f"<tr>{''.join(cells)}</tr>", "</thead>"]
    lines.append("<tbody>")
    for name, *values in table.rows:
        inner = ' class="inner"' if name.startswith(" ") else ""
        cells = (f"<td{kind(i, text)}>{code(text)}</td>" for i, text in enumerate(values, 1))
        lines.append(f'<tr><th scope="row"{inner}>{code(name)}</th>{"".join(cells)}</tr>')
    lines += ["</tbody>", "</table>"]
    lines += [f'<p class="note">{code(note)}</p>' for note in table.notes]
    return "\n".join([*lines, "</section>", ""])


def code(text: str) -> str:
    """Returns a text as HTML in which names in backticks are code.

    A long name may be broken after an underscore, a dot or a slash.
    """
    with_code = re.sub(r"`([^`]*)`", r"<code>\1</code>", escape(text))
    return re.sub(r"(?<=\w)([_./])(?=[^\W\d])", r"\1<wbr>", with_code)


def escape(text: str) -> str:
    """Returns a text in which no character has a meaning in HTML, as jinja2 escapes it."""
    return html.escape(text).replace("&quot;", "&#34;").replace("&#x27;", "&#39;")
