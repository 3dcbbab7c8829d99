"""The services that every driver has, on whatever base it drives."""

from __future__ import annotations

from typing import Any

from thorvaldc.runtime.control.service_table import Argument, Service, ServiceError
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.driver_parameters import LIMITS
from thorvaldc.runtime.multiplexer import Multiplexer
from thorvaldc.runtime.se2 import Twist

SAFETY_STOP = "safety_stop"
"""The lock that every robot has, above all sources."""


def driving_services(driver: BaseDriver, multiplexer: Multiplexer) -> list[Service]:
    """Twists and locks, the state, odometry, parameters and the stop.

    The stop is one of software: it is no safety function.
    """

    def twist(now: float, source: str, vx: float, vy: float, wz: float) -> None:
        if not multiplexer.publish(source, Twist(vx, vy, wz), now):
            raise ServiceError("the twist is beyond all bounds")

    def lock(now: float, name: str, locked: bool) -> None:
        multiplexer.lock(name, locked, now)

    def state(now: float) -> dict[str, Any]:
        return driver_state(driver, multiplexer, now)

    def reset_odometry(now: float) -> None:
        driver.reset_pose()

    def set_drive_parameters(
        now: float, set: str | None, radii: dict[str, float], **limits: float | None
    ) -> None:
        given = {name: value for name, value in limits.items() if value is not None}
        if set is None and not radii and not given:
            raise ServiceError("`set_drive_parameters` needs `set`, `radii` or a limit")
        if set is not None and (radii or given):
            raise ServiceError("`set` goes alone; change single values in a call of their own")
        if set is not None:
            driver.use(set or None)
        else:
            driver.update(radii=radii, noise=None, **given)

    def safety_stop(now: float) -> None:
        multiplexer.lock(SAFETY_STOP, True, now)

    def release_safety_stop(now: float) -> None:
        multiplexer.lock(SAFETY_STOP, False, now)

    return [
        Service(
            "twist",
            "Drive: a source's velocity (m/s, m/s, rad/s), in force until its time-out.",
            twist,
            (
                Argument("source", "text"),
                Argument("vx", "number", 0.0),
                Argument("vy", "number", 0.0),
                Argument("wz", "number", 0.0),
            ),
        ),
        Service(
            "lock",
            "Set a lock, which holds back sources of a lower priority, or take it away.",
            lock,
            (Argument("name", "text"), Argument("locked", "flag", True)),
        ),
        Service("state", "What the driver does.", state),
        Service("description", "What the robot is.", lambda now: driver_description(driver)),
        Service("reset_odometry", "Set the odometry's pose to zero.", reset_odometry),
        Service(
            "set_drive_parameters",
            "Switch to a parameter set (`set`; empty: the ordinary values), or change radii (m, by"
            " wheel) and limits.",
            set_drive_parameters,
            (
                Argument("set", "text", None),
                Argument("radii", "mapping", {}),
                *(Argument(name, "number", None) for name in LIMITS),
            ),
        ),
        Service("safety_stop", "Stop the robot and keep it stopped.", safety_stop),
        Service("release_safety_stop", "Let the robot drive again.", release_safety_stop),
    ]


def driver_state(driver: BaseDriver, multiplexer: Multiplexer, now: float) -> dict[str, Any]:
    """The state as plain values: m, rad, m/s, rad/s; ``time`` of the last tick in s."""
    state, selected = driver.state, multiplexer.select(now)
    return {
        "robot": driver.robot.name,
        "time": state.time if state.time > 0.0 else 0.0,
        "mode": state.mode.value,
        "source": selected.source,
        "locks": list(selected.locks),
        "asked": state.commanded_twist._asdict(),
        "in_force": state.ramped._asdict(),
        "infeasible": state.infeasible._asdict(),
        "odometry": state.odometry.twist._asdict(),
        "pose": state.pose._asdict(),
        "fault": state.fault,
        "held": state.hold_reason,
    }


def driver_description(driver: BaseDriver) -> dict[str, Any]:
    """What does not change while it runs: names, top speeds (m/s, rad/s), rate (Hz)."""
    robot, limits = driver.robot, driver.settings
    turns = [w.steered or w.swivel_joint is not None for w in robot.wheels]
    return {
        "robot": robot.name,
        "rate": limits.rate,
        "max_linear_velocity": limits.max_linear_velocity,
        "max_angular_velocity": limits.max_angular_velocity,
        "sideways": bool(turns) and all(turns),
        "sources": [source.name for source in robot.twist_sources],
        "locks": [lock.name for lock in robot.twist_locks],
        "parameter_sets": [found.name for found in robot.parameter_sets],
    }
