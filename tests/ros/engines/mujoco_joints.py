"""The joints of a MuJoCo scene, which its actuators move."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
from nav_msgs.msg import Odometry

from tests.ros.engines.joint_engine import Motions, fail

VELOCITY, POSITION = "velocity", "position"


class MujocoJoints:
    """A scene in MuJoCo.  It runs with a whole number of steps for each cycle.

    ``rate`` (Hz) is the rate of the cycles; the time step of the scene becomes at most a little
    shorter.  ``keyframe`` is the start of the robot.
    """

    has_clock = True

    def __init__(self, scene: Path, rate: float, keyframe: str | None = None) -> None:
        try:
            self.model = mujoco.MjModel.from_xml_path(str(scene))
        except ValueError as error:
            fail(f"{scene}: {str(error).splitlines()[0]}")
        steps = math.ceil(1.0 / (rate * self.model.opt.timestep) - 1e-9)
        self.model.opt.timestep = 1.0 / (rate * steps)
        self.data = mujoco.MjData(self.model)
        self._keyframe = self._number_of(keyframe)
        kinds = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
        joints = [j for j in range(self.model.njnt) if int(self.model.jnt_type[j]) in kinds]
        self.names = [self.model.joint(j).name for j in joints]
        self._places = self.model.jnt_qposadr[joints], self.model.jnt_dofadr[joints]
        limited = [bool(self.model.jnt_limited[j]) for j in joints]
        self.unlimited = {n for n, has in zip(self.names, limited, strict=True) if not has}
        roots = np.flatnonzero(self.model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE))
        self._root = int(roots[0]) if len(roots) else None
        self.inputs = self._find_inputs()
        self.reset()

    def _number_of(self, keyframe: str | None) -> int | None:
        if keyframe is None:
            return 0 if self.model.nkey else None
        number = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_KEY, keyframe)
        return number if number >= 0 else fail(f"the scene has no keyframe {keyframe!r}")

    def _find_inputs(self) -> dict[tuple[str, str], int]:
        """Returns the actuator of each joint and interface ("velocity" or "position").

        MuJoCo's ``position`` has a stiffness in its bias, ``velocity`` only a damping, and
        ``intvelocity`` integrates the commanded speed.
        """
        found = {}
        for number in range(self.model.nu):
            if self.model.actuator_trntype[number] != int(mujoco.mjtTrn.mjTRN_JOINT):
                continue
            joint = self.model.joint(self.model.actuator_trnid[number][0]).name
            stiffness, damping = self.model.actuator_biasprm[number][1:3]
            if self.model.actuator_dyntype[number] == int(mujoco.mjtDyn.mjDYN_INTEGRATOR):
                found[joint, VELOCITY] = number
            elif stiffness:
                found[joint, POSITION] = number
            elif damping:
                found[joint, VELOCITY] = number
        return found

    @property
    def time_ns(self) -> int:
        return round(self.data.time * 1e9)

    def advance(self, time_ns: int) -> None:
        while self.data.time + 0.5 * self.model.opt.timestep < time_ns * 1e-9:
            mujoco.mj_step(self.model, self.data)
        mujoco.mj_forward(self.model, self.data)

    def reset(self) -> None:
        """Time 0 and the start of the robot; the commands stay."""
        commands = self.data.ctrl.copy()
        if self._keyframe is None:
            mujoco.mj_resetData(self.model, self.data)
        else:
            mujoco.mj_resetDataKeyframe(self.model, self.data, self._keyframe)
            self.data.time = 0.0
        self.data.ctrl[:] = commands
        mujoco.mj_forward(self.model, self.data)

    def command(self, joint: str, interface: str, value: float) -> None:
        """Commands an angle (rad), a speed (rad/s), or those of a slider (m, m/s)."""
        self.data.ctrl[self.inputs[joint, interface]] = value

    def motions(self) -> Motions:
        positions, dofs = self._places
        values = zip(self.data.qpos[positions], self.data.qvel[dofs], strict=True)
        return {n: (float(q), float(v)) for n, (q, v) in zip(self.names, values, strict=True)}

    def truth(self, message: Odometry) -> bool:
        if self._root is None:
            return False
        position = self.data.qpos[self.model.jnt_qposadr[self._root] :][:7]
        speed = self.data.qvel[self.model.jnt_dofadr[self._root] :][:6]
        message.header.frame_id = "world"
        message.child_frame_id = self.model.body(self.model.jnt_bodyid[self._root]).name
        pose, twist = message.pose.pose, message.twist.twist
        pose.position.x, pose.position.y, pose.position.z = map(float, position[:3])
        o = pose.orientation
        o.w, o.x, o.y, o.z = map(float, position[3:])  # wxyz in MuJoCo
        # A free joint's linear velocity is in the world, its angular velocity in the body.
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, position[3:])
        linear = rotation.reshape(3, 3).T @ speed[:3]
        twist.linear.x, twist.linear.y, twist.linear.z = map(float, linear)
        twist.angular.x, twist.angular.y, twist.angular.z = map(float, speed[3:])
        return True
