"""Hardware of a module document: masses and shapes of links, joints, motors, meshes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli.conftest import GOOD
from tests.workshop import CART, TETRAHEDRON, Workshop
from thorvaldc.compiler.hardware import hardware_reader as hardware
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Box, Brake, Cylinder, Inertial, MeshShape, Robot, Sphere

SOURCE = 'source: "chosen: for a test"'
MOUNT = "mount: {kinds: [clamp], link: body}\n"


def body(parts: str, more: str = "") -> str:
    """Returns a module document whose only link `body` has these parts."""
    return f"{MOUNT}links:\n  body:\n    parts:\n{parts}\n{more}"


def part(text: str) -> str:
    return f"      - {{{text}, {SOURCE}}}\n"


def inertial(robot: Robot, link: str = "part_body") -> Inertial:
    computed = robot.link(link).inertial
    assert computed is not None
    return computed


def tensor(inertia: Inertial) -> np.ndarray[Any, Any]:
    return np.array(inertia.matrix())


def points_of(shape: str, count: int = 40) -> np.ndarray[Any, Any]:
    """Returns a fine grid of points in a shape, for numerical integration."""
    steps = (np.arange(count) + 0.5) / count - 0.5
    x, y, z = (v.ravel() for v in np.meshgrid(steps, steps, steps, indexing="ij"))
    if shape == "box":
        return np.stack([x * 0.4, y * 0.3, z * 0.2], axis=1)
    if shape == "sphere":
        inside = x * x + y * y + z * z <= 0.25
        return np.stack([x, y, z], axis=1)[inside] * 0.4
    inner = 0.5 if shape == "tube" else 0.0
    ring = (x * x + y * y <= 0.25) & (x * x + y * y >= (0.5 * inner) ** 2)
    return np.stack([x * 0.4, y * 0.4, z * 0.3], axis=1)[ring]


# -- masses -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("shape", "text"),
    [
        ("box", "shape: {box: [0.4, 0.3, 0.2]}"),
        ("cylinder", "shape: {cylinder: {radius: 0.2, length: 0.3}}"),
        ("tube", "shape: {cylinder: {radius: 0.2, length: 0.3}}, wall: 0.1"),
        ("sphere", "shape: {sphere: {radius: 0.2}}"),
    ],
)
def test_inertia_of_a_solid_agrees_with_numerical_integration(
    workshop: Workshop, shape: str, text: str
) -> None:
    computed = inertial(workshop.part(body(part(f"{text}, mass: 6"))))
    points = points_of(shape)
    expected = 6 * np.mean([p @ p * np.eye(3) - np.outer(p, p) for p in points], axis=0)
    assert computed.mass == 6.0
    assert computed.com == (0.0, 0.0, 0.0)
    np.testing.assert_allclose(tensor(computed), expected, rtol=0.01, atol=1e-6)


def test_parts_are_combined_about_their_centre_of_mass(workshop: Workshop) -> None:
    parts = part("shape: {sphere: {radius: 0.001}}, xyz: [1, 0, 0], mass: 1")
    parts += part("shape: {sphere: {radius: 0.001}}, xyz: [-1, 0, 2], mass: 3")
    computed = inertial(workshop.part(body(parts)))
    assert computed.mass == 4.0
    assert computed.com == pytest.approx((-0.5, 0.0, 1.5))
    # Two point masses at distance d with reduced mass 3/4: m d^2 across the line, 0 along it.
    moments = sorted(np.linalg.eigvalsh(tensor(computed)))
    assert moments == pytest.approx([0.0, 0.75 * 8, 0.75 * 8], abs=1e-5)
    along = np.array([2.0, 0.0, -2.0]) / math.sqrt(8)
    assert along @ tensor(computed) @ along == pytest.approx(0.0, abs=1e-5)


def test_stated_inertia_rotates_with_its_part(workshop: Workshop) -> None:
    text = "mass: 2, com: [0.1, 0, 0], inertia: [1, 2, 2.5, 0.1, 0.2, 0.3], rpy: [0, 0, 90 deg]"
    computed = inertial(workshop.part(body(part(text))))
    assert computed.com == pytest.approx((0.0, 0.1, 0.0))
    assert computed.inertia == pytest.approx((2.0, 1.0, 2.5, -0.1, -0.3, 0.2))


def test_an_expression_gives_the_inertia(workshop: Workshop) -> None:
    text = "mass: 2, com: [0, 0, 0], inertia: '${moments}'"
    moments = "let: {moments: [1 kg m^2, 2 kg m^2, 2.5 kg m^2, 0 kg m^2, 0 kg m^2, 0 kg m^2]}\n"
    computed = inertial(workshop.part(body(part(text), moments)))
    assert computed.inertia == (1.0, 2.0, 2.5, 0.0, 0.0, 0.0)


def test_part_without_mass_is_only_visual(workshop: Workshop) -> None:
    parts = part("shape: {box: [1, 1, 1]}") + part("shape: {sphere: {radius: 0.1}}, mass: 2")
    link = workshop.part(body(parts)).link("part_body")
    assert [v.shape for v in link.visuals] == [Box((1.0, 1.0, 1.0)), Sphere(0.1)]
    assert inertial(workshop.part(body(parts))).mass == 2.0


def test_a_link_without_parts_has_no_mass(workshop: Workshop) -> None:
    robot = workshop.part(f"{MOUNT}links: {{body: {{}}}}")
    assert robot.link("part_body").inertial is None


# -- parts ------------------------------------------------------------------------------


def test_show_and_collide_select_visuals_and_collisions(workshop: Workshop) -> None:
    parts = part("shape: {box: [1, 2, 3]}, color: '#ff8000'")
    parts += part("shape: {sphere: {radius: 0.5}}, show: false, collide: true")
    parts += part("shape: {cylinder: {radius: 0.5, length: 2}}, collide: true, rpy: [90 deg, 0, 0]")
    link = workshop.part(body(parts)).link("part_body")
    assert [v.shape for v in link.visuals] == [Box((1.0, 2.0, 3.0)), Cylinder(0.5, 2.0)]
    assert [c.shape for c in link.collisions] == [Sphere(0.5), Cylinder(0.5, 2.0)]
    assert link.visuals[0].color == (1.0, 0.502, 0.0, 1.0)
    assert link.visuals[1].pose == link.collisions[1].pose


def test_for_repeats_a_part_for_each_value(workshop: Workshop) -> None:
    text = "shape: {box: [0.1, 0.1, '${0.1 m * n}']}, xyz: ['${x}', 0, 0], "
    text += "for: {x: [0, 200 mm], n: [1, 2, 3]}, mass: 1"
    link = workshop.part(body(part(text))).link("part_body")
    shown = [(v.pose.xyz[0], v.shape.size[2]) for v in link.visuals if isinstance(v.shape, Box)]
    assert [x for x, _ in shown] == [0.0, 0.0, 0.0, 0.2, 0.2, 0.2]
    assert [z for _, z in shown] == pytest.approx([0.1, 0.2, 0.3, 0.1, 0.2, 0.3])
    assert link.inertial is not None
    assert link.inertial.mass == 6.0


@pytest.mark.parametrize(("lid", "count"), [("true", 2), ("false", 1)])
def test_when_selects_a_part(workshop: Workshop, lid: str, count: int) -> None:
    params = f"params: {{lid: {{type: boolean, description: With it., default: true, {SOURCE}}}}}\n"
    parts = part("shape: {box: [1, 1, 1]}, mass: 1")
    parts += part("shape: {box: [1, 1, 0.1]}, mass: 1, when: '${lid}'")
    robot = workshop.part(params + body(parts), f"lid: {lid}")
    assert len(robot.link("part_body").visuals) == count


def test_palette_of_the_user_has_priority(workshop: Workshop) -> None:
    workshop.write("my_modules/palette.yaml", 'mine: "#000000"\ntyre: "#ffffff80"\n')
    parts = "".join(part(f"shape: {{sphere: {{radius: 1}}}}, color: {c}") for c in ("mine", "tyre"))
    black, white = workshop.part(body(parts)).link("part_body").visuals
    assert black.color == (0.0, 0.0, 0.0, 1.0)
    assert white.color == (1.0, 1.0, 1.0, 0.502)


def test_palette_of_one_robot_does_not_affect_another(workshop: Workshop) -> None:
    palette = workshop.write("my_modules/palette.yaml", 'tyre: "#ff0000"\n')
    cart = CART.replace("t/leg", "caster/fixed").replace("t/plate", "frame/open")
    cart = cart.replace("body: {type: frame/open}", "body: {type: frame/tube_rectangular}")
    red = workshop.robot(cart).link("fl_tyre").visuals
    assert (1.0, 0.0, 0.0, 1.0) in [v.color for v in red]
    palette.unlink()
    assert (1.0, 0.0, 0.0, 1.0) not in [
        v.color for v in workshop.robot(cart).link("fl_tyre").visuals
    ]


# -- meshes -------------------------------------------------------------------------------


def test_mesh_path_is_relative_to_the_module(workshop: Workshop) -> None:
    workshop.write("my_modules/t/part/meshes/cover.obj", TETRAHEDRON)
    parts = part(
        "shape: {mesh: {file: meshes/cover.obj, scale: 0.5}}, mass: 2, "
        "inertia_shape: {box: [1, 1, 1]}"
    )
    robot = workshop.part(body(parts))
    (visual,) = robot.link("part_body").visuals
    assert isinstance(visual.shape, MeshShape)
    assert visual.shape.scale == (0.5, 0.5, 0.5)
    (mesh,) = robot.meshes
    assert mesh.name == visual.shape.mesh
    assert mesh.data == TETRAHEDRON.encode()
    assert inertial(robot).inertia[0] == pytest.approx(2 / 6)


def test_modules_share_one_mesh(workshop: Workshop) -> None:
    workshop.write("my_modules/t/part/cover.obj", TETRAHEDRON)
    workshop.module("t/part", body(part("shape: {mesh: {file: cover.obj}}")))
    mounts = [f"{{port: body.front, xyz: [0, 0, 0.{i}]}}" for i in range(3)]
    more = "".join(f"    p{i}: {{type: t/part, mount: {m}}}\n" for i, m in enumerate(mounts))
    robot = workshop.robot(CART + more)
    assert len(robot.meshes) == 1
    assert len({v.shape for i in range(3) for v in robot.link(f"p{i}_body").visuals}) == 1


# -- joints and motors ----------------------------------------------------------------------


def two_links(joint: str, more: str = "") -> str:
    link = f"{{parts: [{{shape: {{sphere: {{radius: 0.1}}}}, mass: 1, {SOURCE}}}]}}"
    return (
        f"{MOUNT}links:\n  body: {link}\n  arm: {link}\n"
        f"joints: {{j: {{parent: body, child: arm, {joint}}}}}\n{more}"
    )


def test_a_prismatic_joint_is_in_metres_and_newtons(workshop: Workshop) -> None:
    text = "type: prismatic, axis: [0, 3, 4], lower: -10 mm, upper: 2 cm, effort: 1 kN, "
    text += "velocity: 0.5 m/s, damping: 3, friction: 2 N, xyz: [0, 0, 1], rpy: [0, 0, 90 deg]"
    joint = workshop.part(two_links(text)).joint("part_j")
    assert joint.axis == pytest.approx((0.0, 0.6, 0.8))
    assert (joint.lower, joint.upper, joint.effort, joint.velocity) == (-0.01, 0.02, 1000.0, 0.5)
    assert (joint.damping, joint.friction) == (3.0, 2.0)
    assert joint.pose.xyz == (0.0, 0.0, 1.0)
    assert joint.pose.rpy()[2] == pytest.approx(math.pi / 2)


def test_a_revolute_joint_is_in_radians_and_newton_metres(workshop: Workshop) -> None:
    text = "type: revolute, lower: -90 deg, upper: 1, effort: 5 N m, velocity: 60 rpm, "
    text += "spring: {stiffness: 10 N m/rad, damping: 1}, damping: 0.5"
    joint = workshop.part(two_links(text)).joint("part_j")
    assert joint.axis == (0.0, 0.0, 1.0)
    assert joint.lower == pytest.approx(-math.pi / 2)
    assert joint.velocity == pytest.approx(2 * math.pi)
    assert (joint.effort, joint.stiffness, joint.damping) == (5.0, 10.0, 1.5)


def test_a_continuous_joint_has_no_limits(workshop: Workshop) -> None:
    joint = workshop.part(two_links("type: continuous, lower: -1, upper: 1")).joint("part_j")
    assert (joint.lower, joint.upper) == (None, None)


MOTOR = """
motors:
  m:
    joint: j
    role: steering
    gear_ratio: 20:1
    encoder_ppr: 500
    motor_max_speed: 3000 rpm
    max_acceleration: 5
    max_torque: %s
    rotor_inertia: 2e-4
    %s
    source: "chosen: for a test"
