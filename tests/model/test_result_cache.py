"""The classes of the model, and the cache of results of a model."""

from __future__ import annotations

import copy
import dataclasses
import gc
import pickle
import weakref
from pathlib import Path

from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Mesh, Robot
from thorvaldc.model.result_cache import once_per_model

EXAMPLE = Path(__file__).parents[2] / "examples" / "4wd4ws_wide" / "robot.yaml"


def _robot() -> Robot:
    model = compile_file(EXAMPLE).model
    assert isinstance(model, Robot)
    return model


def test_a_field_that_is_not_compared_is_kept_in_copies() -> None:
    mesh = Mesh("rim.stl", "digest", b"data")
    assert mesh == Mesh("rim.stl", "digest", b"other")
    assert hash(mesh) == hash(Mesh("rim.stl", "digest"))
    assert "data" not in repr(mesh)
    assert [twin.data for twin in (copy.deepcopy(mesh), pickle.loads(pickle.dumps(mesh)))] == [
        b"data",
        b"data",
    ]


def test_a_result_is_computed_once_for_a_model_and_its_arguments() -> None:
    calls: list[tuple[str, int]] = []

    @once_per_model
    def named(robot: Robot, number: int = 0) -> str:
        calls.append((robot.name, number))
        return f"{robot.name} {number}"

    robot = _robot()
    other = dataclasses.replace(robot, name="other")
    assert [named(robot), named(robot), named(robot, 1), named(robot, 1)] == [
        *(f"{robot.name} 0",) * 2,
        *(f"{robot.name} 1",) * 2,
    ]
    assert [named(other), named(robot, number=0)] == ["other 0", f"{robot.name} 0"]
    assert calls == [(robot.name, 0), (robot.name, 1), ("other", 0), (robot.name, 0)]


def test_the_cache_keeps_no_model_alive_and_forgets_its_results() -> None:
    @once_per_model
    def name(robot: Robot) -> str:
        return robot.name

    template = _robot()
    for number in range(50):  # a new model often has the id of one that was deleted
        robot = dataclasses.replace(template, name=f"r{number}")
        assert name(robot) == f"r{number}"
        alive = weakref.ref(robot)
        del robot
        if alive() is not None:
            gc.collect()
        assert alive() is None
