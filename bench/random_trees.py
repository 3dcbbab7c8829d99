"""Random robots on rockers, bogies, pivoting axles and swing arms, for ``bench.standing``."""

from __future__ import annotations

import math
import random
from dataclasses import replace
from typing import TYPE_CHECKING

from thorvaldc.diagnostics import Span
from thorvaldc.model import (
    Box,
    CalculatorChoice,
    Collision,
    Cylinder,
    DriverSettings,
    Inertial,
    Joint,
    Link,
    Mimic,
    Pose,
    Robot,
    Wheel,
)
from thorvaldc.model.statics.joint_tree import JointTree
from thorvaldc.model.statics.standing import spring_loads

if TYPE_CHECKING:
    from thorvaldc.model import Vec3

SPAN = Span("random")
RADIUS, WIDTH = 0.15, 0.06  # m, of all wheels
Y = (0.0, 1.0, 0.0)
X = (1.0, 0.0, 0.0)


class Tree:
    """A robot that grows joint by joint; all frames are parallel to ``base_link``."""

    def __init__(self, rng: random.Random) -> None:
        self.rng = rng
        self.at: dict[str, Vec3] = {"base_link": (0.0, 0.0, 0.0)}
        self.links = [Link("base_link", "", None, (), (), SPAN)]
        self.joints: list[Joint] = []
        self.wheels: list[Wheel] = []

    def link(
        self, name: str, parent: str, at: Vec3, mass: float, com: Vec3, **joint: object
    ) -> str:
        """Adds a body at a place in ``base_link`` (m), with its joint; returns the joint's name."""
        i = 0.02 * mass
        inertial = Inertial(mass, com, (i, i, i, 0.0, 0.0, 0.0))
        self.links.append(Link(name, name, inertial, (), (), SPAN))
        origin = self.at[parent]
        pose = Pose(tuple(a - b for a, b in zip(at, origin, strict=True)))  # type: ignore[arg-type]
        kind = str(joint.pop("type", "fixed"))
        self.joints.append(
            Joint(f"{name}_joint", name, kind, parent, name, pose, SPAN, **joint)  # type: ignore[arg-type]
        )
        self.at[name] = at
        return f"{name}_joint"

    def hinge(self, name: str, parent: str, at: Vec3, axis: Vec3, mass: float, com: Vec3) -> str:
        """Adds a body on a passive hinge, sometimes with a spring."""
        limits = {"lower": -1.0, "upper": 1.0}
        if self.rng.random() < 0.15:
            limits = {"lower": 0.0, "upper": 1.0}  # a stop at the drawn position
        stiffness = self.rng.choice([0.0, 0.0, 0.0, 0.0, 60.0, 3000.0])
        return self.link(
            name,
            parent,
            at,
            mass,
            com,
            type="revolute",
            axis=axis,
            damping=3.0,
            stiffness=stiffness,
            **limits,
        )

    def wheel(self, name: str, parent: str, x: float, y: float) -> None:
        """Adds a free wheel below a body."""
        at = (x, y, RADIUS)
        spin = self.link(name, parent, at, 3.0, (0.0, 0.0, 0.0), type="continuous", axis=Y)
        upright = Pose.from_xyz_rpy(rpy=(math.pi / 2, 0.0, 0.0))
        shape = Collision(Cylinder(RADIUS, WIDTH), upright)
        self.links[-1] = replace(self.links[-1], collisions=(shape,))
        self.joints[-1] = replace(self.joints[-1], role="wheel", damping=0.02)
        self.wheels.append(
            Wheel(
                name=name,
                module=name,
                link=name,
                spin_joint=spin,
                steering_joint=None,
                swivel_joint=None,
                suspension_joint=None,
                driven=False,
                x=x,
                y=y,
                heading=0.0,
                steering_sign=1.0,
                trail=0.0,
                lateral_offset=0.0,
                radius=RADIUS,
                width=WIDTH,
                radii=(),
                friction=0.8,
                rolling_resistance=0.0,
                load=0.0,
                contact_height=0.0,
                span=SPAN,
            )
        )

    def couple(self, joint: str, leader: str, ratio: float) -> None:
        """Makes a joint follow another one."""
        self.joints = [
            replace(j, mimic=Mimic(leader, ratio, 0.0), lower=-1.0, stiffness=0.0)
            if j.name == joint
            else j
            for j in self.joints
        ]

    def robot(self) -> Robot:
        """Returns the model with wheel loads and rest positions of the springs."""
        tree = JointTree(self.links, self.joints)
        joints, loads = spring_loads(tree, self.joints, self.wheels, ())
        wheels = [replace(w, load=n) for w, n in zip(self.wheels, loads, strict=True)]
        return Robot(
            name="random",
            namespace="",
            description="",
            links=tuple(self.links),
            joints=tuple(joints),
            wheels=tuple(wheels),
            actuators=(),
            sensors=(),
            batteries=(),
            buses=(),
            meshes=(),
            calculator=CalculatorChoice("general", ()),
            driver=DriverSettings(50.0, 0.5, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0),
            inertial=tree.inertial(),
            span=SPAN,
        )


