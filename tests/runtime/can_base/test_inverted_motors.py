"""Motors that are mounted the other way round: `inverted` of the robot file, over the whole bus."""

from __future__ import annotations

import functools
import math
import shutil
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.runtime.can_base.simulated_rig import Rig
from tests.simulation.bus.robots import MODULES, at_home, quick_to_home
from tests.slow import mostly_exhaustive
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.model import Robot
from thorvaldc.model.scenario import BusFault, BusFaults
from thorvaldc.runtime.se2 import Pose2, Twist
from thorvaldc.simulation.bus.fault_injection import FaultInjector
from thorvaldc.simulation.bus.motor_wiring import Wiring
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene

ROBOT = """
thorvaldc: 1
name: rover
calibration: calibration.yaml
modules:
  frame: {{type: frame/tube_rectangular,
    params: {{length: 1.2 m, width: 800 mm, cross_members: [-100 mm]}}}}
  fl: {{type: assembly/steered_drive, mount: frame.front_left, can: 1,
    params: {{controller: {controller}{left}}}}}
  fr: {{type: assembly/steered_drive, mount: frame.front_right, can: 2,
    params: {{controller: {controller}{right}}}}}
  rl: {{type: caster/swivel, mount: frame.rear_left}}
  rr: {{type: caster/swivel, mount: frame.rear_right}}
  battery: {{type: battery/enclosure, mount: {{parent: frame, xyz: [0, 0, 0.07]}}, can: 1}}
"""
CALIBRATION = """
thorvaldc: 1
robot: rover
wheels: {{fl_wheel: {{steering_offset: {} deg}}, fr_wheel: {{steering_offset: {} deg}}}}
"""
SCRIPT = "controller/propulsion_steering"
CIA_402 = "controller/cia402_propulsion_steering"
BOTH = ", inverted: true, steering_inverted: true"
CURVE = Twist(0.4, 0.0, 0.4)
REVERSED = Wiring(direction=-1)


