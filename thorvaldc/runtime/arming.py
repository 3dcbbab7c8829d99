"""A robot that can be armed and stopped: the conditions under which a commanded twist moves it.

The robot is armed only if it passes all checks of ``PRE_ARM_CHECKS``.  Each check is a function
that returns its reasons against arming.  All reasons of all checks are reported together, so that
the operator can remove them in one go.  Stop locks, low batteries and silence of all sources disarm
the robot again.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.model.settings import AUTOMATIC, SAFETY_STOP
from thorvaldc.runtime.base_interface import BaseHandle, ParameterError, RequestRefused
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.multiplexer import Multiplexer
from thorvaldc.runtime.pace import Pace, Timing
from thorvaldc.runtime.se2 import ZERO_TWIST
from thorvaldc.runtime.service_table import THIS_PROGRAM

Feed = Callable[[BaseDriver, float], object]
"""Function that is called at the start of each control cycle with the driver and the time (s), and
may command a twist."""
PreArmCheck = Callable[["ArmableRobot", float], Iterable[str]]
"""Function that returns the reasons against arming, from the robot and the time (s)."""
GAP_MEMORY = 2.0
"""Time (s) after a gap in time in which the robot is not armed."""


class RunEvent(NamedTuple):
    """An event of a run at the time ``time`` (s), such as ``armed``."""

    time: float
    text: str


class ArmableRobot:
    """A robot with its driver and the sources that command it, and its permission to move.

    - ``base``, ``driver``, ``multiplexer``: parts of the robot;
    - ``pace``: when control cycles are due, with the statistics ``timing``;
    - ``feed``: function that commands a twist, in addition to the sources of the multiplexer;
    - ``paused``: ``True`` while a simulation is paused;
    - ``events``: what has happened, such as ``armed``.
    """

    def __init__(
        self, base: BaseHandle, driver: BaseDriver, pace: Pace, arming: str | None
    ) -> None:
        """Takes the robot's permission to move away, until it is armed.

        ``arming`` replaces the setting of the robot file.
        """
        self.robot = robot = driver.robot
        self.base = base
        self.driver = driver
        self.driver.permission.disarm()
        self.pace = pace
        self.multiplexer = Multiplexer.from_robot(robot)
        self.feed: Feed | None = None
        self.paused = False
        self.events: list[RunEvent] = []
        self.other_versions: dict[str, str] = {}
        """Versions of other programs that differ from this one, with a sentence about each."""
        self.pre_arm_checks: list[PreArmCheck] = list(PRE_ARM_CHECKS)
        self.stop_engaged = False
        """``True`` from the service ``safety_stop`` until its release by all programs."""
        self._automatic = (arming or robot.driver.arming) == AUTOMATIC
        self._arms_itself = self._automatic
        self._arming_owner: str | None = None
        """Program whose arming waits for the end of the homing."""
        self._armed_at = -math.inf

    @property
    def now(self) -> float:
        """Time (s) of the robot."""
        return self.pace.clock.now

    @property
    def timing(self) -> Timing:
        return self.pace.timing

    @property
    def armed(self) -> bool:
        """``True`` if the robot accepts motion."""
        return self.driver.permission.armed

    @property
    def arming(self) -> bool:
        """``True`` while an arming waits for the end of the homing."""
        return self._arming_owner is not None

    @property
    def ready(self) -> bool:
        """``True`` if the base follows joint commands."""
        return not self.base.hold_reason

    # -- arming ------------------------------------------------------------------------------------

    def arming_reasons(self, now: float) -> list[str]:
        """Returns the reasons of all checks against arming the robot at ``now`` (s)."""
        reasons = [reason for check in self.pre_arm_checks for reason in check(self, now)]
        # Two checks can have the same reason, such as a motion that is commanded by a source.
        return list(dict.fromkeys(reasons))

    def arm(self, owner: str = THIS_PROGRAM) -> str:
        """Accepts motion of the robot, if all pre-arm checks pass; homes the steering first.

        The robot is disarmed at the start, after each fault, stop and homing, and after ``disarm``.
        If the steering has to be homed, the robot is armed at the end of the homing, if the program
        ``owner`` has not ended before and all checks pass again.

        Returns an empty text, or what the arming waits for.  Raises ``RequestRefused`` with the
        reasons of all checks that do not pass.
        """
        if self.armed:
            return ""
        now = self.now
        self._arms_itself = self._automatic
        if self._arming_owner is None:
            _raise_if("; ".join(self.arming_reasons(now)))
            if self.base.is_homed:
                self._accept_motion(now)
                return ""
            _raise_if(self.base.home(now))
            self._arming_owner = owner
            self.note("homing the steering")
        return "homing the steering; the robot is armed when it has ended"

    def disarm(self, reason: str = "") -> None:
        """Accepts no motion until ``arm`` is called.  A moving robot ramps to rest.

        ``reason``: reason why the robot disarms itself.  Without a reason a person disarms it, and
        automatic arming ends.
        """
        if self.armed:
            self.note(reason or "disarmed")
        self.driver.permission.disarm(reason)
        self._arming_owner = None
        if not reason:
            self._arms_itself = False

    def home_steering(self) -> None:
        """Homes all steering joints, also those that are homed.

        The steering joints turn during homing, and the robot is disarmed.
        """
        stops = self.multiplexer.active_stop_locks(self.now)
        _raise_if(f"the stop lock `{stops[0]}` is active" if stops else "")
        _raise_if(self.base.home(self.now, again=True))

    def _accept_motion(self, now: float) -> None:
        self.driver.permission.arm()
        self.multiplexer.accept_motion(now)
        self._armed_at = now
        self.note("armed")

    def _supervise_arming(self, now: float) -> None:
        """Disarms the robot for every reason to do so, and continues an arming that waits."""
        base = self.base
        stops = self.multiplexer.active_stop_locks(now)
        if stops:
            base.cancel_homing(now)
        if self.armed:
            if stops:
                self.disarm(f"disarmed: the stop lock `{stops[0]}` is active")
            elif base.disarming_reason:
                self.disarm(f"disarmed: {base.disarming_reason}")
            elif self._forgotten(now):
                timeout = self.driver.settings.arming_timeout
                self.disarm(f"disarmed: no source was heard for {timeout:g} s")
        elif self._arming_owner is not None:
            if not base.is_homing:
                self._arming_owner = None
                self._arm_if_allowed(now)
        elif self._arms_itself and (self.ready or not base.is_homed):
            # A homing moves the steering, so that it waits until somebody has commanded zero.
            if base.is_homed:
                self._arm_if_allowed(now)
            elif self.multiplexer.holders(now) or self.feed is not None:
                with contextlib.suppress(RequestRefused):
                    self.arm()

    def _arm_if_allowed(self, now: float) -> None:
        reasons = "; ".join(self.arming_reasons(now))
        if reasons:
            self.driver.permission.disarm(f"disarmed: {reasons}")
        else:
            self._accept_motion(now)

    def _forgotten(self, now: float) -> bool:
        """Checks whether no source was heard for the time after which an arming ends."""
        if self._automatic or self.feed is not None:
            return False
        heard = max(self._armed_at, self.multiplexer.last_heard)
        return now - heard > self.driver.settings.arming_timeout

    # -- stops and faults --------------------------------------------------------------------------

    def safety_stop(
        self, engaged: bool = True, *, owner: str = THIS_PROGRAM, force: bool = False
    ) -> None:
        """Stops all motors of the base and switches the motors off.

        With ``engaged=False``, releases the safety stop of the program ``owner``, or with ``force``
        of all programs.  Raises ``RequestRefused`` if another program has engaged it.

        After the release, the services ``reset`` and ``arm`` must be called before the robot can
        drive again.  A stop in software is not a safety function.
        """
        self.lock(SAFETY_STOP, engaged, owner=owner, force=force)
        self.stop_engaged = engaged
        if engaged:
            self.disarm("disarmed: the safety stop is engaged")
        self.base.safety_stop(engaged)

    @property
    def stop_owners(self) -> tuple[str, ...]:
        """Names of the programs that have engaged the safety stop, also those that have ended."""
        return self.multiplexer.lock_owners(SAFETY_STOP) if self.stop_engaged else ()

    def lock(
        self, name: str, locked: bool = True, *, owner: str = THIS_PROGRAM, force: bool = False
    ) -> None:
        """Sets a twist lock of the program ``owner``, or releases it, see ``Multiplexer.lock``.

        Raises ``RequestRefused`` if another program keeps it locked.
        """
        others = [name for name in self.multiplexer.lock_owners(name) if name != owner]
        try:
            self.multiplexer.lock(name, locked, self.now, owner, force=force)
        except ParameterError as error:
            raise RequestRefused(str(error)) from None
        if force and others and not locked:
            self.note(f"{owner} released by force `{name}` of {' and '.join(others)}")

    def reset(self) -> None:
        """Resets a fault or a stop.  After the reset, the robot is disarmed.

        Raises ``RequestRefused`` unless the safety stop is released and no motion is commanded.
        """
        now = self.now
        commanded = self.driver.commanded_twist(now) != ZERO_TWIST
        _raise_if(self.base.reset(now, commanded or bool(self.multiplexer.requests(now))))
        self.driver.reset()

    def set_drive_parameters(
        self,
        parameters: str | None = None,
        *,
        radii: dict[str, float] | None = None,
        limits: dict[str, float] | None = None,
    ) -> None:
        """Switches to a parameter set of the robot file, or changes single parameters.

        - ``parameters``: name of a parameter set, or ``None`` for the ordinary parameters;
        - ``radii``: wheel radii (m) by wheel name;
        - ``limits``: limits in SI units by name.

        All parameter changes take effect together, between two control cycles.  Raises
        ``RequestRefused`` if a name or a value is invalid.  Then no parameter is changed.
        """
        try:
            if radii or limits:
                self.driver.update(radii=radii, noise=None, **(limits or {}))
            else:
                self.driver.use(parameters)
        except (ParameterError, DiagnosticError) as error:
            raise RequestRefused(str(error)) from None

    def note(self, text: str) -> None:
        """Records an event for the summary of the run, such as ``armed``."""
        self.events.append(RunEvent(self.now, text))

    def end_program(self, name: str) -> None:
        """Notes that a program has ended: its twists are void, its stops stay engaged."""
        self.multiplexer.release(name)
        if self._arming_owner == name:
            self._arming_owner = None
            self.note("not armed: the program that armed has ended during the homing")


def _raise_if(reason: str) -> None:
    """Raises ``RequestRefused`` with the text ``reason`` if ``reason`` is not empty."""
    if reason:
        raise RequestRefused(reason)


def check_base(robot: ArmableRobot, now: float) -> Iterable[str]:
    """Requires that the base is ready: nodes, drives and batteries of a robot on its buses."""
    return robot.base.arming_reasons(now)


def check_stops(robot: ArmableRobot, now: float) -> Iterator[str]:
    if robot.stop_engaged:
        yield "the safety stop is engaged"
    for name in robot.multiplexer.active_stop_locks(now):
        if not (robot.stop_engaged and name == SAFETY_STOP):
            yield f"the stop lock `{name}` is active"


def check_commands(robot: ArmableRobot, now: float) -> Iterator[str]:
    """Refuses to arm while a motion is commanded, which would start at once.

    A source counts also behind a lock and below a source of a higher priority: it would drive as
    soon as the lock is released or the other source is silent.
    """
    sources = robot.multiplexer.requests(now)
    if not sources and robot.driver.commanded_twist(now) != ZERO_TWIST:
        yield "a motion is commanded; command zero first"
    for name in sources:
        yield f"`{name}` commands a motion"


def check_time(robot: ArmableRobot, now: float) -> Iterator[str]:
    if robot.paused:
        yield "the simulation is paused"
    if robot.driver.permission.fault:
        yield robot.driver.permission.fault
    gap = robot.timing.latest_gap
    if gap is not None and now - gap[0] < GAP_MEMORY:
        yield (
            f"there was no control cycle for {gap[1] * 1000.0:.0f} ms, {now - gap[0]:.1f} s ago;"
            " is the computer too busy?"
        )


PRE_ARM_CHECKS: tuple[PreArmCheck, ...] = (check_base, check_stops, check_commands, check_time)
