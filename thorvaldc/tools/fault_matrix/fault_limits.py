"""The limits of the reactions to faults, from the model of the robot."""

from __future__ import annotations

import math

from thorvaldc.model import Robot
from thorvaldc.model.statics.slope import roll_out
from thorvaldc.model.stopping import DETECTED_FAULT, STOP_LOCK, stop_bounds
from thorvaldc.tools.fault_matrix.fault_cases import MOVING_PHASES, STOPPING, FaultCase
from thorvaldc.tools.fault_matrix.fault_reaction import NOT_SIMULATED, STOPS, UNASKED, Reaction


def rest_limit(robot: Robot, case: FaultCase, phase: str) -> tuple[float, float]:
    """Returns the longest time (s) and distance (m) until the robot stands after a fault.

    Until the reaction the robot may drive at its top speed.  Then the robot stops within the time
    and distance of ``stop_bounds``, or rolls out without power.
    """
    if case.rolls_out:
        _, time, distance = roll_out(robot)
        return time, distance
    delay = case.detection.get(phase, 0.0) if case.braking is None else case.braking
    by_ramp = case.by_ramp or (phase not in case.detection and case.braking is None)
    bounds = {bound.kind: bound for bound in stop_bounds(robot)}
    stop = bounds[STOP_LOCK if by_ramp else DETECTED_FAULT]
    choices = [robot.driver, *(parameters.driver for parameters in robot.parameter_sets)]
    speed = max(choice.max_linear_velocity for choice in choices)
    return delay + stop.time, speed * delay + stop.distance


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
    must_stand = stopped or phase == STOPPING or case.must_stop
    if phase in MOVING_PHASES and must_stand:
        longest, farthest = rest_limit(robot, case, phase)
        if math.isinf(longest):
            pass  # nothing is promised
        elif reaction.rest_time is None or reaction.rest_distance is None:
            problems.append("the wheels still turn at the end of the observation")
        elif reaction.rest_time > longest:
            problems.append(f"at rest after {reaction.rest_time:.2f} s; promised: {longest:.2f} s")
        elif reaction.rest_distance > farthest:
            problems.append(
                f"at rest after {reaction.rest_distance:.2f} m; promised: {farthest:.2f} m"
            )
    if reaction.unasked > UNASKED + case.motion:
        problems.append(
            f"the wheels became faster by {reaction.unasked:.2f} m/s without a command; "
            f"{UNASKED + case.motion:g} m/s are tolerated"
        )
    return problems
