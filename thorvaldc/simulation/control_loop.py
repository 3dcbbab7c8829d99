"""The control loop of one simulated robot: its manoeuvre and the samples of each tick."""

from __future__ import annotations

import bisect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from thorvaldc.model import DriverSettings, Robot
from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import BaseHandle, JointCommands, JointStates
from thorvaldc.runtime.calculators import for_robot
from thorvaldc.runtime.driver import BaseDriver, DriverState
from thorvaldc.runtime.se2 import ZERO_COV, ZERO_TWIST, Cov3, Pose2, Twist
from thorvaldc.runtime.twist_ramp import is_axle_swing
from thorvaldc.simulation.direct_commands import DirectCommands
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene
from thorvaldc.simulation.physics.sim_base import GroundTruth
from thorvaldc.simulation.simulation_result import RobotResult

# -- manoeuvres ------------------------------------------------------------------------------------


class Segment(NamedTuple):
    """A commanded twist that holds from the time ``start`` (s) to the next segment's start."""

    start: float
    twist: Twist


Manoeuvre = Sequence[Segment]
"""Segments in the order of their start times."""
_LARGEST = (math.inf, math.inf, math.inf)


def twist_at(manoeuvre: Manoeuvre, time: float) -> Twist:
    """Returns the commanded twist of a manoeuvre at ``time`` (s).

    The commanded twist is zero before the first segment of the manoeuvre.
    """
    following = bisect.bisect_right(manoeuvre, (time + 1e-9, _LARGEST))
    return manoeuvre[following - 1].twist if following else ZERO_TWIST


PARTS: Final = (
    (4.0, "forward"),
    (4.0, "arc"),
    (3.0, "sideways"),
    (3.0, "turn"),
)
"""The default manoeuvre: durations (s) and names of its parts."""
STOP: Final = 2.0
"""Duration (s) of the standstill at the end of the default manoeuvre."""
_TIME_STEP: Final = 0.1
"""Time step (s) of the predicted paths of a fleet."""


def default_manoeuvre(robot: Robot) -> tuple[list[Segment], float]:
    """Returns the default manoeuvre of a robot and the duration of the manoeuvre (s).

    The default manoeuvre has four parts: straight ahead, an arc, sideways, and a turn on the spot.
    The arc is as tight as the steering limits allow.  A part of the default manoeuvre is omitted if
    the arrangement of the wheels or a steering limit does not allow the motion.  At the end the
    robot stands still for ``STOP`` s.
    """
    segments: list[Segment] = []
    time = 0.0
    for duration, name in PARTS:
        twist = _possible_part(robot, _part_twist(name, robot.driver))
        if twist != ZERO_TWIST:
            segments.append(Segment(time, twist))
            time += duration
    segments.append(Segment(time, ZERO_TWIST))
    return segments, time + STOP


def fleet_manoeuvres(
    robots: Sequence[tuple[str, Robot, Pose2]],
) -> tuple[dict[str, list[Segment]], float]:
    """Returns a manoeuvre for each robot of a fleet, and the duration of the manoeuvres (s).

    ``robots`` has a tuple for each robot: name, robot, and start pose in the world.  All robots
    drive the same parts of the default manoeuvre at the same times.  A robot that cannot drive a
    part of the manoeuvre stands still during the part.  The function tries the whole default
    manoeuvre first, and then simpler and shorter manoeuvres.  The function returns the first
    manoeuvres in which the robots do not collide (``_keep_apart``).
    """
    if not robots:
        return {}, STOP
    settings = min((robot.driver for _, robot, _ in robots), key=lambda s: s.max_linear_velocity)
    manoeuvres: dict[str, list[Segment]] = {}
    duration = STOP
    for parts, speed_factor in (
        (("forward", "arc", "sideways", "turn"), 1.0),
        (("forward", "arc", "turn"), 1.0),
        (("forward", "turn"), 1.0),
        (("forward", "turn"), 0.4),
        (("turn",), 1.0),
    ):
        manoeuvres = {name: [] for name, _, _ in robots}
        time = 0.0
        for part_duration, part in PARTS:
            if part not in parts:
                continue
            twist = _part_twist(part, settings)
            if part != "turn":
                twist = twist.scaled(speed_factor)
            for name, robot, _ in robots:
                manoeuvres[name].append(Segment(time, _possible_part(robot, twist)))
            time += part_duration
        for manoeuvre in manoeuvres.values():
            manoeuvre.append(Segment(time, ZERO_TWIST))
        duration = time + STOP
        if _keep_apart(robots, manoeuvres, duration):
            break
    return manoeuvres, duration


def _part_twist(name: str, settings: DriverSettings) -> Twist:
    v = min(1.0, 0.8 * settings.max_linear_velocity)
    w = min(0.5, 0.8 * settings.max_angular_velocity)
    return {
        "forward": Twist(v, 0.0, 0.0),
        "arc": Twist(v, 0.0, w),
        "sideways": Twist(0.0, 0.7 * v, 0.0),
        "turn": Twist(0.0, 0.0, -w),
    }[name]


