"""A base calculator: what every one of them offers."""

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

_TOO_FAST = 1e18
"""Square of a twist beyond all bounds, m^2/s^2."""


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
    ``must_stop``: a wheel that rolls has to turn around, which it does once the robot stands;
    until then all hold their angles, and whoever drives ramps down to rest.
    ``aligned``: no wheel has further to turn than one may that rolls.
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
    """A calculator's options are a frozen dataclass of scalars; here there are none."""


Odometry = Callable[[Any, JointStates], TwistEstimate]


def bounded(odometry: Odometry) -> Odometry:
    """``NotFiniteError`` in place of a result that is not finite, for joints beyond all bounds."""

    @functools.wraps(odometry)
    def checked(self: Any, states: JointStates) -> TwistEstimate:
        try:
            found = odometry(self, states)
        except (ZeroDivisionError, OverflowError):
            raise NotFiniteError("the joint states are out of all bounds") from None
        told = sum(found.twist) + sum(map(sum, found.covariance)) + sum(found.chi_squares)
        if not math.isfinite(told):
            raise NotFiniteError("the joint states are out of all bounds")
        return found

    return checked


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
    def unsuited_reason(cls, geometry: BaseGeometry) -> str | None:
        """Why this calculator cannot drive such a robot; ``None`` where it can."""
        return None

    @abc.abstractmethod
    def feasible(self, twist: Twist) -> Twist:
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

    def with_parameters(self, radii: Sequence[float], noise: Noise) -> Self:
        """Such a calculator for other wheel radii (m) and errors, with nothing commanded yet."""
        return type(self)(self.geometry.with_radii(radii), self.options, noise)

    def resume(self, before: Self) -> None:
        """Go on from what ``before``, another for the same wheels, has commanded.

        A subclass that keeps anything between commands takes it over here.
        """
        return

    def _check(self, twist: Twist, states: JointStates | None, dt: float | None) -> None:
        vx, vy, wz = twist
        if not vx * vx + vy * vy + wz * wz < _TOO_FAST:  # so is a NaN
            raise NotFiniteError(f"the commanded twist is {tuple(twist)}")
        if dt is not None and not 0.0 < dt < math.inf:
            raise ValueError(f"the time step is {dt} s; it must be positive")
        if states is not None:
            self.estimator.check(states)
