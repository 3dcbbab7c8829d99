"""Runs schedules, each in its own process that is copied from a prepared robot.

``os.fork`` copies a process with a robot that is ready, so that no mission waits for a start-up.
The copy runs one mission, writes its result into a pipe, and ends.
"""

from __future__ import annotations

import gc
import json
import os
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tests.chaos.chaos_robots import chaos_robot
from tests.chaos.chaos_world import ChaosWorld
from tests.chaos.invariants import Violation
from tests.chaos.schedule import READY, Schedule
from tests.runtime.exploration import small_classes
from thorvaldc.model.settings import AUTOMATIC

SNAPSHOT_SEED = 7
_PREPARED: dict[str, ChaosWorld] = {}


@dataclass(frozen=True)
class Outcome:
    """Result of a schedule.

    - ``invariant``: name of the violated invariant, or empty.
    - ``text``: description of the violation.
    - ``time``: time (s) of the violation.
    - ``seconds``: simulated time (s).
    - ``digest``: number that is equal for equal runs.
    """

    invariant: str = ""
    text: str = ""
    time: float = 0.0
    seconds: float = 0.0
    digest: str = ""

    @property
    def holds(self) -> bool:
        return not self.invariant


def prepared_world(robot: str) -> ChaosWorld:
    """Returns a world whose robot is ready; made once in this process."""
    world = _PREPARED.get(robot)
    if world is None:
        world = _PREPARED[robot] = ChaosWorld(robot, SNAPSHOT_SEED)
        world.prepare()
        gc.collect()
        getattr(gc, "freeze", gc.collect)()  # PyPy has no gc.freeze
    return world


def run_here(schedule: Schedule, world: ChaosWorld | None = None) -> Outcome:
    """Runs a schedule in this process.  A mission from ready uses up the world."""
    if world is None:
        world = ChaosWorld(schedule.robot, _device_seed(schedule), schedule.start)
        if schedule.start == READY:
            world.prepare()
    start = world.now
    try:
        result = world.run(schedule)
    except Violation as violation:
        return Outcome(
            violation.invariant, violation.text, violation.time, world.now - start, world.digest()
        )
    except Exception as error:  # any exception in the process of the driver is a violation
        where = "".join(traceback.format_exc(limit=-4))
        text = f"{type(error).__name__}: {error}\n{where}"
        return Outcome("exception", text, world.now - start, world.now - start)
    return Outcome(seconds=result["seconds"], digest=result["digest"])


def _device_seed(schedule: Schedule) -> int:
    return SNAPSHOT_SEED if schedule.start == READY else schedule.seed


def run_schedule(schedule: Schedule) -> Outcome:
    """Runs a schedule in a copy of this process."""
    small_classes(chaos_robot(schedule.robot).driver.arming == AUTOMATIC)  # the copy has them too
    world = prepared_world(schedule.robot) if schedule.start == READY else None
    return in_copy(lambda: run_here(schedule, world))


def in_copy(work: Callable[[], Outcome]) -> Outcome:
    """Runs a function in a copy of this process, and returns its result."""
    readable, writable = os.pipe()
    child = os.fork()
    if child == 0:
        status = 1
        try:
            gc.disable()
            os.close(readable)
            data = json.dumps(work().__dict__).encode()
            while data:
                data = data[os.write(writable, data) :]
            status = 0
        finally:
            os._exit(status)
    os.close(writable)
    with os.fdopen(readable, "rb") as stream:
        data = stream.read()
    os.waitpid(child, 0)
    if not data:
        return Outcome("exception", "the process of the mission ended without a result")
    values: dict[str, Any] = json.loads(data)
    return Outcome(**values)
