"""Whatever differs in the model, `diff` does not call two robots equal."""

from __future__ import annotations

import json
import random
from collections.abc import Iterator
from typing import Any

import pytest

from tests.examples import example_fleet, example_robot
from tests.slow import mostly_slow
from thorvaldc.comparison.difference_text import difference_document, difference_text
from thorvaldc.comparison.robot_comparison import compare_fleets, compare_robots
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.model_json import ModelFormatError, from_json, to_json

Step = tuple[Any, Any]  # a container and the key of a value in it


def values_of(container: Any) -> Iterator[Step]:
    """Every plain value of a JSON document, without source spans."""
    items = container.items() if isinstance(container, dict) else enumerate(container)
    for key, value in items:
        if key == "span":
            continue
        if isinstance(value, dict | list) and value:
            yield from values_of(value)
        else:
            yield container, key


def mutated(value: Any, factor: float) -> Any:
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + 1
    if isinstance(value, float):
        return value * factor if value else factor - 1.0
    return f"{value}x" if isinstance(value, str) else value


@pytest.mark.slow
def test_a_changed_value_is_a_difference() -> None:
    robot = example_robot("4wd4ws_wide")
    text = to_json(robot)
    count = len(list(values_of(json.loads(text)["model"])))
    generator = random.Random(1)
    tried = 0
    for number in generator.sample(range(count), 60):
        document = json.loads(text)
        container, key = list(values_of(document["model"]))[number]
        container[key] = mutated(container[key], generator.choice((1.0 + 1e-15, 1.1)))
        try:
            other = from_json(json.dumps(document))
        except ModelFormatError:  # a word that is not one of those allowed
            continue
        assert isinstance(other, Robot)
        if other == robot:  # an empty list, or a number that rounds to the same
            continue
        tried += 1
        for pair in ((robot, other), (other, robot)):
            difference = compare_robots(*pair)
            assert not difference.is_equal
            assert "no differences" not in difference_text(difference)
            assert difference_document(difference)["values_of_model"]
    assert tried > 24


def test_a_removed_element_is_a_difference() -> None:
    robot = example_robot("4wd4ws_wide")
    for field in ("links", "joints", "wheels", "actuators", "sensors", "batteries", "meshes"):
        document = json.loads(to_json(robot))
        document["model"][field].pop()
        other = from_json(json.dumps(document))
        assert isinstance(other, Robot)
        difference = compare_robots(robot, other)
        text = difference_text(difference, everything=True)
        assert not difference.is_equal, field
        assert " - " in text, text


def test_another_order_is_a_difference() -> None:
    robot = example_robot("4wd4ws_wide")
    document = json.loads(to_json(robot))
    document["model"]["twist_sources"].reverse()
    other = from_json(json.dumps(document))
    assert isinstance(other, Robot)
    text = difference_text(compare_robots(robot, other))
    assert "twist sources" in text
    assert "order" in text


@pytest.mark.parametrize(
    "path", mostly_slow([("robot", "name"), ("pose", "xyz", 0), ("robot", "wheels")])
)
def test_a_change_in_a_fleet_is_a_difference(path: tuple[Any, ...]) -> None:
    fleet = example_fleet("fleet_of_four")
    document = json.loads(to_json(fleet))
    container = document["model"]["placements"][1]
    for key in path[:-1]:
        container = container[key]
    value = container[path[-1]]
    container[path[-1]] = value[1:] if isinstance(value, list) else mutated(value, 1.1)
    other = from_json(json.dumps(document))
    assert isinstance(other, Fleet)
    assert compare_fleets(fleet, fleet).is_equal
    difference = compare_fleets(fleet, other)
    assert not difference.is_equal
    assert fleet.placements[1].name in difference_text(difference)
