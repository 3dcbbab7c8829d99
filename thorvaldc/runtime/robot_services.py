"""Services of every driven robot, simulated or real, for other programs and for ROS."""

from __future__ import annotations

from typing import Any

from thorvaldc.runtime.arming import ArmableRobot
from thorvaldc.runtime.run_time_parameters import LIMITS
from thorvaldc.runtime.se2 import Twist
from thorvaldc.runtime.service_table import Argument, Caller, Service, ServiceError

FORCE = Argument("force", "flag", False)
"""Argument that also releases the stops of other programs."""


def robot_services(robot: ArmableRobot) -> list[Service]:
    """Returns the services that command twists, arm and stop the robot, return its state, reset the
    odometry and change parameters.

    The service ``safety_stop`` stops the robot by software and is not a safety function.
    """
    multiplexer = robot.multiplexer

    def twist(now: float, caller: Caller, source: str, vx: float, vy: float, wz: float) -> None:
        refusal = multiplexer.publish(source, Twist(vx, vy, wz), now - caller.age, caller.name)
        if refusal:
            raise ServiceError(refusal)

    def reset_odometry(now: float) -> None:
        robot.driver.reset_pose()

    def set_drive_parameters(
        now: float, set: str | None, radii: dict[str, float], **limits: float | None
    ) -> None:
        changes = {name: value for name, value in limits.items() if value is not None}
        if set is None and not radii and not changes:
            raise ServiceError("`set_drive_parameters` needs `set`, `radii` or a limit")
        if set is not None and (radii or changes):
            raise ServiceError("`set` cannot be combined; change single values in another call")
        robot.set_drive_parameters(set or None, radii=radii, limits=changes)

    return [
        Service(
            "twist",
            "Command the twist of a source (m/s, m/s, rad/s); it is valid until the time-out of the"
            " source, while the connection is open.",
            twist,
            (
                Argument("source", "text"),
                Argument("vx", "number", 0.0),
                Argument("vy", "number", 0.0),
                Argument("wz", "number", 0.0),
            ),
            with_caller=True,
        ),
        Service(
            "state",
            "Return the state of the robot.",
            lambda now: robot_state(robot, now),
            valid_late=True,
        ),
        Service(
            "description",
            "Return the robot's constants: names, top speeds, rate.",
            lambda now: robot_description(robot),
            valid_late=True,
        ),
        Service("reset_odometry", "Set the pose of the odometry to zero.", reset_odometry),
        Service(
            "set_drive_parameters",
            "Change to a parameter set (`set`; empty: the default values), or change radii (m, by"
            " wheel) and limits.",
            set_drive_parameters,
            (
                Argument("set", "text", None),
                Argument("radii", "mapping", {}),
                *(Argument(name, "number", None) for name in LIMITS),
            ),
        ),
        *_arming_services(robot),
        *_stop_services(robot),
    ]


def _arming_services(robot: ArmableRobot) -> list[Service]:
    """Returns the services that let the robot move, or take this permission away."""

    def arm(now: float, caller: Caller) -> str | None:
        return robot.arm(caller.name) or None

    def disarm(now: float) -> None:
        robot.disarm()

    def home_steering(now: float) -> None:
        robot.home_steering()

    def reset_faults(now: float) -> None:
        robot.reset()

    return [
        Service(
            "arm",
            "Accept motion, if all pre-arm checks pass; homes the steering first if needed, while"
            " the connection is open. Refused with every reason.",
            arm,
            with_caller=True,
        ),
        Service(
            "disarm",
            "Accept no motion until `arm`; a moving robot ramps to rest.",
            disarm,
            valid_late=True,
        ),
        Service("home_steering", "Home all steering joints; they turn.", home_steering),
        Service(
            "reset_faults",
            "Leave a fault or a stop; the stop must be released, and zero commanded.",
            reset_faults,
        ),
    ]


def _stop_services(robot: ArmableRobot) -> list[Service]:
    """Returns the services that set and release locks."""

    def lock(now: float, caller: Caller, name: str, locked: bool, force: bool) -> None:
        if caller.void and not locked:
            raise ServiceError(caller.void)
        robot.lock(name, locked, owner=caller.name, force=force)

    def safety_stop(now: float, caller: Caller) -> None:
        robot.safety_stop(owner=caller.name)

    def release_safety_stop(now: float, caller: Caller, force: bool) -> None:
        robot.safety_stop(False, owner=caller.name, force=force)

    return [
        Service(
            "lock",
            "Set a lock, which blocks sources up to its priority, or release it.",
            lock,
            (Argument("name", "text"), Argument("locked", "flag", True), FORCE),
            with_caller=True,
            valid_late=True,  # the function refuses a late release
        ),
        Service(
            "safety_stop",
            "Stop all motors and switch them off, until release and reset.",
            safety_stop,
            with_caller=True,
            valid_late=True,
        ),
        Service(
            "release_safety_stop",
            "Release the safety stop of this connection (`force`: of every connection); to drive"
            " again, call `reset_faults` and `arm`.",
            release_safety_stop,
            (FORCE,),
            with_caller=True,
        ),
    ]


def robot_state(robot: ArmableRobot, now: float) -> dict[str, Any]:
    """Returns the state of a robot as JSON values, in m, rad, m/s and rad/s.

    ``time``: time (s) of the last control cycle.  The base adds its own values, such as those of
    batteries; its ``fault`` replaces that of the driver.
    """
    driver, multiplexer = robot.driver, robot.multiplexer
    state, selected = driver.state, multiplexer.select(now)
    values = {
        "robot": driver.robot.name,
        "time": state.time if state.time > 0.0 else 0.0,
        "mode": state.mode.value,
        "armed": robot.armed,
        "arming": robot.arming,
        "paused": robot.paused,
        "source": selected.source,
        "locks": list(selected.locks),
        "owners": multiplexer.holders(now),
        "zero_awaited": multiplexer.awaited_zeros(now),
        "asked": state.commanded_twist._asdict(),
        "in_force": state.ramped._asdict(),
        "infeasible": state.infeasible._asdict(),
        "odometry": state.odometry.twist._asdict(),
        "pose": state.pose._asdict(),
        "fault": state.fault,
        "held": state.hold_reason,
        "limited_by": driver.limit_of(state.commanded_twist),
        "not_followed": state.not_followed,
        "stopped_by": list(robot.stop_owners),
        "warnings": [*robot.base.warnings(now), *driver.odometry.warnings],
        "cycles": robot.timing.cycles,
        "overruns": robot.timing.overruns,
    }
    base = robot.base.values()
    return {**values, **base, "fault": base.get("fault") or values["fault"]}


def robot_description(robot: ArmableRobot) -> dict[str, Any]:
    """Returns the constants of a robot as JSON values.

    The constants are names, top speeds (m/s, rad/s) and the rate of the control cycle (Hz).
    """
    model, limits = robot.robot, robot.driver.settings
    steerable = [w.steered or w.swivel_joint is not None for w in model.wheels]
    return {
        "robot": model.name,
        "rate": limits.rate,
        "max_linear_velocity": limits.max_linear_velocity,
        "max_angular_velocity": limits.max_angular_velocity,
        "sideways": bool(steerable) and all(steerable),
        "sources": [source.name for source in model.twist_sources],
        "locks": [lock.name for lock in model.twist_locks],
        "parameter_sets": [parameters.name for parameters in model.parameter_sets],
    }
