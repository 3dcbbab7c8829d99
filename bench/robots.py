"""Robots and wheels for the measurements."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.figure import ROOT

if TYPE_CHECKING:
    from collections.abc import Callable

    from thorvaldc.model import Robot
    from thorvaldc.runtime.calculators import WheelGeometry
    from thorvaldc.runtime.driven_robot import DrivenRobot
    from thorvaldc.runtime.driver import BaseDriver
    from thorvaldc.runtime.se2 import Twist


def example(name: str) -> Path:
    """Returns the path of an example's robot file."""
    return ROOT / "examples" / name / "robot.yaml"


def built(path: Path) -> tuple[Robot, dict[str, bytes]]:
    """Returns a compiled robot and its MJCF files."""
    from thorvaldc.compiler.pipeline import compile_file, emit
    from thorvaldc.diagnostics import Report
    from thorvaldc.model import Robot

    model = compile_file(path).model
    if not isinstance(model, Robot):
        raise SystemExit(f"{path} does not compile")
    return model, emit(model, ["mjcf"], Report())


def wheel_positions(wheels: int) -> list[tuple[float, float]]:
    """Returns positions (m) of wheels, in pairs along a frame."""
    pairs = (wheels + 1) // 2
    positions = [(0.55 * (2 * i / (pairs - 1) - 1), y) for i in range(pairs) for y in (0.45, -0.45)]
    return positions[:wheels]


def wheel(name: str, x: float, y: float, **changes: Any) -> WheelGeometry:
    """Returns a driven and steered wheel with the limits of the original Thorvald modules."""
    from thorvaldc.runtime.calculators import WheelGeometry

    geometry = WheelGeometry(
        name, x, y, 0.0, 1.0, 0.0, 0.0, 0.2,
        driven=True, steered=True, swivel=False, encoder=True,
        max_speed=7.48, max_acceleration=7.5, lower=-3.078, upper=3.078,
        max_rate=4.0, max_rate_change=20.0,
    )  # fmt: skip
    return replace(geometry, **changes)


def drives_with(driven: DrivenRobot, twist: Twist) -> Callable[[BaseDriver, float], None]:
    """Returns a ``feed`` of a robot with automatic arming: a zero twist until it is armed, and
    after a gap in time, else ``twist``."""
    from thorvaldc.runtime.driver import DriveMode
    from thorvaldc.runtime.se2 import ZERO_TWIST

    def feed(driver: BaseDriver, now: float) -> None:
        if driven.ready:
            waiting = not driven.armed or driver.state.mode is DriveMode.WAITING
            driver.command(ZERO_TWIST if waiting else twist, now)

    return feed
