"""Base calculators: from a twist to the joints, and from the joints to a twist.

One file and one line in the table of ``registry`` each; those from outside come by
the entry point group ``thorvaldc.base_calculators``.
"""

from __future__ import annotations

from thorvaldc.runtime.calculators.base_calculator import BaseCalculator, BaseCommand, NoOptions
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry, WheelGeometry
from thorvaldc.runtime.calculators.calculator_registry import (
    PLUGINS,
    calculator_class,
    faults,
    for_robot,
    names,
)
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
    "faults",
    "for_robot",
    "names",
]