def random_tree(seed: int) -> Robot:
    """Returns a random robot; it may stand, lean or fall."""
    rng = random.Random(seed)
    tree = Tree(rng)
    height = rng.uniform(0.3, 0.6)
    com = (
        rng.choice([0.0, rng.uniform(-0.25, 0.25)]),
        rng.uniform(-0.08, 0.08),
        rng.uniform(-0.3, 0.4),
    )
    tree.link("body", "base_link", (0.0, 0.0, height), rng.uniform(30, 120), com)
    box = Collision(Box((0.4, 0.3, 0.1)), Pose())
    tree.links[-1] = replace(tree.links[-1], collisions=(box,))
    layout = rng.choice(["rockers", "rockers", "bogies", "axle", "two axles", "arms", "mixed"])
    if layout in ("rockers", "bogies"):
        _rockers(tree, 0.0, height, bogies=layout == "bogies")
    elif layout == "mixed":
        _rockers(tree, -0.35, height, bogies=False)
        for y in (0.4, -0.4):
            tree.wheel(f"front{y:+}", "body", 0.5, y)
    elif layout == "arms":
        for x in (0.4, -0.4):
            for y in (0.4, -0.4):
                name = f"arm{x:+}{y:+}"
                tree.hinge(name, "body", (x + 0.2, y, height), Y, 4.0, (-0.1, 0.0, -0.1))
                tree.wheel(f"wheel{x:+}{y:+}", name, x, y)
    else:
        for x in (0.45, -0.45):
            parent = "body"
            if x > 0.0 or layout == "two axles":
                parent = f"axle{x:+}"
                tree.hinge(parent, "body", (x, 0.0, rng.uniform(0.2, height)), X, 5.0, (0.0,) * 3)
            for y in (0.4, -0.4):
                tree.wheel(f"wheel{x:+}{y:+}", parent, x, y)
    if rng.random() < 0.2:
        drop = rng.choice([-0.2, 0.2])
        tree.hinge("pendulum", "body", (0.1, 0.0, height + 0.1), Y, 3.0, (0.0, 0.0, -drop))
    return tree.robot()


def _rockers(tree: Tree, x: float, height: float, *, bogies: bool) -> None:
    """Adds a rocker with two or three wheels on each side, often with a differential."""
    rng = tree.rng
    pivot = rng.uniform(0.2, height)
    pivots = []
    for side, y in (("left", 0.4), ("right", -0.4)):
        rocker = f"{side}_rocker"
        pivots.append(tree.hinge(rocker, "body", (x, y, pivot), Y, 5.0, (0.0, 0.0, 0.0)))
        ahead, behind = 0.35, 0.3
        tree.wheel(f"{side}_front", rocker, x + ahead, y)
        if bogies:
            bogie = f"{side}_bogie"
            tree.hinge(bogie, rocker, (x - behind, y, 0.22), Y, 3.0, (0.0, 0.0, 0.0))
            tree.wheel(f"{side}_middle", bogie, x - behind + 0.17, y)
            tree.wheel(f"{side}_rear", bogie, x - behind - 0.17, y)
        else:
            tree.wheel(f"{side}_rear", rocker, x - behind, y)
    ratio = rng.choice([0.0, -1.0, -1.0, 1.0])
    if ratio:
        tree.couple(pivots[1], pivots[0], ratio)
