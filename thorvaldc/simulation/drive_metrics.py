"""Measures how a robot drives: what was commanded, what was true, what the joints say."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from thorvaldc.model import Robot
from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import BaseHandle, JointStates
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.se2 import ZERO_COV, ZERO_TWIST, Cov3, Pose2, Twist
from thorvaldc.simulation.manoeuvre import Manoeuvre, twist_at
from thorvaldc.simulation.physics.mujoco_base import MujocoBase, MujocoScene
from thorvaldc.simulation.physics.simulated_base import SimulatedBase

TIPPED = math.cos(math.radians(60.0))
"""Cosine of the tilt at which a robot counts as fallen."""
NOTICEABLE = 0.01
"""Infeasible or unreachable motion (m/s, rad/s) below which nobody is told."""


def size(twist: Twist) -> float:
    """The largest part of a twist, m/s or rad/s."""
    return max(abs(twist.vx), abs(twist.vy), abs(twist.wz))


@dataclass(frozen=True, slots=True)
class RobotRun:
    """How one robot drove.  Lengths in m, angles in rad, poses relative to the start.

    ``path_commanded`` is the way of ``base_link`` that the driver aimed at, its
    ramps and limits applied; ``path_true`` the way in the simulated world and
    ``path_odometry`` that by the joints.  ``end_error`` is the distance between
    the true and the estimated position at the end, ``yaw_error`` that of the headings.
    With ideal joints there is no other truth than the joints: true is odometry.
    """

    name: str
    mass: float
    wheels: int
    driven: int
    steered: int
    path_commanded: float
    path_true: float
    path_odometry: float
    end_error: float
    yaw_error: float
    pose_true: Pose2
    pose_odometry: Pose2
    largest_tilt: float
    infeasible: Twist
    unreachable: tuple[str, ...]
    tipped: bool


@dataclass(slots=True)
class Sample:
    """What a tick of a robot saw: time in s, twists of ``base_link`` in itself, its poses.

    ``asked`` is the twist of the script, ``aimed`` what the driver made of it within its
    limits and ramps, ``estimated`` and ``pose_estimated`` are the odometry's, ``true`` and
    ``pose_true`` the simulated world's.  Both poses are in the world, the estimated one
    from the true start on; yaw is not wrapped.  With ideal joints true is estimated.
    ``posture`` is what the true pose leaves out: height (m), roll and pitch (rad).  The
    covariances are those of a small motion of ``base_link`` and of the estimated twist, both
    in ``base_link``.
    """

    time: float
    asked: Twist
    aimed: Twist
    estimated: Twist
    true: Twist
    pose_estimated: Pose2
    pose_true: Pose2
    joints: JointStates | None
    posture: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pose_covariance: Cov3 = ZERO_COV
    twist_covariance: Cov3 = ZERO_COV


class Meter:
    """One robot of a run: its driver, and what is measured beside it."""

    def __init__(
        self,
        name: str,
        robot: Robot,
        base: BaseHandle,
        manoeuvre: Manoeuvre,
        parameters: str | None = None,
    ) -> None:
        self.name = name
        self.robot = robot
        self.driver = BaseDriver(robot, base, parameters=parameters)
        self.base = base
        self.manoeuvre = manoeuvre
        self.ticks = 0
        self._simulated = base if isinstance(base, SimulatedBase) else None
        self.start = se2.ORIGIN if self._simulated is None else self._simulated.true_pose()
        self.true = self.start
        self.turned = 0.0
        self.commanded = self.path = self.estimated = 0.0
        self.upright = 1.0
        self.infeasible = ZERO_TWIST
        self.unreachable: tuple[int, ...] = ()
        self.unreachable_twist = ZERO_TWIST
        self.infeasible_twist = ZERO_TWIST

    @property
    def scene(self) -> MujocoScene | None:
        """The scene that the robot drives in; ``None`` with ideal joints."""
        return self.base.scene if isinstance(self.base, MujocoBase) else None

    @property
    def next(self) -> float:
        return self.ticks / self.robot.driver.rate

    def tick(self, joints: JointStates | None = None) -> None:
        """A tick of the driver; ``joints`` as in ``BaseDriver.tick``."""
        now = self.next
        before = self.driver.state
        self.driver.command(twist_at(self.manoeuvre, now), now)
        state = self.driver.tick(now, joints)
        if self.ticks:
            dt = now - before.time
            if before.command is not None:
                self.commanded += before.command.target.speed * dt
            self.estimated += state.odometry.twist.speed * dt
            self._measure_truth()
        self.ticks += 1
        command = state.command
        if command is None:
            return
        if size(state.infeasible) > size(self.infeasible):
            self.infeasible, self.infeasible_twist = state.infeasible, state.commanded_twist
        for i in command.unreachable:
            if i not in self.unreachable and size(state.ramped) > NOTICEABLE:
                self.unreachable += (i,)
                self.unreachable_twist = state.commanded_twist

    def _measure_truth(self) -> None:
        base = self._simulated
        if base is None:
            return
        pose = base.true_pose()
        turn = math.remainder(pose.yaw - self.true.yaw, math.tau)
        self.turned += turn
        chord = math.hypot(pose.x - self.true.x, pose.y - self.true.y)
        self.path += chord / se2.chord_over_arc(turn)
        self.true = pose
        upright = base.uprightness()
        if upright < self.upright:
            self.upright = upright

    def sample(self) -> Sample:
        """The last tick."""
        state = self.driver.state
        estimated, pose = state.odometry.twist, self.start.moved(state.pose)
        true, pose_true = estimated, pose
        posture = (0.0, 0.0, 0.0)
        if self._simulated is not None:
            true = self._simulated.true_twist()
            pose_true = Pose2(self.true.x, self.true.y, self.start.yaw + self.turned)
            posture = self._simulated.posture()
        aimed = ZERO_TWIST if state.command is None else state.command.target
        return Sample(
            state.time,
            state.commanded_twist,
            aimed,
            estimated,
            true,
            pose,
            pose_true,
            state.joints,
            posture,
            state.pose_covariance,
            state.odometry.covariance,
        )

    @property
    def tipped(self) -> bool:
        return self.upright < TIPPED

    def result(self) -> RobotRun:
        robot = self.robot
        odometry = self.driver.state.pose
        true, path = odometry, self.estimated
        if self._simulated is not None:
            x, y, _ = self.true.relative_to(self.start)
            true, path = Pose2(x, y, self.turned), self.path
        return RobotRun(
            name=self.name,
            mass=robot.inertial.mass,
            wheels=len(robot.wheels),
            driven=sum(1 for w in robot.wheels if w.driven),
            steered=sum(1 for w in robot.wheels if w.steered),
            path_commanded=self.commanded,
            path_true=path,
            path_odometry=self.estimated,
            end_error=math.hypot(true.x - odometry.x, true.y - odometry.y),
            yaw_error=abs(true.yaw - odometry.yaw),
            pose_true=true,
            pose_odometry=odometry,
            largest_tilt=math.acos(max(self.upright, -1.0)),
            infeasible=self.infeasible,
            unreachable=tuple(robot.wheels[i].name for i in self.unreachable),
            tipped=self.tipped,
        )


Watch = Callable[[Meter], None]
"""Called after each tick of each robot of a run."""
