"""Robots from a list of wheel plans, with statics by numpy and without the compiler.

``tests/robots.py`` builds simple robots.  Here wheels have different radii, headings, trails,
cambers and suspensions, and ``graft`` adds a random tree of links, joints, meshes and sensors.
"""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tests.examples import sampled
from tests.robots import SPAN
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
    Mesh,
    MeshShape,
    Mimic,
    Pose,
    Robot,
    Sensor,
    Sphere,
    Visual,
    Wheel,
)
from thorvaldc.model.spatial import combine

G = 9.81
GREY = (0.5, 0.5, 0.5, 1.0)
LIMIT = 3.078027759


@dataclass(frozen=True)
class Plan:
    """A wheel: ``kind`` is ``steered``, ``fixed`` (driven), ``passive`` or ``swivel``.

    The steering axis (without one, the wheel's centre) is above ``x``, ``y``;
    the wheel's centre is ``trail`` ahead and ``lateral`` left of it; angles in rad.

    A suspended wheel slides vertically, or swings on an arm if ``arm`` is not 0: the hinge is
    ``arm`` m ahead of the steering axis, its axis is ``hinge``, and the robot's weight turns
    it by about ``sag`` rad.  An ``endless`` steering axis has no limits; ``lowest`` is the
    lower limit of the others.
    """

    x: float
    y: float
    kind: str = "steered"
    heading: float = 0.0
    radius: float = 0.2
    width: float = 0.16
    trail: float = 0.0
    lateral: float = 0.0
    camber: float = 0.0
    suspended: bool = False
    arm: float = 0.0
    hinge: tuple[float, float, float] = (0.0, 1.0, 0.0)
    sag: float = 0.0
    endless: bool = False
    lowest: float = -LIMIT


def build(
    plans: Sequence[Plan],
    *,
    name: str = "planned",
    namespace: str = "",
    body_mass: float = 100.0,
    body_com: tuple[float, float, float] = (0.0, 0.0, 0.0),
    height: float = 0.65,
) -> Robot:
    """Build a body with wheels that stand on the ground at joint positions 0."""
    inertia = (body_mass / 6, body_mass / 5, body_mass / 4, 0.3, -0.2, 0.1)
    body = Inertial(body_mass, body_com, inertia)
    shape = Box((1.0, 0.8, 0.1))
    links = [
        Link("base_link", "", None, (), (), SPAN),
        Link(
            "frame_body",
            "frame",
            body,
            (Visual(shape, Pose(), GREY),),
            (Collision(shape, Pose()),),
            SPAN,
        ),
    ]
    mount = Pose((0.0, 0.0, height))
    joints = [Joint("frame_mount", "frame", "fixed", "base_link", "frame_body", mount, SPAN)]
    placed = [body.transformed(mount)]
    contacts = []
    for plan in plans:
        at = Pose.from_xyz_rpy((plan.x, plan.y, height), (0.0, 0.0, plan.heading))
        tyre = at * _tyre_pose(plan, height)
        if plan.suspended:
            placed.append(_carriage().transformed(at * Pose((plan.arm, 0.0, 0.0))))
        placed += [_leg().transformed(at), _tyre(plan).transformed(tyre)]
        contacts.append(at.apply((plan.trail, plan.lateral + plan.radius * _sin(plan), 0.0))[:2])
    total = combine(placed)
    points = np.array([(1.0, *c) for c in contacts])
    weight = total.mass * G
    moments = np.array([weight, weight * total.com[0], weight * total.com[1]])
    loads = points @ np.linalg.lstsq(points.T @ points, moments, rcond=None)[0]
    wheels, actuators = [], []
    for i, (plan, contact, load) in enumerate(zip(plans, contacts, loads.tolist(), strict=True)):
        _add_wheel(i, plan, contact, load, height, links, joints, wheels, actuators)
    return Robot(
        name,
        namespace,
        "",
        tuple(links),
        tuple(joints),
        tuple(wheels),
        tuple(actuators),
        (),
        (),
        (),
        (),
        CalculatorChoice("general"),
        DriverSettings(50.0, 0.5, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5),
        total,
        SPAN,
    )


