"""What must hold at every instant, judged by the true motors, not by what the driver believes."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from tests.chaos.permission import wheel_speed
from tests.runtime import exploration
from tests.runtime.exploration import check_explored
from thorvaldc.model.stopping import DRIVE_DEAD, DRIVER_DEAD, STOP_LOCK, stop_bounds
from thorvaldc.runtime.se2 import ORIGIN, Pose2
from thorvaldc.simulation.bus.canopen_device import CanopenDevice
from thorvaldc.simulation.bus.promised_times import CLIMB, NOT_FOLLOWING

if TYPE_CHECKING:
    from tests.chaos.chaos_world import ChaosWorld

CHECK_PERIOD = 0.02
TOLERATED = 0.07 + CHECK_PERIOD
"""s by which a stop may begin later than stated: a tolerated gap of 2.5 cycles, and the check."""
QUARTER_TURN = math.pi / 2.0
"""Largest angle (rad) by which a steering joint turns between two motions."""
TURN_SHARE = 0.3
"""Share of the deceleration of a stop with which the fastest wheel brakes between two motions."""
RAMP_SHARE = 0.9
"""Share of the stated deceleration that a stop must reach."""
AFTER_IMPEDIMENT = 0.2
"""s after which the driver controls the drives again, when a hindrance has ended."""
SPEED_TOLERANCE, SPEED_SHARE = 0.04, 1.06
"""Wheel speeds (m/s) that count as standing, and the tolerance of the permitted speed."""
PUSHED = "pushed_motor"
DISOBEDIENCE = 0.2 + NOT_FOLLOWING + CLIMB
"""s until a drive that ignores its commands brakes: its target must change, which takes a ramp,
then it is noticed, and climbs the ladder."""
LONGEST_DELAY = 2.5
"""Longest time (s) by which an injected fault delays frames."""
SIGMAS = 5.0
POSE_TOLERANCE = 0.03
"""m and rad."""
LATENCY = 0.08
"""s between the report of a motor and the control cycle."""
MARGIN = 0.1
"""s by which a fault may be noticed later than promised, because of other faults."""
SURPLUS = 8
"""Number of false reports that are noticed at the latest, if they have the period of the report."""
SAMPLING_TIME = 0.12
"""s between two counts of the same report."""


def false_reports_notice(period: float) -> float:
    """Returns the longest time (s) until false reports with a period (s) are noticed."""
    return SURPLUS * period + SAMPLING_TIME


rules_are_whole = True
"""``False`` while a rule is taken out, so that the true motors show it."""


class Violation(Exception):
    """An invariant does not hold."""

    def __init__(self, invariant: str, time: float, text: str) -> None:
        super().__init__(f"{invariant} at {time:.3f} s: {text}")
        self.invariant = invariant
        self.time = time
        self.text = text


@dataclass
class MotionInvariant:
    """No wheel turns faster than permitted, and every stop ends in time.

    The envelope of the wheel speed is the highest permitted speed in the last reaction time.  Then
    it falls to zero within the stated time of a stop.  The reaction time is that of the driver, or
    that of the drives' own watchdogs where the driver cannot act.  Both come from the stopping
    distances that the model states (``thorvaldc.model.stopping``).
    """

    world: ChaosWorld
    envelope: float = 0.0
    _recent: deque[tuple[float, float]] = field(default_factory=deque)
    _impeded_since: float = math.inf
    _impeded_until: float = -math.inf
    _delay: float = 0.0
    """Longest time (s) by which frames are late during the present hindrance."""
    _ramp_start: float = 0.0
    """Speed (m/s) of the envelope at the start of its last fall."""
    _rest_time: float = -math.inf
    """Time (s) at which no motion was permitted last."""

    def __post_init__(self) -> None:
        robot = self.world.robot
        stops = {bound.kind: bound for bound in stop_bounds(robot)}
        by_driver = stops[STOP_LOCK]
        self.reaction = by_driver.reaction + TOLERATED
        self.watchdog = max(stops[DRIVER_DEAD].reaction, stops[DRIVE_DEAD].reaction) + TOLERATED
        self.ramp_time = (by_driver.time - by_driver.reaction) / RAMP_SHARE
        steerings = {wheel.steering_joint for wheel in robot.wheels}
        rates = [a.max_velocity for a in robot.actuators if a.joint in steerings]
        self.turn_time = max(QUARTER_TURN / min(rates), self.reaction) if rates else self.reaction

    def check(self, now: float) -> None:
        world = self.world
        settings = world.limits
        level = 0.0
        if not world.driver_hangs:
            twist = world.permission.twist(now)
            level = wheel_speed(world.robot, twist, *settings)
        level = max(level, world.forged_level(now))
        recent = self._recent
        recent.append((now, level))
        if world.impeded:
            # A frame that is late keeps the watchdog of a drive from acting.
            self._delay = max(self._delay, world.frame_delay)
            self._impeded_since = min(self._impeded_since, now)
            self._impeded_until = now + AFTER_IMPEDIMENT + self._delay
        elif now >= self._impeded_until:
            self._impeded_since, self._delay = math.inf, 0.0
        watchdog = self.watchdog + self._delay
        reaction = watchdog if now < self._impeded_until else self.reaction
        while recent and recent[0][0] < now - max(self.watchdog + LONGEST_DELAY, self.turn_time):
            recent.popleft()
        if level == 0.0:
            self._rest_time = now
        # Between two motions, the wheels turn first, and then the fastest wheel may brake more
        # slowly than in a stop.
        begin = min(now - reaction, max(now - self.turn_time, self._rest_time))
        highest = max(level for time, level in recent if time >= begin)
        share = 1.0 if level == 0.0 else TURN_SHARE
        if highest >= self.envelope:
            self.envelope = self._ramp_start = highest
        elif 0.0 <= now - self._impeded_since <= watchdog:
            pass  # the drives hold their last speed until their watchdogs end the motion
        else:
            if level > 0.0:
                # A stop that begins later has the stated time from the speed at that instant.
                self._ramp_start = self.envelope
            fall = share * self._ramp_start * CHECK_PERIOD / self.ramp_time
            self.envelope = max(highest, self.envelope - fall)
        speed = world.truth.driven_speed() - world.pushed_speed
        if world.truth.retaken_speed > self.envelope:  # its stop begins now
            self.envelope = self._ramp_start = world.truth.retaken_speed
        if speed > SPEED_SHARE * self.envelope + SPEED_TOLERANCE:
            raise Violation(
                "unasked motion",
                now,
                f"a wheel turns at {speed:.2f} m/s; permitted are {self.envelope:.2f} m/s"
                f" ({world.describe()})",
            )


@dataclass
class StateInvariant:
    """The reported state is not better than the truth for longer than the stated time."""

    world: ChaosWorld
    _since: dict[int, float] = field(default_factory=dict)

    def check(self, now: float) -> None:
        """Called after each control cycle."""
        world = self.world
        for number, problem in world.problems.items():
            limit = problem.notice
            if limit is None:
                continue
            # Objects are read by SDO, which lost and late frames delay without a limit.
            delayed = problem.kind == "object_written" and world.impeded
            delayed = delayed or not problem.holds()
            # What turns a wheel is noticed while the robot should stand.
            delayed = delayed or (
                problem.kind == PUSHED and world.motion.envelope > SPEED_TOLERANCE
            )
            if delayed or not world.driven.base.state.drives or world.late_cycle:
                self._since.pop(number, None)
                continue
            since = self._since.setdefault(number, max(now, problem.since))
            if now - since > limit + MARGIN:
                raise Violation(
                    "unnoticed problem",
                    now,
                    f"{problem.kind} since {now - since:.2f} s, and the driver reports"
                    f" `{world.driven.base.state.value}`",
                )
        for number in [n for n in self._since if n not in world.problems]:
            del self._since[number]


def check_commands(world: ChaosWorld, now: float) -> None:
    """Commands are finite and within the limits of the robot."""
    base, state = world.driven.base, world.driven.driver.state
    if state.time != now:
        return
    for axis in base._axes:
        actuator, target = axis.actuator, axis.target
        if not math.isfinite(target):
            raise Violation("command", now, f"{actuator.name} is commanded to {target}")
        if not base.state_machine.state.drives:
            continue
        joint = world.robot.joint(actuator.joint)
        if axis.steering:
            lower = -math.inf if joint.lower is None else joint.lower
            upper = math.inf if joint.upper is None else joint.upper
            within = lower - 1e-3 <= target <= upper + 1e-3
        else:
            within = abs(target) <= 1.001 * actuator.max_velocity + 1e-6
        if not within:
            raise Violation("command", now, f"{actuator.name} is commanded to {target:.3f}")
    linear, angular = world.limits
    twist = state.ramped
    if twist.speed > 1.01 * linear + 0.01 or abs(twist.wz) > 1.01 * angular + 0.01:
        raise Violation("command", now, f"the ramped twist {twist} exceeds {world.limits}")


def check_explored_permission(world: ChaosWorld, now: float) -> None:
    """The permission of the running robot is in a class that tests/runtime/exploration visits."""
    if not rules_are_whole:
        return
    try:
        check_explored(world.driven.permission, now)
    except exploration.Violation as violation:
        raise Violation("explored permission", now, str(violation)) from None


def check_stored(world: ChaosWorld, stored: Mapping[str, Mapping[str, object]]) -> None:
    """Nothing that a device has stored is lost or changed, and no two devices hold the same id.

    ``stored``: contents of the non-volatile memories at the start of the mission, by device.
    """
    holders: dict[tuple[str, object], str] = {}
    for bus in world.robot.buses:
        for node in bus.nodes:
            device = world.simulated.devices[node.name]
            changes = {
                key: device.nonvolatile.get(key)
                for key, value in stored[node.name].items()
                if device.nonvolatile.get(key) != value
            }
            if changes:
                raise Violation("stored values", world.now, f"{node.name} has stored {changes}")
            if node.channels and isinstance(device, CanopenDevice):
                other = holders.setdefault((bus.name, device.node_id), node.name)
                if other != node.name:
                    text = f"{node.name} and {other} hold the id {device.node_id}"
                    raise Violation("node id", world.now, text)


@dataclass
class OdometryInvariant:
    """The covariance of the odometry contains the true pose.

    The true pose follows from the true motors: the twist that fits the wheels best, integrated.
    The check pauses after an injected fault that falsifies what the motors report, until the pose
    is set to zero again.
    """

    world: ChaosWorld
    pose: Pose2 = ORIGIN
    valid: bool = False
    _time: float = -math.inf

    def advance(self, now: float) -> None:
        """Integrates the true pose to the time ``now`` (s)."""
        dt = now - self._time
        self._time = now
        if 0.0 < dt < 1.0:
            vx, vy, wz = self.world.truth.twist()
            x, y, yaw = self.pose
            heading = yaw + wz * dt / 2.0
            c, s = math.cos(heading), math.sin(heading)
            self.pose = Pose2(x + (c * vx - s * vy) * dt, y + (s * vx + c * vy) * dt, yaw + wz * dt)

    def restart(self, now: float) -> None:
        """The driver has set its pose to the origin."""
        self.pose, self.valid, self._time = ORIGIN, not self.world.encoders_lie, now

    def invalidate(self) -> None:
        self.valid = False

    def check(self, now: float) -> None:
        """Compares with the odometry after a control cycle."""
        if self.world.encoders_lie:
            self.valid = False
        if not self.valid:
            return
        state = self.world.driven.driver.state
        covariance = state.pose_covariance
        x, y, yaw = state.pose
        true_x, true_y, true_yaw = self.pose
        dx, dy = true_x - x, true_y - y
        c, s = math.cos(yaw), math.sin(yaw)
        turn = math.remainder(true_yaw - yaw, math.tau)
        errors = (c * dx + s * dy, c * dy - s * dx, turn)
        settings = self.world.robot.driver
        linear, angular = settings.max_linear_velocity, settings.max_angular_velocity
        # A driver that stalls while it sends has measured its pose before the stall.
        latency = LATENCY + max(now - state.time, 0.0)
        for i, (error, speed) in enumerate(zip(errors, (linear, linear, angular), strict=True)):
            variance = covariance[i][i]
            allowed = SIGMAS * math.sqrt(max(variance, 0.0)) + POSE_TOLERANCE + latency * speed
            if not abs(error) <= allowed:
                raise Violation(
                    "odometry",
                    now,
                    f"the pose is {error:.3f} off in {('x', 'y', 'yaw')[i]}; 5 sigma and the"
                    f" tolerance are {allowed:.3f}",
                )
