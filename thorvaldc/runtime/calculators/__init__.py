"""Base calculators convert a twist to joint commands, and joint states to a twist estimate.

``general`` has the inverse kinematics of any set of driven and steered wheels (``steering_branch``
chooses the direction of a wheel, ``reachable_twists`` keeps the limits), and ``twist_estimator``
the twist from the joints; the other calculators are checks and commands over ``general``.

To add a base calculator to this package, list its class in ``base_calculator``.  Other Python
packages add base calculators with the entry point group ``thorvaldc.base_calculators``.
"""

from __future__ import annotations

from thorvaldc.runtime.calculators.base_calculator import (
    PLUGINS,
    BaseCalculator,
    BaseCommand,
    NoOptions,
    calculator_class,
    calculator_errors,
    calculator_names,
    for_robot,
)
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry, WheelGeometry
from thorvaldc.runtime.calculators.twist_estimator import TwistEstimate
from thorvaldc.runtime.calculators.twist_fit import Noise

__all__ = [
    "PLUGINS",
    "BaseCalculator",
    "BaseCommand",
    "BaseGeometry",
    "NoOptions",
    "Noise",
    "TwistEstimate",
    "WheelGeometry",
    "calculator_class",
    "calculator_errors",
    "calculator_names",
    "for_robot",
]
