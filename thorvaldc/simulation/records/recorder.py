"""The interface of recorders, and the hash of a run."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Sequence
from typing import Protocol

from thorvaldc.runtime.base_interface import JointCommands
from thorvaldc.simulation.control_loop import ControlLoop, Sample, TickCallback


class Recorder(Protocol):
    """A recorder receives the samples of a run.

    The samples of a robot arrive in the order of their times.  ``commands`` are the joint commands
    of the driver, or ``None`` before the first command.  The method ``close`` of a recorder may be
    called twice.
    """

    def record(self, robot: str, sample: Sample, commands: JointCommands | None) -> None: ...

    def close(self) -> None: ...


def record_ticks(recorders: Sequence[Recorder]) -> TickCallback:
    """Returns a callback that passes the sample of each tick to all recorders."""

    def on_tick(loop: ControlLoop) -> None:
        sample, command = loop.sample(), loop.driver.state.command
        for recorder in recorders:
            recorder.record(loop.name, sample, None if command is None else command.joints)

    return on_tick


class SampleInterval:
    """Selects the samples to record.

    One sample of each robot is recorded in each interval of ``every`` s.  If ``every`` is 0, all
    samples are recorded.
    """

    def __init__(self, every: float) -> None:
        self._every = every
        self._next: dict[str, float] = {}

    def is_due(self, robot: str, time: float) -> bool:
        """Returns true if the sample of the robot at ``time`` (s) must be recorded."""
        if self._every <= 0.0:
            return True
        if time < self._next.get(robot, 0.0) - 1e-9:
            return False
        self._next[robot] = (int((time + 1e-9) / self._every) + 1) * self._every
        return True


class RunHash:
    """A recorder that computes a hash of every number of a run.

    Two runs with the same hash have the same numbers to the last bit.
    """

    def __init__(self) -> None:
        self._hash = hashlib.sha256()

    def record(self, robot: str, sample: Sample, commands: JointCommands | None) -> None:
        numbers = _numbers(sample, commands)
        self._hash.update(robot.encode() + struct.pack(f"<{len(numbers)}d", *numbers))

    def close(self) -> None:
        return

    def hexdigest(self) -> str:
        """Returns the SHA-256 hash of all samples that the recorder received."""
        return self._hash.hexdigest()


def _numbers(sample: Sample, commands: JointCommands | None) -> list[float]:
    numbers = [
        sample.time,
        *sample.commanded,
        *sample.limited,
        *sample.estimated,
        *sample.true,
        *sample.pose_estimated,
        *sample.pose_true,
    ]
    joints = sample.joints
    if joints is not None:
        numbers += [*joints.speeds, *joints.angles, *joints.angle_rates, *(joints.positions or ())]
        if joints.yaw_rate is not None:
            numbers.append(joints.yaw_rate)
    if commands is not None:
        numbers += [*commands.speeds, *commands.angles]
    return numbers
