"""Faults between the wheels and the ground, which no bus shows: how wrong is the odometry?

The robot drives in MuJoCo with the torque of its motors.  It is held, or wheels stall or lose their
grip.  Its base driver reads the joints, and a yaw rate if the robot has an IMU; the truth comes
from the simulation.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from thorvaldc.compiler.pipeline import emit
from thorvaldc.diagnostics import Report
from thorvaldc.model import Robot
from thorvaldc.model.fleet import Fleet, Placement
from thorvaldc.model.scenario import Command, Noise, Scenario, WheelFault
from thorvaldc.model.spatial import Pose
from thorvaldc.runtime.calculators import Noise as OdometryNoise
from thorvaldc.simulation.control_loop import ControlLoop, Sample
from thorvaldc.simulation.physics.drive_servos import set_hard_friction
from thorvaldc.simulation.scenario_run import ScenarioSimulation

HEADINGS: Final = ("fault", "true path", "odometry", "position wrong by", "warning")

_SPEED, _TURN_RATE = 0.6, 0.3
"""Largest commanded speed (m/s) and yaw rate (rad/s)."""
_BEGIN, _TURN, _STOP, _END = 2.0, 4.0, 6.0, 7.0
"""Times (s) at which the fault begins, the robot turns, it brakes, and the run ends."""
_ICE, _AIR = 0.05, 1e-3
"""Coefficients of friction."""
_HELD = 1e5
"""Friction (N, N m) of a body and of a wheel that no motor moves."""
_PLANAR_DOFS = (0, 1, 5)
"""Degrees of freedom of the body: x, y and yaw."""


class GroundFault(NamedTuple):
    """A fault of the ground.

    - ``anchored``: the body cannot move along the ground.
    - ``stalled``: names of wheels that cannot turn.
    - ``slippery``: names of wheels whose coefficient of friction is ``friction``.
    """

    name: str
    anchored: bool = False
    stalled: tuple[str, ...] = ()
    slippery: tuple[str, ...] = ()
    friction: float = _ICE


@dataclass(frozen=True)
class GroundRow:
    """What the odometry makes of a fault.

    - ``path_true``, ``path_odometry``: m.
    - ``error``: distance (m) between the true and the estimated position at the end.
    - ``deviation``: standard deviation (m) of the estimated position in the direction of the error.
    - ``warned_after``: time (s) from the fault until the first warning, or ``None`` without one.
    - ``warning``: that warning of the driver, or empty.
    """

    fault: GroundFault
    path_true: float
    path_odometry: float
    error: float
    deviation: float
    warned_after: float | None
    warning: str

    @property
    def deviations(self) -> float:
        """Error relative to its standard deviation."""
        return self.error / self.deviation if self.deviation else math.inf


def ground_faults(robot: Robot) -> list[list[GroundFault]]:
    """Returns the faults of the ground, with those of the same name in one list."""
    wheels = tuple(wheel.name for wheel in robot.wheels if wheel.swivel_joint is None)
    groups = [
        [GroundFault("the robot is held", anchored=True)],
        [GroundFault("held, a wheel on ice", anchored=True, slippery=(w,)) for w in wheels],
        [GroundFault("held, all wheels on ice", anchored=True, slippery=wheels)],
        [GroundFault("a wheel stalls", stalled=(w,)) for w in wheels],
        [GroundFault("all wheels stall", stalled=wheels)],
        [GroundFault("a wheel on ice", slippery=(w,)) for w in wheels],
        [GroundFault("a wheel in the air", slippery=(w,), friction=_AIR) for w in wheels],
        [
            GroundFault("all wheels but one on ice", slippery=tuple(o for o in wheels if o != w))
            for w in wheels
        ],
        [GroundFault("all wheels on ice", slippery=wheels)],
    ]
    return [group for group in groups if group]


def ground_rows(robot: Robot, groups: Sequence[Sequence[GroundFault]]) -> Iterator[GroundRow]:
    """Yields the row of each group: that of its fault with the largest error, relative to the
    standard deviation."""
    for group in groups:
        yield max((ground_row(robot, fault) for fault in group), key=lambda row: row.deviations)


def ground_row(robot: Robot, fault: GroundFault) -> GroundRow:
    """Tries a fault and returns what the odometry makes of it.

    The robot accelerates, drives straight ahead, turns and brakes.
    """
    scenario = _scenario(robot, fault)
    simulation = ScenarioSimulation(scenario, emit(scenario.fleet, ["mjcf"]))
    warned: list[tuple[float, str]] = []
    last: list[Sample] = []

    def measure(loop: ControlLoop) -> None:
        now = loop.driver.state.time
        if now < _BEGIN <= loop.next_time:
            _hold(loop, fault)
        if not warned and (warnings := loop.driver.odometry.warnings):
            warned.append((now - _BEGIN, warnings[0]))
        last[:] = [loop.sample()]

    report = simulation.play(Report(), on_tick=measure, hashed=False)
    result = report.run.robots[0]
    error, deviation = _position_error(last[0])
    after, warning = warned[0] if warned else (None, "")
    return GroundRow(
        fault, result.path_true, result.path_odometry, error, deviation, after, warning
    )


def _scenario(robot: Robot, fault: GroundFault) -> Scenario:
    speed = min(_SPEED, robot.driver.max_linear_velocity)
    twists = ((0.0, speed, 0.0), (_TURN, speed, _TURN_RATE), (_STOP, 0.0, 0.0))
    name = robot.name
    return Scenario(
        name="ground",
        description="",
        fleet=Fleet("ground", "", (Placement(name, Pose(), robot),)),
        duration=_END,
        commands=((name, tuple(Command(time, vx, 0.0, wz) for time, vx, wz in twists)),),
        faults=tuple(
            WheelFault("ice", name, wheel, "", fault.friction, _BEGIN, math.inf, robot.span)
            for wheel in fault.slippery
        ),
        noise=Noise(gyro=OdometryNoise(**dict(robot.driver.noise)).gyro),
        expectations=(),
        span=robot.span,
    )


def _hold(loop: ControlLoop, fault: GroundFault) -> None:
    """Holds the body and wheels of a robot by friction."""
    scene, robot = loop.scene, loop.robot
    assert scene is not None
    model = scene.model
    blocked: list[int] = []
    if fault.anchored:
        body = scene.index("body", robot.prefix + robot.links[0].name, robot)
        blocked += [int(model.body_dofadr[body]) + k for k in _PLANAR_DOFS]
    for wheel in robot.wheels:
        if wheel.name in fault.stalled:
            joint = scene.index("joint", robot.prefix + wheel.spin_joint, robot)
            blocked.append(int(model.jnt_dofadr[joint]))
    for dof in blocked:
        set_hard_friction(model, dof, _HELD)


def _position_error(sample: Sample) -> tuple[float, float]:
    """Returns the error (m) of the position and its standard deviation in this direction (m)."""
    true, estimated, covariance = sample.pose_true, sample.pose_estimated, sample.pose_covariance
    dx, dy = true.x - estimated.x, true.y - estimated.y
    error = math.hypot(dx, dy)
    if not error:
        return 0.0, math.sqrt(covariance[0][0])
    angle = math.atan2(dy, dx) - estimated.yaw
    c, s = math.cos(angle), math.sin(angle)
    variance = c * c * covariance[0][0] + 2.0 * c * s * covariance[0][1] + s * s * covariance[1][1]
    return error, math.sqrt(variance)


# -- output ----------------------------------------------------------------------------------------


def ground_json(row: GroundRow) -> dict[str, Any]:
    """Returns a row as JSON values, in m and s."""
    fault = row.fault
    return {
        "fault": fault.name,
        "stalled": [*fault.stalled],
        "slippery": [*fault.slippery],
        "path_true": row.path_true,
        "path_odometry": row.path_odometry,
        "error": row.error,
        "standard_deviation": row.deviation,
        "warned_after": row.warned_after,
        "warning": row.warning,
    }


def ground_cells(row: GroundRow) -> tuple[str, ...]:
    """Returns the cells of the table for one fault."""
    return (
        row.fault.name,
        f"{row.path_true:.2f} m",
        f"{row.path_odometry:.2f} m",
        f"{row.error:.2f} m, stated {row.deviation:.2f} m",
        "none" if row.warned_after is None else f"in {row.warned_after:.1f} s",
    )