def _possible_part(robot: Robot, twist: Twist) -> Twist:
    """Returns ``twist`` with a yaw rate that the steering limits allow, or zero.

    The result is zero if the wheels do not allow a nonzero component of the velocity, or no turn.
    The feasible twist may contain components that are zero in ``twist``.  For example, a robot
    whose axle lies behind ``base_link`` moves ``base_link`` sideways in a turn.
    """
    allowed = for_robot(robot).feasible(twist)
    if twist.vx and abs(allowed.vx - twist.vx) > 1e-6:
        return ZERO_TWIST
    if twist.vy and abs(allowed.vy - twist.vy) > 1e-6:
        return ZERO_TWIST
    if twist.wz and abs(allowed.wz) < 1e-6:
        return ZERO_TWIST
    return Twist(twist.vx, twist.vy, allowed.wz)


def _keep_apart(
    robots: Sequence[tuple[str, Robot, Pose2]],
    manoeuvres: Mapping[str, Manoeuvre],
    duration: float,
) -> bool:
    """Returns true if all robots keep a safe distance from each other on the predicted paths.

    Each robot is approximated by a disc around the wheels of the robot.  The discs of two robots
    must not touch.  If two discs touch at the start already, the distance between the two robots
    must not decrease by more than 5 cm.
    """
    paths: list[list[Pose2]] = []
    radii: list[float] = []
    for name, robot, start in robots:
        pose, path = start, [start]
        for k in range(round(duration / _TIME_STEP)):
            twist = twist_at(manoeuvres[name], k * _TIME_STEP)
            pose = pose.moved(se2.exp(twist, _TIME_STEP))
            path.append(pose)
        paths.append(path)
        radii.append(max((math.hypot(w.x, w.y) + w.width for w in robot.wheels), default=0.5))
    for i in range(len(robots)):
        for j in range(i):
            distances = [math.dist(a[:2], b[:2]) for a, b in zip(paths[i], paths[j], strict=True)]
            if min(distances) < min(radii[i] + radii[j], distances[0] - 0.05):
                return False
    return True


TIPPED: Final = math.cos(math.radians(60.0))
"""Cosine of the tilt from which a robot counts as fallen over."""
NEGLIGIBLE_TWIST: Final = 0.01
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
    start of the run, and ``turn_commanded`` the commanded turn (rad).  ``yaw_true`` is the true yaw
    angle (rad) since the start of the run and is not wrapped.
    ``uprightness`` is the smallest cosine of the tilt angle since the start of the run.
    """

    def __init__(
        self,
        name: str,
        robot: Robot,
        base: BaseHandle,
        manoeuvre: Manoeuvre,
        parameters: str | None = None,
    ) -> None:
        """Creates the driver of a robot at the start of a run."""
        self.name = name
        self.robot = robot
        self.driver = BaseDriver(robot, base, parameters=parameters)
        self.base = base
        self.manoeuvre = manoeuvre
        self._direct: DirectCommands | None = None
        self._commands = 0
        """Number of the commands of the driver, as long as all are those of the manoeuvre."""
        self.ticks = 0
        self._truth = base if isinstance(base, GroundTruth) else None
        self.start = se2.ORIGIN if self._truth is None else self._truth.true_pose()
        self.pose_true = self.start
        self.yaw_true = 0.0
        self.path_commanded = self.path_true = self.path_estimated = 0.0
        self.turn_commanded = 0.0
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

    def follow(self, manoeuvre: Manoeuvre) -> None:
        """Follows a manoeuvre from the next tick on."""
        if self._direct is not None:
            self.driver.calculator = self._direct.odometer
            self.driver.calculator.reset(self.driver.state.joints)
            self._direct = None
        self.manoeuvre, self._commands = manoeuvre, self.driver.commands

    def follow_joints(self, commands: JointCommands) -> None:
        """Passes joint commands on from the next tick on, past the calculator of the driver.

        Raises ``ValueError`` if they are not one finite speed and angle for each wheel.
        """
        direct = self._direct
        if direct is None:
            driver = self.driver
            direct = DirectCommands(self.robot, driver.calculator, driver.state.joints)
        direct.set(commands)
        self.driver.calculator = self._direct = direct
        self.manoeuvre, self._commands = (), self.driver.commands

    def place(self, pose: Pose2) -> None:
        """Moves the robot to a planar pose in the world, before the first tick."""
        if self._truth is not None:
            self._truth.place(pose)
            pose = self._truth.true_pose()
        self.start = self.pose_true = pose

    def tick(self) -> None:
        """Runs one tick of the base driver.

        The driver follows the manoeuvre until another program, such as a function that is called
        after each tick, commands it; then its command time-out holds.
        """
        now = self.next_time
        previous = self.driver.state
        if self.driver.commands == self._commands:
            self.driver.command(twist_at(self.manoeuvre, now), now)
            self._commands = self.driver.commands
        state = self.driver.tick(now)
        if self.ticks:
            dt = now - previous.time
            in_force = _twist_in_force(previous)
            self.path_commanded += in_force.speed * dt
            self.turn_commanded += in_force.wz * dt
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
            turn_commanded=self.turn_commanded,
        )


TickCallback = Callable[[ControlLoop], None]
"""A function that a run calls after each tick of each robot."""
