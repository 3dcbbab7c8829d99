"""Base calculators: from a twist to the joints, and from the joints to a twist.

One file and one line in the table each; those from outside come by the entry
point group ``thorvaldc.base_calculators``.
"""

from __future__ import annotations

import abc
import dataclasses
import difflib
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from thorvaldc.model import Robot
from thorvaldc.runtime.base import JointCommands, JointStates
from thorvaldc.runtime.calculators.estimator import Noise, TwistEstimate, TwistEstimator
from thorvaldc.runtime.calculators.geometry import BaseGeometry, WheelGeometry
from thorvaldc.runtime.faults import NotFiniteError, RuntimeFault
from thorvaldc.runtime.se2 import Twist

__all__ = [
    "BUILTIN",
    "ENTRY_POINT_GROUP",
    "BaseCalculator",
    "BaseCommand",
    "BaseGeometry",
    "NoOptions",
    "Noise",
    "TwistEstimate",
    "WheelGeometry",
    "calculator_class",
    "for_robot",
    "names",
]

BUILTIN: dict[str, str] = {
    "general": "thorvaldc.runtime.calculators.general:General",
    "differential": "thorvaldc.runtime.calculators.differential:Differential",
    "one_wheel": "thorvaldc.runtime.calculators.one_wheel:OneWheel",
    "random_pairs": "thorvaldc.runtime.calculators.random_pairs:RandomPairs",
}
ENTRY_POINT_GROUP = "thorvaldc.base_calculators"


@dataclass(slots=True)
class BaseCommand:
    """What the joints shall do for a twist.

    ``joints``: per wheel.  ``target``: the twist aimed at, the nearest to the
    one asked for that fixed wheels allow and wheels are fast enough for.
    ``twist``: what the joints do now, while wheels still turn to their
    angles.  ``infeasible``: the part that was asked for and that the fixed
    wheels do not allow.  ``scale``: by how much the speed limits slowed it
    down (1: not).  ``unreachable``: indices of wheels whose steering limits
    leave no angle for the twist; they stand.  ``required_rates`` (rad/s, per
    wheel): how fast its steering would have to turn to be at its angle at the end
    of the tick; beyond its limit the wheel is late.  0 without a time step.
    """

    joints: JointCommands
    target: Twist
    twist: Twist
    infeasible: Twist
    scale: float
    unreachable: tuple[int, ...]
    required_rates: Sequence[float] = ()


@dataclass(frozen=True, slots=True)
class NoOptions:
    """A calculator's options are a frozen dataclass of scalars; here there are none."""


class BaseCalculator(abc.ABC):
    """Joint commands and odometry of one robot.  Keeps what it last commanded.

    A subclass names itself, gives its options as a frozen dataclass with
    defaults (its ``__post_init__`` raises ``ValueError`` for values out of
    range) and says by ``unsuited`` which robots it is not for.
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

    @classmethod
    def unsuited(cls, geometry: BaseGeometry) -> str | None:
        """Why this calculator cannot drive such a robot; ``None`` where it can."""
        return None

    @abc.abstractmethod
    def allowed(self, twist: Twist) -> Twist:
        """The nearest twist that the wheels' arrangement allows, at any speed."""

    @abc.abstractmethod
    def command(
        self, twist: Twist, states: JointStates | None = None, dt: float | None = None
    ) -> BaseCommand:
        """Joint commands for a twist of ``base_link``.

        With ``states`` wheel speeds agree with the angles that the wheels have
        now; with ``dt`` (s since the last command) steering keeps its rates.
        Without either it is the pure inverse.  Raises ``NotFiniteError`` and
        changes nothing where a value is not a finite number.
        """

    def odometry(self, states: JointStates) -> TwistEstimate:
        """The twist that the joints tell.  Raises ``NotFiniteError`` for bad states."""
        return self.estimator.estimate(states)

    @abc.abstractmethod
    def reset(self, states: JointStates | None = None) -> None:
        """Forget what was commanded; the joints are where ``states`` says, or at zero."""

    def _check(self, twist: Twist, states: JointStates | None, dt: float | None) -> None:
        vx, vy, wz = twist
        if not math.isfinite(vx + vy + wz):
            raise NotFiniteError(f"the commanded twist is {tuple(twist)}")
        if dt is not None and not 0.0 < dt < math.inf:
            raise ValueError(f"the time step is {dt} s; it must be positive")
        if states is not None:
            self.estimator.check(states)


