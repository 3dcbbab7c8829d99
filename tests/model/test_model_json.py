"""The model as JSON: it reads back equal, and other texts are errors."""

from __future__ import annotations

import json
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from tests.examples import FLEETS, SAMPLED_ROBOTS, example_fleet, example_robot
from tests.robots import FOUR_STEERED, SPAN, make_robot
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.model import (
    Battery,
    Block,
    Box,
    Brake,
    Bus,
    CalculatorChoice,
    Channel,
    Collision,
    Cylinder,
    Fleet,
    FrameDefinition,
    Ground,
    JointServo,
    Link,
    Mesh,
    MeshShape,
    Mimic,
    Module,
    Node,
    ParameterSet,
    Placement,
    Pose,
    Purchase,
    Robot,
    Sensor,
    Signal,
    SourcedMass,
    Sphere,
    Tread,
    TwistInput,
    Visual,
    World,
    model_json,
)
from thorvaldc.model import robot as robot_module
from thorvaldc.model.model_json import VERSION, ModelFormatError, from_json, load_model, to_json

POSE = Pose.from_xyz_rpy((0.1, -0.2, 1 / 3), (0.3, 0.2, 0.1))
GREY = (0.5, 0.25, 1.0, 1.0)


def everything() -> Robot:
    """A robot with an element of every class, and with a different value in every field."""
    shapes = (
        Box((1.0, 2.0, 3.0)),
        Cylinder(0.1, 0.2),
        Sphere(0.3),
        MeshShape("a.stl", (1.0, 2.0, 3.0)),
    )
    link = Link(
        "odd",
        "måne.ä",
        None,
        tuple(Visual(shape, POSE, GREY) for shape in shapes),
        tuple(Collision(shape, POSE) for shape in shapes),
        SPAN,
    )
    signal = Signal(
        "speed",
        32,
        16,
        True,
        0.1,
        -1.5,
        "rad/s",
        -1.0,
        2.0,
        "w0_axle",
        False,
        (1, 2),
        ((0, "off"), (1, "on")),
        "of the wheel",
    )
    select = Signal("content", 0, 8, multiplexer=True)
    frame = FrameDefinition(
        "rpdo1", 0x201, "pdo", "master", ("node",), 8, 0.02, None, (signal, select), SPAN
    )
    channels = (
        Channel("left", "propulsion", "w0_propulsion"),
        Channel("right", "propulsion", None),
    )
    node = Node(
        "node",
        "m",
        "thorvald_roboteq",
        3,
        "canopen",
        0x469,
        None,
        channels,
        (("timeout", 2.0), ("name", "x"), ("count", 3), ("on", True)),
        SPAN,
    )
    robot = make_robot(FOUR_STEERED, suspended=True)
    joint = replace(robot.joints[-1], mimic=Mimic("w0_axle", -2.0, 0.5), spring_reference=1e-17)
    return replace(
        robot,
        namespace="r1",
        description='Text with "quotes", \\ and \u2603\n',
        links=(*robot.links, link),
        joints=(*robot.joints[:-1], joint),
        wheels=tuple(
            replace(
                w,
                radii=(("floor", 0.1), ("rail", 0.09)),
                treads=(Tread("rail", (0.0, 0.06, 0.0), 0.05, 0.01),),
            )
            for w in robot.wheels
        ),
        sensors=(Sensor("s", "m", "imu", "odd", (("rate", 100.0),), SPAN),),
        batteries=(Battery("b", "m", "odd", None, (("cells", 14),), SPAN),),
        buses=(Bus("main", 500000, 0.02, (node,), (frame,), SPAN),),
        meshes=(Mesh("a.stl", "0" * 64, b"data"),),
        calculator=CalculatorChoice("general", (("hysteresis", 0.2),)),
        urdf_extensions=("<gazebo/>",),
        modules=(
            Module(
                "fl.drive",
                "drive/standard",
                "fl",
                True,
                (SourcedMass(1.5, "measured: scale"),),
                SPAN,
                Purchase(1250.0, "EUR", "Example Motors", 86400.0),
            ),
        ),
        parameter_sets=(
            ParameterSet("a", "rail", replace(robot.driver, noise=(("angle", 0.1),)), SPAN),
            ParameterSet("b", None, robot.driver, SPAN),
        ),
        twist_sources=(TwistInput("nav", "nav/cmd_vel", 10, 0.5),),
        twist_locks=(TwistInput("pause", "nav/pause", 50, 0.0),),
        joint_servos=(JointServo("elbow", "position", 0.25, SPAN),),
        actuators=tuple(
            replace(a, back_driving_torque=2.1, brake=Brake(84.0, 0.03)) for a in robot.actuators
        ),
        design_slope=0.25,
        battery_connection="parallel",
    )


@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_examples_read_back_equal(name: str) -> None:
    robot = example_robot(name)
    text = to_json(robot)
    assert from_json(text) == robot
    assert to_json(from_json(text)) == text


