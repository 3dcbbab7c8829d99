"""The world of a scenario in the MJCF: gravity on a slope, blocks, zones and rough ground."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree

import pytest

from tests.backend_files import files_of
from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.backends.mjcf import Mjcf
from thorvaldc.model import (
    Block,
    Box,
    Cylinder,
    Fleet,
    Ground,
    Placement,
    Pose,
    Sphere,
    World,
    Zone,
)

POSE = Pose.from_xyz_rpy((5.0, 6.0, 0.5), (0.0, 0.0, math.pi / 2))


def scene(world: World) -> tuple[ElementTree.Element, dict[str, bytes]]:
    robot = make_robot(FOUR_STEERED)
    files = files_of(Mjcf, Fleet("f", "", (Placement("a", Pose(), robot),), world))
    return ElementTree.fromstring(files["mjcf/scene.xml"]), files


def geoms(root: ElementTree.Element) -> dict[str, ElementTree.Element]:
    return {g.get("name", ""): g for g in root.iter("geom")}


def numbers(element: ElementTree.Element, name: str) -> list[float]:
    return [float(text) for text in element.attrib[name].split()]


def test_blocks_have_half_sizes() -> None:
    blocks = (
        Block("obstacle", "box", Box((1.0, 2.0, 3.0)), POSE),
        Block("post", "pole", Cylinder(0.25, 2.0), POSE),
        Block("crop", "ball", Sphere(0.75), POSE),
    )
    root, _ = scene(World(Ground(), blocks))
    found = geoms(root)
    for name, kind, size in (
        ("obstacle/box", "box", [0.5, 1.0, 1.5]),
        ("post/pole", "cylinder", [0.25, 1.0]),
        ("crop/ball", "sphere", [0.75]),
    ):
        assert found[name].get("type") == kind
        assert numbers(found[name], "size") == size
        assert numbers(found[name], "pos") == [5.0, 6.0, 0.5]
        assert numbers(found[name], "quat") == pytest.approx(POSE.quat)


def test_a_slope_leans_the_gravity() -> None:
    root, _ = scene(World(Ground(angle=0.2, direction=0.7)))
    gravity = next(numbers(o, "gravity") for o in root.iter("option") if "gravity" in o.attrib)
    down = 9.81 * math.sin(0.2)
    expected = [-down * math.cos(0.7), -down * math.sin(0.7), -9.81 * math.cos(0.2)]
    assert gravity == pytest.approx(expected, rel=1e-3)


def test_rough_ground_is_a_height_field_about_the_plane() -> None:
    root, files = scene(World(Ground(amplitude=0.1, wavelength=2.0, size=(20.0, 10.0))))
    (field,) = root.iter("hfield")
    assert numbers(field, "size") == [10.0, 5.0, 0.2, 0.5]
    geom = geoms(root)["ground/terrain"]
    assert geom.get("hfield") == field.get("name")
    assert numbers(geom, "pos") == [0.0, 0.0, -0.1]
    assert numbers(geoms(root)["ground"], "pos") == [0.0, 0.0, -0.1], "the plane around it"
    assert any(path.endswith(field.get("file", "?")) for path in files)


def test_level_zones_are_visible_plates_and_others_are_height_fields() -> None:
    zones = (
        Zone(POSE, (4.0, 2.0), friction=0.2),
        Zone(POSE, (4.0, 2.0), friction=0.3),
        Zone(POSE, (4.0, 2.0), height=0.2, slope=1.0),
    )
    root, files = scene(World(Ground(), zones=zones))
    found = geoms(root)
    for number, height in ((1, 0.0015), (2, 0.002)):
        plate = found[f"zone/{number}"]
        assert numbers(plate, "size") == pytest.approx([2.0, 1.0, height])
        assert plate.get("contype") == plate.get("conaffinity") == "0"
        assert plate.get("group") == "2"
        assert numbers(plate, "pos") == [5.0, 6.0, 0.5]
    assert found["zone/1"].get("rgba") != found["zone/2"].get("rgba"), "ice has its own colour"
    (field,) = root.iter("hfield")
    assert numbers(field, "size") == [2.0, 1.0, 0.2, 0.5]
    assert found["ground/zone_3"].get("hfield") == field.get("name") == "zone_3"
    assert "mjcf/zone_3.bin" in files
