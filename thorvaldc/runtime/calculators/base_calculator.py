"""Abstract base class of the base calculators, the command that one returns, and their table."""

from __future__ import annotations

import abc
import dataclasses
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Self

from thorvaldc.diagnostics import DiagnosticError, Proposal, Span, did_you_mean
from thorvaldc.model import Robot
from thorvaldc.model.plugins import PluginFailure, PluginTable
from thorvaldc.runtime.base_interface import JointCommands, JointStates, NotFiniteError
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry
from thorvaldc.runtime.calculators.twist_estimator import TwistEstimate, TwistEstimator
from thorvaldc.runtime.calculators.twist_fit import Noise
from thorvaldc.runtime.mypyc_marks import mypyc_attr
from thorvaldc.runtime.se2 import Twist

_MAX_TWIST_SQUARED: Final = 1e18
"""Commanded twists whose square (m^2/s^2) reaches this limit are rejected as not finite."""


@dataclass(slots=True)
class BaseCommand:
    """Joint commands for a twist, with the limits and conditions that changed the twist.

    - ``joints``: commands of the spin and steering joints of each wheel.
    - ``target``: feasible twist for the commanded twist, scaled to the wheels' speed limits.
    - ``twist``: twist of the robot under the joint commands.  ``twist`` differs from ``target``
      while wheels steer or accelerate.  When all wheels have reached their steering angles, the
      wheels roll at ``twist`` without slip.  While wheels steer, they also slip sideways.
      ``twist`` then has the commanded speeds of all driven wheels along their present directions.
      While acceleration limits hold the wheels back, their speeds contradict each other, and
      ``twist`` is the best fit to them.
    - ``infeasible``: part of the commanded twist that fixed wheels and steering limits do not
      allow.
    - ``scale``: factor by which the speed limits reduce the twist, or 1 if no wheel reaches its
      speed limit.
    - ``unreachable``: indices of the wheels whose steering limits exclude the commanded twist.
      These wheels roll at an angle within their limits, at which the robot moves with ``target``.
    - ``required_rates``: for each wheel, the steering rate (rad/s) that would reach the target
      angle within the tick.  A wheel whose steering rate limit is lower than the required rate
      reaches its target angle late.  All required rates are 0 if ``command`` is called without
      ``dt``.
    - ``must_stop``: ``True`` if a rolling wheel has to turn around its steering axis so far that
      the robot must stop first.  The calculator stops the robot, whatever is commanded.
    - ``aligned``: ``True`` if every wheel is close enough to its target angle to roll.
    """

    joints: JointCommands
    target: Twist
    twist: Twist
    infeasible: Twist
    scale: float
    unreachable: tuple[int, ...]
    required_rates: Sequence[float] = ()
    must_stop: bool = False
    aligned: bool = True


@dataclass(frozen=True, slots=True)
class NoOptions:
    """Empty options class for base calculators that have no options."""


