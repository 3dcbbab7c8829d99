"""A robot that can be armed and stopped: the conditions under which a commanded twist moves it.

The robot is armed only if it passes all checks of ``PRE_ARM_CHECKS``.  Each check is a function
that returns its reasons against arming.  All reasons of all checks are reported together, so that
the operator can remove them in one go.  What the robot may do then, and what disarms it, are the
rules of the module ``permission``: this module reports to them what happens, and what they answer
to the base.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.runtime.base_interface import BaseHandle, ParameterError, RequestRefused
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.multiplexer import Multiplexer
from thorvaldc.runtime.pace import Pace, Timing, gap_text
from thorvaldc.runtime.permission import (
    SERVICE_STOP,
    THIS_PROGRAM,
    Answer,
    Base,
    MotionPermission,
    Rules,
)
from thorvaldc.runtime.se2 import ZERO_TWIST

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
    - ``start_time``: time (s) at which the driver was made;
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
        self.permission = driver.permission = MotionPermission.of(robot, arming or "", armed=False)
        self.permission.home = lambda again: base.home(self.now, again=again)
        self.pace = pace
        self.start_time = self.now
        self.multiplexer = Multiplexer(driver.permission)
        self.feed: Feed | None = None
        self.paused = False
        self.events: list[RunEvent] = []
        self.other_versions: dict[str, str] = {}
        """Versions of other programs that differ from this one, with a sentence about each."""
        self.pre_arm_checks: list[PreArmCheck] = list(PRE_ARM_CHECKS)

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
        return self.permission.value.armed

    @property
    def arming(self) -> bool:
        """``True`` while an arming waits for the end of the homing."""
        return bool(self.permission.value.arming_owner)

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
        return self._arm(owner)

    def _arm(self, owner: str, by_itself: bool = False) -> str:
        now = self.now
        reasons = () if self.armed or self.arming else tuple(self.arming_reasons(now))
        homed = self.base.is_homed
        answer = self.permission.step(Rules.arm, now, owner, reasons, homed, by_itself)
        return self._done(answer)

    def disarm(self, reason: str = "") -> None:
        """Accepts no motion until ``arm`` is called.  A moving robot ramps to rest.

        ``reason``: reason why the robot disarms itself.  Without a reason a person disarms it, and
        automatic arming ends.
        """
        self._done(self.permission.step(Rules.disarm, reason))

    def home_steering(self) -> None:
        """Homes all steering joints, also those that are homed.

        The steering joints turn during homing, and the robot is disarmed.
        """
        self._done(self.permission.step(Rules.home, self.now))

    def _done(self, answer: Answer) -> str:
        """Does what an answer requires, and returns its text.  Raises ``RequestRefused``."""
        _raise_if(answer.refusal)
        if answer.stop is not None:
            self.base.safety_stop(answer.stop)
        if answer.note:
            self.note(answer.note)
        return answer.text

    def _select(self, now: float) -> None:
        """Selects the source of this control cycle; disarms the robot for every reason to do so,
        and continues an arming that waits."""
        base, rules = self.base, self.permission.rules
        report = Base(self.ready, base.is_homed, base.is_homing, base.disarming_reason)
        answer = self.multiplexer.feed(self.driver, now, report, self.feed is not None)
        self._done(answer)
        if any(rules.locks[k].is_stop_lock for k in answer.locked):
            base.cancel_homing(now)
        if answer.arm:
            try:
                self._arm(THIS_PROGRAM, by_itself=True)
            except RequestRefused as error:
                if report.homed:
                    self.disarm(f"disarmed: {error}")

    # -- stops and faults --------------------------------------------------------------------------

    def safety_stop(
        self, engaged: bool = True, *, owner: str = THIS_PROGRAM, force: bool = False
    ) -> str:
        """Stops all motors of the base and switches the motors off.

        With ``engaged=False``, releases the safety stop of the program ``owner``, or with ``force``
        of all programs, and returns the other programs that stop the robot as text.  Raises
        ``RequestRefused`` if only other programs have engaged it.

        After the release, the services ``reset`` and ``arm`` must be called before the robot can
        drive again.  A stop in software is not a safety function.
        """
        step, now = self.permission.step, self.now
        return self._done(step(Rules.set_lock, SERVICE_STOP, engaged, now, owner, force))

    @property
    def stop_owners(self) -> tuple[str, ...]:
        """Names of the programs that stop the robot, also those that have ended."""
        return tuple(self.permission.rules.stopped_by(self.permission.value, self.now))

    def lock(
        self, name: str, locked: bool = True, *, owner: str = THIS_PROGRAM, force: bool = False
    ) -> str:
        """Sets a twist lock of the program ``owner``, or releases it, see ``Multiplexer.lock``.

        Returns the programs that keep it locked as text.  Raises ``RequestRefused`` if only other
        programs do.
        """
        try:
            return self._done(self.multiplexer.lock(name, locked, self.now, owner, force=force))
        except ParameterError as error:
            raise RequestRefused(str(error)) from None

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
        self._done(self.multiplexer.release(name))


def _raise_if(reason: str) -> None:
    """Raises ``RequestRefused`` with the text ``reason`` if ``reason`` is not empty."""
    if reason:
        raise RequestRefused(reason)


def check_base(robot: ArmableRobot, now: float) -> Iterable[str]:
    """Requires that the base is ready: nodes, drives and batteries of a robot on its buses."""
    return robot.base.arming_reasons(now)


def check_stops(robot: ArmableRobot, now: float) -> Iterator[str]:
    rules = robot.permission.rules
    return map(rules.stop_text, rules.stops(robot.permission.value, now))


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
    if fault := robot.permission.value.fault:
        yield fault
    gap = robot.timing.latest_gap
    if gap is not None and now - gap[0] < GAP_MEMORY:
        ago = now - gap[0]
        yield f"there was {gap_text(gap[1])}, {ago:.1f} s ago; is the computer too busy?"


PRE_ARM_CHECKS: tuple[PreArmCheck, ...] = (check_base, check_stops, check_commands, check_time)
