"""Each number of model and facts states its quantity once, in the type of its field."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Iterator
from typing import Any

import pytest

from thorvaldc.model import Fleet, Robot
from thorvaldc.model.facts.robot_facts import RobotFacts, fact_quantity
from thorvaldc.model.quantities import MONEY, NUMBER, field_types, quantity_at

WITHOUT = frozenset(
    [
        *("Joint.axis", "MeshShape.scale", "Pose.quat", "Visual.color"),  # numbers
        *("Signal.maximum", "Signal.minimum", "Signal.offset", "Signal.scale"),  # of Signal.unit
        "DriverSettings.noise",  # its names state them
    ]
)


def classes(hint: Any, seen: set[type]) -> None:
    for part in typing.get_args(hint):
        classes(part, seen)
    if isinstance(hint, type) and dataclasses.is_dataclass(hint) and hint not in seen:
        seen.add(hint)
        for field in field_types(hint).values():
            classes(field, seen)


def bare_floats(hint: Any) -> Iterator[Any]:
    if hint is float:
        yield hint
    elif typing.get_origin(hint) is not typing.Annotated and bool not in typing.get_args(hint):
        for part in typing.get_args(hint):
            yield from bare_floats(part)


def test_every_number_states_its_quantity() -> None:
    seen: set[type] = set()
    for root in (Robot, Fleet, RobotFacts):
        classes(root, seen)
    bare = {
        f"{cls.__name__}.{name}"
        for cls in seen
        for name, hint in field_types(cls).items()
        if any(bare_floats(hint))
    }
    assert bare == WITHOUT


@pytest.mark.parametrize(
    ("path", "kind", "unit"),
    [
        ("inertial.com", "length", "m"),
        ("joints.fl_joint.lower", "angle or length", "rad or m"),
        ("wheels.fl_wheel.radii.rail", "length", "m"),
        ("buses.main.load", "number", "share"),
        ("parameter_sets.slow.driver.rate", "frequency", "Hz"),
        ("links.base_link.visuals.0.shape.radius", "length", "m"),
    ],
)
def test_values_of_the_model(path: str, kind: str, unit: str) -> None:
    assert quantity_at(Robot, path.split(".")) == (kind, unit)


def test_values_without_a_quantity() -> None:
    for path in ("wheels", "wheels.fl_wheel.name", "wheels.fl_wheel.driven", "sensors.imu.size"):
        assert quantity_at(Robot, path.split(".")) is None


def test_facts() -> None:
    assert fact_quantity("size.upper.2").unit == "m"
    assert fact_quantity("stability.angles.left").unit == "rad"
    assert fact_quantity("wheels.3.load_range.1").kind == "force"
    assert fact_quantity("purchase.items.0.price") == MONEY
    assert fact_quantity("bill.2.count") == NUMBER
