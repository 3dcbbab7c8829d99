"""Names what is wrong in the assembly, from what each motor did and what the operator has seen.

A plug carries motor and encoder, so that direction, scale and zero belong to the joint that moved,
and not to the channel that moved it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from thorvaldc.commissioning.commission_report import Finding
from thorvaldc.model import Actuator, Robot
from thorvaldc.model.robot import MAX_STEERING_OFFSET
from thorvaldc.tools.commission.motion_watch import ABORTS, OPPOSITE, OTHERS, SILENT, Travel
from thorvaldc.tools.commission.questions import joint_text
from thorvaldc.tools.commission.results import STANDS, WATCHDOG, MotorResult, Observation

SCALE_TOLERANCE = 0.12
"""Largest deviation of the travel that the operator sees, as a share of the expected one."""
ZERO_TOLERANCE = math.radians(2.0)
"""Largest angle (rad) between straight ahead and the zero of a steering joint."""


def expected_travel(observation: Observation) -> float:
    """Returns the travel (rad) of the joint that moved, if its encoder is the right one.

    The drive counts the commanded travel with the encoder and the gear of its own motor.
    """
    assert observation.travel is not None
    own, moved = observation.axis.actuator, observation.moved or observation.axis.actuator
    return observation.travel.commanded * own.pulses_per_joint_turn / moved.pulses_per_joint_turn


def has_moved_as_expected(observation: Observation) -> bool:
    """Checks whether the right joint moved in the right direction and by the right travel."""
    return observation.moved is observation.axis.actuator and not list(
        _direction_and_scale(observation)
    )


def findings(robot: Robot, results: Mapping[str, MotorResult]) -> list[Finding]:
    """Returns what is wrong in the assembly of the robot."""
    observations = [result.observation for result in results.values()]
    assembly = [
        *_exchanges(robot, observations),
        *(f for each in observations for f in _faults_of(each)),
    ]
    blamed = {name for finding in assembly for name in finding.motors}
    for result in results.values():
        if result.observation.axis.actuator.name not in blamed:
            assembly += _figures_out_of_bounds(result)
    return list(dict.fromkeys(assembly))


def _figures_out_of_bounds(result: MotorResult) -> Iterator[Finding]:
    motor = result.observation.axis.actuator
    for figure in result.figures:
        if figure.passed:
            continue
        change = "measure again; is the drive set up as in the robot file (`can verify`)?"
        if figure.name in (WATCHDOG, STANDS):
            change = (
                f"set up the watchdog of {motor.node} (heartbeat consumer, object 0x1016, and its"
                " reaction): without it nothing stops the wheel if the computer fails"
            )
        text = f"{motor.name}: {figure.name}: {figure.value_text}, must be {figure.bounds_text}"
        yield Finding((motor.name,), text, change)


def _exchanges(robot: Robot, observations: list[Observation]) -> Iterator[Finding]:
    moved = {o.axis.actuator.name: o.moved for o in observations if o.moved is not None}
    for observation in observations:
        own, other = observation.axis.actuator, observation.moved
        if other is None or other.name == own.name:
            continue
        back = moved.get(other.name)
        names = tuple(sorted((own.name, other.name)))
        if back is not None and back.name == own.name:
            yield Finding(
                names,
                f"{names[0]} and {names[1]} are exchanged: each channel moves the other's joint",
                f"exchange the plugs of the motors {names[0]} and {names[1]}, with their encoders",
            )
        else:
            yield Finding(
                (own.name, other.name),
                f"the channel of {own.name} moves the {joint_text(robot, other)}",
                f"connect the motor {own.name} to {own.node or 'its controller'},"
                f" channel {own.channel}",
            )


def _faults_of(observation: Observation) -> Iterator[Finding]:
    """Yields what is wrong with the motor and the encoder of the joint that moved."""
    travel = observation.homing
    if travel is None or travel.completed:
        travel = observation.travel
    if travel is None:
        return
    moved = observation.moved or observation.axis.actuator
    if not travel.completed:
        # A joint that the channel is not made for fails for that reason.
        exchanged = moved.role != observation.axis.actuator.role
        if not exchanged or travel.cause in (OTHERS, OPPOSITE):
            yield _failure(observation, travel, moved)
        return
    if observation.moved is None:
        yield Finding(
            (moved.name,),
            f"{moved.name} reports motion, but nothing moves",
            "does the operator see the right robot? is the gear or the coupling broken?",
        )
        return
    yield from _direction_and_scale(observation)
    yield from _zero(observation, moved)


def _failure(observation: Observation, travel: Travel, moved: Actuator) -> Finding:
    name = moved.name
    if travel.cause == OTHERS:
        reporting = {axis.actuator.name for axis in travel.others}
        names = tuple(sorted({observation.axis.actuator.name, *reporting}))
        return Finding(
            names,
            f"the encoders of {' and '.join(names)} are exchanged: one moves, the other reports it",
            f"exchange the plugs of the encoders of {' and '.join(names)}",
        )
    if travel.cause == SILENT:
        if observation.moved is None:
            return Finding(
                (name,),
                f"{name} does not move, and its encoder reports nothing",
                "is the motor connected, its brake open, its joint free?",
            )
        return Finding(
            (name,),
            f"the encoder of {name} does not count",
            "is the plug of the encoder connected? is the encoder broken?",
        )
    # In a homing, the direction of the command is not known.
    unstable = observation.travel is None and bool(travel.cause)
    if travel.cause == OPPOSITE or unstable:
        return Finding(
            (name,),
            f"the encoder of {name} counts against its motor",
            "exchange the lines A and B of the encoder (not `inverted`: that is for a motor that"
            " turns the wrong way with its encoder)",
        )
    if observation.travel is None:
        return Finding(
            (name,),
            f"the homing of {name} failed: {travel.fault}",
            "is the home switch connected, in its place? are `encoder_ppr`, `gear_ratio` right?",
        )
    return Finding(
        (name,),
        f"{name} stopped: {travel.fault or ABORTS[travel.cause]}",
        "is its joint free? see the fault of the drive, then check again",
    )


def _direction_and_scale(observation: Observation) -> Iterator[Finding]:
    moved = observation.moved or observation.axis.actuator
    expected = expected_travel(observation)
    ratio = observation.seen / expected
    if math.isnan(ratio):
        return
    if ratio < 0.0:
        yield Finding(
            (moved.name,),
            f"{moved.name} turns the wrong way, with its encoder",
            f"write `{_inverted_parameter(moved)}` for its module, or exchange two lines of the"
            " motor and the lines A and B of the encoder",
        )
    # The small motion of a steering channel is too short for a wheel, and the reverse too long.
    same_kind = moved.role == observation.axis.actuator.role
    if same_kind and abs(abs(ratio) - 1.0) > SCALE_TOLERANCE:
        pulses = moved.encoder_ppr / abs(ratio) if ratio else math.inf
        yield Finding(
            (moved.name,),
            f"{moved.name} turned by {abs(observation.seen) / math.tau:.2f} turns in place of"
            f" {abs(expected) / math.tau:.2f}",
            f"is `encoder_ppr` {pulses:.0f} in place of {moved.encoder_ppr}, or `gear_ratio`"
            f" {moved.gear_ratio / abs(ratio):.3g} in place of {moved.gear_ratio:.3g}?"
            if ratio
            else "is the gear or the coupling broken?",
        )


def _zero(observation: Observation, moved: Actuator) -> Iterator[Finding]:
    zero = observation.zero
    if math.isnan(zero) or abs(zero) <= ZERO_TOLERANCE or moved.role != "steering":
        return
    offset = measured_offset(observation)
    change = "mount the home switch or the encoder in its right place"
    if offset is not None:
        change = f"`steering_offset: {math.degrees(offset):.1f} deg` in the calibration file"
    degrees = math.degrees(zero)
    yield Finding(
        (moved.name,),
        f"at zero, the wheel of {moved.name} points {degrees:+.1f} deg off straight ahead",
        change,
    )


def measured_offset(observation: Observation) -> float | None:
    """Returns the steering offset (rad) for a calibration file, or ``None`` if none is needed, or
    if it is more than a calibration can correct."""
    moved, zero = observation.moved, observation.zero
    if moved is None or moved.role != "steering" or not abs(zero) > ZERO_TOLERANCE:
        return None
    offset = moved.encoder_offset + zero
    return offset if abs(offset) <= MAX_STEERING_OFFSET else None


def _inverted_parameter(motor: Actuator) -> str:
    """Returns the parameter of the modules of the library that turns a motor round."""
    name = "steering_inverted" if motor.role == "steering" else "inverted"
    return f"params: {{{name}: {str(not motor.inverted).lower()}}}"
