"""The limits of the reactions to faults, from the model of the robot."""

from __future__ import annotations

from thorvaldc.model import Robot
from thorvaldc.tools.fault_matrix.fault_cases import MOVING_PHASES, FaultCase
from thorvaldc.tools.fault_matrix.fault_reaction import NOT_SIMULATED, STOPS, UNASKED, Reaction

MARGIN = 0.1
"""Time (s) for the control cycles and the delays of the drives at the end of a stop."""


def rest_limit(robot: Robot, case: FaultCase, phase: str, speed: float) -> tuple[float, float]:
    """Returns the longest time (s) and distance (m) until the robot stands after a fault.

    ``speed``: speed (m/s) of the fastest wheel at the time of the fault.  Until the reaction, the
    robot can reach its top speed.
    """
    speed = max(speed, robot.driver.max_linear_velocity)
    delay = max(case.detection.get(phase, 0.0), case.silence)
    braking = speed / robot.driver.max_linear_acceleration + MARGIN
    return delay + braking, speed * (delay + braking / 2.0) + 0.01


def broken_limits(robot: Robot, case: FaultCase, phase: str, reaction: Reaction) -> list[str]:
    """Returns a sentence for each promise that the reaction does not keep."""
    if reaction.reaction == NOT_SIMULATED:
        return []
    problems = []
    limit = case.detection.get(phase)
    stopped = reaction.reaction in STOPS
    if limit is not None and not stopped:
        problems.append(f"the driver does not stop the robot; {limit:.2f} s are promised")
    elif limit is not None and (reaction.after or 0.0) > limit:
        problems.append(f"the driver reacts after {reaction.after:.2f} s; promised: {limit:.2f} s")
    if phase in MOVING_PHASES and (stopped or phase != MOVING_PHASES[0] or case.silence):
        longest, farthest = rest_limit(robot, case, phase, reaction.speed)
        if reaction.rest_time is None or reaction.rest_distance is None:
            problems.append("the wheels still turn at the end of the observation")
        elif reaction.rest_time > longest:
            problems.append(f"at rest after {reaction.rest_time:.2f} s; promised: {longest:.2f} s")
        elif reaction.rest_distance > farthest:
            problems.append(
                f"at rest after {reaction.rest_distance:.2f} m; promised: {farthest:.2f} m"
            )
    if reaction.moved_unasked:
        problems.append(
            f"a wheel became faster by {reaction.unasked:.2f} m/s without a command; "
            f"{UNASKED:g} m/s are tolerated"
        )
    return problems
