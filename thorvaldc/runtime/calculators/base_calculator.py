"""Abstract base class of the base calculators, and the command that a calculator returns."""

from __future__ import annotations

import abc
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

from thorvaldc.runtime.base_interface import JointCommands, JointStates
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry
from thorvaldc.runtime.calculators.twist_estimator import TwistEstimate, TwistEstimator
from thorvaldc.runtime.calculators.twist_fit import Noise
from thorvaldc.runtime.errors import NotFiniteError
from thorvaldc.runtime.se2 import Twist

_MAX_TWIST_SQUARED = 1e18
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
      the robot must stop first.  All wheels hold their steering angles until the driver has ramped
      the twist down to zero.
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


class BaseCalculator(abc.ABC):
    """Abstract base calculator: computes the joint commands and the odometry of one robot.

    A base calculator stores its last joint command.  A calculator class defines the class
    attributes ``name``, ``summary`` and ``Options``.  The class attribute ``Options`` is a frozen
    dataclass of scalars with default values.  The method ``Options.__post_init__`` raises
    ``ValueError`` if an option is out of range.  A subclass also overrides ``unsuited_reason`` to
    reject robots that the calculator cannot drive.

    ``checked_states``: joint states that the odometry has checked in this control cycle.  The
    method ``command`` does not check them again.
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

        After a reset, the calculator assumes that the joints have the joint states ``states``.
        Without ``states``, the calculator assumes that all steering angles and wheel speeds are
        zero.
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
