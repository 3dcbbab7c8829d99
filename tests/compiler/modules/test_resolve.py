"""Resolution of modules: mounts, ports, assemblies, defaults, channels."""

from __future__ import annotations

import math

import pytest

from tests.workshop import CART, EXPECTED, Workshop, format_report
from thorvaldc.compiler.catalogue import check_library
from thorvaldc.model import Robot
from thorvaldc.model.statics.joint_tree import JointTree

SOURCE = 'source: "chosen: for a test"'
ARM = f"""
mount: {{kinds: [clamp], link: base}}
links:
  base: {{parts: [{{shape: {{box: [0.1, 0.1, 0.1]}}, mass: 1 kg, {SOURCE}}}]}}
ports:
  tip: {{kind: clamp, link: base, xyz: [1, 0, 0], rpy: [0, 0, 90 deg]}}
"""


def origin_of(robot: Robot, link: str) -> tuple[float, float, float]:
    """Returns the origin of a link in base_link (m), rounded to a micrometre."""
    x, y, z = JointTree(robot.links, robot.joints).pose[link].xyz
    return (round(x, 6) + 0.0, round(y, 6) + 0.0, round(z, 6) + 0.0)


# -- mounts ---------------------------------------------------------------------------


def test_mount_pose_is_port_pose_times_offset(workshop: Workshop) -> None:
    workshop.module("t/arm", ARM)
    robot = workshop.robot(
        CART
        + """
    a: {type: t/arm, mount: body.front}
    b: {type: t/arm, mount: {port: a.tip, xyz: [0.5, 0, 0.1], rpy: [0, 0, 90 deg]}}
    c: {type: t/block, mount: b.tip}
    """
    )
    # a points forward from x = 0.5, its tip points left, and b points back from 0.5 m along it.
    assert origin_of(robot, "a_base") == (0.5, 0.0, 0.6)
    assert origin_of(robot, "b_base") == (1.5, 0.5, 0.7)
    assert origin_of(robot, "c_box") == (0.5, 0.5, 0.7)


def test_mount_pose_of_the_module_is_inverted(workshop: Workshop) -> None:
    workshop.module(
        "t/hook",
        ARM.replace("link: base}", "link: base, xyz: [0.2, 0, 0], rpy: [0, 0, 90 deg]}", 1),
    )
    robot = workshop.robot(CART + "    hook: {type: t/hook, mount: body.front}")
    pose = JointTree(robot.links, robot.joints).pose["hook_base"]
    # Its mount is at (0.2, 0, 0); there its x axis is the frame's -y axis.
    assert origin_of(robot, "hook_base") == (0.5, 0.2, 0.6)
    assert pose.rpy()[2] == pytest.approx(-math.pi / 2)


def test_the_order_in_the_file_does_not_matter(workshop: Workshop) -> None:
    workshop.module("t/arm", ARM)
    lines = CART.strip().splitlines()
    lines += ["    a: {type: t/arm, mount: body.front}", "    b: {type: t/arm, mount: a.tip}"]
    in_order = workshop.robot("\n".join(line.strip() for line in lines))
    reversed_order = workshop.robot("\n".join(line.strip() for line in reversed(lines)))
    assert {x.name for x in in_order.links} == {x.name for x in reversed_order.links}
    for link in in_order.links:
        assert origin_of(in_order, link.name) == pytest.approx(origin_of(reversed_order, link.name))
    assert [x.name for x in reversed_order.links][1] == "b_base"


def test_free_mount_on_an_assembly_is_on_its_root(workshop: Workshop) -> None:
    workshop.module(
        "t/tower",
        """
        modules:
          top: {type: t/block, mount: {parent: base, xyz: [0, 0, 1]}}
          base: {type: t/block}
        """,
    )
    robot = workshop.robot(
        CART
        + """
    tower: {type: t/tower, mount: {parent: body, xyz: [0.1, 0, 0]}}
    on: {type: t/block, mount: {parent: tower, xyz: [0, 0.3, 0]}}
    on_top: {type: t/block, mount: {parent: tower.top}}
    """
    )
    assert origin_of(robot, "tower_base_box") == (0.1, 0.0, 0.6)
    assert origin_of(robot, "on_box") == (0.1, 0.3, 0.6)
    assert origin_of(robot, "on_top_box") == (0.1, 0.0, 1.6)