"""


@pytest.mark.parametrize(
    ("stated", "at_the_joint"),
    [("", 5 * math.pi), ("max_velocity: 4", 4.0), ("max_velocity: 40", 5 * math.pi)],
)
def test_motor_limits_the_speed_of_its_joint(
    workshop: Workshop, stated: str, at_the_joint: float
) -> None:
    robot = workshop.part(two_links("type: continuous", MOTOR % (30, stated)))
    (motor,) = [a for a in robot.actuators if a.module == "part"]
    assert motor.max_velocity == pytest.approx(at_the_joint)
    assert motor.motor_max_speed == pytest.approx(100 * math.pi)
    assert motor.armature == pytest.approx(2e-4 * 400)
    assert robot.joint("part_j").velocity == motor.max_velocity


@pytest.mark.parametrize(
    ("stated", "brake"),
    [
        ("brake: none", None),
        ("brake: {torque: 2 N m, closing_time: 30 ms, when: '${1 > 2}'}", None),
        ("brake: {torque: 2 N m, closing_time: 30 ms, when: '${2 > 1}'}", Brake(40.0, 0.03)),
        ("brake: {torque: 2 N m, closing_time: 0}", Brake(40.0, 0.0)),
    ],
)
def test_the_brake_of_a_motor_acts_through_its_gear(
    workshop: Workshop, stated: str, brake: Brake | None
) -> None:
    robot = workshop.part(two_links("type: continuous", MOTOR % (30, stated)))
    assert [(a.brake, a.back_driving_torque) for a in robot.actuators if a.module == "part"] == [
        (brake, 0.0)
    ]


def test_the_back_driving_torque_is_that_at_the_joint(workshop: Workshop) -> None:
    robot = workshop.part(
        two_links("type: continuous", MOTOR % (30, "back_driving_torque: 1.5 N m"))
    )
    assert [a.back_driving_torque for a in robot.actuators if a.module == "part"] == [1.5]


@pytest.mark.parametrize(
    ("stated", "codes"),
    [
        ("brake: {torque: 0, closing_time: 30 ms}", ["size-not-positive"]),
        ("brake: {torque: 2 N m, closing_time: -1 ms}", ["size-not-positive"]),
        ("back_driving_torque: -1 N m", ["size-not-positive"]),
        ("brake: {torque: 2 N m}", ["missing-key"]),
        ("brake: yes_please", ["unknown-value"]),
    ],
)
def test_impossible_brakes_are_errors(workshop: Workshop, stated: str, codes: list[str]) -> None:
    assert workshop.part_codes(two_links("type: continuous", MOTOR % (30, stated))) == codes


@pytest.mark.parametrize(("stated", "pulses"), [('"${4096 / 4}"', 1024), ('"${2 * 600}"', 1200)])
def test_pulses_of_an_encoder_may_be_computed(workshop: Workshop, stated: str, pulses: int) -> None:
    motor = (MOTOR % (30, "")).replace("encoder_ppr: 500", f"encoder_ppr: {stated}")
    robot = workshop.part(two_links("type: continuous", motor))
    assert [a.encoder_ppr for a in robot.actuators if a.module == "part"] == [pulses]


@pytest.mark.parametrize("stated", ['"${0.3}"', '"${1000 / 3}"'])
def test_pulses_of_an_encoder_are_a_whole_number(workshop: Workshop, stated: str) -> None:
    motor = (MOTOR % (30, "")).replace("encoder_ppr: 500", f"encoder_ppr: {stated}")
    assert workshop.part_codes(two_links("type: continuous", motor)) == ["wrong-type"]


@pytest.mark.parametrize(
    ("stated", "inverted"),
    [
        ("", False),
        ("inverted: true", True),
        ("inverted: false", False),
        ("inverted: '${2 > 1}'", True),
    ],
)
def test_a_motor_may_be_inverted(workshop: Workshop, stated: str, inverted: bool) -> None:
    robot = workshop.part(two_links("type: continuous", MOTOR % (30, stated)))
    assert [a.inverted for a in robot.actuators if a.module == "part"] == [inverted]


@pytest.mark.parametrize("stated", ["1", "sideways", "'${3}'", "[]"])
def test_inverted_is_true_or_false(workshop: Workshop, stated: str) -> None:
    motor = MOTOR % (30, f"inverted: {stated}")
    assert workshop.part_codes(two_links("type: continuous", motor)) == ["wrong-type"]


@pytest.mark.parametrize(("effort", "at_the_joint"), [("", 30.0), (", effort: 20", 20.0)])
def test_effort_is_the_lower_of_motor_and_joint(
    workshop: Workshop, effort: str, at_the_joint: float
) -> None:
    robot = workshop.part(two_links(f"type: continuous{effort}", MOTOR % (30, "")))
    assert robot.joint("part_j").effort == at_the_joint
    assert [a.max_torque for a in robot.actuators if a.module == "part"] == [at_the_joint]


def test_velocity_is_the_lower_of_motor_and_joint(workshop: Workshop) -> None:
    robot = workshop.part(two_links("type: continuous, velocity: 3", MOTOR % (30, "")))
    assert robot.joint("part_j").velocity == 3.0
    assert [a.max_velocity for a in robot.actuators if a.module == "part"] == [3.0]


# -- errors ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("module", "code"),
    [
        (f"{MOUNT}links: {{body: {{when: false}}}}", "link-unknown"),
        (f"{MOUNT}joints: {{j: {{type: fixed, parent: body, child: arm}}}}", "link-unknown"),
        (two_links("type: continuous").replace("child: arm", "child: leg"), "link-unknown"),
        (two_links("type: continuous").replace("link: body", "link: arm"), "link-unknown"),
        (two_links("type: continuous, axis: [0, 0, 0]"), "axis-zero"),
        (two_links("type: revolute, lower: 0"), "joint-limit-missing"),
        (two_links("type: revolute, lower: 1, upper: 1"), "joint-limits-reversed"),
        (two_links("type: prismatic, lower: 1 deg, upper: 2"), "wrong-dimension"),
        (
            two_links("type: continuous", MOTOR % (30, "")).replace("joint: j", "joint: k"),
            "joint-unknown",
        ),
        (two_links("type: fixed", MOTOR % (30, "")), "motor-joint"),
        (two_links("type: continuous", MOTOR % (0, "")), "size-not-positive"),
        (two_links("type: continuous, friction: -1"), "size-not-positive"),
        (body(part("shape: {box: [1, 1, 0]}, mass: 1")), "size-not-positive"),
        (
            body(part("shape: {cylinder: {radius: 1, length: 1}}, wall: 0, mass: 1")),
            "size-not-positive",
        ),
        (body(part("shape: {box: [1, 1, 1]}, mass: -1")), "mass-negative"),
        (body(part("shape: {box: [1, 1, 1]}, color: '#12345'")), "color-unknown"),
        (body(part("shape: {mesh: {file: no.stl}}")), "mesh-missing"),
        (body(part("shape: {box: [1, 1, 1]}, mass: 1, for: {x: '${3}'}")), "wrong-type"),
    ],
)
def test_each_error_is_reported_once_in_the_module(
    workshop: Workshop, module: str, code: str
) -> None:
    workshop.module("t/part", module)
    diagnostics = workshop.diagnostics(CART + "    part: {type: t/part, mount: body.front}")
    errors = [d for d in diagnostics if d.severity.value == "error"]
    assert [d.code.name for d in errors if d.code.name != "mount-without-hardware"] == [code]
    (diagnostic,) = [d for d in errors if d.code.name == code]
    assert diagnostic.span is not None
    assert diagnostic.span.file.endswith("my_modules/t/part/module.yaml")
    assert [(x.span.line, x.text) for x in diagnostic.labels][-1] == (10, "`part` uses it")


def test_error_in_the_built_in_library_points_at_the_users_line(workshop: Workshop) -> None:
    diagnostics = workshop.diagnostics(
        "frame: {type: frame/tube_rectangular, params: {wall: 100 mm}}"
    )
    (diagnostic, *_) = [d for d in diagnostics if d.code.name == "mass-negative"]
    assert diagnostic.span is not None
    assert (diagnostic.span.file, diagnostic.span.line) == (str(workshop.folder / "robot.yaml"), 5)
    assert diagnostic.labels[0].span.file.startswith("<library>/")


# -- many robots ------------------------------------------------------------------------


def test_the_hardware_of_many_designs_is_not_kept_for_ever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A study compiles thousands of frames with other parameters in one process."""
    monkeypatch.setattr(hardware, "MAX_CACHED", 4)
    path = tmp_path / "robot.yaml"
    expected = (0.8011, 0.8022, 0.8033, 0.8044, 0.8055, 0.8066, 0.8011, 0.8066)
    widths = []
    for width in expected:  # which no other test of this process has
        path.write_text(GOOD.replace("width: 0.9", f"width: {width}"))
        compilation = compile_file(path)
        assert isinstance(compilation.model, Robot)
        wheels = compilation.model.wheels
        widths.append(round(wheels[0].y - wheels[1].y, 9))
        frame = next(compilation.instances["robot.yaml"].leaves())
        assert frame.type is not None
        assert len(frame.type.elaborated) <= 4
    assert widths == pytest.approx(expected)
