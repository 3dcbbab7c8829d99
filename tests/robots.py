"""Robot models that are built without the compiler."""

from __future__ import annotations

import math
from collections.abc import Sequence

from thorvaldc.diagnostics import Span
from thorvaldc.model import (
    Actuator,
    Box,
    CalculatorChoice,
    Collision,
    Cylinder,
    DriverSettings,
    Inertial,
    Joint,
    Link,
    Pose,
    Robot,
    TwistInput,
    Visual,
    Wheel,
)
from thorvaldc.model.spatial import combine

SPAN = Span("test.yaml")
G = 9.81  # m/s^2
GREY = (0.5, 0.5, 0.5, 1.0)
LIMIT = 3.078027759  # rad, steering


def make_robot(
    wheels: Sequence[tuple[float, float, str]],
    *,
    radius: float = 0.2,
    width: float = 0.16,
    body_mass: float = 100.0,
    body_height: float = 0.65,
    calculator: str = "general",
    suspended: bool = False,
) -> Robot:
    """Returns a box on wheels; lengths in m, masses in kg.

    Each wheel is ``(x, y, kind)``; kind is ``steered`` (driven and steered),
    ``fixed`` (driven, not steered), ``passive`` (fixed, not driven) or
    ``swivel`` (a caster).
    """
    links = [Link("base_link", "", None, (), (), SPAN)]
    joints: list[Joint] = []
    actuators: list[Actuator] = []
    model_wheels: list[Wheel] = []
    frame = Inertial(
        body_mass, (0.0, 0.0, 0.0), (body_mass / 6, body_mass / 5, body_mass / 4, 0.1, 0.0, 0.0)
    )
    shape = Box((1.0, 0.8, 0.1))
    links.append(Link("frame_body", "frame", frame, (Visual(shape, Pose(), GREY),), (), SPAN))
    joints.append(
        Joint(
            "frame_mount",
            "frame",
            "fixed",
            "base_link",
            "frame_body",
            Pose((0.0, 0.0, body_height)),
            SPAN,
        )
    )
    inertials = [frame.transformed(Pose((0.0, 0.0, body_height)))]
    leg = Inertial(18.0, (0.0, 0.01, -0.1), (0.5, 0.5, 0.1, 0.0, 0.0, 0.01))
    iw = 6.0 * radius**2 / 2  # solid cylinder, m r^2 / 2, about its axis
    tyre = Inertial(6.0, (0.0, 0.0, 0.0), (iw / 2 + 0.01, iw, iw / 2 + 0.01, 0.0, 0.0, 0.0))
    carriage = Inertial(1.0, (0.0, 0.0, 0.0), (0.01, 0.01, 0.01, 0.0, 0.0, 0.0))
    for x, y, _ in wheels:
        if suspended:
            inertials.append(carriage.transformed(Pose((x, y, body_height))))
        inertials.append(leg.transformed(Pose((x, y, body_height))))
        inertials.append(tyre.transformed(Pose((x, y, radius))))
    total = combine(inertials)
    for i, (x, y, kind) in enumerate(wheels):
        m = f"w{i}"
        parent = "frame_body"
        at = Pose((x, y, 0.0))
        suspension = None
        load = total.mass * G / len(wheels)  # N
        if suspended:
            suspension = f"{m}_suspension_travel"
            links.append(
                Link(f"{m}_suspension_carriage", f"{m}.suspension", carriage, (), (), SPAN)
            )
            sprung = load - (1.0 + 18.0 + 6.0) * G
            joints.append(
                Joint(
                    suspension,
                    f"{m}.suspension",
                    "prismatic",
                    parent,
                    f"{m}_suspension_carriage",
                    at,
                    SPAN,
                    axis=(0.0, 0.0, 1.0),
                    lower=-0.05,
                    upper=0.05,
                    effort=5000.0,
                    velocity=2.0,
                    damping=900.0,
                    stiffness=20000.0,
                    spring_reference=-sprung / 20000.0,
                    role="suspension",
                )
            )
            parent, at = f"{m}_suspension_carriage", Pose()
        turns_about_z = kind in ("steered", "swivel")
        steering = f"{m}_steering_axis"
        links.append(
            Link(
                f"{m}_leg",
                m,
                leg,
                (Visual(Cylinder(0.03, 0.3), Pose((0.0, 0.1, -0.2)), GREY),),
                (),
                SPAN,
            )
        )
        joints.append(
            Joint(
                steering,
                m,
                "fixed" if not turns_about_z else "continuous" if kind == "swivel" else "revolute",
                parent,
                f"{m}_leg",
                at,
                SPAN,
                axis=(0.0, 0.0, 1.0),
                lower=-LIMIT if kind == "steered" else None,
                upper=LIMIT if kind == "steered" else None,
                effort=200.0 if kind == "steered" else None,
                velocity=4.0 if kind == "steered" else None,
                role="steering" if kind == "steered" else "swivel" if kind == "swivel" else "",
            )
        )
        collision = Collision(
            Cylinder(radius, width), Pose.from_xyz_rpy(rpy=(math.pi / 2, 0.0, 0.0))
        )
        links.append(Link(f"{m}_tyre", m, tyre, (), (collision,), SPAN))
        driven = kind in ("steered", "fixed")
        joints.append(
            Joint(
                f"{m}_axle",
                m,
                "continuous",
                f"{m}_leg",
                f"{m}_tyre",
                Pose((0.0, 0.0, radius - body_height)),
                SPAN,
                axis=(0.0, 1.0, 0.0),
                effort=90.0 if driven else None,
                velocity=7.48 if driven else None,
                armature=0.2 if driven else 0.0,
                role="propulsion" if driven else "wheel",
            )
        )
        if driven:
            actuators.append(
                Actuator(
                    f"{m}_propulsion",
                    m,
                    f"{m}_axle",
                    "propulsion",
                    42.0,
                    314.159,
                    1024,
                    7.48,
                    7.5,
                    90.0,
                    0.2,
                    None,
                    None,
                    SPAN,
                )
            )
        if kind == "steered":
            actuators.append(
                Actuator(
                    f"{m}_steering",
                    m,
                    steering,
                    "steering",
                    42.857,
                    314.159,
                    1024,
                    4.0,
                    20.0,
                    200.0,
                    0.2,
                    None,
                    None,
                    SPAN,
                )
            )
        model_wheels.append(
            Wheel(
                m,
                m,
                f"{m}_tyre",
                f"{m}_axle",
                steering if kind == "steered" else None,
                steering if kind == "swivel" else None,
                suspension,
                driven,
                x,
                y,
                0.0,
                1.0,
                0.0,
                0.0,
                radius,
                width,
                (),
                0.8,
                0.015,
                load,
                0.0,
                SPAN,
            )
        )
    return Robot(
        "test_robot",
        "",
        "",
        tuple(links),
        tuple(joints),
        tuple(model_wheels),
        tuple(actuators),
        (),
        (),
        (),
        (),
        CalculatorChoice(calculator),
        DriverSettings(50.0, 0.5, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5),
        total,
        SPAN,
        twist_sources=(
            TwistInput("teleop_joy", "teleop_joy/cmd_vel", 100, 0.5),
            TwistInput("auto_nav", "auto_nav/cmd_vel", 10, 0.5),
        ),
        twist_locks=(
            TwistInput("safety_stop", "safety_stop/lock", 255, 0.0),
            TwistInput("auto_nav_pause", "auto_nav/pause", 50, 0.0),
        ),
    )


FOUR_STEERED = [
    (0.55, 0.45, "steered"),
    (0.55, -0.45, "steered"),
    (-0.55, 0.45, "steered"),
    (-0.55, -0.45, "steered"),
]
