"""Writes the data sheet of a robot: one HTML page with all facts, drawings and labels."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from thorvaldc.backends import Backend
from thorvaldc.backends.datasheet_drawings import (
    dimension_drawing,
    side_pictures,
    tip_over_drawing,
)
from thorvaldc.backends.datasheet_outlines import OutlineProjector
from thorvaldc.backends.templates import Templates
from thorvaldc.model import Robot
from thorvaldc.model.facts.fact_tables import fact_tables
from thorvaldc.model.facts.robot_facts import robot_facts

if TYPE_CHECKING:
    from markupsafe import Markup


def _code(text: str) -> Markup:
    """Return a text as HTML in which names in backticks are code.

    A long name may be broken after an underscore, a dot or a slash.
    """
    from markupsafe import Markup, escape

    html = re.sub(r"`([^`]*)`", r"<code>\1</code>", str(escape(text)))
    return Markup(re.sub(r"(?<=\w)([_./])(?=[^\W\d])", r"\1<wbr>", html))


_TEMPLATES = Templates("datasheet", {"code": _code}, escapes_html=True)


class Datasheet(Backend):
    name = "datasheet"
    summary = "HTML page to print: facts, drawings, wiring, labels, modules"

    def emit(self, robot: Robot) -> dict[str, bytes]:
        facts = robot_facts(robot)
        projector = OutlineProjector(robot)
        addresses = [address for bus in facts.buses for address in bus.addresses]
        page = _TEMPLATES.render(
            "page.html",
            facts=facts,
            tables=fact_tables(facts),
            dimensions=dimension_drawing(robot, facts, projector),
            sides=side_pictures(facts, projector),
            tip_over=tip_over_drawing(facts.stability),
            labels=[address for address in addresses if address.id_space],
        )
        return {"datasheet/datasheet.html": page.encode()}