@pytest.mark.parametrize("name", FLEETS)
def test_fleets_read_back_equal(name: str) -> None:
    fleet = example_fleet(name)
    assert from_json(to_json(fleet)) == fleet


def test_a_model_with_everything_in_it_reads_back_equal() -> None:
    robot = everything()
    assert from_json(to_json(robot)) == robot
    fleet = Fleet("two", "", (Placement("a", POSE, robot), Placement("b", Pose(), robot)))
    assert from_json(to_json(fleet)) == fleet
    blocks = (Block("kerb", "1", Box((1.0, 0.2, 0.1)), POSE), Block("crop", "2", Sphere(1), POSE))
    world = World(Ground(0.1, 0.2, 0.03, 1.5, 4, (10.0, 20.0)), blocks)
    assert from_json(to_json(replace(fleet, world=world))) == replace(fleet, world=world)


def test_everything_contains_every_class_of_the_model() -> None:
    seen: set[str] = set()

    def walk(value: Any) -> None:
        if is_dataclass(value):
            seen.add(type(value).__name__)
            for field in fields(value):
                walk(getattr(value, field.name))
        elif isinstance(value, tuple):
            for item in value:
                walk(item)

    walk(everything())
    classes = {
        name
        for name, value in vars(robot_module).items()
        if isinstance(value, type) and value.__module__ == robot_module.__name__
    }
    assert classes - {"Fleet", "Placement", "World", "Ground", "Block", "Zone"} <= seen


def test_types_of_scalars_are_kept() -> None:
    robot = from_json(to_json(everything()))
    assert isinstance(robot, Robot)
    properties = dict(robot.buses[0].nodes[0].properties)
    assert [type(v) for v in properties.values()] == [float, str, int, bool]
    assert type(robot.wheels[0].x) is float


def test_a_whole_number_is_read_as_float() -> None:
    text = to_json(make_robot(FOUR_STEERED))
    changed = json.loads(text)
    changed["model"]["driver"]["rate"] = 50
    robot = from_json(json.dumps(changed))
    assert isinstance(robot, Robot)
    assert type(robot.driver.rate) is float


def test_mesh_bytes_are_omitted() -> None:
    assert "data" not in json.loads(to_json(everything()))["model"]["meshes"][0]
    robot = from_json(to_json(everything()))
    assert isinstance(robot, Robot)
    assert robot.meshes[0].data == b""


def test_not_a_number_is_not_written() -> None:
    robot = make_robot(FOUR_STEERED)
    broken = replace(robot, driver=replace(robot.driver, rate=float("nan")))
    with pytest.raises(ValueError, match="JSON"):
        to_json(broken)


GOOD = json.loads(to_json(make_robot(FOUR_STEERED)))


def changed(path: str, value: Any) -> str:
    copy = json.loads(json.dumps(GOOD))
    *way, last = path.split(".")
    place = copy
    for key in way:
        place = place[int(key)] if key.isdigit() else place[key]
    if value is ...:
        del place[last]
    else:
        place[int(last) if last.isdigit() else last] = value
    return json.dumps(copy)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "3",
        "null",
        "[" * 100_000,
        '{"format": "thorvaldc-model"}',
        changed("format", "urdf"),
        changed("version", 1),
        changed("version", "1"),
        changed("kind", "Rover"),
        changed("kind", ["Robot"]),
        changed("model", []),
        changed("model.name", ...),
        changed("model.name", 3),
        changed("model.links", {}),
        changed("model.links.0.span", ["robot.yaml"] * 9),
        changed("model.joints.0.pose.xyz", [0.0, 1.0]),
        changed("model.joints.0.pose.xyz.0", "left"),
        changed("model.joints.0.pose.xyz.0", None),
        changed("model.joints.0.pose.xyz.0", True),
        changed("model.links.1.visuals.0.shape.kind", "Cone"),
        changed("model.driver.rate", None),
        changed("model.wheels.0.driven", "yes"),
        changed("model.driver.rate", float("nan")),
    ],
)
def test_other_texts_are_errors(text: str) -> None:
    with pytest.raises(ModelFormatError) as caught:
        from_json(text)
    assert caught.value.reason


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("model.wheels.2.treads", ..., "robot.wheels[2]: the field `treads` is missing"),
        (
            "model.wheels.2.tread",
            [],
            "robot.wheels[2]: there is no field `tread` (did you mean `treads`?)",
        ),
        ("model.colour", "red", "robot: there is no field `colour`"),
        ("model.name", 3, "robot.name: expected text, found 3"),
        ("model.links", {}, "robot.links: expected a list, found an object"),
        ("model.driver", None, "robot.driver: expected an object, found null"),
        ("model.driver.rate", "fast", 'robot.driver.rate: expected a number, found "fast"'),
        ("model.driver.rate", True, "robot.driver.rate: expected a number, found true"),
        ("model.driver.rate", 10**400, "robot.driver.rate: the number is too large"),
        (
            "model.driver.rate",
            float("inf"),
            "robot.driver.rate: expected a finite number, found inf",
        ),
        ("model.wheels.0.driven", 1, "robot.wheels[0].driven: expected true or false, found 1"),
        (
            "model.actuators.0.encoder_ppr",
            1024.0,
            "robot.actuators[0].encoder_ppr: expected a whole number, found 1024.0",
        ),
        (
            "model.wheels.0.steering_joint",
            [],
            "robot.wheels[0].steering_joint: expected text, found a list",
        ),
        (
            "model.joints.0.pose.xyz",
            [0.0, 1.0],
            "robot.joints[0].pose.xyz: expected 3 values, found 2",
        ),
        (
            "model.links.0.span",
            ["robot.yaml", 1, 1, "two", 1],
            'robot.links[0].span[3]: expected a whole number, found "two"',
        ),
        (
            "model.links.1.visuals.0.shape",
            5,
            "robot.links[1].visuals[0].shape: expected an object, found 5",
        ),
        (
            "model.links.1.visuals.0.shape.kind",
            "Cone",
            "robot.links[1].visuals[0].shape.kind: "
            'expected one of Box, Cylinder, Sphere, MeshShape, found "Cone"',
        ),
        (
            "model.links.1.visuals.0.shape.kind",
            ...,
            "robot.links[1].visuals[0].shape: the field `kind` is missing",
        ),
        (
            "model.joints.0.type",
            "ball",
            "robot.joints[0].type: "
            'expected one of fixed, revolute, continuous, prismatic, found "ball"',
        ),
        ("kind", "Rover", 'kind: expected Robot or Fleet, found "Rover"'),
        ("kind", ..., "the field `kind` is missing"),
        ("date", "today", "there is no field `date`"),
        ("format", "urdf", "not a thorvaldc-model file"),
        ("version", "3", f'version "3"; this program reads {VERSION}'),
    ],
)
def test_the_message_names_the_path(path: str, value: Any, message: str) -> None:
    with pytest.raises(ModelFormatError) as caught:
        from_json(changed(path, value))
    assert str(caught.value) == message