def test_free_mount_is_relative_to_its_stated_pose(workshop: Workshop) -> None:
    workshop.module(
        "t/shelf",
        ARM + "free_mount: {kind: clamp, link: base, xyz: [0, 0, 1], rpy: [0, 0, 90 deg]}\n",
    )
    robot = workshop.robot(
        CART
        + """
    shelf: {type: t/shelf, mount: body.front}
    box: {type: t/block, mount: {parent: shelf, xyz: [0.2, 0, 0]}}
    """
    )
    assert origin_of(robot, "box_box") == (0.5, 0.2, 1.6)


def test_module_fits_only_ports_of_its_kinds(workshop: Workshop) -> None:
    workshop.module("t/arm", ARM.replace("kind: clamp", "kind: tool"))
    arm = CART + "    arm: {type: t/arm, mount: body.front}\n"
    assert "port-kind" in [
        d.code.name for d in workshop.diagnostics(f"{arm}    b: {{type: t/block, mount: arm.tip}}")
    ]
    workshop.module("t/loose", "links:\n  box: {}\n")
    (loose,) = workshop.diagnostics(f"{CART}    c: {{type: t/loose, mount: body.front}}")
    assert (loose.code.name, loose.hint) == (
        "port-kind",
        "state `mount: {kinds: [clamp], link: LINK}` in the module",
    )
    block = "links:\n  box: {}\nmount: {kinds: [clamp, tool]}\n"
    workshop.module("t/any", block)
    workshop.robot(
        f"{arm}    a: {{type: t/any, mount: arm.tip}}\n    b: {{type: t/any, mount: body.front}}"
    )


def test_ports_of_nested_assemblies(workshop: Workshop) -> None:
    workshop.module("t/arm", ARM)
    workshop.module(
        "t/two",
        """
        modules:
          first: {type: t/arm}
          second: {type: t/arm, mount: first.tip}
        ports: {end: second.tip}
        """,
    )
    workshop.module(
        "t/four",
        """
        modules:
          near: {type: t/two}
          far: {type: t/two, mount: near.end}
        ports: {end: far.end}
        """,
    )
    robot = workshop.robot(
        CART
        + """
    arm: {type: t/four, mount: body.front}
    block: {type: t/block, mount: arm.end}
    inside: {type: t/block, mount: arm.near.first.tip}
    """
    )
    # Four steps of 1 m, each followed by a quarter turn, lead back to the start.
    assert origin_of(robot, "block_box") == (0.5, 0.0, 0.6)
    assert origin_of(robot, "inside_box") == (1.5, 0.0, 0.6)
    names = [x.name for x in robot.links if x.name.startswith("arm")]
    assert names[-1] == "arm_far_second_base"
    assert {x.module for x in robot.links} >= {"arm.near.first", "arm.far.second"}


def test_device_without_mount_is_only_on_the_bus(workshop: Workshop) -> None:
    cart = CART + "    board: {type: io/board%s}"
    unmounted = workshop.robot(cart % "")
    assert [x.name for x in unmounted.links if "board" in x.name] == []
    assert [n.name for bus in unmounted.buses for n in bus.nodes] == ["board"]
    head = "    plate: {type: frame/tube, params: {length: 0.3}, mount: {parent: body}}\n"
    workshop.module("t/plate", workshop_plate("frame_clamp"))
    mounted = workshop.robot(
        CART.replace("t/leg", "caster/fixed")
        + head
        + "    board: {type: io/board, mount: {parent: plate}}"
    )
    assert [x.name for x in mounted.links if "board" in x.name]
    assert [n.name for bus in mounted.buses for n in bus.nodes] == ["board"]


def workshop_plate(kind: str) -> str:
    return f"""
    links:
      body: {{parts: [{{shape: {{box: [1, 0.8, 0.1]}}, mass: 100 kg, {SOURCE}}}]}}
    free_mount: {{kind: {kind}, link: body}}
    """


# -- params and defaults ----------------------------------------------------------------


def test_params_of_a_module_have_priority_over_defaults(workshop: Workshop) -> None:
    robot = workshop.robot(
        CART.replace("[0.5, 0.4, 0]}", "[0.5, 0.4, 0]}, params: {torque: 7}"),
        "defaults: {leg: {torque: 60, radius: 0.2}}\n",
    )
    torque = {a.module: a.max_torque for a in robot.actuators}
    assert torque == {"fl": 7.0, "fr": 60.0, "rl": 60.0, "rr": 60.0}


