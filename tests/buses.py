"""A robot model with one bus, without the compiler: two drives and a battery."""

from __future__ import annotations

import dataclasses
import math

from tests.robots import SPAN, make_robot
from thorvaldc.model import Battery, Bus, Channel, FrameDefinition, Node, Robot, Signal

GEAR, STEERING_GEAR = 42.0, 42.857  # gear ratios
PPR = 1024  # encoder pulses per turn of the motor
MAX_SPEED = 314.159  # rad/s, motor
LIMIT = 3.078027759  # rad, steering
CYCLE = 0.02  # s


def drive_frames(
    name: str, node_id: int, propulsion: str, steering: str
) -> tuple[FrameDefinition, ...]:
    """Returns the frames of a propulsion and steering controller, with calculated scalings."""
    return (
        FrameDefinition(
            f"{name}_rpdo1",
            0x200 + node_id,
            "pdo",
            "master",
            (name,),
            8,
            CYCLE,
            CYCLE,
            (
                Signal("sequence", 0, 32, signed=True),
                Signal(
                    "speed",
                    32,
                    32,
                    signed=True,
                    scale=MAX_SPEED / 1000 / GEAR,
                    unit="rad/s",
                    joint=propulsion,
                    description='Wheel speed, "raw" a thousandth.',
                ),
            ),
            SPAN,
            "Propulsion command.",
        ),
        FrameDefinition(
            f"{name}_rpdo4",
            0x500 + node_id,
            "pdo",
            "master",
            (name,),
            8,
            CYCLE,
            CYCLE,
            (
                Signal(
                    "position", 32, 32, signed=True, scale=LIMIT / 1000, unit="rad", joint=steering
                ),
            ),
            SPAN,
        ),
        FrameDefinition(
            f"{name}_tpdo1",
            0x180 + node_id,
            "pdo",
            name,
            ("master",),
            8,
            CYCLE,
            CYCLE,
            (
                Signal(
                    "propulsion_velocity",
                    0,
                    16,
                    signed=True,
                    scale=math.pi / 30 / GEAR,
                    unit="rad/s",
                    joint=propulsion,
                ),
                Signal(
                    "steering_position",
                    32,
                    32,
                    signed=True,
                    scale=2 * math.pi / (4 * PPR * STEERING_GEAR),
                    unit="rad",
                    joint=steering,
                ),
            ),
            SPAN,
        ),
        FrameDefinition(
            f"{name}_tpdo4",
            0x480 + node_id,
            "pdo",
            name,
            ("master",),
            8,
            1.0,
            1.0,
            (
                Signal(
                    "content",
                    24,
                    8,
                    multiplexer=True,
                    choices=((1, "configuration"), (2, "version"), (3, "encoder")),
                ),
                Signal("configuration", 32, 32, selected_by=(1,)),
                Signal("controller_type", 32, 8, selected_by=(2,)),
                Signal("version_major", 56, 8, selected_by=(2,)),
                Signal("propulsion_encoder_ppr", 32, 16, selected_by=(3,)),
            ),
            SPAN,
        ),
        FrameDefinition(
            f"{name}_heartbeat",
            0x700 + node_id,
            "heartbeat",
            name,
            ("master",),
            1,
            0.1,
            0.1,
            (Signal("state", 0, 7, choices=((0, "boot_up"), (5, "operational"))),),
            SPAN,
        ),
    )


def drive_node(name: str, node_id: int, wheel: str) -> Node:
    """Returns the controller of the propulsion and steering motors of a wheel."""
    return Node(
        name,
        name.replace("_", "."),
        "thorvald_roboteq",
        node_id,
        "canopen",
        0x469,
        None,
        (
            Channel("propulsion", "propulsion", f"{wheel}_propulsion"),
            Channel("steering", "steering", f"{wheel}_steering"),
        ),
        (("heartbeat_timeout", 2.0),),
        SPAN,
    )


def robot_with_bus() -> Robot:
    """Returns a robot with two steered drives and a battery on one bus."""
    robot = make_robot([(0.5, 0.4, "steered"), (0.5, -0.4, "steered"), (-0.5, 0.0, "swivel")])
    battery = Node("battery", "battery", "kc", 1, "kc_battery", None, "0x12", (), (), SPAN)
    frames = (
        FrameDefinition("sync", 0x080, "sync", "master", ("w0_controller", "w1_controller"), 0,
              CYCLE, CYCLE, (), SPAN),
        *drive_frames("w0_controller", 3, "w0_axle", "w0_steering_axis"),
        *drive_frames("w1_controller", 2, "w1_axle", "w1_steering_axis"),
        FrameDefinition(
            "battery_status", 0x3C1, "broadcast", "battery", ("master",), 8, 0.1, 0.1,
            (
                Signal("voltage", 16, 16, scale=0.01, unit="V"),
                Signal("temperature", 48, 8, signed=True, unit="°C", offset=-40.0),
            ),
            SPAN,
        ),
    )  # fmt: skip
    bus = Bus(
        "main",
        500_000,
        CYCLE,
        (drive_node("w0_controller", 3, "w0"), drive_node("w1_controller", 2, "w1"), battery),
        frames,
        SPAN,
    )
    return dataclasses.replace(
        robot,
        buses=(bus,),
        batteries=(Battery("battery", "battery", "frame_body", "battery", (), SPAN),),
        actuators=tuple(
            dataclasses.replace(a, node=f"{a.module}_controller", channel=a.role)
            for a in robot.actuators
        ),
    )
