"""The hardware of a module: elements of the model in the frame of the module.

Links, joints and motors have the names of the module document, no module and the spans of that
document.  ``RobotParts`` places them in a robot: with the name of the module as a prefix, the path
of the module, and its span in the robot file.
"""

from __future__ import annotations

from typing import NamedTuple

from thorvaldc.model import Actuator, Battery, Joint, Link, Mesh, Pose, Sensor, SourcedMass, Wheel
from thorvaldc.model.module import NOT_STATED, Purchase


class Hardware(NamedTuple):
    """Links, joints, motors and devices of a module for given parameter values.

    - ``masses``: masses of the parts of all links, in the order of the module document.
    - ``joints``, ``motors``: effort and velocity of a joint with a motor are the lower of the two
      limits.
    - ``wheel``: wheel with its size; ``make_wheels`` computes its place in the robot.
    - ``battery``: its ``node`` is ``None`` if the enclosure is empty.
    - ``mount_pose``: pose in the first link's frame where the module is mounted.
    """

    links: tuple[Link, ...] = ()
    masses: tuple[SourcedMass, ...] = ()
    joints: tuple[Joint, ...] = ()
    motors: tuple[Actuator, ...] = ()
    wheel: Wheel | None = None
    sensor: Sensor | None = None
    battery: Battery | None = None
    mount_pose: Pose = Pose()
    meshes: tuple[Mesh, ...] = ()
    height_above_ground: float | None = None
    purchase: Purchase = NOT_STATED