def test_defaults_apply_only_to_types_with_the_parameter(workshop: Workshop) -> None:
    cart = CART.replace(
        "rl: {type: t/leg, mount: {parent: body, xyz: [-0.5, 0.4, 0]}}",
        "rl: {type: t/other, mount: {parent: body, xyz: [-0.5, 0.4, 0]}}",
    )
    workshop.module(
        "t/other",
        f"""
        category: leg
        mount: {{kinds: [clamp], link: box}}
        links:
          box: {{parts: [{{shape: {{sphere: {{radius: 0.1}}}}, mass: 1 kg, {SOURCE}}}]}}
        """,
    )
    robot = workshop.robot(cart, "defaults: {leg: {torque: 60}}\n", warned=("tip-over",))
    assert [a.max_torque for a in robot.actuators] == [60.0, 60.0, 60.0]


def test_parts_of_assemblies_get_their_parameters_from_the_assembly(workshop: Workshop) -> None:
    workshop.module(
        "t/pair",
        f"""
        category: pair
        params:
          torque: {{quantity: torque, default: 3, description: Of it., {SOURCE}}}
        modules:
          base: {{type: t/block}}
          leg: {{type: t/leg, mount: {{parent: base}}, params: {{torque: "${{torque * 2}}"}}}}
        """,
    )
    cart = CART.replace("fl: {type: t/leg", "fl: {type: t/pair")
    robot = workshop.robot(cart, "defaults: {leg: {torque: 60}, pair: {torque: 5}}\n")
    torque = {a.module: a.max_torque for a in robot.actuators}
    assert torque == {"fl.leg": 10.0, "fr": 60.0, "rl": 60.0, "rr": 60.0}


def test_a_default_may_choose_a_module(workshop: Workshop) -> None:
    big = "defaults: {drive: {wheel: {type: wheel/agri_200, params: {radius: 0.25}}}}\n"
    robot = workshop.robot(
        """
    frame: {type: frame/tube_rectangular}
    fl: {type: assembly/steered_drive, mount: frame.front_left}
    fr: {type: assembly/steered_drive, mount: frame.front_right}
    rl: {type: assembly/steered_drive, mount: frame.rear_left}
    rr: {type: assembly/steered_drive, mount: frame.rear_right}
    """,
        big,
    )
    assert [w.radius for w in robot.wheels] == [0.25] * 4


# -- parts that are left out --------------------------------------------------------------


@pytest.mark.parametrize("how", ["default: none", 'default: "none"'])
def test_mount_on_a_part_that_is_left_out_is_an_error(workshop: Workshop, how: str) -> None:
    workshop.module(
        "t/stand",
        f"""
        params:
          post: {{type: module, category: t, {how}, description: Of it., {SOURCE}}}
        modules:
          base: {{type: t/block}}
          post: {{type: "${{post}}", mount: {{parent: base}}}}
          lamp: {{type: t/block, mount: {{parent: post}}}}
        """,
    )
    diagnostics = workshop.diagnostics(CART + "    stand: {type: t/stand, mount: body.front}")
    unexpected = [d for d in diagnostics if d.code.name not in EXPECTED]
    assert [d.code.name for d in unexpected] == ["module-unknown"]
    assert "left out" in unexpected[0].message
    whole = CART + "    stand: {type: t/stand, mount: body.front, params: {post: t/block}}"
    assert "stand_lamp_box" in [x.name for x in workshop.robot(whole).links]


# -- channels -----------------------------------------------------------------------------

PAIR = """
    frame: {type: frame/tube_rectangular}
    left: {type: assembly/fixed_drive, mount: frame.front_left}
    right: {type: assembly/fixed_drive, mount: frame.front_right}
    rear: {type: caster/swivel, mount: frame.rear_center}
    box:
      type: controller/propulsion_propulsion
      can: 9
      channels: {left: left.propulsion, right: right.drive.propulsion}
"""


