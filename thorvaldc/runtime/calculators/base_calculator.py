"""The interface of base calculators."""

from __future__ import annotations

import abc
import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

from thorvaldc.runtime.base_interface import JointCommands, JointStates
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry
from thorvaldc.runtime.calculators.twist_estimator import TwistEstimate, TwistEstimator
from thorvaldc.runtime.calculators.twist_fit import Noise
from thorvaldc.runtime.errors import NotFiniteError
from thorvaldc.runtime.se2 import Twist

_MAX_TWIST_SQUARED = 1e18
"""Square of a commanded twist (m^2/s^2) above which it counts as not finite."""


@dataclass(slots=True)
class BaseCommand:
    """Joint commands for a twist, and how far they realise it.

    ``joints``: commands per wheel.  ``target``: the feasible twist nearest to the commanded one,
    scaled to the speed limits of the wheels.  ``twist``: the twist of these joint commands, which
    differs from ``target`` while wheels steer or accelerate.  ``infeasible``: the part of the
    commanded twist that the fixed wheels do not allow.  ``scale``: factor of the speed limits
    (1: no limit reached).  ``unreachable``: indices of wheels that stand because no angle within
    their steering limits fits the twist.  ``required_rates`` (rad/s, per wheel): the steering rate
    that would reach the target angle within the tick; a wheel with a lower limit is late.  0
    without a time step.  ``must_stop``: a rolling wheel has to turn around.  All wheels hold their
    angles, and the driver has to ramp the twist down to zero; then the wheel turns.
    ``aligned``: every wheel is near enough to its target angle to roll.
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
    """Options of a calculator that has none.  Options are a frozen dataclass of scalars."""


OdometryMethod = Callable[[Any, JointStates], TwistEstimate]


def finite_result(odometry: OdometryMethod) -> OdometryMethod:
    """Decorates an odometry method: it raises ``NotFiniteError`` if the result is not finite."""

    @functools.wraps(odometry)
    def checked(self: Any, states: JointStates) -> TwistEstimate:
        try:
            estimate = odometry(self, states)
        except (ZeroDivisionError, OverflowError):
            raise NotFiniteError("the joint states are out of all bounds") from None
        total = sum(estimate.twist) + sum(map(sum, estimate.covariance)) + sum(estimate.chi_squares)
        if not math.isfinite(total):
            raise NotFiniteError("the joint states are out of all bounds")
        return estimate

    return checked


class BaseCalculator(abc.ABC):
    """Joint commands and odometry of one robot; stores its last command.

    A subclass defines its name, its options as a frozen dataclass with defaults (whose
    ``__post_init__`` raises ``ValueError`` for values out of range), and in
    ``unsuited_reason`` the robots that it cannot drive.
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
    def unsuited_reason(cls, geometry: BaseGeometry) -> str | None:
        """Returns why this calculator cannot drive such a robot, or ``None`` if it can."""
        return None

    @abc.abstractmethod
    def feasible(self, twist: Twist) -> Twist:
        """Returns the nearest twist that the fixed wheels allow, without regard to speed limits."""

    @abc.abstractmethod
    def command(
        self, twist: Twist, states: JointStates | None = None, dt: float | None = None
    ) -> BaseCommand:
        """Computes joint commands for a twist of ``base_link``.

        With ``states``, the wheel speeds fit the steering angles that the wheels have now.  With
        ``dt`` (s since the last command), steering and drive motors keep their rates and
        accelerations.  Without both, the result is the inverse kinematics.  Raises
        ``NotFiniteError`` for a value that is not a finite number, and then changes nothing.
        """

    def odometry(self, states: JointStates) -> TwistEstimate:
        """Estimates the twist from the joint states.  Raises ``NotFiniteError``, ``ValueError``."""
        return self.estimator.estimate(states)

    @abc.abstractmethod
    def reset(self, states: JointStates | None = None) -> None:
        """Forgets the last command; the joints are at ``states``, or at zero without them."""

    def with_parameters(self, radii: Sequence[float], noise: Noise) -> Self:
        """Returns a calculator with other wheel radii (m) and noise, and without a last command."""
        return type(self)(self.geometry.with_radii(radii), self.options, noise)

    def resume(self, previous: Self) -> None:
        """Takes over the last command of ``previous``, a calculator for the same wheels.

        A subclass that stores anything between commands takes it over here.
        """
        return

    def _check(self, twist: Twist, states: JointStates | None, dt: float | None) -> None:
        vx, vy, wz = twist
        if not vx * vx + vy * vy + wz * wz < _MAX_TWIST_SQUARED:  # true for a NaN, too
            raise NotFiniteError(f"the commanded twist is {tuple(twist)}")
        if dt is not None and not 0.0 < dt < math.inf:
            raise ValueError(f"the time step is {dt} s; it must be positive")
        if states is not None:
            self.estimator.check(states)
