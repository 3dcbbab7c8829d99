"""The control loop of one simulated robot, and the measurements of each tick."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from thorvaldc.model import Robot
from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import BaseHandle, JointStates
from thorvaldc.runtime.driver import BaseDriver, DriverState
from thorvaldc.runtime.lasting_difference import is_axle_swing
from thorvaldc.runtime.se2 import ZERO_COV, ZERO_TWIST, Cov3, Pose2, Twist
from thorvaldc.simulation.manoeuvre import Manoeuvre, twist_at
from thorvaldc.simulation.physics.ground_truth_base import GroundTruthBase
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene
from thorvaldc.simulation.run_result import RobotResult

if TYPE_CHECKING:
    from thorvaldc.simulation.vectorised.deferred_odometry import DeferredOdometry

TIPPED = math.cos(math.radians(60.0))
"""Cosine of the tilt from which a robot counts as fallen over."""
NEGLIGIBLE_TWIST = 0.01
"""Largest infeasible or unreachable motion (m/s, rad/s) that is not reported."""


def largest_component(twist: Twist) -> float:
    """Returns the largest absolute value of the components of a twist (m/s, rad/s)."""
    return max(abs(twist.vx), abs(twist.vy), abs(twist.wz))


@dataclass(slots=True)
class Sample:
    """Measurements of a simulated robot at one tick of its driver.

    ``time`` is the simulated time (s) of the tick.  Twists are expressed in the link frame
    ``base_link``, and poses in the world frame.  The yaw angles of the poses are not wrapped.  With
    ideal joints, the true pose and the true twist are equal to the estimated pose and twist.

    * ``commanded``: twist that the script requests.
    * ``limited``: commanded twist after the limits and ramps of the driver.
    * ``estimated``: twist that the odometry computes.
    * ``true``: twist of the robot in the simulated world.
    * ``pose_estimated``: pose that the odometry computes, from the true start pose on.
    * ``pose_true``: pose of the robot in the simulated world.
    * ``joints``: joint states that the driver read; ``None`` if the driver has no states.
    * ``posture``: height (m), roll (rad) and pitch (rad) of the robot in the simulated world.
    * ``pose_covariance``: covariance of a small motion of ``base_link``, in ``base_link``.
    * ``twist_covariance``: covariance of the estimated twist, in ``base_link``.
    """

    time: float
    commanded: Twist
    limited: Twist
    estimated: Twist
    true: Twist
    pose_estimated: Pose2
    pose_true: Pose2
    joints: JointStates | None
    posture: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pose_covariance: Cov3 = ZERO_COV
    twist_covariance: Cov3 = ZERO_COV


def _twist_in_force(state: DriverState) -> Twist:
    """Returns the commanded twist after the limits and ramps of the driver.

    This is the target twist of the wheels.  If the wheels do not follow for a long time, the result
    is the twist that they were asked for.
    """
    if state.command is None:
        return ZERO_TWIST
    return state.ramped if state.not_followed else state.command.target


class ControlLoop:
    """Runs the driver of one robot along a manoeuvre and measures how the robot moves.

    ``path_commanded``, ``path_true`` and ``path_estimated`` are the path lengths (m) since the
    start of the run.  Without samples, ``path_estimated`` is known only after ``result``.
    ``yaw_true`` is the true yaw angle (rad) since the start of the run and is not wrapped.
    ``uprightness`` is the smallest cosine of the tilt angle since the start of the run.
    """

    def __init__(
        self,
        name: str,
        robot: Robot,
        base: BaseHandle,
        manoeuvre: Manoeuvre,
        parameters: str | None = None,
        *,
        sampled: bool = True,
    ) -> None:
        """Creates the driver of a robot at the start of a run.

        If nobody calls ``sample``, ``sampled`` may be false: the odometry is then computed in
        ``result``, which takes less time and gives the same result.
        """
        self.name = name
        self.robot = robot
        self.driver = BaseDriver(robot, base, parameters=parameters)
        self.base = base
        self.manoeuvre = manoeuvre
        self.ticks = 0
        self._deferred = None if sampled else self._deferred_odometry()
        self._truth = base if isinstance(base, GroundTruthBase) else None
        self.start = se2.ORIGIN if self._truth is None else self._truth.true_pose()
        self.pose_true = self.start
        self.yaw_true = 0.0
        self.path_commanded = self.path_true = self.path_estimated = 0.0
        self.uprightness = 1.0
        self.infeasible = ZERO_TWIST
        self.infeasible_twist = ZERO_TWIST
        self.unreachable: tuple[int, ...] = ()
        self.unreachable_twist = ZERO_TWIST
        self._last_commanded = ZERO_TWIST
        self.limit = ""
        """Speed limit that scaled a commanded twist, or empty."""
        self.limited_twist = self.limited_to = ZERO_TWIST
        """Fastest commanded twist beyond a speed limit, and the twist that the limit allows."""
        self.not_followed = ""
        """Last lasting difference that neither wheels nor speed limits of the driver explain."""

    @property
    def scene(self) -> MujocoScene | None:
        """MuJoCo scene of the robot, or ``None`` for a robot with ideal joints."""
        return self.base.scene if isinstance(self.base, MujocoBase) else None

    @property
    def next_time(self) -> float:
        """Time (s) of the next tick of the driver."""
        return self.ticks / self.robot.driver.rate

    def tick(self, joints: JointStates | None = None) -> None:
        """Runs one tick of the base driver.

        ``joints`` are joint states that were already read, as for ``BaseDriver.tick``.
        """
        now = self.next_time
        previous = self.driver.state
        self.driver.command(twist_at(self.manoeuvre, now), now)
        state = self.driver.tick(now, joints)
        if self.ticks:
            dt = now - previous.time
            self.path_commanded += _twist_in_force(previous).speed * dt
            if self._deferred is None:
                self.path_estimated += state.odometry.twist.speed * dt
            self._measure_truth()
        self.ticks += 1
        command = state.command
        if command is None:
            return
        if state.commanded_twist != self._last_commanded:
            self._last_commanded = state.commanded_twist
            self._note_limit(state.commanded_twist)
        infeasible = state.infeasible
        if state.not_followed and not self.driver.limit_of(state.commanded_twist):
            swing = is_axle_swing(state.commanded_twist, infeasible)
            if swing or largest_component(infeasible) <= NEGLIGIBLE_TWIST:
                self.not_followed = state.not_followed
        if infeasible is not ZERO_TWIST and (
            largest_component(infeasible) > largest_component(self.infeasible)
        ):
            self.infeasible, self.infeasible_twist = state.infeasible, state.commanded_twist
        if largest_component(infeasible) > NEGLIGIBLE_TWIST:
            for i in self.driver.calculator.limiting_wheels(state.commanded_twist):
                if i not in self.unreachable:
                    self.unreachable += (i,)
                    self.unreachable_twist = state.commanded_twist

    def _deferred_odometry(self) -> DeferredOdometry | None:
        """Replaces the odometry of the driver, or returns ``None`` if it cannot be deferred."""
        if not isinstance(self.base, MujocoBase) or self.base.is_noisy:
            return None
        from thorvaldc.simulation.vectorised.deferred_odometry import DeferredOdometry

        driver, timestep = self.driver, self.base.scene.timestep
        if not DeferredOdometry.suits(driver.calculator, 1.0 / self.robot.driver.rate, timestep):
            return None
        driver.odometry = odometry = DeferredOdometry(driver.odometry)
        return odometry

    def _note_limit(self, commanded: Twist) -> None:
        if largest_component(commanded) <= largest_component(self.limited_twist):
            return
        limit = self.driver.limit_of(commanded)
        if limit:
            self.limit, self.limited_twist = limit, commanded
            self.limited_to = self.driver.limited(commanded)

    def _measure_truth(self) -> None:
        base = self._truth
        if base is None:
            return
        pose = base.true_pose()
        turn = math.remainder(pose.yaw - self.pose_true.yaw, math.tau)
        self.yaw_true += turn
        # The robot is assumed to move along an arc between two ticks.  The distance between the
        # positions of the robot at the two ticks is the chord of the arc.
        chord = math.hypot(pose.x - self.pose_true.x, pose.y - self.pose_true.y)
        self.path_true += chord / se2.chord_over_arc(turn)
        self.pose_true = pose
        uprightness = base.uprightness()
        if uprightness < self.uprightness:
            self.uprightness = uprightness

    def sample(self) -> Sample:
        """Returns the measurements at the last tick of the driver."""
        state = self.driver.state
        estimated, pose = state.odometry.twist, self.start.moved(state.pose)
        true, pose_true = estimated, pose
        posture = (0.0, 0.0, 0.0)
        if self._truth is not None:
            true = self._truth.true_twist()
            pose_true = Pose2(self.pose_true.x, self.pose_true.y, self.start.yaw + self.yaw_true)
            posture = self._truth.posture()
        return Sample(
            state.time,
            state.commanded_twist,
            _twist_in_force(state),
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
        """True if the robot fell over during the run."""
        return self.uprightness < TIPPED

    def result(self) -> RobotResult:
        """Returns the result of the robot from the start of the run to the last tick."""
        robot = self.robot
        if self._deferred is not None:
            self._deferred.finish()
            self.path_estimated = self._deferred.path
        odometry = self.driver.odometry.pose
        true, path = odometry, self.path_estimated
        if self._truth is not None:
            x, y, _ = self.pose_true.relative_to(self.start)
            true, path = Pose2(x, y, self.yaw_true), self.path_true
        return RobotResult(
            name=self.name,
            mass=robot.inertial.mass,
            wheels=len(robot.wheels),
            driven=sum(1 for w in robot.wheels if w.driven),
            steered=sum(1 for w in robot.wheels if w.steered),
            path_commanded=self.path_commanded,
            path_true=path,
            path_odometry=self.path_estimated,
            end_error=math.hypot(true.x - odometry.x, true.y - odometry.y),
            yaw_error=abs(true.yaw - odometry.yaw),
            pose_true=true,
            pose_odometry=odometry,
            largest_tilt=math.acos(max(self.uprightness, -1.0)),
            infeasible=self.infeasible,
            unreachable=tuple(robot.wheels[i].name for i in self.unreachable),
            tipped=self.tipped,
        )


TickCallback = Callable[[ControlLoop], None]
"""A function that a run calls after each tick of each robot."""
