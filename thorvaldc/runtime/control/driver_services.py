"""Services of the base driver, for simulated robots and for robots with CAN buses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from thorvaldc.model.robot import SAFETY_STOP
from thorvaldc.runtime.control.service_table import Argument, Caller, Service, ServiceError
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.multiplexer import Multiplexer
from thorvaldc.runtime.run_time_parameters import LIMITS
from thorvaldc.runtime.se2 import Twist

FORCE = Argument("force", "flag", False)
"""Argument that also releases the stops of other programs."""


def driving_services(
    driver: BaseDriver,
    multiplexer: Multiplexer,
    note: Callable[[str], None] = lambda text: None,
) -> list[Service]:
    """Returns the services of a base driver.

    The services of the base driver command twists, set stop locks, return the state, reset the
    odometry, change parameters and stop the robot.  The service ``safety_stop`` stops the robot by
    software and is not a safety function.

    ``note``: function that records an event, such as a stop that was released by force.
    """

    def twist(now: float, caller: Caller, source: str, vx: float, vy: float, wz: float) -> None:
        refusal = multiplexer.publish(source, Twist(vx, vy, wz), now - caller.age, caller.name)
        if refusal:
            raise ServiceError(refusal)

    def state(now: float) -> dict[str, Any]:
        return driver_state(driver, multiplexer, now)

    def reset_odometry(now: float) -> None:
        driver.reset_pose()

    def set_drive_parameters(
        now: float, set: str | None, radii: dict[str, float], **limits: float | None
    ) -> None:
        changes = {name: value for name, value in limits.items() if value is not None}
        if set is None and not radii and not changes:
            raise ServiceError("`set_drive_parameters` needs `set`, `radii` or a limit")
        if set is not None and (radii or changes):
            raise ServiceError("`set` cannot be combined; change single values in another call")
        if set is not None:
            driver.use(set or None)
        else:
            driver.update(radii=radii, noise=None, **changes)

    def reset_faults(now: float) -> None:
        sources = multiplexer.requests(now)
        if sources:
            raise ServiceError(f"{', '.join(sources)} commands a motion; command zero first")
        driver.reset()

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
        Service("state", "Return the state of the driver.", state, valid_late=True),
        Service(
            "description",
            "Return the robot's constants: names, top speeds, rate.",
            lambda now: driver_description(driver),
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
        Service("reset_faults", "Leave the fault of a gap in time.", reset_faults),
        *_stop_services(multiplexer, note),
    ]


def _stop_services(multiplexer: Multiplexer, note: Callable[[str], None]) -> list[Service]:
    """Returns the services that set and release locks."""

    def lock(now: float, caller: Caller, name: str, locked: bool, force: bool) -> None:
        if caller.void and not locked:
            raise ServiceError(caller.void)
        others = [owner for owner in multiplexer.lock_owners(name) if owner != caller.name]
        multiplexer.lock(name, locked, now, caller.name, force=force)
        if force and others and not locked:
            note(f"{caller.name} released by force `{name}` of {' and '.join(others)}")

    def safety_stop(now: float, caller: Caller) -> None:
        lock(now, caller, SAFETY_STOP, True, False)

    def release_safety_stop(now: float, caller: Caller, force: bool) -> None:
        lock(now, caller, SAFETY_STOP, False, force)

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
            "Stop the robot and keep it stopped.",
            safety_stop,
            with_caller=True,
            valid_late=True,
        ),
        Service(
            "release_safety_stop",
            "Release the safety stop of this connection; `force`: of every connection.",
            release_safety_stop,
            (FORCE,),
            with_caller=True,
        ),
    ]


def driver_state(driver: BaseDriver, multiplexer: Multiplexer, now: float) -> dict[str, Any]:
    """Returns the state of a base driver as JSON values, in m, rad, m/s and rad/s.

    ``time``: time (s) of the last control cycle.
    """
    state, selected = driver.state, multiplexer.select(now)
    return {
        "robot": driver.robot.name,
        "time": state.time if state.time > 0.0 else 0.0,
        "mode": state.mode.value,
        "source": selected.source,
        "locks": list(selected.locks),
        "owners": multiplexer.holders(now),
        "asked": state.commanded_twist._asdict(),
        "in_force": state.ramped._asdict(),
        "infeasible": state.infeasible._asdict(),
        "odometry": state.odometry.twist._asdict(),
        "pose": state.pose._asdict(),
        "fault": state.fault,
        "held": state.hold_reason,
        "limited_by": driver.limit_of(state.commanded_twist),
    }


def driver_description(driver: BaseDriver) -> dict[str, Any]:
    """Returns the constants of a base driver as JSON values.

    The constants are names, top speeds (m/s, rad/s) and the rate of the control cycle (Hz).
    """
    robot, limits = driver.robot, driver.settings
    steerable = [w.steered or w.swivel_joint is not None for w in robot.wheels]
    return {
        "robot": robot.name,
        "rate": limits.rate,
        "max_linear_velocity": limits.max_linear_velocity,
        "max_angular_velocity": limits.max_angular_velocity,
        "sideways": bool(steerable) and all(steerable),
        "sources": [source.name for source in robot.twist_sources],
        "locks": [lock.name for lock in robot.twist_locks],
        "parameter_sets": [parameters.name for parameters in robot.parameter_sets],
    }
