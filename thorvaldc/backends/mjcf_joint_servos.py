"""Servos on the joints of extras, such as arms and grippers, in MJCF.

A URDF states neither the gains of the controllers nor the inertia of the motors.  The gains
therefore follow from the effort limit of the joint and the inertia I that it carries:

- Stiffness: kp = effort / DEFLECTION.  Under its own weight, an arm sags by the share of the effort
  limit that the weight needs, times DEFLECTION.  The arms of MuJoCo Menagerie, whose gains were
  chosen by hand, have 0.006 rad (Franka) to 0.075 rad (UR5e).  Without an effort limit,
  kp = I w^2 with w = FREQUENCY.
- Damping: kv = 2 sqrt(kp I), which is critical for the joint alone, and at least kp LAG.  With the
  implicit integrator and the time step h, a servo is stable for any inertia if kv > kp h / 2:
  the last joints of arms carry much less inertia than their torque can hold.
"""

from __future__ import annotations

import math

from thorvaldc.backends.mjcf_sections import TIMESTEP
from thorvaldc.model import Joint
from thorvaldc.model.spatial import clean

DEFLECTION = 0.02  # rad, position error at which a servo applies the effort limit
LINEAR_DEFLECTION = 0.002  # m, the same for a prismatic joint
FREQUENCY = 20.0  # rad/s, natural frequency of a joint without an effort limit
LAG = 4 * TIMESTEP  # s, least ratio of damping and stiffness


def servo_gains(joint: Joint, inertia: float) -> tuple[float, float]:
    """Return stiffness and damping of the servo of a joint, in N m/rad or N/m and the same times s.

    - ``inertia``: inertia that the joint carries, in kg m^2 or kg.
    """
    deflection = LINEAR_DEFLECTION if joint.type == "prismatic" else DEFLECTION
    stiffness = joint.effort / deflection if joint.effort else inertia * FREQUENCY**2
    damping = max(2.0 * math.sqrt(stiffness * inertia), stiffness * LAG)
    return clean(stiffness), clean(damping)
