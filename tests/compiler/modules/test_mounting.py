"""The mounting ports of a robot: where they are, and what is on them."""

from __future__ import annotations

import pytest

from tests.workshop import CART, Workshop, format_report
from thorvaldc.compiler.modules.mounting import MountingPort
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Fleet, Robot

ARM = """
mount: {kinds: [clamp], link: base}
params:
  long: {type: boolean, default: false, description: Second port., source: "chosen: for a test"}
links:
  base: {parts: [{shape: {box: [0.1, 0.1, 0.1]}, mass: 1 kg, source: "chosen: for a test"}]}
ports:
  tip: {kind: clamp, xyz: [1, 0, 0]}
  end: {kind: clamp, link: base, xyz: [2, 0, 0], when: "${long}"}
"""
HEAD = """<robot name="head"><link name="head"/></robot>
"""


def ports(workshop: Workshop, modules: str, head: str = "") -> dict[str, MountingPort]:
    workshop.module("t/arm", ARM)
    compilation = workshop.compile(CART + modules, head)
    assert isinstance(compilation.model, Robot), format_report(compilation)
    return {port.name: port for port in compilation.ports(compilation.model)}


def test_free_and_taken_ports(workshop: Workshop) -> None:
    found = ports(
        workshop,
        """
    a: {type: t/arm, mount: body.front}
    b: {type: t/arm, params: {long: true}, mount: {port: a.tip, xyz: [0.5, 0, 0]}}
    """,
    )
    carries = {name: port.carries for name, port in found.items()}
    assert carries == {
        "body.front": ("a",),
        "body.rear": (),
        "a.tip": ("b",),  # with a distance to the port
        "b.tip": (),
        "b.end": (),  # `a` has no such port
    }
    assert found["b.end"].link == "b_base"
    assert found["b.tip"].link == "b_base"  # the first link
    assert found["b.end"].pose.xyz == (2.0, 0.0, 0.0)
    assert found["b.end"].kind == "clamp"


def test_an_extra_takes_a_port(workshop: Workshop) -> None:
    workshop.write("head.urdf", HEAD)
    found = ports(workshop, "", "extras: [{xacro: head.urdf, parent: body.rear}]\n")
    assert found["body.rear"].carries == ("extras",)


@pytest.mark.parametrize("name", ["fleet_of_four/fleet", "scenarios/field_edge"])
def test_the_robots_of_a_fleet_have_ports(name: str) -> None:
    compilation = compile_file(f"examples/{name}.yaml")
    assert isinstance(compilation.model, Fleet)
    for placed in compilation.model.placements:
        links = {link.name for link in placed.robot.links}
        found = compilation.ports(placed.robot)
        assert {port.link for port in found} <= links
        assert {"fl.drive.hub": ("fl.wheel",)}.items() <= {p.name: p.carries for p in found}.items()
