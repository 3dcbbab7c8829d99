"""Descriptions of module types: mass, positions of ports, and what fits where."""

from __future__ import annotations

from functools import cache

import pytest

from tests.examples import example_robot
from thorvaldc.compiler.catalogue import ModuleDescription, describe_module
from thorvaldc.compiler.modules.library import Library
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report, Span
from thorvaldc.model.facts.robot_facts import robot_facts

NAMES = Library([]).names()


@cache
def described(name: str) -> ModuleDescription:
    library = Library([])
    module = library.load(name, Node(name, Span(name)), Report())
    assert module is not None
    return describe_module(module, library)


@pytest.mark.parametrize("name", ["drive/standard", "wheel/agri_200", "steering/standard"])
def test_the_mass_is_that_in_a_robot_with_default_parameters(name: str) -> None:
    rows = robot_facts(example_robot("9wd9ws")).bill
    row = next(row for row in rows if row.type == name)
    description = described(name)
    if name == "steering/standard":
        assert description.mass == pytest.approx(row.mass)
    assert {part.source for part in description.masses or ()} >= {p.source for p in row.sources}


def test_an_assembly_has_the_mass_of_its_modules() -> None:
    parts = ("steering/standard", "drive/standard", "wheel/agri_200")
    total = sum(described(part).mass or 0.0 for part in parts)
    assert described("assembly/steered_drive").mass == pytest.approx(total)


def test_what_fits_is_symmetric() -> None:
    frame, steering = described("frame/tube_rectangular"), described("steering/standard")
    assert "frame/tube_rectangular" in steering.carriers
    front_left = next(port for port in frame.ports if port.name == "front_left")
    assert front_left.kind in steering.mounts_on
    assert "steering/standard" in front_left.takes
    assert "wheel/agri_200" not in front_left.takes
    assert front_left.position == (0.549, 0.449, 0.0)


def test_units_of_parameters() -> None:
    units = described("drive/standard").units
    assert (units["max_torque"], units["motor_max_speed"]) == ("N m", "rad/s")
    assert "leg_side" not in units


def test_a_type_with_a_parameter_without_default_has_no_numbers() -> None:
    tube = described("frame/tube")
    assert tube.mass is None
    assert tube.masses is None
    assert tube.ports
    assert all(port.position is None for port in tube.ports)


def test_a_module_that_is_only_wired_by_default_has_its_mass() -> None:
    assert described("controller/propulsion_steering").mass == 0.5
