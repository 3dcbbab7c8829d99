"""A robot with a bus for each side loses one of them while it drives straight ahead."""

from __future__ import annotations

import math

import pytest

from tests.model.stops import stop_bound
from tests.robots import SPAN
from tests.runtime.can_base.simulated_rig import Rig
from tests.simulation.bus.robots import compiled
from tests.slow import mostly_exhaustive, mostly_slow
from thorvaldc.model import Robot
from thorvaldc.model.scenario import BusFault, BusFaults
from thorvaldc.model.stopping import BUS_LOST, BUS_SILENT, DRIVER_DEAD, swerve_bounds
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.bus.fault_injection import FaultInjector

SPEED = 0.8
ROBOT = """
thorvaldc: 1
name: two_buses
buses: {{port: {{}}, starboard: {{}}}}
driver: {{max_linear_velocity: 0.8 m/s}}
modules:
  frame: {{type: frame/tube_rectangular,
    params: {{length: 1.2 m, width: 800 mm, cross_members: [-100 mm]}}}}
  fl: {{type: assembly/steered_drive, mount: frame.front_left{drives}, can: {{bus: port, id: 1}}}}
  fr: {{type: assembly/steered_drive, mount: frame.front_right{drives},
    can: {{bus: starboard, id: 2}}}}
  rl: {{type: caster/swivel, mount: frame.rear_left}}
  rr: {{type: caster/swivel, mount: frame.rear_right}}
"""
DRIVES = {
    "CiA 402": ", params: {controller: controller/cia402_propulsion_steering}",
    "Thorvald script": "",
}
both = pytest.mark.parametrize("drives", mostly_exhaustive(DRIVES))


def robot(drives: str) -> Robot:
    return compiled(ROBOT.format(drives=DRIVES[drives]))


class Drive:
    """The straight drive of a rig, with the paths of its wheels from the loss of the bus on."""

    def __init__(self, drives: str) -> None:
        self.rig = Rig(robot(drives))
        self.rig.drive(Twist(SPEED, 0.0, 0.0), 2.0)
        self.wheels = [w for w in self.rig.robot.wheels if w.driven]
        self._begin = self._positions()
        self.yaw = 0.0
        """Largest yaw (rad) so far."""

    def _positions(self) -> list[float]:
        motors = [self.rig.robot.actuator_of(wheel.spin_joint) for wheel in self.wheels]
        return [
            self.rig.simulated.motors[motor.name].read(self.rig.now).position * wheel.radius
            for motor, wheel in zip(motors, self.wheels, strict=True)
            if motor is not None
        ]

    @property
    def paths(self) -> list[float]:
        return [b - a for a, b in zip(self._begin, self._positions(), strict=True)]

    def until_rest(self) -> float:
        """Returns the time (s) until all wheels stand."""
        start = self.rig.now
        while self.rig.speed() > 0.01:
            self.rig.run(0.02)
            left, right = self.paths
            track = self.wheels[0].y - self.wheels[1].y
            self.yaw = max(self.yaw, abs(left - right) / track)
            assert self.rig.now - start < 3.0
        return self.rig.now - start


def bound(drives: str, kind: str) -> float:
    return next(b.yaw for b in swerve_bounds(robot(drives)) if b.kind == kind)


@both
@pytest.mark.parametrize("side", mostly_slow(["port", "starboard"]))
@pytest.mark.parametrize("how", ["bus-off", "unplugged"])
def test_all_wheels_stop_together(drives: str, side: str, how: str) -> None:
    drive = Drive(drives)
    rig = drive.rig
    if how == "bus-off":
        rig.interfaces[side].controller.go_bus_off()
    else:
        connection = next(c for c in rig.base.connections if c.bus.name == side)
        connection.receiver.lost = "the adapter is unplugged"
    time = drive.until_rest()
    assert rig.state is BaseState.FAULT
    assert drive.yaw <= bound(drives, BUS_LOST) < math.radians(9.0)
    limit = stop_bound(rig.robot, DRIVER_DEAD)
    assert time <= limit.time
    assert max(drive.paths) <= limit.distance
    rig.run(1.0)
    assert rig.speed() == 0.0


@both
def test_a_silent_bus_stops_the_other_wheels_at_once(drives: str) -> None:
    """The drives may have lost their power: the robot must not go further than it has to."""
    drive = Drive(drives)
    fault = BusFault("lost_frames", "starboard", None, 0.0, None, SPAN, share=1.0)
    FaultInjector(drive.rig.simulated, BusFaults(())).inject(fault)
    drive.until_rest()
    assert min(drive.paths) < 0.3
    assert bound(drives, BUS_LOST) < drive.yaw <= bound(drives, BUS_SILENT)


@both
def test_the_safety_stop_ends_the_delay(drives: str) -> None:
    drive = Drive(drives)
    drive.rig.interfaces["starboard"].controller.go_bus_off()
    drive.rig.run(0.1)
    assert drive.rig.speed() > 0.75
    drive.rig.driven.safety_stop()
    drive.until_rest()
    assert drive.rig.state is BaseState.ESTOP
    assert min(drive.paths) < 0.36


def test_a_robot_at_rest_does_not_move() -> None:
    rig = Rig(robot("CiA 402"))
    rig.ready()
    rig.arm()
    rig.interfaces["port"].controller.go_bus_off()
    for _ in range(50):
        rig.run(0.02)
        assert rig.speed() == 0.0
    assert rig.state is BaseState.FAULT
