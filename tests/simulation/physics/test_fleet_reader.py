"""A scene of many robots is read in groups of robots; the model is the same to the last bit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from tests.examples import FOLDER
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.model import Fleet
from thorvaldc.simulation.physics import fleet_reader
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene

FLEET = f"""\
thorvaldc: 1
name: mixed
robots:
  wide: {{robot: {FOLDER}/4wd4ws_wide/robot.yaml, grid: {{rows: 1, columns: 2, spacing: 4 m}}}}
  rocker: {{robot: {FOLDER}/rocker_bogie/robot.yaml, xyz: [9, 5, 0]}}
  car: {{robot: {FOLDER}/car/robot.yaml, xyz: [9, -5, 0]}}
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    path: Path = tmp_path_factory.mktemp("fleet") / "fleet.yaml"
    path.write_text(FLEET, encoding="utf-8")
    compilation = compile_file(path)
    assert isinstance(compilation.model, Fleet), compilation.report.errors
    return emit(compilation.model, ["mjcf"])


def arrays(model: mujoco.MjModel) -> dict[str, Any]:
    values = {name: getattr(model, name) for name in dir(model) if not name.startswith("_")}
    return {name: value.tolist() for name, value in values.items() if isinstance(value, np.ndarray)}


def test_groups_give_the_same_model(
    files: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    at_once = MujocoScene(files).model
    assert fleet_reader.read_fleet(files["mjcf/scene.xml"]) is None
    monkeypatch.setattr(fleet_reader, "ROBOTS", 2)
    assert fleet_reader.read_fleet(files["mjcf/scene.xml"]) is not None
    (tmp_path / "mjcf").mkdir()
    (tmp_path / "mjcf/scene.xml").write_bytes(files["mjcf/scene.xml"])
    for source in (files, tmp_path):
        model = MujocoScene(source).model
        assert arrays(model) == arrays(at_once)
        assert model.names == at_once.names
        assert model.stat.extent == at_once.stat.extent


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (
            b"<worldbody>",
            b'<asset><hfield name="h" file="h.png" size="1 1 1 1"/></asset><worldbody>',
        ),
        (b"</worldbody>", b'<body name="post"/></worldbody>'),
        (b"<mujoco ", b'<!DOCTYPE mujoco [<!ENTITY name "wide">]><mujoco '),
        (b"<inertial ", b'<geom type="mesh" mesh="wide_1/hub_11344e18"/><inertial '),
    ],
)
def test_other_scenes_are_read_at_once(
    files: dict[str, bytes], monkeypatch: pytest.MonkeyPatch, old: bytes, new: bytes
) -> None:
    monkeypatch.setattr(fleet_reader, "ROBOTS", 2)
    text = files["mjcf/scene.xml"]
    assert old in text
    assert fleet_reader.read_fleet(text.replace(old, new, 1)) is None


def test_broken_scene_of_a_fleet_is_an_error(
    files: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fleet_reader, "ROBOTS", 2)
    text = files["mjcf/scene.xml"].replace(b"<inertial ", b"<inertial wrong='1' ", 1)
    with pytest.raises(DiagnosticError, match="MuJoCo cannot read mjcf"):
        MujocoScene(files | {"mjcf/scene.xml": text})
