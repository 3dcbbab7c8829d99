"""The simulated robot that a page drives, with the base driver and the physics of ``sim``.

A program with threads calls ``run`` in one of them; in a web browser, which has none, a timer calls
``advance``.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from thorvaldc.compiler.pipeline import emit_without_model
from thorvaldc.model import Fleet, Robot, robots_by_name
from thorvaldc.model.settings import AUTOMATIC
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.runtime.teleop_loop import FIRST_SHARE, Limits, Operation, Request, operate
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene

HOLD_TIME = 0.25
"""Time in s for which a motion from the page drives.  The page repeats a held motion 20 times per
second."""
GIVE_WAY = 0.1
"""Time in s for which the page commands zero after the robot was driven."""
PICTURE_PERIOD = 1 / 30
"""Time in s between two states for the page."""
SOURCE = "teleop_joy"
MAX_CYCLES = 5
"""Most control cycles in one call of ``advance``, so that a slow computer stays responsive."""
LONGEST_LAG = 0.5
"""Time in s by which a simulation without a thread can be late and still catch up."""

Send = Callable[[dict[str, Any]], None]


class PageOperator:
    """An operator who drives with a page.  The robot stops if the page sends no motions."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self.share = FIRST_SHARE
        self.message = ""
        self.finished = False
        self._motion = (0.0, 0.0, 0.0)
        self._received = -math.inf

    def move(self, x: float, y: float, yaw: float, now: float) -> None:
        """Stores a motion: fractions of the top speeds, between -1 and 1."""
        if all(math.isfinite(value) for value in (x, y, yaw)):
            self._motion = (_clamped(x), _clamped(y), _clamped(yaw))
            self._received = now

    def poll(self, now: float) -> list[Request]:
        return []

    def twist(self, now: float) -> Twist | None:
        age = now - self._received
        if age <= HOLD_TIME and not self.finished:
            return self.limits.twist(*self._motion, self.share)
        return ZERO_TWIST if age <= HOLD_TIME + GIVE_WAY else None

    def close(self) -> None:
        self.finished = True


def _clamped(value: float) -> float:
    return min(max(value, -1.0), 1.0)


class PageDrive:
    """A simulated robot that a page drives.  The other robots of a fleet stand in the scene.

    ``send`` is called by ``run`` and ``advance``: with the states of the robots, and once at the
    end.
    """

    def __init__(self, model: Robot | Fleet, name: str, send: Send) -> None:
        """Drives the robot ``name`` of the model, or its first robot without such a robot."""
        robots = robots_by_name(model)
        self._name = name if name in robots else next(iter(robots))
        self._model, self._robots, self._send = model, robots, send
        self._vehicle: _ShownRobot | None = None
        self._operator: PageOperator | None = None
        self._operation: Operation | None = None
        self._source = SOURCE
        self._ended = threading.Event()
        self._paced = 0.0  # real time (s) up to which the cycles have run, without a thread

    def move(self, x: float, y: float, yaw: float) -> None:
        """Drives for ``HOLD_TIME``."""
        if self._operator is not None:
            self._operator.move(x, y, yaw, time.monotonic())

    def close(self) -> None:
        """Stops the robot and ends the simulation."""
        self._ended.set()

    def run(self) -> None:
        """Drives the robot until ``close`` is called, and until it is at rest then."""
        text = ""
        try:
            vehicle, operator = self._begin(time.monotonic)
            try:
                operate(vehicle, operator, self._source, _show_nothing, self._ended.is_set)
            finally:
                vehicle.shutdown()
        except Exception as error:  # the page shows what ended the simulation
            text = f"the simulation ended: {error}"
        self._send({"kind": "drive", "on": False, "message": text})

    def advance(self) -> bool:
        """Runs the control cycles that are due, and returns whether the drive goes on.

        Cycles that are late, because the only thread has compiled meanwhile, run one after the
        other as if they were in time.  After ``close``, the robot comes to rest without waiting.
        """
        text = ""
        try:
            if self._vehicle is None or self._operation is None:
                self._paced = time.monotonic()
                self._vehicle, operator = self._begin(lambda: self._paced)
                self._operation = Operation(
                    self._vehicle, operator, self._source, _show_nothing, time.monotonic
                )
            now = time.monotonic()
            self._paced = max(self._paced, now - LONGEST_LAG)
            for _ in range(MAX_CYCLES):
                self._paced = min(self._paced + max(self._vehicle.wait(), 0.0), now)
                if self._ended.is_set() or self._vehicle.wait() > 0.0:
                    break
                self._operation.cycle()
            if not self._ended.is_set():
                return True
            self._vehicle.shutdown()
        except Exception as error:  # the page shows what ended the simulation
            text = f"the simulation ended: {error}"
        self._send({"kind": "drive", "on": False, "message": text})
        return False

    def _begin(self, real_time: Callable[[], float]) -> tuple[_ShownRobot, PageOperator]:
        robot = self._robots[self._name]
        scene = MujocoScene(emit_without_model(self._model, ["mjcf"]))
        vehicle = _ShownRobot(robot, scene, self._name, self._robots, self._send, real_time)
        description = vehicle.call("description")
        sources = description["sources"]
        if SOURCE not in sources:
            self._source = next(iter(sources))
        self._operator = PageOperator(Limits.of(description))
        self._send({"kind": "drive", "on": True, "message": "ready"})
        return vehicle, self._operator


def _show_nothing(lines: list[str]) -> None:
    """The page shows the states of the robot, not the status lines of a terminal."""


class _ShownRobot(DrivenRobot):
    """A simulated robot that sends its state, and the poses of all robots, to the page."""

    def __init__(
        self,
        robot: Robot,
        scene: MujocoScene,
        name: str,
        robots: Mapping[str, Robot],
        send: Send,
        real_time: Callable[[], float],
    ) -> None:
        super().__init__(robot, MujocoBase(robot, scene), arming=AUTOMATIC, real_time=real_time)
        self._scene, self._name, self._send = scene, name, send
        self._bodies = {
            name: scene.index("body", other.prefix + other.links[0].name, other)
            for name, other in robots.items()
        }
        self._joints = [
            (joint.name, int(scene.model.jnt_qposadr[index]))
            for joint in robot.joints
            if joint.type != "fixed" and joint.mimic is None
            for index in [scene.index("joint", robot.prefix + joint.name, robot)]
        ]
        self._shown = -math.inf

    def step(self) -> None:
        super().step()
        if self.now - self._shown < PICTURE_PERIOD:
            return
        self._shown = self.now
        data = self._scene.data
        state = self.call("state")
        self._send(
            {
                "kind": "state",
                "robot": self._name,
                "time": self.now,
                "poses": {
                    name: [*data.xpos[body].tolist(), *data.xquat[body].tolist()]
                    for name, body in self._bodies.items()
                },
                "joints": {name: float(data.qpos[index]) for name, index in self._joints},
                "twist": state["in_force"],
                "odometry": state["pose"],
            }
        )