def test_one_controller_may_serve_two_drives(workshop: Workshop) -> None:
    robot = workshop.robot(PAIR)
    wired = {a.module: (a.node, a.channel) for a in robot.actuators}
    assert wired == {"left.drive": ("box", "left"), "right.drive": ("box", "right")}
    (node,) = [n for bus in robot.buses for n in bus.nodes]
    assert (node.name, node.id) == ("box", 9)


def test_address_of_an_assembly_is_that_of_its_controller(workshop: Workshop) -> None:
    robot = workshop.robot(
        """
    frame: {type: frame/tube_rectangular}
    fl: {type: assembly/steered_drive, mount: frame.front_left, can: 5}
    fr: {type: assembly/steered_drive, mount: frame.front_right}
    rl: {type: assembly/steered_drive, mount: frame.rear_left, can: 1}
    rr: {type: assembly/steered_drive, mount: frame.rear_right}
    """
    )
    ids = {n.name: n.id for bus in robot.buses for n in bus.nodes}
    assert ids["fl_controller"] == 5
    assert ids["rl_controller"] == 1
    assert len(set(ids.values())) == 4


# -- errors without further errors -----------------------------------------------------------


@pytest.mark.parametrize(
    ("modules", "codes"),
    [
        ("part: {type: t/nothing, mount: body.front}", ["module-type-unknown"]),
        (
            "part: {type: t/nothing, mount: body.front}\n"
            "    on: {type: t/block, mount: {parent: part}}\n"
            "    at: {type: t/block, mount: part.top}",
            ["module-type-unknown"],
        ),
        ("part: {type: t/block, mount: boddy.front}", ["module-unknown"]),
        ("part: {type: t/block, mount: body.front.left}", ["port-unknown"]),
        ("part: {type: t/block, mount: {parent: part}}", ["mount-cycle"]),
        (
            "part: {type: t/block, mount: {parent: other}}\n"
            "    other: {type: t/block, mount: {parent: part}}",
            ["mount-cycle"],
        ),
    ],
)
def test_one_mistake_causes_one_diagnostic(
    workshop: Workshop, modules: str, codes: list[str]
) -> None:
    diagnostics = workshop.diagnostics(f"{CART}    {modules}")
    assert [d.code.name for d in diagnostics if d.code.name not in EXPECTED] == codes


def test_a_frame_of_an_unknown_type_hides_nothing_else(workshop: Workshop) -> None:
    compilation = workshop.compile(
        """
    body: {type: t/plaet}
    fl: {type: t/leg, mount: {parent: body}, params: {radius: 3 kg}}
    fr: {type: t/leg, mount: {parent: boddy}}
    """
    )
    names = [d.code.name for d in compilation.report]
    assert names == ["module-type-unknown", "wrong-dimension", "module-unknown"], format_report(
        compilation
    )


def test_hints_contain_the_nearest_name(workshop: Workshop) -> None:
    workshop.module("t/arm", ARM)
    arm = CART + "    arm: {type: t/arm, mount: body.front}\n"
    hints = {
        "{type: t/blok, mount: arm.tip}": "`t/block`",
        "{type: t/block, mount: amr.tip}": "`arm`",
        "{type: t/block, mount: arm.tipp}": "`tip`",
        "{type: t/block, mount: arm}": "`arm.tip`",
        "{type: t/block, mount: arm.tip, params: {maas: 1}}": "`mass`",
    }
    for text, near in hints.items():
        diagnostics = workshop.diagnostics(f"{arm}    block: {text}")
        assert near in str(diagnostics[0].hint), (text, diagnostics[0])


def test_ports_motors_and_can_of_an_assembly_are_checked_in_the_library(workshop: Workshop) -> None:
    workshop.module(
        "t/pair",
        """
        params:
          extra: {type: module, default: none, description: May be., source: "chosen: none"}
        modules:
          post: {type: t/block}
          leg: {type: t/leg, mount: {parent: post}}
          extra: {type: "${extra}", mount: {parent: post}}
        can: controler
        motors: {propulsion: leg.propulsion, steering: leg.steer}
        ports: {top: past.top, side: post.side, far: extra.top}
        """,
    )
    diagnostics = check_library(workshop.folder / "my_modules").report
    assert [(d.code.name, d.span.line if d.span else 0) for d in diagnostics.sorted()] == [
        ("module-unknown", 9),
        ("motor-unknown", 10),
        ("module-unknown", 11),
        ("port-unknown", 11),
    ]
