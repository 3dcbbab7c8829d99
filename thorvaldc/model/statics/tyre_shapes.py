"""The collision shapes of a tyre: one for each kind of physics engine.

The data of a tyre are in ``Wheel``: radius, width, friction, and the rings (``treads``) that roll
on rails. No shape rolls correctly in every engine:

- The cylinder of the tyre is the first collision shape of the wheel's link. It is the true shape,
  for tools that check distances, and is in the URDF.
- A soft contact (MuJoCo) needs an ellipsoid that is enlarged by half of the penetration, see
  ``wheel_contact.contact_ellipsoid``.
- A rigid contact (DART, the engine of Gazebo) needs a sphere, see ``rigid_contact_shapes``.
"""

from __future__ import annotations

from thorvaldc.model.robot import Collision, Cylinder, Sphere, Wheel
from thorvaldc.model.spatial import Pose, quat_from_z_to
from thorvaldc.model.statics.joint_tree import JointTree
from thorvaldc.model.statics.standing_pose import spin_axis
from thorvaldc.model.statics.wheel_contact import rolling_sphere


def rigid_contact_shapes(tree: JointTree, wheel: Wheel) -> tuple[Collision, ...]:
    """Return the shapes of a wheel for rigid contacts, in the link frame of the wheel.

    The first one is the sphere of the tyre, whose lowest point lies on the rolling circle when
    every joint is at position 0. A cylinder has two contact points in DART and rolls on one of its
    edges: a robot with steered wheels 0.16 m wide turns on the spot by 8 % too slowly or 14 % too
    fast, which depends on the version. The others are the cylinders of the rings that roll on
    rails.
    """
    axis = spin_axis(tree, wheel)
    tilt = tree.pose[wheel.link].rotate(axis)[2]
    sphere = rolling_sphere(wheel.radius, axis, tilt)
    turned = quat_from_z_to(axis)
    rings = (
        Collision(Cylinder(wheel.radius_named(t.name), t.width), Pose(t.center, turned))
        for t in wheel.treads
    )
    return (Collision(Sphere(sphere.radius), Pose(sphere.center)), *rings)
