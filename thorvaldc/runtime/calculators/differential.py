"""Base calculator ``differential``: ``general``, for robots that turn by the speeds of one axle."""

from __future__ import annotations

from thorvaldc.runtime.calculators.base_calculator import NoOptions
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry, FixedWheels
from thorvaldc.runtime.calculators.general import General, GeneralOptions
from thorvaldc.runtime.calculators.twist_estimator import Noise


class Differential(General):
    """Refuses robots with steered wheels, and robots that turn by skidding.

    A robot file that names it states what the robot is, so that a later change of the wheels that
    ``general`` would accept is an error.
    """

    name = "differential"
    summary = "driven wheels on one axle, steered by the difference of their speeds"
    Options = NoOptions

    def __init__(
        self, geometry: BaseGeometry, options: NoOptions | None = None, noise: Noise | None = None
    ) -> None:
        super().__init__(geometry, GeneralOptions(), noise)

    @classmethod
    def unsuited_reason(cls, geometry: BaseGeometry) -> str | None:
        steered = [w.name for w in geometry.wheels if w.steered]
        if steered:
            return f"it has steered wheels ({', '.join(steered)})"
        driven = [w for w in geometry.driven if not w.swivel]
        if len(driven) < 2:
            return f"it has {len(driven)} driven wheels; two or more are needed"
        fixed = FixedWheels(geometry.wheels)
        if len(fixed.rows) > 1:
            return "its fixed wheels point in different directions"
        if fixed.skids:
            names = ", ".join(geometry.wheels[i].name for i in fixed.skids)
            return f"its fixed wheels ({names}) are not on one axle, so that it turns by skidding"
        nx, ny, _ = fixed.rows[0]
        positions = [nx * w.x + ny * w.y for w in driven]
        if max(positions) - min(positions) < 1e-3:
            return "its driven wheels are at the same position along the axle"
        return None
