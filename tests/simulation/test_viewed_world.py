"""The world of a scenario in the data of the 3D viewer."""

from __future__ import annotations

import base64
import math
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.examples import example_fleet
from thorvaldc.backends.mjcf_terrain import relief_of
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Fleet, Ground, Pose, World, Zone
from thorvaldc.model.spatial import rotate
from thorvaldc.simulation.web_viewer import MAX_CELLS, page_data


def grid(relief: dict[str, Any]) -> Any:
    values = np.frombuffer(base64.b64decode(relief["heights"]), dtype="<f4")
    return values.reshape(relief["rows"], relief["columns"])


def test_the_world_of_a_scenario() -> None:
    fleet = compile_file("examples/scenarios/field_edge.yaml").model
    assert isinstance(fleet, Fleet)
    assert fleet.world is not None
    data = page_data(fleet)
    world = data["world"]
    kinds = Counter(body["kind"] for body in world["bodies"])
    assert kinds == Counter(block.kind for block in fleet.world.blocks)
    crate = next(body for body in world["bodies"] if body["name"] == "crate")
    points = base64.b64decode(data["shapes"][crate["shape"]]["points"])
    size = np.ptp(np.frombuffer(points, dtype="<f4").reshape(-1, 3), axis=0)
    assert size == pytest.approx([0.6, 0.4, 0.3])
    # The ground rises by 4 deg towards y.
    uphill = rotate(tuple(world["tilt"]), (0.0, 1.0, 0.0))
    assert uphill == pytest.approx((0.0, math.cos(math.radians(4)), math.sin(math.radians(4))))
    assert "slope 4 deg" in world["text"]
    assert "40 crops" in world["text"]


def test_the_terrain_is_that_of_the_simulation() -> None:
    ground = Ground(amplitude=0.02, wavelength=1.0, seed=4, size=(8.0, 6.0))
    fleet = replace(example_fleet("fleet_of_four"), world=World(ground))
    (relief,) = page_data(fleet)["world"]["reliefs"]
    expected = relief_of(ground, [p.pose for p in fleet.placements]).rows
    assert grid(relief) == pytest.approx(0.04 * np.asarray(expected), abs=1e-6)
    assert relief["pose"][2] == -0.02
    # Large ground: fewer points, at the same place.
    large = replace(fleet, world=World(replace(ground, size=(60.0, 40.0))))
    (relief,) = page_data(large)["world"]["reliefs"]
    shown = grid(relief)
    assert 0.5 * MAX_CELLS < shown.size <= MAX_CELLS
    assert shown[0, 0] == 0.0
    assert np.ptp(shown) == pytest.approx(0.04, rel=0.1)
    assert large.world is not None
    whole = np.asarray(relief_of(large.world.ground, [p.pose for p in large.placements]).rows)
    ys, xs = (
        np.linspace(0, n - 1, m).round() for n, m in zip(whole.shape, shown.shape, strict=True)
    )
    expected = 0.04 * whole[np.ix_(ys.astype(int), xs.astype(int))]
    assert np.array_equal(shown, expected.astype("<f4"))


def test_zones_are_plates_and_reliefs() -> None:
    level = Zone(Pose((1.0, 2.0, 0.0)), (3.0, 2.0), friction=0.1)
    raised = Zone(Pose(), (2.0, 2.0), height=0.1, slope=0.5)
    fleet = replace(example_fleet("fleet_of_four"), world=World(Ground(), zones=(level, raised)))
    world = page_data(fleet)["world"]
    (plate,), (relief,) = world["bodies"], world["reliefs"]
    assert (plate["kind"], plate["name"]) == ("zone", "friction 0.1")
    assert plate["pose"][:3] == [1.0, 2.0, 0.0]
    assert grid(relief).max() == pytest.approx(0.1)
    assert world["text"] == "2 zones"
