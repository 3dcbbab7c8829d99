"""Records of runs: samples of robots at one time, and where they go."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TextIO

from thorvaldc.model import Robot
from thorvaldc.runtime.base import JointStates
from thorvaldc.runtime.se2 import Pose2, Twist


@dataclass(frozen=True, slots=True)
class Sample:
    """A robot at ``time`` (s).

    Poses: ``true_pose`` in the scene, ``odometry_pose`` where the robot started.  Twists of
    ``base_link``: ``asked`` in the script, ``commanded`` within the robot's ramps and limits,
    ``true_twist`` and ``odometry_twist``.  ``joints`` are those the driver is told,
    ``speeds`` and ``angles`` what it asked of them.  ``tilt`` in rad.
    """

    time: float
    robot: str
    true_pose: Pose2
    true_twist: Twist
    odometry_pose: Pose2
    odometry_twist: Twist
    asked: Twist
    commanded: Twist
    joints: JointStates
    speeds: Sequence[float]
    angles: Sequence[float]
    tilt: float

    def numbers(self) -> Iterator[float]:
        """All of it, for comparing runs."""
        yield self.time
        for part in (
            self.true_pose,
            self.true_twist,
            self.odometry_pose,
            self.odometry_twist,
            self.asked,
            self.commanded,
            self.joints.speeds,
            self.joints.positions or (),
            self.joints.angles,
            self.speeds,
            self.angles,
        ):
            yield from part
        yield self.tilt


class Recorder(Protocol):
    """What takes samples, each robot's in order of time.  ``close`` may be called twice."""

    def record(self, sample: Sample) -> None: ...

    def close(self) -> None: ...


class Digest:
    """A hash of every number of a run: equal for runs that are equal to the last bit."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()

    def record(self, sample: Sample) -> None:
        self._hash.update(sample.robot.encode())
        numbers = list(sample.numbers())
        self._hash.update(struct.pack(f"<{len(numbers)}d", *numbers))

    def close(self) -> None:
        return

    def hexdigest(self) -> str:
        return self._hash.hexdigest()


_TWIST = ("vx", "vy", "wz")
_POSE = ("x", "y", "yaw")


class CsvRecorder:
    """One CSV file for each robot in a folder, ``<robot>.csv``; SI units, a line a sample.

    ``groups`` are groups of columns: ``odometry``, ``truth``, ``twist`` (asked and
    commanded) and ``joints`` (by name; positions and velocities, then commands).
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

    def record(self, sample: Sample) -> None:
        due = self._next[sample.robot]
        if sample.time < due - 1e-9:
            return
        if self._every > 0.0:
            steps = int((sample.time + 1e-9) / self._every) + 1
            self._next[sample.robot] = steps * self._every
        values = _values(self._robots[sample.robot], sample, self._groups)
        self._files[sample.robot].write(",".join(map(_text, values)) + "\n")

    def close(self) -> None:
        while self._files:
            self._files.popitem()[1].close()


def columns(robot: Robot, groups: Sequence[str]) -> list[str]:
    """Names of the columns of a robot's record."""
    found = ["time"]
    if "odometry" in groups:
        found += [f"odometry_{part}" for part in (*_POSE, *_TWIST)]
    if "truth" in groups:
        found += [f"true_{part}" for part in (*_POSE, *_TWIST)] + ["tilt"]
    if "twist" in groups:
        found += [f"{what}_{part}" for what in ("asked", "commanded") for part in _TWIST]
    if "joints" in groups:
        for wheel in robot.wheels:
            if wheel.driven:
                joint = wheel.spin_joint
                found += [f"{joint}_position", f"{joint}_velocity", f"{joint}_command"]
            if wheel.steering_joint is not None:
                found += [f"{wheel.steering_joint}_position", f"{wheel.steering_joint}_command"]
    return found


def _values(robot: Robot, sample: Sample, groups: Sequence[str]) -> list[float]:
    found = [sample.time]
    if "odometry" in groups:
        found += [*sample.odometry_pose, *sample.odometry_twist]
    if "truth" in groups:
        found += [*sample.true_pose, *sample.true_twist, sample.tilt]
    if "twist" in groups:
        found += [*sample.asked, *sample.commanded]
    if "joints" in groups:
        joints = sample.joints
        positions = joints.positions or [0.0] * len(robot.wheels)
        for i, wheel in enumerate(robot.wheels):
            if wheel.driven:
                found += [positions[i], joints.speeds[i], sample.speeds[i]]
            if wheel.steering_joint is not None:
                found += [joints.angles[i], sample.angles[i]]
    return found


def _text(value: float) -> str:
    return f"{value:.9g}"