def _sin(plan: Plan) -> float:
    return math.sin(plan.camber)


def _tyre_pose(plan: Plan, height: float) -> Pose:
    center = (plan.trail, plan.lateral, plan.radius * math.cos(plan.camber) - height)
    return Pose.from_xyz_rpy(center, (plan.camber, 0.0, 0.0)).clean()


def _carriage() -> Inertial:
    return Inertial(1.5, (0.0, 0.02, 0.0), (0.01, 0.012, 0.013, 0.0, 0.0, 0.001))


def _leg() -> Inertial:
    return Inertial(18.0, (0.01, 0.02, -0.1), (0.5, 0.51, 0.1, 0.01, 0.0, 0.02))


def _tyre(plan: Plan) -> Inertial:
    mass = 6.0 * (plan.radius / 0.2) ** 2
    spin = mass * plan.radius**2 / 2
    across = spin / 2 + 0.01
    return Inertial(mass, (0.0, 0.0, 0.0), (across, spin, across, 0.0, 0.0, 0.0))


def _add_wheel(
    i: int,
    plan: Plan,
    contact: tuple[float, float],
    load: float,
    height: float,
    links: list[Link],
    joints: list[Joint],
    wheels: list[Wheel],
    actuators: list[Actuator],
) -> None:
    m, parent = f"w{i}", "frame_body"
    at = Pose.from_xyz_rpy((plan.x, plan.y, 0.0), (0.0, 0.0, plan.heading)).clean()
    if plan.suspended:
        sprung = load - (1.5 + 18.0 + _tyre(plan).mass) * G
        carriage = f"{m}_carriage"
        links.append(Link(carriage, m, _carriage(), (), (), SPAN))
        swings = plan.arm != 0.0
        lever = plan.arm * plan.hinge[1] if swings else 1.0  # m
        stiffness = 20000.0 * lever**2
        joints.append(
            Joint(
                f"{m}_travel",
                m,
                "revolute" if swings else "prismatic",
                parent,
                carriage,
                (at * Pose((plan.arm, 0.0, 0.0))).clean() if swings else at,
                SPAN,
                axis=plan.hinge if swings else (0.0, 0.0, 1.0),
                lower=-0.5 if swings else -0.05,
                upper=0.5 if swings else 0.05,
                effort=5000.0,
                velocity=2.0,
                damping=900.0 * lever**2,
                stiffness=stiffness,
                spring_reference=plan.sag - sprung * lever / stiffness,
                role="suspension",
            )
        )
        parent, at = carriage, Pose((-plan.arm, 0.0, 0.0))
    steered, swivel = plan.kind == "steered", plan.kind == "swivel"
    limited = steered and not plan.endless
    driven = plan.kind in ("steered", "fixed")
    arm = Visual(Cylinder(0.03, 0.3), Pose.from_xyz_rpy((0.0, 0.1, -0.2), (0.1, 0.2, 0.3)), GREY)
    links.append(Link(f"{m}_leg", m, _leg(), (arm,), (), SPAN))
    joints.append(
        Joint(
            f"{m}_turn",
            m,
            "revolute" if limited else "continuous" if steered or swivel else "fixed",
            parent,
            f"{m}_leg",
            at,
            SPAN,
            lower=plan.lowest if limited else None,
            upper=LIMIT if limited else None,
            effort=200.0 if steered else None,
            velocity=4.0 if steered else None,
            damping=0.05 if swivel else 0.0,
            armature=0.2 if steered else 0.0,
            role="steering" if steered else "swivel" if swivel else "",
        )
    )
    rubber = Collision(
        Cylinder(plan.radius, plan.width), Pose.from_xyz_rpy(rpy=(math.pi / 2, 0.0, 0.0)).clean()
    )
    hub = Visual(Cylinder(plan.radius, plan.width), rubber.pose, (0.1, 0.1, 0.1, 1.0))
    links.append(Link(f"{m}_tyre", m, _tyre(plan), (hub,), (rubber,), SPAN))
    joints.append(
        Joint(
            f"{m}_axle",
            m,
            "continuous",
            f"{m}_leg",
            f"{m}_tyre",
            _tyre_pose(plan, height),
            SPAN,
            axis=(0.0, 1.0, 0.0),
            effort=90.0 if driven else None,
            velocity=7.5 if driven else None,
            damping=0.01,
            friction=0.1 if driven else 0.0,
            armature=0.2 if driven else 0.0,
            role="propulsion" if driven else "wheel",
        )
    )
    for joint, role, limits in (
        (f"{m}_axle", "propulsion", (7.5, 7.5, 90.0)),
        (f"{m}_turn", "steering", (4.0, 20.0, 200.0)),
    ):
        if steered or (driven and role == "propulsion"):
            actuators.append(
                Actuator(
                    f"{m}_{role}",
                    m,
                    joint,
                    role,
                    42.0,
                    314.159,
                    1024,
                    *limits,
                    0.2,
                    None,
                    None,
                    SPAN,
                )
            )
    turning = steered or swivel
    wheels.append(
        Wheel(
            m,
            m,
            f"{m}_tyre",
            f"{m}_axle",
            f"{m}_turn" if steered else None,
            f"{m}_turn" if swivel else None,
            f"{m}_travel" if plan.suspended else None,
            driven,
            plan.x if turning else contact[0],
            plan.y if turning else contact[1],
            plan.heading,
            1.0,
            plan.trail if turning else 0.0,
            plan.lateral + plan.radius * _sin(plan) if turning else 0.0,
            plan.radius,
            plan.width,
            (),
            0.8,
            0.015,
            load,
            0.0,
            SPAN,
        )
    )


