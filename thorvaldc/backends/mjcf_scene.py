"""What a MuJoCo scene has besides its robots: ground, sky, light, the key frame ``home``."""

from __future__ import annotations

import math
from collections.abc import Iterable

from thorvaldc.backends.stance import Rest
from thorvaldc.backends.tree import Tree
from thorvaldc.backends.xml_writer import Element
from thorvaldc.model import Pose, Robot, Vec3
from thorvaldc.model.spatial import clean


def _reach(robots: Iterable[Robot], poses: Iterable[Pose]) -> tuple[Vec3, float]:
    """Middle of the robots (m) and the radius about it that holds their wheels."""
    points = []
    for robot, pose in zip(robots, poses, strict=True):
        points.append(pose.apply(robot.inertial.com))
        points += [pose.apply((wheel.x, wheel.y, 0.0)) for wheel in robot.wheels]
    low = [min(p[i] for p in points) for i in range(3)]
    high = [max(p[i] for p in points) for i in range(3)]
    x, y, z = (clean((a + b) / 2) for a, b in zip(low, high, strict=True))
    return (x, y, z), max(1.0, round(math.dist(low, high) / 2, 3))


def add_surroundings(scene: Element, robots: list[Robot], poses: list[Pose]) -> None:
    middle, reach = _reach(robots, poses)
    scene.add("statistic", center=middle, extent=reach)
    visual = scene.add("visual")
    visual.add(
        "headlight", ambient=(0.3, 0.3, 0.3), diffuse=(0.5, 0.5, 0.5), specular=(0.1, 0.1, 0.1)
    )
    # "global" is how MuJoCo calls it; the offscreen buffer is what renderings need.
    visual.add("global", azimuth=140, elevation=-20, offwidth=1920, offheight=1080)
    visual.add("rgba", haze=(0.62, 0.72, 0.82, 1))
    asset = scene.add("asset")
    asset.add(
        "texture",
        name="sky",
        type="skybox",
        builtin="gradient",
        rgb1=(0.45, 0.6, 0.8),
        rgb2=(0.9, 0.94, 0.97),
        width=256,
        height=1536,
    )
    asset.add(
        "texture",
        name="ground",
        type="2d",
        builtin="checker",
        mark="edge",
        rgb1=(0.42, 0.44, 0.38),
        rgb2=(0.38, 0.4, 0.34),
        markrgb=(0.5, 0.52, 0.46),
        width=512,
        height=512,
    )
    asset.add("material", name="ground", texture="ground", texuniform=True, texrepeat=(1, 1))
    world = scene.add("worldbody")
    world.add(
        "light",
        name="sun",
        type="directional",
        pos=(middle[0], middle[1], 10),
        dir=(-0.3, 0.25, -1),
        diffuse=(0.6, 0.6, 0.6),
    )
    # Level: the robots are settled on it.  A plane, not a box, which rolls best.
    world.add("geom", name="ground", type="plane", size=(0, 0, 1), material="ground")


def add_home(scene: Element, trees: list[Tree], settled: list[Rest], poses: list[Pose]) -> None:
    """The key frame in which every robot stands still, with its servos at their targets."""
    qpos: list[float] = []
    ctrl: list[float] = []
    act: list[float] = []
    for tree, stance, pose in zip(trees, settled, poses, strict=True):
        base = (pose * stance.base).clean()
        qpos += [*base.xyz, *base.quat]
        qpos += [stance.positions[joint.name] for joint in tree.moving]
        for actuator in tree.robot.actuators:
            position = stance.positions[actuator.joint]
            if actuator.role == "steering":
                ctrl.append(position)
            else:
                ctrl.append(0.0)
                act.append(position)
    key = scene.add("keyframe").add("key", name="home", qpos=tuple(qpos))
    key.set(ctrl=tuple(ctrl) if ctrl else None, act=tuple(act) if act else None)
