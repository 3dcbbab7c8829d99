"""The bound of one kind of stop."""

from __future__ import annotations

from thorvaldc.model import Robot
from thorvaldc.model.stopping import StopBound, stop_bounds


def stop_bound(robot: Robot, kind: str) -> StopBound:
    return {bound.kind: bound for bound in stop_bounds(robot)}[kind]
