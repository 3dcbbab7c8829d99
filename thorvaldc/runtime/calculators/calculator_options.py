"""Options of the calculators ``general``, ``differential`` and ``one_wheel``.

This module is not compiled: plug-ins derive their options from these, and a frozen dataclass cannot
set the attributes of a compiled one.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SteeringOptions:
    """Options of calculators that steer wheels.

    - ``hysteresis``: a steered wheel changes between rolling forwards and backwards only if the
      change saves more than this time (s).
    - ``arrive_together``: if ``True``, all wheels take the same time to turn to new angles.
    """

    hysteresis: float = 0.02
    arrive_together: bool = True

    def __post_init__(self) -> None:
        if not 0.0 <= self.hysteresis <= 10.0:
            raise ValueError(f"hysteresis is {self.hysteresis:g} s; it must be 0 to 10 s")


@dataclass(frozen=True, slots=True)
class GeneralOptions(SteeringOptions):
    """Options of the calculator ``general``, in addition to the steering options.

    - ``faulty_wheels``: largest number of faulty wheels that the odometry may leave out, 0 to 2.
    - ``polish``: number of additional Gauss-Newton steps of the odometry.  Each additional
      Gauss-Newton step brings the estimated twist closer to the maximum-likelihood estimate.
    """

    faulty_wheels: int = 2
    polish: int = 0

    def __post_init__(self) -> None:
        # slots=True creates a new class, for which super() without arguments fails.
        SteeringOptions.__post_init__(self)
        if self.faulty_wheels not in (0, 1, 2):
            raise ValueError(f"faulty_wheels is {self.faulty_wheels}; it must be 0, 1 or 2")
        if not 0 <= self.polish <= 10:
            raise ValueError(f"polish is {self.polish}; it must be 0 to 10")