# -- random additions ----------------------------------------------------------------


def stl(*triangles: tuple[tuple[float, float, float], ...]) -> bytes:
    """A binary STL file."""
    out = b"\0" * 80 + struct.pack("<I", len(triangles))
    for triangle in triangles:
        out += struct.pack("<12fH", 0, 0, 0, *itertools.chain(*triangle), 0)
    return out


def mesh(name: str, size: float) -> Mesh:
    """A tetrahedron."""
    a, b, c, d = (0.0, 0.0, 0.0), (size, 0.0, 0.0), (0.0, size, 0.0), (0.0, 0.0, size)
    data = stl((a, c, b), (a, b, d), (a, d, c), (b, c, d))
    return Mesh(name, hashlib.sha256(data).hexdigest(), data)


def graft(robot: Robot, seed: int, count: int = 8) -> Robot:
    """Return the robot with ``count`` more random links on its body, as an extra adds them."""
    rng = np.random.default_rng(seed)
    meshes = (mesh("wedge.stl", 0.3), mesh("tip.stl", 0.1))
    links, joints = list(robot.links), list(robot.joints)
    parents = ["frame_body"]
    movable: list[str] = []

    def vector(scale: float) -> tuple[float, float, float]:
        x, y, z = (round(float(v), 6) for v in rng.uniform(-scale, scale, 3))
        return (x, y, z)

    def pose(scale: float) -> Pose:
        return Pose.from_xyz_rpy(vector(scale), vector(3.0)).clean()

    def color() -> tuple[float, float, float, float]:
        r, g, b, a = (round(float(v), 2) for v in rng.uniform(0, 1, 4))
        return (r, g, b, a)

    def shape() -> Box | Cylinder | Sphere | MeshShape:
        a, b, c = (round(float(v), 4) for v in rng.uniform(0.02, 0.3, 3))
        return (
            Box((a, b, c)),
            Cylinder(a, b),
            Sphere(a),
            MeshShape(meshes[int(rng.integers(2))].name, (a * 5, b * 5, c * 5)),
        )[int(rng.integers(4))]

    for i in range(count):
        kind = ("fixed", "revolute", "continuous", "prismatic")[int(rng.integers(4))]
        moving = kind != "fixed"
        inertial = None
        if moving or rng.random() < 0.6:
            # The inertia of random point masses is always physically possible.
            r = rng.normal(size=(6, 3)) * 0.1
            i3 = sum(np.dot(p, p) * np.eye(3) - np.outer(p, p) for p in r)
            values = (i3[0, 0], i3[1, 1], i3[2, 2], i3[0, 1], i3[0, 2], i3[1, 2])
            xx, yy, zz, xy, xz, yz = (float(v) for v in values)
            inertial = Inertial(
                round(float(rng.uniform(0.1, 5)), 3), vector(0.2), (xx, yy, zz, xy, xz, yz)
            ).clean()
        name = f"extra{i}_body"
        # Everything is above the ground: the new links must not carry weight.
        visuals = tuple(Visual(shape(), pose(0.2), color()) for _ in range(int(rng.integers(3))))
        shapes = tuple(Collision(shape(), pose(0.05)) for _ in range(int(rng.integers(2))))
        links.append(Link(name, f"extras.extra{i}", inertial, visuals, shapes, SPAN))
        axis = rng.normal(size=3)
        x, y, z = (float(v) for v in axis / np.linalg.norm(axis))
        limited = kind in ("revolute", "prismatic")
        lower, upper = sorted(round(float(v), 3) for v in rng.uniform(-1.5, 1.5, 2))
        parent = parents[int(rng.integers(len(parents)))]
        at = pose(0.2)
        if parent == "frame_body":
            at = Pose((at.xyz[0], at.xyz[1], at.xyz[2] + 2.0), at.quat)
        joints.append(
            Joint(
                f"extra{i}_joint",
                f"extras.extra{i}",
                kind,
                parent,
                name,
                at,
                SPAN,
                axis=(x, y, z) if moving else (0.0, 0.0, 1.0),
                lower=lower if limited else None,
                upper=upper + 0.1 if limited else None,
                effort=round(float(rng.uniform(1, 50)), 2) if limited else None,
                velocity=round(float(rng.uniform(1, 9)), 2) if limited else None,
                damping=round(float(rng.uniform(0, 2)), 3) if moving else 0.0,
                friction=round(float(rng.uniform(0, 1)), 3) if moving else 0.0,
                stiffness=900.0 if kind == "prismatic" else 0.0,
                spring_reference=0.013 if kind == "prismatic" else 0.0,
                mimic=Mimic(movable[0], 0.5, 0.1) if limited and movable and i % 2 else None,
            )
        )
        parents.append(name)
        if limited and joints[-1].mimic is None:
            movable.append(f"extra{i}_joint")
    sensors = (
        Sensor("imu", "imu", "imu", "extra0_body", (), SPAN),
        Sensor("scan", "scan", "lidar_2d", "extra1_body", (("range", 25.0),), SPAN),
        Sensor(
            "eye",
            "eye",
            "camera",
            "extra2_body",
            (("image_width", 1280), ("image_height", 720), ("horizontal_field_of_view", 1.2)),
            SPAN,
        ),
    )
    grown = dataclasses.replace(
        robot, links=tuple(links), joints=tuple(joints), sensors=sensors, meshes=meshes
    )
    return dataclasses.replace(grown, inertial=total_inertial(grown))


