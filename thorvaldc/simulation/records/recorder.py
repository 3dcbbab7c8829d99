"""Recorders: the interface that takes the samples of a run, and the hash of a run."""

from __future__ import annotations

import contextlib
import hashlib
import os
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Protocol

from thorvaldc.runtime.base_interface import JointCommands
from thorvaldc.simulation.control_loop import ControlLoop, Sample, TickCallback


class Recorder(Protocol):
    """Takes the samples of a run, those of each robot in order of time.

    ``commands`` are the joint commands of the driver (``None`` before the first command).
    ``close`` may be called twice.
    """

    def record(self, robot: str, sample: Sample, commands: JointCommands | None) -> None: ...

    def close(self) -> None: ...


def record_ticks(recorders: Sequence[Recorder]) -> TickCallback:
    """Returns a callback of a run that passes each tick to the recorders."""

    def on_tick(loop: ControlLoop) -> None:
        sample, command = loop.sample(), loop.driver.state.command
        for recorder in recorders:
            recorder.record(loop.name, sample, None if command is None else command.joints)

    return on_tick


@contextlib.contextmanager
def errors_with_name(path: Path) -> Iterator[None]:
    """Puts the name of the file into each ``OSError`` of the block.

    Errors of ``write`` and ``close`` (a full disk) have no file name of their own.
    """
    try:
        yield
    except OSError as error:
        number = error.errno or 0
        raise OSError(number, error.strerror or os.strerror(number), str(path)) from None


class SampleInterval:
    """Selects the samples to record: one in ``every`` s of each robot, all samples for 0."""

    def __init__(self, every: float) -> None:
        self._every = every
        self._next: dict[str, float] = {}

    def is_due(self, robot: str, time: float) -> bool:
        """Reports if the sample at ``time`` (s) is to be recorded."""
        if self._every <= 0.0:
            return True
        if time < self._next.get(robot, 0.0) - 1e-9:
            return False
        self._next[robot] = (int((time + 1e-9) / self._every) + 1) * self._every
        return True


class RunHash:
    """A recorder that hashes every number of a run: equal hashes mean bit-equal runs."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()

    def record(self, robot: str, sample: Sample, commands: JointCommands | None) -> None:
        numbers = _numbers(sample, commands)
        self._hash.update(robot.encode() + struct.pack(f"<{len(numbers)}d", *numbers))

    def close(self) -> None:
        return

    def hexdigest(self) -> str:
        """Returns the SHA-256 of all samples so far."""
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
