"""A robot that runs on its simulated buses, in virtual time and in one thread."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from thorvaldc.can.frame import CanFrame
from thorvaldc.model import Robot
from thorvaldc.model.scenario import Quirk
from thorvaldc.runtime.base_interface import BaseHandle
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.can_base.can_base import CanBase
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.simulation.bus.motor_wiring import Wiring
from thorvaldc.simulation.bus.simulated_robot import Memory, SimulatedRobot

FORWARD = Twist(0.5, 0.0, 0.0)


class Rig:
    """A running robot with its simulated bus.

    ``twist`` is commanded in every cycle; ``None``: no command.  ``frames`` has time (ns) and frame
    of all traffic on the first bus.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        seed: int = 0,
        base: BaseHandle | None = None,
        power: bool = True,
        drives: Robot | None = None,
        quirks: Iterable[Quirk] = (),
        wiring: Mapping[str, Wiring] | None = None,
        memory: Memory | None = None,
    ) -> None:
        """``drives``: robot whose devices are on the bus; ``None``: those of ``robot``."""
        self.robot = robot
        self.simulated = SimulatedRobot(
            drives or robot,
            seed=seed,
            base=base,
            nonvolatile=memory,
            quirks=quirks,
            wiring=wiring,
        )
        if power:
            self.simulated.power_on()
        self.interfaces = {
            bus.name: self.simulated.interface(bus.name, fifo=True) for bus in robot.buses
        }
        self.base = CanBase(robot, self.interfaces, threaded=False)
        self.interface = next(iter(self.interfaces.values()))
        self.driven = DrivenRobot(robot, self.base, self.interface)
        self.driven.before_cycle = self._operate
        self.homes = True
        """``True`` if an operator homes the steering as soon as the robot has started."""
        self.twist: Twist | None = ZERO_TWIST
        self.driven.feed = self._command
        self.frames: list[tuple[int, CanFrame]] = []
        wire = self.simulated.wire()
        wire.observers.append(lambda time, frame, _: self.frames.append((time, frame)))

    def _command(self, driver: BaseDriver, now: float) -> None:
        if self.twist is not None:
            driver.command(self.twist, now)

    @property
    def now(self) -> float:
        return self.interface.now

    @property
    def state(self) -> BaseState:
        return self.base.state

    @property
    def reason(self) -> str:
        return self.base.state_machine.reason

    def run(self, seconds: float) -> None:
        self.driven.run(self.now + seconds)

    def until(self, condition: Callable[[], bool], limit: float = 30.0) -> float:
        """Runs until ``condition()`` is true; returns the time (s) that this took."""
        start = self.now
        self.driven.run(start + limit, stop=condition)
        assert condition(), f"not within {limit} s: {self.state} {self.reason}"
        return self.now - start

    def ready(self) -> None:
        self.until(lambda: self.state is BaseState.READY)
        self.run(0.1)

    def _operate(self, now: float) -> None:
        if self.homes and self.state is BaseState.STANDBY:
            self.driven.home_steering()

    def arm(self) -> None:
        """Arms the robot as an operator does, while zero is commanded."""
        self.twist = ZERO_TWIST
        self.run(0.1)
        self.driven.arm()

    def stall(self, seconds: float, step: float = 0.01) -> list[float]:
        """Lets virtual time pass without a control cycle, as if the driver's process was stopped.

        Returns the true speeds (m/s), see ``speed``, after each ``step`` s.
        """
        speeds, end = [], self.now + seconds
        while self.now < end - 1e-9:
            self.interface.sleep_until(min(self.now + step, end))
            speeds.append(self.speed())
        return speeds

    def drive(self, twist: Twist = FORWARD, seconds: float = 2.0) -> None:
        """Waits until the robot is ready, arms it, and drives."""
        if not self.driven.ready:
            self.ready()
        if not self.driven.armed:
            self.arm()
        self.twist = twist
        self.run(seconds)
        assert self.state is BaseState.ACTIVE, f"{self.state} {self.reason}"

    def speed(self) -> float:
        """Returns the true speed (m/s) of the fastest wheel, from its simulated motor."""
        speeds = []
        for wheel in self.robot.wheels:
            actuator = self.robot.actuator_of(wheel.spin_joint)
            if actuator is not None and actuator.name in self.simulated.motors:
                motor = self.simulated.motors[actuator.name]
                speeds.append(abs(motor.read(self.now).velocity) * wheel.radius)
        return max(speeds)