@functools.cache
def rover(
    controller: str,
    left: str = "",
    right: str = "",
    offsets: tuple[float, float] = (0.0, 0.0),
    limits: str = "",
) -> Robot:
    """Returns a robot with two steered wheels.

    ``left``, ``right``: further parameters.  ``offsets``: calibrated steering offsets in deg.
    ``limits``: lines that replace the symmetrical limits of the steering joints.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        file = folder / "robot.yaml"
        file.write_text(ROBOT.format(controller=controller, left=left, right=right), "utf-8")
        (folder / "calibration.yaml").write_text(CALIBRATION.format(*offsets), "utf-8")
        if limits:
            path = "steering/standard/module.yaml"
            text = (MODULES / path).read_text("utf-8")
            stated = "    lower: ${-limit}\n    upper: ${limit}\n"
            assert stated in text
            shutil.copytree((MODULES / path).parent, (folder / "library" / path).parent)
            (folder / "library" / path).write_text(text.replace(stated, limits), "utf-8")
        compilation = compile_file(file, library=[folder / "library"] if limits else [])
    assert isinstance(compilation.model, Robot), list(compilation.report)
    return quick_to_home(compilation.model)


class Drive(NamedTuple):
    """What a robot did: where it believes to be, and its true joint positions."""

    pose: Pose2
    homed: list[float]
    wheels: list[float]
    angles: list[float]


def driven(rig: Rig, twist: Twist = CURVE) -> Drive:
    """Starts and homes a robot, and drives it for two seconds."""
    rig.ready()
    homed = positions(rig, "steering")
    rig.drive(twist, 2.0)
    return Drive(
        rig.driven.driver.state.pose,
        homed,
        positions(rig, "propulsion"),
        positions(rig, "steering"),
    )


def positions(rig: Rig, role: str) -> list[float]:
    motors = rig.simulated.motors
    return [motors[a.name].read(rig.now).position for a in rig.robot.actuators if a.role == role]


def assert_equal(drive: Drive, other: Drive) -> None:
    for values, others in zip(drive, other, strict=True):
        assert list(values) == pytest.approx(list(others), abs=3e-3)


each_controller = pytest.mark.parametrize(
    "controller", mostly_exhaustive([SCRIPT, CIA_402]), ids=["script", "cia402"]
)


@each_controller
@pytest.mark.parametrize("offsets", [(0.0, 0.0), (5.0, -3.0)], ids=["", "calibrated"])
def test_the_same_path(controller: str, offsets: tuple[float, float]) -> None:
    usual = driven(Rig(rover(controller, offsets=offsets)))
    assert usual.homed == pytest.approx([0.0, 0.0], abs=2e-3)
    assert min(usual.wheels) > 1.0
    assert min(usual.angles) > 0.3
    for left, right in (
        (BOTH, BOTH),
        (", steering_inverted: true", ", inverted: true"),
    ):
        assert_equal(driven(Rig(rover(controller, left, right, offsets))), usual)


@pytest.mark.parametrize("controller", [SCRIPT, CIA_402])
def test_the_same_path_with_physics(controller: str) -> None:
    drives = []
    for left in ("", BOTH):
        robot = at_home(rover(controller, left))
        base = MujocoBase(robot, MujocoScene(emit(robot, ["mjcf"])))
        drives.append(driven(Rig(robot, base=base)))
        true = base.true_pose()
        assert (true.x, true.yaw) == pytest.approx(
            (drives[-1].pose.x, drives[-1].pose.yaw), abs=0.03
        )
        assert true.x > 0.3 < true.yaw
    assert_equal(drives[1], drives[0])


def test_commands_and_reports_change_their_sign_and_nothing_else_does() -> None:
    rigs = [Rig(at_home(rover(CIA_402, left))) for left in ("", BOTH)]
    for rig in rigs:
        rig.drive(CURVE)
    usual, inverted = ({f.id: f.data for _, f in rig.frames} for rig in rigs)
    for cob_id in (0x201, 0x181):  # command and report of the propulsion: 24 bits, then the speed
        speed, other = (
            int.from_bytes(d[cob_id][3:], "little", signed=True) for d in (usual, inverted)
        )
        assert other == pytest.approx(-speed, abs=3) != 0
        assert usual[cob_id][:3] == inverted[cob_id][:3]
    assert usual[0x202] == inverted[0x202], "the other wheel is as before"
    nodes = [rig.robot.buses[0].nodes[0] for rig in rigs]
    assert nodes[0].objects == nodes[1].objects, "nothing is written to the drive"


# -- limits that are not symmetrical ---------------------------------------------------------------

LIMITS = "    lower: -1.2\n    upper: 0.6\n"


@pytest.mark.parametrize("inverted", [False, True])
def test_the_limits_of_the_drive_are_in_its_own_direction(inverted: bool) -> None:
    """The search for the stop in the negative direction of the drive ends at the upper limit."""
    left = BOTH if inverted else ""
    robot = rover(CIA_402, left, left, (5.0, -3.0), LIMITS)
    actuator = next(a for a in robot.actuators if a.role == "steering")
    counts = 4 * actuator.encoder_ppr * actuator.gear_ratio / math.tau
    low, high = (-0.6, 1.2) if inverted else (-1.2, 0.6)
    objects = {entry.name: entry.value for entry in robot.buses[0].nodes[0].objects}
    assert objects["steering_lowest_position"] == round(low * counts)
    assert objects["steering_highest_position"] == round(high * counts)
    assert objects["steering_home_offset"] == round(-low * counts)

    rig = Rig(robot)
    reached: list[float] = []
    rig.simulated.wire().observers.append(lambda *_: reached.append(positions(rig, "steering")[0]))
    assert driven(rig, Twist(0.3, -0.3, 0.0)).homed == pytest.approx([0.0, 0.0], abs=2e-3)
    assert (max(reached) >= 0.6, min(reached) <= -1.2) == (inverted, not inverted)

    # A command beyond the limits: the joint has them shifted by the offset, the drive has its own.
    codec = rig.base.state_machine.controllers[0].codecs["rpdo2"]
    command = codec.frame.signals[codec.indices["steering_target_position"]]
    offset = math.radians(5.0)
    assert (command.minimum, command.maximum) == pytest.approx((-1.2 + offset, 0.6 + offset))
    clamped = codec.encode_named({command.name: 9.0})[3:]
    assert int.from_bytes(clamped, "little", signed=True) == round(
        (low if inverted else high) * counts
    )


# -- wiring that the robot file does not know ------------------------------------------------------


@each_controller
def test_a_reversed_motor_needs_the_key(controller: str) -> None:
    offsets = (5.0, -3.0)
    usual = driven(Rig(rover(controller, offsets=offsets)))
    file = rover(controller, offsets=offsets)
    wiring = {"fl_drive_propulsion": REVERSED, "fr_steering_steering": REVERSED}
    wrong = driven(Rig(file, wiring=wiring))
    assert wrong.wheels[0] == pytest.approx(-usual.wheels[0], abs=0.05)
    # Position 0 of the drive is at the offset, and the drive turns away from it the wrong way.
    mirrored = 2.0 * math.radians(offsets[1]) - usual.angles[1]
    assert wrong.angles[1] == pytest.approx(mirrored, abs=5e-3)
    assert list(wrong.pose) == pytest.approx(list(usual.pose), abs=0.01), "the driver sees nothing"
    corrected = rover(controller, ", inverted: true", ", steering_inverted: true", offsets)
    assert_equal(driven(Rig(corrected, drives=file, wiring=wiring)), usual)


def test_a_deviation_from_a_file_that_says_inverted() -> None:
    file = rover(SCRIPT, ", inverted: true")
    wrong = driven(Rig(file, wiring={"fl_drive_propulsion": REVERSED}))
    assert wrong.wheels[0] < -1.0 < 1.0 < wrong.wheels[1]


@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        ("encoder_jump", {"channel": "steering", "angle": 0.4}),
        ("runaway_motor", {"channel": "propulsion", "speed": 3.0}),
        ("pushed_motor", {"channel": "propulsion", "speed": 0.5}),
    ],
)
def test_injected_faults_are_those_of_the_joint(kind: str, fields: dict[str, Any]) -> None:
    found = []
    for left in ("", BOTH):
        rig = Rig(rover(SCRIPT, left))
        rig.drive(Twist(0.2, 0.0, 0.0), 1.0)
        fault = BusFault(kind, "main", "fl_controller", 0.0, None, rig.robot.span, **fields)
        FaultInjector(rig.simulated, BusFaults(())).inject(fault)
        rig.run(0.3)
        joints = rig.base.state_machine.controllers[0].axes
        found.append([a.position for a in joints] + positions(rig, "propulsion"))
    assert found[1] == pytest.approx(found[0], abs=3e-3)
