"""The base of a robot that MuJoCo simulates."""

from __future__ import annotations

import math
from typing import Final

from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.model import Robot
from thorvaldc.runtime.base_interface import JointCommands, JointStates
from thorvaldc.runtime.se2 import Pose2, Twist
from thorvaldc.simulation.physics.drive_servos import DriveServos, MotorsWithoutPower
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene
from thorvaldc.simulation.physics.sim_base import GroundTruth, SimulatedJoints, WheelErrors

LONGEST_STEP: Final = 0.2
"""Largest time (s) between two commands for which ``write`` adds the feed-forward term."""


class MujocoBase(SimulatedJoints, GroundTruth):
    """The joints and the true motion of one robot in a MuJoCo scene.

    Wheel errors: the MuJoCo scene contains the wheels without wheel errors.  The base applies the
    wheel errors to the joint commands and the joint readings of the driver.  A wheel with the true
    radius ratio * R, where R is the radius in the model, rolls ratio * R * w at the wheel speed w.
    A wheel with the radius R of the model rolls the same distance at the wheel speed ratio * w.
    The base thus multiplies a commanded wheel speed by the radius ratio, and divides a measured
    wheel speed by the radius ratio.

    Open loop: with ``open_loop`` the drive motors apply a voltage without speed control.  The
    torque of a DC motor at constant voltage falls linearly from the stall torque to zero at the
    no-load speed.  The simulation takes the commanded speed u as the no-load speed::

        torque = k (u - w),  k = max_torque / max_speed

    If two wheels work against each other, the torque of the drive motors lets both wheels follow
    the motion of the robot.

    - ``is_noisy``: whether the joint readings have sensor noise.
    - ``positions``, ``velocities``: views of the MuJoCo arrays ``qpos`` and ``qvel`` from the free
      joint of the robot to the last joint of a wheel.
    - ``spin_joints``, ``steering_joints``: (wheel, index in ``positions``, index in
      ``velocities``) of each joint.
    """

    is_noisy = False

    def __init__(
        self,
        robot: Robot,
        scene: MujocoScene,
        prefix: str | None = None,
        *,
        wheel_errors: WheelErrors | None = None,
        open_loop: bool = False,
    ) -> None:
        """Finds the joints, actuators and bodies of the robot in the scene.

        The names of the joints, actuators and bodies begin with ``prefix``.  By default, ``prefix``
        is the name space of the robot and a slash.  Raises ``DiagnosticError`` if the scene does
        not contain the robot.
        """
        if prefix is None:
            prefix = robot.prefix
        self.robot = robot
        self.scene = scene
        model = scene.model
        self._n = len(robot.wheels)
        wheel_errors = wheel_errors or WheelErrors.none(robot)
        self._ratios, self._offsets = wheel_errors.radius_ratios, wheel_errors.steering_offsets
        body = scene.index("body", prefix + robot.links[0].name, robot)
        free = int(model.body_jntadr[body])
        if free < 0 or int(model.body_dofnum[body]) != 6:
            raise DiagnosticError(
                "simulation-scene",
                f"the body `{prefix + robot.links[0].name}` of the scene has no free joint",
                robot.span,
            )
        self._base = int(model.jnt_qposadr[free])
        self._base_velocity = int(model.jnt_dofadr[free])
        # Each motor is a tuple of the wheel index and the actuator index.
        self.spin_joints: list[tuple[int, int, int]] = []
        self.steering_joints: list[tuple[int, int, int]] = []
        self._drive_motors: list[tuple[int, int]] = []
        self._steering_motors: list[tuple[int, int]] = []
        for i, wheel in enumerate(robot.wheels):
            for name, joints, motors in (
                (wheel.spin_joint, self.spin_joints, self._drive_motors),
                (wheel.steering_joint, self.steering_joints, self._steering_motors),
            ):
                if name is None:
                    continue
                joint = scene.index("joint", prefix + name, robot)
                q, v = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
                joints.append((i, q - self._base, v - self._base_velocity))
                actuator = robot.actuator_of(name)
                if actuator is not None:
                    index = scene.index("actuator", prefix + actuator.name, robot)
                    motors.append((i, index))
        all_joints = self.spin_joints + self.steering_joints
        last_q = max((q for _, q, _ in all_joints), default=6)
        last_v = max((v for _, _, v in all_joints), default=5)
        # Views of the MuJoCo arrays of the scene.  Creating a view of a MuJoCo array takes four
        # times as long as copying the values of the view.  MuJoCo never moves the arrays of a
        # scene.
        data, base, base_velocity = scene.data, self._base, self._base_velocity
        self.positions = data.qpos[base : base + last_q + 1]
        self.velocities = data.qvel[base_velocity : base_velocity + last_v + 1]
        self._base_qpos = data.qpos[base : base + 7]
        self._ctrl = data.ctrl
        self._voltages: list[tuple[int, int, float]] = []
        if open_loop:
            self._open_speed_loops()
        self.servos = DriveServos(model, data, (motor for _, motor in self._drive_motors))
        # (wheel, actuator, lag of the servo in s) of each motor; see `write`.
        self._drives = tuple((i, m, self._lag(m)) for i, m in self._drive_motors)
        self._steerings = tuple((i, m, self._lag(m)) for i, m in self._steering_motors)
        self._last_commands: JointCommands | None = None
        self._last_time = 0.0
        self._without_power = MotorsWithoutPower(
            scene,
            [
                (i, steering, motor, self._base + q, self._base_velocity + v)
                for steering, motors, joints in (
                    (False, self._drive_motors, self.spin_joints),
                    (True, self._steering_motors, self.steering_joints),
                )
                for i, motor in motors
                for wheel, q, v in joints
                if wheel == i
            ],
            robot,
        )

    def change_scene(self, now: float) -> None:
        """Makes the changes of the scene that hold until it has advanced to the time ``now`` (s).

        ``read`` calls it; a batch does so before, to advance many scenes at once.
        """

    def read(self, now: float) -> JointStates:
        self.change_scene(now)
        self._without_power.advance(now)
        self.servos.limit()
        ratios, offsets = self._ratios, self._offsets
        # Reading a single number from a list is several times faster than from a numpy array.
        qpos: list[float] = self.positions.tolist()
        qvel: list[float] = self.velocities.tolist()
        speeds, positions = [0.0] * self._n, [0.0] * self._n
        angles, rates = [0.0] * self._n, [0.0] * self._n
        for i, q, v in self.spin_joints:
            positions[i] = qpos[q] / ratios[i]
            speeds[i] = qvel[v] / ratios[i]
        for i, q, v in self.steering_joints:
            angles[i] = qpos[q] - offsets[i]
            rates[i] = qvel[v]
        return JointStates(self.scene.time, speeds, angles, rates, positions)

    def write(self, commands: JointCommands, now: float) -> None:
        """Sets the set points of the servos and adds a feed-forward term.

        A servo applies the torque::

            torque = kp (s - q) - kv q'

        Here q is the joint position and s is the position set point.  For a drive, s is the
        integral of the commanded speed.  While the set point s changes at the constant rate s',
        the joint follows at the same rate with the position q = s - (kv/kp) s'.  The joint lags
        behind the set point by the time kv/kp.  The feed-forward term (kv/kp) s' on the set point
        removes the lag.  The input of a drive servo is the speed s', so that the feed-forward term
        of a drive is (kv/kp) s''.

        Real motor controllers use the same feed-forward.  Without feed-forward, the drives lag by
        0.1 s and the steering lags by 0.02 s.  While a robot turns into a curve, the wheel speeds
        would then be later than the steering angles.
        """
        ctrl = self._ctrl
        speeds, angles, ratios, offsets = (
            commands.speeds,
            commands.angles,
            self._ratios,
            self._offsets,
        )
        last, dt = self._last_commands, now - self._last_time
        self._last_commands, self._last_time = commands, now
        if last is None or not 0.0 < dt <= LONGEST_STEP:
            last, dt = commands, 1.0  # no feed-forward
        last_speeds, last_angles = last.speeds, last.angles
        for i, motor, lag in self._drives:
            v = speeds[i]
            ctrl[motor] = (v + lag / dt * (v - last_speeds[i])) * ratios[i]
        for i, motor, lag in self._steerings:
            a = angles[i]
            ctrl[motor] = a + lag / dt * (a - last_angles[i]) + offsets[i]
        for i, joint, slope in self._voltages:
            on = not self._without_power.is_off(i, False)
            self.scene.data.qfrc_applied[joint] = on * slope * commands.speeds[i] * self._ratios[i]

    def switch_motor(self, wheel: int, steering: bool, on: bool, now: float) -> None:
        self._without_power.switch(wheel, steering, on, now)
        for i, joint, _ in self._voltages:
            if i == wheel and not steering:
                self.scene.data.qfrc_applied[joint] = 0.0  # until the next command

    def expect_single_commands(self) -> None:
        """Disables the servo feed-forward, because the time between joint commands is unknown."""
        self._drives = tuple((i, motor, 0.0) for i, motor, _ in self._drives)
        self._steerings = tuple((i, motor, 0.0) for i, motor, _ in self._steerings)

    def _lag(self, motor: int) -> float:
        """Returns the time (s) by which the servo of a motor lags behind the position set point."""
        _, stiffness, damping = self.scene.model.actuator_biasprm[motor, :3].tolist()
        return damping / stiffness if stiffness else 0.0

    def _open_speed_loops(self) -> None:
        """Replaces the speed control of the drives by the characteristic of a DC motor.

        Each drive servo becomes a damper with the torque -k w.  The method ``write`` adds the
        torque k u of the commanded speed u.
        """
        model = self.scene.model
        joints = {i: v for i, _, v in self.spin_joints}
        for i, motor in self._drive_motors:
            actuator = self.robot.actuator_of(self.robot.wheels[i].spin_joint)
            if actuator is None:
                continue
            slope = actuator.max_torque / actuator.max_velocity
            model.actuator_gainprm[motor] = 0.0
            model.actuator_biasprm[motor] = 0.0
            model.actuator_biasprm[motor, 2] = -slope
            self._voltages.append((i, self._base_velocity + joints[i], slope))

    # -- ground truth -----------------------------------------------------------------

    def true_pose(self) -> Pose2:
        """Returns the planar pose of ``base_link`` in the world frame, with yaw in -pi..pi."""
        x, y, _, w, i, j, k = self._base_position()
        yaw = math.atan2(2.0 * (w * k + i * j), 1.0 - 2.0 * (j * j + k * k))
        return Pose2(x, y, yaw)

    def place(self, pose: Pose2) -> None:
        """Moves the robot to the planar pose ``pose``.

        The height, roll, pitch and velocities of the robot do not change.  The robot is rotated
        about the vertical axis by the difference between the two yaw angles.
        """
        data, start = self.scene.data, self._base
        w, i, j, k = data.qpos[start + 3 : start + 7].tolist()
        turn = (pose.yaw - self.true_pose().yaw) / 2.0
        c, s = math.cos(turn), math.sin(turn)
        turned = (c * w - s * k, c * i - s * j, c * j + s * i, c * k + s * w)
        data.qpos[start : start + 2] = pose[:2]
        data.qpos[start + 3 : start + 7] = turned
        self.scene.forward()

    def true_twist(self) -> Twist:
        v = self.scene.data.qvel[self._base_velocity : self._base_velocity + 6].tolist()
        yaw = self.true_pose().yaw
        c, s = math.cos(yaw), math.sin(yaw)
        return Twist(c * v[0] + s * v[1], c * v[1] - s * v[0], v[5])

    def posture(self) -> tuple[float, float, float]:
        _, _, z, w, i, j, k = self._base_position()
        roll = math.atan2(2.0 * (w * i + j * k), 1.0 - 2.0 * (i * i + j * j))
        return z, roll, math.asin(min(max(2.0 * (w * j - k * i), -1.0), 1.0))

    def uprightness(self) -> float:
        _, _, _, _, i, j, _ = self._base_position()
        return 1.0 - 2.0 * (i * i + j * j)

    def leaning(self) -> str:
        _, _, _, w, i, j, k = self._base_position()
        # Vertical components of the x axis and the y axis of the link ``base_link``.
        x, y = 2.0 * (i * k - w * j), 2.0 * (j * k + w * i)
        if abs(x) > abs(y):
            return "forwards" if x < 0.0 else "backwards"
        return "to its left" if y < 0.0 else "to its right"

    def _base_position(self) -> list[float]:
        """Returns the position x, y, z (m) and the quaternion wxyz of the base.

        The position and quaternion are read from the MuJoCo array ``qpos``.  The array ``xpos`` of
        MuJoCo is not used, because ``xpos`` after a step contains the positions at the beginning of
        the step.
        """
        position: list[float] = self._base_qpos.tolist()
        return position
