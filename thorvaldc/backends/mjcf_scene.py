"""The parts of a MuJoCo scene around its robots: ground, sky, light and key frame ``home``."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from thorvaldc.backends.mjcf_world import lowest
from thorvaldc.backends.xml_writer import Element
from thorvaldc.model import Pose, Robot, Vec3, World
from thorvaldc.model.spatial import clean
from thorvaldc.model.statics.joint_tree import JointTree
from thorvaldc.model.statics.standing_pose import Statics


def _reach(robots: Iterable[Robot], poses: Iterable[Pose]) -> tuple[Vec3, float]:
    """Return the centre of the robots, and the radius of a sphere around all their wheels, in m."""
    points = []
    for robot, pose in zip(robots, poses, strict=True):
        points.append(pose.apply(robot.inertial.com))
        points += [pose.apply((wheel.x, wheel.y, 0.0)) for wheel in robot.wheels]
    low = [min(p[i] for p in points) for i in range(3)]
    high = [max(p[i] for p in points) for i in range(3)]
    x, y, z = (clean((a + b) / 2) for a, b in zip(low, high, strict=True))
    return (x, y, z), max(1.0, round(math.dist(low, high) / 2, 3))


def add_surroundings(
    scene: Element, robots: list[Robot], poses: list[Pose], world: World | None = None
) -> None:
    """Add the ground, the sky, the light and the camera settings to a MuJoCo scene."""
    middle, reach = _reach(robots, poses)
    # In MuJoCo's viewer, the camera starts at a distance of 1.5 times ``extent`` from the centre of
    # the scene. The shadows in MuJoCo's viewer have a range of one ``extent``.
    scene.add("statistic", center=middle, extent=clean(2.0 * reach))
    visual = scene.add("visual")
    visual.add(
        "headlight",
        ambient=(0.35, 0.35, 0.36),
        diffuse=(0.25, 0.25, 0.25),
        specular=(0.1, 0.1, 0.1),
    )
    visual.add("global", azimuth=140, elevation=-20, offwidth=1920, offheight=1080)
    visual.add("quality", shadowsize=4096)
    visual.add("map", shadowclip=1.5, shadowscale=0.9)
    visual.add("rgba", haze=(0.9, 0.92, 0.94, 1))
    asset = scene.add("asset")
    asset.add(
        "texture",
        name="sky",
        type="skybox",
        builtin="gradient",
        rgb1=(0.72, 0.82, 0.92),
        rgb2=(0.9, 0.92, 0.94),
        width=256,
        height=1536,
    )
    asset.add(
        "texture",
        name="ground",
        type="2d",
        builtin="checker",
        mark="edge",
        rgb1=(0.78, 0.79, 0.75),
        rgb2=(0.74, 0.75, 0.71),
        markrgb=(0.66, 0.67, 0.63),
        width=512,
        height=512,
    )
    asset.add("material", name="ground", texture="ground", texuniform=True, texrepeat=(1, 1))
    body = scene.add("worldbody")
    direction = (-0.35, 0.3, -1.0)
    back = -2.5 * reach
    body.add(
        "light",
        name="sun",
        type="directional",
        pos=tuple(clean(m + back * d) for m, d in zip(middle, direction, strict=True)),
        dir=direction,
        diffuse=(0.6, 0.59, 0.56),
        specular=(0.2, 0.2, 0.2),
    )
    # The ground is level, because the standing pose of the robots is computed for level ground.
    # The ground is a MuJoCo plane and not a box, because wheels roll most smoothly on a plane.
    below = lowest(world.ground) if world is not None else 0.0
    body.add(
        "geom",
        name="ground",
        type="plane",
        pos=(0, 0, below) if below else None,
        size=(0, 0, 1),
        material="ground",
    )


def add_home(
    scene: Element,
    robots: Sequence[Robot],
    trees: Sequence[JointTree],
    statics: Sequence[Statics],
    poses: Sequence[Pose],
    *,
    velocity_servos: bool = False,
) -> None:
    """Add the MuJoCo key frame ``home``, in which every robot stands still.

    In the key frame ``home``, every servo holds its joint at the position of the standing pose.
    ``velocity_servos`` is that of ``RobotWriter``: such servos have no state.
    """
    qpos: list[float] = []
    ctrl: list[float] = []
    act: list[float] = []
    for robot, tree, standing, pose in zip(robots, trees, statics, poses, strict=True):
        base = (pose * standing.base).clean()
        qpos += [*base.xyz, *base.quat]
        qpos += [standing.positions[joint.name] for joint in tree.moving]
        for actuator in robot.actuators:
            position = standing.positions[actuator.joint]
            if actuator.role == "steering":
                ctrl.append(position)
            else:
                ctrl.append(0.0)
                act.append(position)
        for servo in robot.joint_servos:
            position = standing.positions[servo.joint]
            ctrl.append(position if servo.interface == "position" else 0.0)
            act += [position] if servo.interface == "velocity" else []
    key = scene.add("keyframe").add("key", name="home", qpos=tuple(qpos))
    has_state = act and not velocity_servos
    key.set(ctrl=tuple(ctrl) if ctrl else None, act=tuple(act) if has_state else None)
