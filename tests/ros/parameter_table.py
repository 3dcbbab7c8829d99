"""The table of the node's parameters in docs/ros2-node.md, from ``thorvaldc/ros/parameters.py``.

``python -m tests.ros.parameter_table`` writes the table into the page; a test compares it.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

from tests.examples import example_robot
from thorvaldc.diagnostics.text_layout import markdown_table
from thorvaldc.ros.parameters import PARAMETERS

PAGE = Path(__file__).parents[2] / "docs" / "ros2-node.md"
BEGIN, END = "<!-- made by tests/ros/parameter_table.py -->\n", "<!-- end -->\n"
HEADINGS = ("parameter", "type", "description", "set at run time")
TYPES = {str: "string", bool: "bool", float: "double"}


def table() -> Iterator[str]:
    robot = example_robot("4wd4ws_wide")  # the types are those of every robot
    rows = [
        (f"`{p.name}`", TYPES[type(p.default_for(robot))], p.text, "no" if p.read_only else "yes")
        for p in PARAMETERS
    ]
    return markdown_table([HEADINGS, *rows])


def text() -> str:
    """Returns the page with the present table."""
    head, _, tail = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    return head + BEGIN + "".join(f"{line}\n" for line in table()) + END + tail.partition(END)[2]


def main() -> int:
    PAGE.write_text(text(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
