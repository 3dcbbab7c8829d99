"""The data sheet: one accessible page that loads nothing, with the facts and the drawings."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from tests.accessibility import Page, accessible_page
from tests.buses import robot_with_bus
from tests.examples import FLEETS, SAMPLED_ROBOTS, example_fleet, example_robot
from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.backends.datasheet import RIGHT, Datasheet, OutlineProjector
from thorvaldc.model import Link, Robot
from thorvaldc.model.facts.fact_tables import fact_tables
from thorvaldc.model.facts.robot_facts import robot_facts

ROBOTS_TO_CHECK = ["4wd2ws_tall", "car", "2wd0ws_greenhouse"]


def text_of(robot: Robot) -> str:
    return Datasheet().emit(robot)["datasheet/datasheet.html"].decode()


@pytest.fixture(scope="module", params=ROBOTS_TO_CHECK)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def test_the_page_is_accessible_and_loads_nothing(name: str) -> None:
    page = accessible_page(text_of(example_robot(name)))
    assert len(page.all("svg")) == 6


def test_the_page_has_every_fact(name: str) -> None:
    robot = example_robot(name)
    text = text_of(robot)
    shown = re.sub(r"<wbr>|</?code>", "", text)
    for table in fact_tables(robot_facts(robot)):
        assert f">{table.title}</h2>" in shown
        for row in table.rows:
            for cell in row:
                assert cell.replace("`", "") in shown


def test_the_drawing_has_the_dimensions(name: str) -> None:
    robot = example_robot(name)
    size = robot_facts(robot).size
    texts = [text for tag, text in Page(text_of(robot)).texts if tag == "text"]
    for value in (size.length, size.width, size.height, size.wheelbase, size.track):
        assert value is not None
        assert f"{1000 * value:.0f}" in texts


def test_the_outlines_fill_the_dimensions() -> None:
    """The drawing comes from the shapes and the dimensions from their extents: they must agree."""
    robot = example_robot("car")
    text = text_of(robot)
    front = text[text.index('aria-labelledby="front-title') :]
    front = front[: front.index("</svg>")]
    points = re.findall(r'points="([^"]*)"', front)
    xs = [float(pair.split(",")[0]) for polygon in points for pair in polygon.split()]
    ys = [float(pair.split(",")[1]) for polygon in points for pair in polygon.split()]
    size = robot_facts(robot).size
    assert max(xs) - min(xs) == pytest.approx(1000 * size.width, abs=1.0)
    assert max(ys) - min(ys) == pytest.approx(1000 * size.height, abs=1.0)


def test_labels_have_names_and_addresses() -> None:
    robot = robot_with_bus()
    page = Page(text_of(robot))
    nodes = [node for bus in robot.buses for node in bus.nodes if node.id_space]
    assert len(page.all("li")) == len(nodes) > 0
    for node in nodes:
        assert f"(0x{node.id:02X})" in [text for tag, text in page.texts if tag == "span"]


@pytest.mark.parametrize(
    "robot",
    [
        make_robot([]),
        replace(
            make_robot([]),
            links=(Link("base_link", "", None, (), (), make_robot([]).span),),
            joints=(),
        ),
        make_robot([(0.5, 0.1, "fixed"), (0.5, -0.1, "fixed")]),
        make_robot([(0.5, 0.5, "swivel"), (0.5, -0.5, "swivel"), (-0.5, 0.0, "swivel")]),
        make_robot(FOUR_STEERED, suspended=True),
        replace(make_robot(FOUR_STEERED), description='<b>"&amp;" `code` {{ 1 }}'),
    ],
    ids=["no_wheels", "only_a_base", "falls", "casters", "suspended", "odd_text"],
)
def test_pages_of_odd_robots(robot: Robot) -> None:
    page = Page(text_of(robot))
    if robot.description:
        assert "".join(text for tag, text in page.texts if tag == "p").startswith(robot.description)


@pytest.mark.parametrize("name", sorted(set(SAMPLED_ROBOTS) - set(ROBOTS_TO_CHECK)))
def test_every_example_has_a_page(name: str) -> None:
    Page(text_of(example_robot(name)))


def test_a_fleet_has_a_page_for_each_robot() -> None:
    fleet = example_fleet(FLEETS[0])
    files = Datasheet().emit_fleet(fleet)
    assert set(files) == {f"{p.name}/datasheet/datasheet.html" for p in fleet.placements}


def test_a_body_hides_the_battery_in_it() -> None:
    robot = example_robot("2wd0ws_greenhouse")
    battery = next(link for link in robot.links if link.name == "battery_box").visuals[0].color
    outlines = OutlineProjector(robot).outlines(RIGHT)
    widths = [max(x for x, _ in o.points) - min(x for x, _ in o.points) for o in outlines]
    body = widths.index(max(widths))
    inside = [i for i, outline in enumerate(outlines) if outline.color == battery]
    assert inside
    assert max(inside) < body


def test_a_rim_is_shown_in_its_tyre() -> None:
    robot = example_robot("4wd4ws_wide")
    link = next(link for link in robot.links if link.name == "fr_wheel_tyre")
    tyre, rim = (visual.color for visual in link.visuals[:2])
    colors = [outline.color for outline in OutlineProjector(robot).outlines(RIGHT)]
    assert colors.index(tyre) < len(colors) - 1 - colors[::-1].index(rim)