def total_inertial(robot: Robot) -> Inertial:
    """Return the inertia of the whole robot at joint positions 0, in ``base_link``."""
    poses = {robot.links[0].name: Pose()}
    todo = list(robot.joints)
    while todo:
        later = []
        for joint in todo:
            if joint.parent in poses:
                poses[joint.child] = poses[joint.parent] * joint.pose
            else:
                later.append(joint)
        todo = later
    bodies = [
        link.inertial.transformed(poses[link.name])
        for link in robot.links
        if link.inertial is not None
    ]
    return combine(bodies)


# -- the robots ----------------------------------------------------------------------


def square(kind: str = "steered", **more: object) -> list[Plan]:
    """Four wheels of a kind on a rectangle of 1.1 m by 0.9 m."""
    corners = [(0.55, 0.45), (0.55, -0.45), (-0.55, 0.45), (-0.55, -0.45)]
    return [Plan(x, y, kind, **more) for x, y in corners]  # type: ignore[arg-type]


def with_leaning_suspensions(robot: Robot) -> Robot:
    """Returns a robot whose suspensions move along axes that are not vertical."""
    axes = iter(((0.2, 0.1), (-0.1, 0.3), (0.3, -0.2), (-0.2, -0.1)))
    joints = []
    for joint in robot.joints:
        if joint.role == "suspension":
            x, y = next(axes)
            joint = dataclasses.replace(joint, axis=(x, y, math.sqrt(1.0 - x * x - y * y)))
        joints.append(joint)
    return dataclasses.replace(robot, joints=tuple(joints))