@mypyc_attr(allow_interpreted_subclasses=True)
class BaseCalculator(abc.ABC):
    """Abstract base calculator: computes the joint commands and the odometry of one robot.

    A base calculator stores its last joint command.  A calculator class defines the class
    attributes ``name``, ``summary`` and ``Options``.  The class attribute ``Options`` is a frozen
    dataclass of scalars with default values.  The method ``Options.__post_init__`` raises
    ``ValueError`` if an option is out of range.  A subclass also overrides ``unsuited_reason`` to
    reject robots that the calculator cannot drive.

    - ``checked_states``: joint states that the odometry has checked in this control cycle.  The
      method ``command`` does not check them again.
    - ``decelerations``: linear (m/s^2) and angular (rad/s^2) deceleration of a stop.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    Options: ClassVar[type] = NoOptions

    def __init__(
        self, geometry: BaseGeometry, options: Any = None, noise: Noise | None = None
    ) -> None:
        self.geometry = geometry
        self.options = self.Options() if options is None else options
        self.noise = noise or Noise()
        self.estimator = TwistEstimator(geometry, self.noise)
        self.checked_states: JointStates | None = None
        self.decelerations = (math.inf, math.inf)

    @classmethod
    def unsuited_reason(cls, geometry: BaseGeometry) -> str | None:
        """Returns the reason why this calculator cannot drive the robot, or ``None`` if it can."""
        return None

    @abc.abstractmethod
    def feasible(self, twist: Twist) -> Twist:
        """Returns the feasible twist that replaces ``twist``, without regard to speed limits.

        A twist is feasible if it causes no side slip on the fixed wheels, and on the steered wheels
        at steering angles within their limits.  The replacement of an infeasible twist keeps its
        yaw rate or its direction, see ``FixedWheels.feasible`` and the module
        ``reachable_twists``.  It is in general not the nearest feasible twist.
        """

    def limiting_wheels(self, twist: Twist) -> tuple[int, ...]:
        """Returns the indices of the wheels whose steering limits exclude ``twist``."""
        return ()

    @abc.abstractmethod
    def command(
        self, twist: Twist, states: JointStates | None = None, dt: float | None = None
    ) -> BaseCommand:
        """Computes joint commands for a twist of ``base_link``.

        With ``states``, the calculator computes wheel speeds that fit the measured steering angles.
        With ``dt``, the time in s since the last command, the joint commands respect the rate and
        acceleration limits of the motors.  Without ``states`` and ``dt``, the result is the inverse
        kinematics without motor limits.

        Raises ``NotFiniteError`` if the twist, a joint state or ``dt`` is not a finite number.
        After an error, the stored last joint command is unchanged.
        """

    @abc.abstractmethod
    def stop(self, dt: float, measured: JointStates | None = None) -> BaseCommand:
        """Moves the last command towards rest for ``dt`` s.

        No wheel becomes faster or reverses, whatever the joint states are, and the steering joints
        come to rest too.  With ``measured``, the command of each wheel is at most its measured
        speed.
        """

    @property
    def commanded_speeds(self) -> Sequence[float] | None:
        """Last commanded wheel speeds (rad/s), or ``None`` if the calculator does not know them.

        The odometry suspects a wheel that does not turn although it was commanded to turn.
        """
        return None

    def odometry(self, states: JointStates) -> TwistEstimate:
        """Estimates the twist from the joint states.

        Raises ``NotFiniteError`` if a joint state is not a finite number.  Raises ``ValueError`` if
        ``states`` does not have one entry for each wheel.
        """
        return self.estimator.estimate(states, self.commanded_speeds)

    @abc.abstractmethod
    def reset(self, states: JointStates | None = None) -> None:
        """Discards the last joint command of the calculator.

        After a reset, the last command is the steering angles of ``states`` and the speed 0 of all
        wheels.  Without ``states``, all steering angles are zero.
        """

    def with_parameters(self, radii: Sequence[float], noise: Noise) -> Self:
        """Returns a calculator with different wheel radii (m) and measurement noise.

        The returned calculator stores no last joint command.
        """
        return type(self)(self.geometry.with_radii(radii), self.options, noise)

    def resume(self, previous: Self) -> None:
        """Copies the last joint command from ``previous``, a calculator for the same wheels.

        A subclass with additional stored values overrides ``resume`` and also copies the additional
        values.
        """
        return

    def _check(self, twist: Twist, states: JointStates | None, dt: float | None) -> None:
        vx, vy, wz = twist
        if not vx * vx + vy * vy + wz * wz < _MAX_TWIST_SQUARED:  # also rejects NaN
            raise NotFiniteError(f"the commanded twist is {tuple(twist)}")
        if dt is not None and not 0.0 < dt < math.inf:
            raise ValueError(f"the time step is {dt} s; it must be positive")
        if states is not None and states is not self.checked_states:
            self.estimator.check(states)


# -- the table of base calculators, by name, and the checks of their options --------------------

PLUGINS: Final[PluginTable[BaseCalculator]] = PluginTable(
    "thorvaldc.base_calculators",
    BaseCalculator,
    {
        "general": "thorvaldc.runtime.calculators.general:General",
        "differential": "thorvaldc.runtime.calculators.differential:Differential",
        "one_wheel": "thorvaldc.runtime.calculators.differential:OneWheel",
    },
)

_TYPE_NAMES: Final = {bool: "true or false,", int: "a whole number", float: "a number", str: "text"}


class CalculatorError(DiagnosticError):
    """The robot file names an invalid calculator or an invalid option.

    The attribute ``option`` is the name of the invalid option, or ``None`` if the calculator itself
    is invalid.
    """

    def __init__(
        self, code: str, message: str, span: Span | None = None, *, hint: str | None = None
    ) -> None:
        super().__init__(code, message, span, hint=hint)
        self.option: str | None = None


def calculator_names() -> list[str]:
    """Returns the names of all built-in and installed calculators in alphabetical order."""
    return PLUGINS.names()


def calculator_class(name: str) -> type[BaseCalculator]:
    """Returns the class of the base calculator with the name ``name``.

    Raises ``CalculatorError`` if no calculator has this name or its class cannot be loaded.
    """
    cls = PLUGINS.load(name)
    if not isinstance(cls, PluginFailure):
        return cls
    if cls.unknown:
        known = calculator_names()
        hint = did_you_mean(name, known, f"known: {', '.join(known)}")
        raise CalculatorError(
            "calculator-unknown", f"there is no base calculator `{name}`", hint=hint
        )
    raise CalculatorError(
        "calculator-unknown",
        f"base calculator `{name}` {cls.reason}",
        hint="install its package again, or report this to its authors",
    )


def for_robot(robot: Robot) -> BaseCalculator:
    """Returns the calculator that the robot file names, with its options and noise.

    The calculator uses the ordinary wheel radii of the robot file, not a parameter set.  Raises
    ``CalculatorError`` if the calculator is unknown, if it cannot drive this robot, or if an option
    is invalid.
    """
    for error in calculator_errors(robot):
        raise error
    cls = calculator_class(robot.calculator.name)
    options, _ = _read_options(cls, robot)
    noise = Noise(**dict(robot.driver.noise))
    return cls(BaseGeometry.from_robot(robot), options, noise)


def calculator_errors(robot: Robot | str) -> list[CalculatorError]:
    """Returns all errors in the robot file's calculator and calculator options.

    ``robot``: the name of the calculator alone, if there is no robot.
    """
    name = robot if isinstance(robot, str) else robot.calculator.name
    try:
        cls = calculator_class(name)
    except CalculatorError as error:
        diagnostic, span = error.diagnostic, None if isinstance(robot, str) else robot.span
        code, message = diagnostic.code.name, diagnostic.message
        return [CalculatorError(code, message, span, hint=diagnostic.hint)]
    if isinstance(robot, str):
        return []
    _, errors = _read_options(cls, robot)
    reason = cls.unsuited_reason(BaseGeometry.from_robot(robot))
    if reason is not None:
        text = f"base calculator `{cls.name}` cannot drive {robot.name}: {reason}"
        hint = (
            Proposal("use `general`, which drives any arrangement of wheels", "general")
            if cls.name != "general"
            else "give the robot a wheel with a motor"
        )
        errors.insert(0, CalculatorError("calculator-unsuited", text, robot.span, hint=hint))
    return errors


def _read_options(cls: type[BaseCalculator], robot: Robot) -> tuple[Any, list[CalculatorError]]:
    """Returns the robot's calculator options, and all errors in these options.

    The options are an instance of ``cls.Options``.  An invalid option of the calculator is replaced
    by its default value.
    """
    defaults = {field.name: field.default for field in dataclasses.fields(cls.Options)}
    valid: dict[str, Any] = {}
    errors: list[CalculatorError] = []

    def report(option: str | None, text: str, hint: str | None = None) -> None:
        error = CalculatorError("calculator-option", text, robot.span, hint=hint)
        error.option = option
        errors.append(error)

    for name, value in robot.calculator.options:
        if name not in defaults:
            names = f"its options: {', '.join(defaults)}" if defaults else "it has no options"
            text = f"base calculator `{cls.name}` has no option `{name}`"
            report(name, text, did_you_mean(name, defaults, names))
            continue
        default = defaults[name]
        if isinstance(default, float) and type(value) is int:
            value = float(value)
        if type(value) is not type(default):
            report(
                name,
                f"option `{name}` of base calculator `{cls.name}` is {json.dumps(value)}; "
                f"expected {_TYPE_NAMES[type(default)]} such as {json.dumps(default)}",
            )
            continue
        try:
            cls.Options(**{name: value})
        except ValueError as error:
            report(name, f"base calculator `{cls.name}`: {error}")
            continue
        valid[name] = value
    try:
        return cls.Options(**valid), errors
    except ValueError as error:  # two options with valid values can exclude each other
        report(None, f"base calculator `{cls.name}`: {error}")
        return cls.Options(), errors