@pytest.mark.parametrize(
    ("field", "value", "limits"), [("length", 2**70, "0 to 8"), ("cob_id", 2**32, "0 to 536870911")]
)
def test_numbers_that_no_can_frame_has(field: str, value: int, limits: str) -> None:
    document = json.loads(to_json(everything()))
    document["model"]["buses"][0]["frames"][0][field] = value
    with pytest.raises(ModelFormatError) as caught:
        from_json(json.dumps(document))
    expected = f"expected a number from {limits}, found {value}"
    assert str(caught.value) == f"robot.buses[0].frames[0].{field}: {expected}"


def test_a_path_in_a_fleet() -> None:
    head = json.loads(to_json(Fleet("f", "", (Placement("a", POSE, make_robot(FOUR_STEERED)),))))
    del head["model"]["placements"][0]["robot"]["wheels"][1]["radius"]
    with pytest.raises(ModelFormatError) as caught:
        from_json(json.dumps(head))
    assert caught.value.path == "fleet.placements[0].robot.wheels[1]"


def test_the_message_of_another_version_names_both() -> None:
    with pytest.raises(ModelFormatError, match=f"version 1; this program reads {VERSION}"):
        from_json(changed("version", 1))


@pytest.mark.parametrize(
    ("version", "compiler", "hint"),
    [
        (9, None, "build the robot again with this thorvaldc 1.0.0: thorvaldc build FILE"),
        (
            9,
            "thorvaldc 1.0.0",
            "build the robot again with this thorvaldc 1.0.0: thorvaldc build FILE",
        ),
        (9, "thorvaldc 0.1.0", "or use thorvaldc 0.1.0, which wrote the file"),
        (VERSION + 1, "thorvaldc 2.0.0", "or use thorvaldc 2.0.0, which wrote the file"),
        (
            VERSION + 1,
            None,
            "a thorvaldc newer than 1.0.0 wrote the file: install it, or build the",
        ),
    ],
)
def test_a_model_of_another_version_names_the_program(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    version: int,
    compiler: str | None,
    hint: str,
) -> None:
    monkeypatch.setattr(model_json, "program_version", lambda: "1.0.0")
    (tmp_path / "model.json").write_text(changed("version", version), encoding="utf-8")
    if compiler is not None:
        (tmp_path / "manifest.json").write_text(json.dumps({"compiler": compiler}), "utf-8")
    with pytest.raises(DiagnosticError) as caught:
        load_model(tmp_path)
    assert f"version {version}; this program reads {VERSION}" in caught.value.diagnostic.message
    assert hint in str(caught.value.diagnostic.hint)


@pytest.mark.parametrize("text", ["[", "[1]", '{"compiler": 3}', ""])
def test_a_broken_manifest_hides_no_error(tmp_path: Path, text: str) -> None:
    (tmp_path / "model.json").write_text(changed("version", 9), encoding="utf-8")
    (tmp_path / "manifest.json").write_text(text, encoding="utf-8")
    with pytest.raises(DiagnosticError, match=f"version 9; this program reads {VERSION}"):
        load_model(tmp_path)
