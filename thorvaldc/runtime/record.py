"""Records of runs: what takes the samples of robots, and CSV files of them."""

from __future__ import annotations

import hashlib
import math
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Protocol, TextIO

from thorvaldc.model import Robot
from thorvaldc.runtime.base import JointCommands
from thorvaldc.runtime.meter import Sample


class Recorder(Protocol):
    """What takes the samples of a run, each robot's in order of time.

    ``commands`` are what the driver asked of the joints (``None``: nothing yet).  ``close``
    may be called twice.
    """

    def record(self, robot: str, sample: Sample, commands: JointCommands | None) -> None: ...

    def close(self) -> None: ...


class Digest:
    """A hash of every number of a run: equal for runs that are equal to the last bit."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()

    def record(self, robot: str, sample: Sample, commands: JointCommands | None) -> None:
        numbers = list(_numbers(sample, commands))
        self._hash.update(robot.encode() + struct.pack(f"<{len(numbers)}d", *numbers))

    def close(self) -> None:
        return

    def hexdigest(self) -> str:
        return self._hash.hexdigest()


def _numbers(sample: Sample, commands: JointCommands | None) -> Iterator[float]:
    yield sample.time
    for part in (sample.asked, sample.aimed, sample.estimated, sample.true):
        yield from part
    yield from sample.pose_estimated
    yield from sample.pose_true
    joints = sample.joints
    if joints is not None:
        for values in (joints.speeds, joints.angles, joints.angle_rates, joints.positions or ()):
            yield from values
    if commands is not None:
        yield from commands.speeds
        yield from commands.angles


_TWIST = ("vx", "vy", "wz")
_POSE = ("x", "y", "yaw")


class CsvRecorder:
    """One CSV file for each robot in a folder, ``<robot>.csv``; SI units, a line a sample.

    ``groups`` are groups of columns: ``odometry``, ``truth``, ``twist`` (asked for
    and aimed at) and ``joints`` (by name; positions and velocities, then commands).
    """

    def __init__(
        self,
        folder: Path,
        robots: Sequence[tuple[str, Robot]],
        groups: Sequence[str],
        every: float = 0.0,
    ) -> None:
        """Makes the folder and opens the files.  Raises ``OSError`` where that fails."""
        self._groups = groups
        self._every = every
        self._files: dict[str, TextIO] = {}
        self._next: dict[str, float] = {}
        folder.mkdir(parents=True, exist_ok=True)
        try:
            for name, robot in robots:
                path = folder / f"{name}.csv"
                file = path.open("w", encoding="utf-8", newline="\n")
                self._files[name] = file
                self._next[name] = 0.0
                file.write(",".join(columns(robot, groups)) + "\n")
                file.flush()
        except OSError:
            self.close()
            raise
        self._robots = dict(robots)

    def record(self, robot: str, sample: Sample, commands: JointCommands | None) -> None:
        due = self._next[robot]
        if sample.time < due - 1e-9:
            return
        if self._every > 0.0:
            steps = int((sample.time + 1e-9) / self._every) + 1
            self._next[robot] = steps * self._every
        values = _values(self._robots[robot], sample, commands, self._groups)
        self._files[robot].write(",".join(map(_text, values)) + "\n")

    def close(self) -> None:
        while self._files:
            self._files.popitem()[1].close()


def columns(robot: Robot, groups: Sequence[str]) -> list[str]:
    """Names of the columns of a robot's record."""
    found = ["time"]
    if "odometry" in groups:
        found += [f"odometry_{part}" for part in (*_POSE, *_TWIST)]
    if "truth" in groups:
        found += [f"true_{part}" for part in (*_POSE, *_TWIST)]
    if "twist" in groups:
        found += [f"{what}_{part}" for what in ("asked", "aimed") for part in _TWIST]
    if "joints" in groups:
        for wheel in robot.wheels:
            if wheel.driven:
                joint = wheel.spin_joint
                found += [f"{joint}_position", f"{joint}_velocity", f"{joint}_command"]
            if wheel.steering_joint is not None:
                found += [f"{wheel.steering_joint}_position", f"{wheel.steering_joint}_command"]
    return found


def _values(
    robot: Robot, sample: Sample, commands: JointCommands | None, groups: Sequence[str]
) -> Iterator[float]:
    yield sample.time
    if "odometry" in groups:
        yield from sample.pose_estimated
        yield from sample.estimated
    if "truth" in groups:
        yield from sample.pose_true
        yield from sample.true
    if "twist" in groups:
        yield from sample.asked
        yield from sample.aimed
    if "joints" in groups:
        joints, still = sample.joints, [math.nan] * len(robot.wheels)
        positions = (joints.positions if joints is not None else None) or still
        speeds, angles = (joints.speeds, joints.angles) if joints is not None else (still, still)
        for i, wheel in enumerate(robot.wheels):
            if wheel.driven:
                yield positions[i]
                yield speeds[i]
                yield commands.speeds[i] if commands is not None else math.nan
            if wheel.steered:
                yield angles[i]
                yield commands.angles[i] if commands is not None else math.nan


def _text(value: float) -> str:
    """Nine digits; nothing where there is no number."""
    return f"{value:.9g}" if math.isfinite(value) else ""
