"""Diagnostics of a run: divergence, tip-over, unreachable steering, infeasible twists."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from thorvaldc.diagnostics import Report
from thorvaldc.model import Robot, Wheel
from thorvaldc.model.statics.mobility import roll_speeds
from thorvaldc.runtime.lasting_difference import is_axle_swing
from thorvaldc.runtime.se2 import Twist
from thorvaldc.runtime.twist_text import twist_text
from thorvaldc.simulation.control_loop import NEGLIGIBLE_TWIST, ControlLoop, largest_component
from thorvaldc.simulation.physics.ground_truth_base import GroundTruthBase
from thorvaldc.simulation.run_result import SimulationResult

_START_DURATION = 0.5
"""Time (s) before which the cause of a fall is the start position and not the motion."""


def report_run(
    loops: Sequence[ControlLoop], result: SimulationResult, report: Report, fastest_joint: str = ""
) -> None:
    """Adds the problems of a finished run to ``report``.

    ``fastest_joint`` is a description of the fastest joint, for a simulation that diverged.
    """
    if result.diverged:
        cause = f": {fastest_joint}" if fastest_joint else ""
        report.add(
            "simulation-diverged",
            f"the simulation diverged after {result.simulated:.2f} s{cause}",
            next((m for m in loops if f"`{m.robot.namespace}/" in cause), loops[0]).robot.span,
            hint="look for masses or inertias that are very small compared with the forces on them",
        )
        return
    for loop, robot_result in zip(loops, result.robots, strict=True):
        if robot_result.collisions:
            count = robot_result.collisions
            report.add(
                "simulation-collision",
                f"{loop.name} had {count} collision{'s' if count > 1 else ''} with other robots,"
                " the world or its own parts",
                loop.robot.span,
                hint="start the robots farther apart, or give them other motions",
            )
        if loop.tipped:
            in_motion = result.simulated >= _START_DURATION
            report.add(
                "simulation-tipped",
                f"{loop.name} fell over{_direction(loop)} after {result.simulated:.2f} s; "
                f"the commanded twist was {twist_text(loop.driver.state.commanded_twist)}",
                loop.robot.span,
                hint="lower its speed, accelerations or centre of mass, or widen its track"
                if in_motion
                else "check that it does not start inside an obstacle or another robot",
            )
        if loop.unreachable:
            wheels = ", ".join(loop.robot.wheels[i].name for i in loop.unreachable)
            reachable = loop.driver.calculator.feasible(loop.unreachable_twist)
            stands = largest_component(reachable) <= NEGLIGIBLE_TWIST
            motion = "stands" if stands else f"moves with {twist_text(reachable)} instead"
            report.add(
                "steering-unreachable",
                f"{loop.name} cannot steer {wheels} for the twist "
                f"{twist_text(loop.unreachable_twist)} within the joint limits; "
                f"it {motion}",
                loop.robot.span,
                hint="command another twist, or widen the steering limits",
            )
        if loop.limit:
            report.add(
                "twist-limited",
                f"the commanded twist of {loop.name} is {twist_text(loop.limited_twist)}; it is"
                f" limited to {twist_text(loop.limited_to)} by {loop.limit}",
                loop.robot.span,
                hint="command a slower twist, or change the limit in `driver` of the robot file",
            )
        if loop.not_followed:
            report.add(
                "twist-not-followed",
                f"{loop.name} does not follow its command: {loop.not_followed}",
                loop.robot.span,
                hint="command a slower twist, or free the steering joint that the message names",
            )
        limited = loop.driver.calculator.limiting_wheels(loop.infeasible_twist)
        if (
            largest_component(loop.infeasible) > NEGLIGIBLE_TWIST
            and not limited
            and not is_axle_swing(loop.infeasible_twist, loop.infeasible)
        ):
            turned = _turned_wheel(loop.robot, loop.infeasible_twist)
            report.add(
                "twist-infeasible",
                f"the commanded twist of {loop.name} is {twist_text(loop.infeasible_twist)}; "
                f"its fixed wheels do not allow the part {twist_text(loop.infeasible)}",
                loop.robot.span if turned is None else turned.span,
                hint="a robot with fixed wheels cannot move across them"
                if turned is None
                else f"other fixed wheels allow it; turn the mount of `{turned.module}`",
            )


def _turned_wheel(robot: Robot, twist: Twist) -> Wheel | None:
    """Returns the first fixed wheel that blocks a straight motion which other ones allow."""
    if twist.wz:
        return None
    fixed = [w for w in robot.wheels if w.steering_joint is None and w.swivel_joint is None]
    blocking = [w for w in fixed if roll_speeds(replace(robot, wheels=(w,)), twist) is None]
    return blocking[0] if 0 < len(blocking) < len(fixed) else None


def _direction(loop: ControlLoop) -> str:
    direction = loop.base.leaning() if isinstance(loop.base, GroundTruthBase) else ""
    return f" {direction}" if direction else ""
