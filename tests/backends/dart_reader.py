"""Drives a robot in DART; runs in an environment with DART, without thorvaldc.

DART is the physics engine of Gazebo; as there, ODE detects the collisions. It reads no SDF 1.9, so
that the robot is that of the URDF, which has the same masses and joints, with the given tyres.

Input: a JSON list of jobs. Output: a JSON list of yaw angles in rad and distances in m.
"""

from __future__ import annotations

import json
import math
import sys
from typing import Any

import dartpy
import numpy as np

STEP = 0.001  # s, that of the worlds
REST, RAMP = 0.3, 0.5  # s
FRICTION = 0.8


def ground() -> Any:
    skeleton = dartpy.dynamics.Skeleton("ground")
    joint, body = skeleton.createWeldJointAndBodyNodePair()
    shape = body.createShapeNode(dartpy.dynamics.BoxShape([100.0, 100.0, 1.0]))
    shape.createCollisionAspect()
    shape.createDynamicsAspect().setFrictionCoeff(1.0)
    below = dartpy.math.Isometry3()
    below.set_translation([0.0, 0.0, -0.5])
    joint.setTransformFromParentBodyNode(below)
    return skeleton


def replace_tyres(robot: Any, spheres: dict[str, float]) -> None:
    """Gives the links their spheres (radius in m, centred); only tyres collide."""
    for i in range(robot.getNumBodyNodes()):
        body = robot.getBodyNode(i)
        for shape in [body.getShapeNode(k) for k in range(body.getNumShapeNodes())]:
            if shape.getCollisionAspect() is None:
                continue
            if "tyre" not in body.getName():
                shape.removeCollisionAspect()
                continue
            if body.getName() in spheres:
                shape.setShape(dartpy.dynamics.SphereShape(spheres[body.getName()]))
            shape.getDynamicsAspect().setFrictionCoeff(FRICTION)


def drive(
    urdf: str,
    spheres: dict[str, float],
    springs: dict[str, tuple[float, float]],
    wheels: list[dict[str, Any]],
    seconds: float,
) -> tuple[float, float]:
    """Returns how far the robot turns and comes after a ramp.

    ``springs`` has stiffness and rest position of joints, ``wheels`` is as for Drake."""
    robot = dartpy.utils.DartLoader().parseSkeleton(urdf)
    world = dartpy.simulation.World()
    world.setTimeStep(STEP)
    world.setGravity([0.0, 0.0, -9.81])
    world.getConstraintSolver().setCollisionDetector(dartpy.collision.OdeCollisionDetector())
    replace_tyres(robot, spheres)
    robot.disableSelfCollisionCheck()
    for name, (stiffness, rest) in springs.items():
        robot.getJoint(name).setSpringStiffness(0, stiffness)
        robot.getJoint(name).setRestPosition(0, rest)
    world.addSkeleton(ground())
    world.addSkeleton(robot)
    drives = [(robot.getJoint(wheel["drive"]), wheel["speed"]) for wheel in wheels]
    steering = [robot.getJoint(wheel["steering"]) for wheel in wheels if wheel["steering"]]
    for joint, wheel in zip(steering, wheels, strict=True):
        joint.setPosition(0, wheel["angle"])
    for joint in (*steering, *(joint for joint, _ in drives)):
        joint.setActuatorType(dartpy.dynamics.ActuatorType.VELOCITY)
    base = robot.getRootBodyNode()

    def pose() -> tuple[Any, float]:
        matrix = base.getWorldTransform().matrix()
        return matrix[:2, 3].copy(), math.atan2(matrix[1, 0], matrix[0, 0])

    def step(share: float) -> None:
        for joint in steering:
            joint.setCommand(0, 0.0)
        for joint, speed in drives:
            joint.setCommand(0, share * speed)
        world.step()

    for _ in range(round(REST / STEP)):
        step(0.0)
    count = round(RAMP / STEP)
    for i in range(count):
        step((i + 1) / count)
    start, last = pose()
    turned = 0.0
    for _ in range(round(seconds / STEP)):
        step(1.0)
        _, now = pose()
        turned += math.remainder(now - last, math.tau)
        last = now
    return turned, float(np.hypot(*(pose()[0] - start)))


def main() -> None:
    json.dump([drive(**job) for job in json.load(sys.stdin)], sys.stdout)


if __name__ == "__main__":
    main()
