"""`modules new` makes a module that passes a strict check and mounts on a robot."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import pytest
import trimesh
import yaml

from tests.cli.conftest import Command
from tests.slow import mostly_slow


def _robot_with(type: str) -> None:
    robot = Path("r/robot.yaml")
    text = robot.read_text().replace("modules:\n", "library: [modules]\nmodules:\n", 1)
    part = f"  part: {{type: {type}, mount: {{parent: frame, xyz: [0, 0, 300 mm]}}}}\n"
    gnss = "  gnss: {type: sensor/gnss_antenna, mount: part.top}\n"
    robot.write_text(text + part + gnss)


@pytest.fixture
def robot(thorvaldc: Command) -> Command:
    thorvaldc("new", "r")
    return thorvaldc


def test_a_new_frame_carries_legs_that_stand_inwards(robot: Command) -> None:
    tub = trimesh.creation.box((1.2, 0.8, 0.1))
    tub.export("tub.stl")
    assert (
        robot("modules", "new", "frame/tub", "--mesh", "tub.stl", "--library", "r/modules")[0] == 0
    )
    text = "thorvaldc: 1\nname: r\nlibrary: [modules]\nmodules:\n  frame: {type: frame/tub}\n"
    for number, port in enumerate(("front_left", "front_right", "rear_left", "rear_right"), 1):
        text += f"  {port}: {{type: assembly/steered_drive, mount: frame.{port}, can: {number}}}\n"
    text += "  box: {type: battery/enclosure, mount: {parent: frame, xyz: [0, 0, 0.15]}, can: 1}\n"
    Path("r/tub.yaml").write_text(text)
    status, out, err = robot("check", "--strict", "r/tub.yaml")
    assert (status, err) == (0, ""), out
    for port, side in (("front_left", "right"), ("rear_right", "left")):
        value = robot("why", "r/tub.yaml", f"modules.{port}.params.leg_side").out
        assert side in value


def test_a_new_module_passes_and_mounts(robot: Command) -> None:
    status, out, err = robot("modules", "new", "tool/sprayer", "--library", "r/modules")
    assert (status, err) == (0, "")
    assert "type: tool/sprayer" in out
    _robot_with("tool/sprayer")
    for words in (
        ("modules", "check", "--strict", "r/modules"),
        ("check", "--strict", "r/robot.yaml"),
    ):
        status, out, err = robot(*words)
        assert (status, err) == (0, ""), out
    folder = Path("r/modules/tool/sprayer")
    first_line = (folder / "module.yaml").read_text().splitlines()[0]
    assert (folder / first_line.rpartition("=")[2]).resolve() == Path(
        "r/modules/module.schema.json"
    ).resolve()
    assert "@" not in (folder / "module.yaml").read_text()


@pytest.mark.parametrize("factor", [1.0, 1000.0])
@pytest.mark.parametrize("suffix", mostly_slow(["stl", "obj", "glb"]))
def test_the_box_contains_a_mesh_in_metres_and_in_millimetres(
    robot: Command, suffix: str, factor: float
) -> None:
    mesh = trimesh.creation.box([0.4 * factor, 0.2 * factor, 0.1 * factor])
    mesh.apply_translation([0.1 * factor, 0, 0.05 * factor])
    mesh.export(f"my part.{suffix}")
    words = ("tool/part", "--mesh", f"my part.{suffix}", "--library", "r/modules")
    status, _, err = robot("modules", "new", *words)
    assert (status, err) == (0, "")
    _robot_with("tool/part")
    status, out, err = robot("check", "--strict", "r/robot.yaml")
    assert (status, err) == (0, ""), out
    module = yaml.safe_load(Path("r/modules/tool/part/module.yaml").read_text())
    shown, box = module["links"]["body"]["parts"]
    assert sorted(box["shape"]["box"]) == ["100 mm", "200 mm", "400 mm"]
    assert ("scale" in shown["shape"]["mesh"]) == (factor > 1)
    assert (Path("r/modules/tool/part") / shown["shape"]["mesh"]["file"]).is_file()


@pytest.mark.parametrize(
    "blocker", ["modules/tool/part/module.yaml", "modules/tool/part/meshes/body.obj"]
)
def test_existing_files_are_kept(thorvaldc: Command, blocker: str) -> None:
    Path(blocker).parent.mkdir(parents=True)
    Path(blocker).write_text("mine")
    status, _, err = thorvaldc("modules", "new", "tool/part")
    assert status == 2
    assert f"{blocker.replace('/', os.sep)} exists already" in err
    assert [path.as_posix() for path in Path("modules").rglob("*.*")] == [blocker]
    assert Path(blocker).read_text() == "mine"


def test_an_existing_schema_is_kept(thorvaldc: Command) -> None:
    Path("modules").mkdir()
    Path("modules/module.schema.json").write_text("{}")
    assert thorvaldc("modules", "new", "tool/part").status == 0
    assert Path("modules/module.schema.json").read_text() == "{}"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("sprayer",), "'sprayer' is no name of a module type"),
        (("../x",), "'../x' is no name of a module type"),
        (("/tmp/x",), "'/tmp/x' is no name of a module type"),
        (("Tool/X",), "'Tool/X' is no name of a module type"),
        (("wheel/passive",), "the library has a module 'wheel/passive' already"),
        (("tool/x", "--library", "file"), "'file' is not a folder"),
    ],
)
def test_wrong_usage(thorvaldc: Command, words: tuple[str, ...], message: str) -> None:
    Path("file").touch()
    status, out, err = thorvaldc("modules", "new", *words)
    assert (status, out) == (2, "")
    assert message in err
    assert not [*Path().rglob("module.yaml")]


def test_a_mesh_that_cannot_be_read(thorvaldc: Command) -> None:
    Path("broken.stl").write_bytes(bytes(80) + struct.pack("<I", 9))
    for name, code in (("no.stl", "TV730"), ("broken.stl", "TV732"), ("part.step", "TV731")):
        status, _, err = thorvaldc("modules", "new", "tool/x", "--mesh", name)
        assert status == 1
        assert code in err
    assert not Path("modules").exists()
