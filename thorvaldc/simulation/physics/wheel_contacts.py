"""The forces and the slip of the wheels in a MuJoCo scene, for experiments."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from thorvaldc.model import Robot
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene


class WheelContact(NamedTuple):
    """Force and slip of a wheel at the last step of the physics, in the frame of the wheel.

    The x axis of the frame is the rolling direction of the base calculator on the ground, y is
    along the spin axis to the left, and z upwards.

    * ``force``: force on the wheel (N); its z component is the wheel load.
    * ``slip``: velocity (m/s) with which the lowest point of the wheel slides along x and y.
    """

    name: str
    force: tuple[float, float, float]
    slip: tuple[float, float]


def wheel_contacts(robot: Robot, scene: MujocoScene) -> tuple[WheelContact, ...]:
    """Returns the force and the slip of each wheel of a robot, in the order of ``Robot.wheels``."""
    model, data = scene.model, scene.data
    forces: dict[int, NDArray[np.float64]] = {}
    wrench = np.zeros(6)
    for number in range(data.ncon):
        contact = data.contact[number]
        mujoco.mj_contactForce(model, data, number, wrench)
        force = contact.frame.reshape(3, 3).T @ wrench[:3]  # of the first geom on the second one
        for geom, sign in ((contact.geom1, -1.0), (contact.geom2, 1.0)):
            body = int(model.geom_bodyid[geom])
            forces[body] = forces.get(body, np.zeros(3)) + sign * force
    contacts = []
    base = scene.index("body", robot.prefix + robot.links[0].name, robot)
    geometry = BaseGeometry.from_robot(robot).wheels
    for number, wheel in enumerate(robot.wheels):
        joint = scene.index("joint", robot.prefix + wheel.spin_joint, robot)
        # MuJoCo may have fused the wheel link into another body, which its joint names.
        body = int(model.jnt_bodyid[joint])
        turning, angle = wheel.steering_joint or wheel.swivel_joint, 0.0
        if turning is not None:
            turned = scene.index("joint", robot.prefix + turning, robot)
            angle = float(data.qpos[model.jnt_qposadr[turned]])
        c, s, _ = geometry[number].rows(angle)[0]
        rolling = data.xmat[base].reshape(3, 3) @ (c, s, 0.0)
        ahead = np.cross(data.xaxis[joint], (0.0, 0.0, 1.0))
        ahead *= np.sign(ahead @ rolling) / np.linalg.norm(ahead)
        left = data.xaxis[joint] * np.sign(np.cross((0.0, 0.0, 1.0), ahead) @ data.xaxis[joint])
        up = np.cross(ahead, left)
        motion = np.zeros(6)  # rotation, velocity of the origin of the body
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, motion, 0)
        lowest = data.xanchor[joint] - wheel.radius * up
        velocity = motion[3:] + np.cross(motion[:3], lowest - data.xpos[body])
        force = forces.get(body, np.zeros(3))
        contacts.append(
            WheelContact(
                wheel.name,
                (float(force @ ahead), float(force @ left), float(force @ up)),
                (float(velocity @ ahead), float(velocity @ left)),
            )
        )
    return tuple(contacts)