ROBOTS: dict[str, Robot] = {
    "square": build(square()),
    "suspended": build(square(suspended=True), body_com=(0.1, -0.05, 0.0)),
    "leaning": with_leaning_suspensions(build(square(suspended=True), body_com=(0.1, -0.05, 0.0))),
    "off_centre": build(square(), body_com=(0.2, 0.1, 0.1)),
    "trike": build([Plan(0.6, 0.0), Plan(-0.5, 0.4, "passive"), Plan(-0.5, -0.4, "passive")]),
    "casters": build(
        [
            Plan(0.3, 0.4, "fixed"),
            Plan(0.3, -0.4, "fixed"),
            Plan(-0.5, 0.3, "swivel", radius=0.125, width=0.06, trail=-0.07),
            Plan(-0.5, -0.3, "swivel", radius=0.125, width=0.06, trail=-0.07),
        ],
        body_com=(0.1, 0.0, -0.1),
    ),
    "mixed_radii": build(
        [
            Plan(0.6, 0.5, radius=0.25, suspended=True),
            Plan(0.6, -0.5, radius=0.15, suspended=True),
            Plan(0.0, 0.55, radius=0.2, suspended=True),
            Plan(-0.7, 0.4, radius=0.3, suspended=True),
            Plan(-0.6, -0.5, radius=0.2, suspended=True),
        ]
    ),
    "angled": build(
        [
            Plan(0.5, 0.5, heading=0.5),
            Plan(0.5, -0.5, heading=-0.7),
            Plan(-0.5, 0.5, heading=2.5),
            Plan(-0.5, -0.5, heading=-2.0),
        ]
    ),
    "cambered": build(
        [
            Plan(0.5, 0.5, camber=0.15),
            Plan(0.5, -0.5, camber=-0.15),
            Plan(-0.5, 0.5, camber=0.1),
            Plan(-0.5, -0.5, camber=-0.1),
        ]
    ),
    "swing_arms": build(
        [
            Plan(0.6, 0.5, suspended=True, arm=0.25, sag=0.015, hinge=(0.28, 0.96, 0.0)),
            Plan(0.55, -0.45, suspended=True, arm=-0.3, sag=-0.02, heading=0.4, endless=True),
            Plan(-0.5, 0.4, suspended=True, arm=0.2, sag=0.01, trail=0.05),
            Plan(-0.6, -0.5, "fixed", suspended=True, arm=0.35, sag=0.03, radius=0.25),
        ],
        body_com=(0.1, -0.05, 0.0),
    ),
    "endless": build(square(endless=True, trail=-0.04, lateral=0.03), body_com=(-0.1, 0.0, 0.1)),
    "turned_home": build(
        [
            Plan(0.55, 0.45, lowest=0.6, trail=0.06),
            Plan(0.55, -0.45, lowest=0.3, lateral=0.1),
            Plan(-0.55, 0.45, lowest=1.2, camber=0.1),
            Plan(-0.55, -0.45),
        ]
    ),
    "nine": build(
        [Plan(0.8 * (i - 1), 0.6 * (j - 1), suspended=True) for i in range(3) for j in range(3)]
    ),
}
SAMPLED_PLANS = sampled(sorted(ROBOTS), ["casters", "mixed_radii", "swing_arms"])


def grafted(seed: int) -> Robot:
    """Return one of the robots with a random tree on top; every third one has a name space."""
    names = sorted(ROBOTS)
    robot = graft(ROBOTS[names[seed % len(names)]], seed)
    return dataclasses.replace(robot, namespace="r1") if seed % 3 == 0 else robot