_KINDS = {bool: "true or false,", int: "a whole number", float: "a number", str: "text"}


def names() -> list[str]:
    """All calculators, built in and from outside, in alphabetical order."""
    from importlib.metadata import entry_points

    return sorted({*BUILTIN, *(e.name for e in entry_points(group=ENTRY_POINT_GROUP))})


def calculator_class(name: str) -> type[BaseCalculator]:
    """The calculator of that name.  Raises ``KeyError`` for an unknown one."""
    if name in BUILTIN:
        from importlib import import_module

        module, attribute = BUILTIN[name].split(":")
        builtin: type[BaseCalculator] = getattr(import_module(module), attribute)
        return builtin
    from importlib.metadata import entry_points

    for entry in entry_points(group=ENTRY_POINT_GROUP):
        if entry.name == name:
            found: type[BaseCalculator] = entry.load()
            return found
    raise KeyError(name)


def for_robot(robot: Robot, radii: str | None = None) -> BaseCalculator:
    """The calculator that the robot's file names, for its wheels.

    ``radii`` names the set of wheel radii in force.  Raises ``RuntimeFault``
    where there is no such calculator, where it is not for such a robot and
    where an option is wrong.
    """
    choice = robot.calculator
    try:
        cls = calculator_class(choice.name)
    except KeyError:
        known = names()
        near = difflib.get_close_matches(choice.name, known, 1)
        hint = f"did you mean `{near[0]}`?" if near else f"known: {', '.join(known)}"
        raise RuntimeFault(
            "calculator-unknown",
            f"there is no base calculator `{choice.name}`",
            robot.origin,
            hint=hint,
        ) from None
    geometry = BaseGeometry.from_robot(robot, radii)
    reason = cls.unsuited(geometry)
    if reason is not None:
        raise RuntimeFault(
            "calculator-unsuited",
            f"base calculator `{cls.name}` cannot drive {robot.name}: {reason}",
            robot.origin,
            hint="use base_calculator: general, which drives any arrangement of wheels"
            if cls.name != "general"
            else "give the robot a wheel with a motor",
        )
    return cls(geometry, _options(cls, robot))


def _options(cls: type[BaseCalculator], robot: Robot) -> Any:
    known = {f.name: f for f in dataclasses.fields(cls.Options)}
    given: dict[str, Any] = {}
    for key, value in robot.calculator.options:
        if key not in known:
            near = difflib.get_close_matches(key, known, 1)
            hint = f"did you mean `{near[0]}`?" if near else None
            if hint is None:
                hint = f"its options: {', '.join(known)}" if known else "it has no options"
            raise RuntimeFault(
                "calculator-option",
                f"base calculator `{cls.name}` has no option `{key}`",
                robot.origin,
                hint=hint,
            )
        default = known[key].default
        if isinstance(default, float) and type(value) is int:
            value = float(value)
        if type(value) is not type(default):
            raise RuntimeFault(
                "calculator-option",
                f"option `{key}` of base calculator `{cls.name}` is {json.dumps(value)}; "
                f"expected {_KINDS[type(default)]} such as {json.dumps(default)}",
                robot.origin,
            )
        given[key] = value
    try:
        return cls.Options(**given)
    except ValueError as fault:
        raise RuntimeFault(
            "calculator-option", f"base calculator `{cls.name}`: {fault}", robot.origin
        ) from fault
